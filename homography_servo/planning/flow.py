"""
Go along the path without stopping: the next poses as one timed trajectory.

With every look the joints of the next poses are solved anew in the corrected model,
and timed from where and how fast the arm is: as fast as joints and tracker allow, and
so that it could come to rest at the last pose sent. So an arm that hears nothing more
stands still by itself, a fraction of a second later.

Speeds are shares of the full speed: a share of 1 means that one joint goes as fast as
it may.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.command import Command
from homography_servo.planning.control import damped_step
from homography_servo.planning.control import displacement
from homography_servo.robot.robot_file import Robot
import numpy as np

AHEAD = 10  # poses sent at once
LEAD_S = 0.04  # a pose nearer than this in time is as good as passed
NEWTON_STEPS = 2
EXACT_BELOW_RAD = 1e-3  # a step so small leaves less than a thousandth of itself to the next
ACCELERATION_SHARE = 0.6  # the rest is for bends and for corrections
LARGEST_STEP_RAD = 0.3
SHORTEST_S = 1e-3


class Timed(NamedTuple):
    """When points are passed, and how fast."""

    times_s: np.ndarray  # (K,) from now
    velocities_rad_s: np.ndarray  # (K, n)
    shares: np.ndarray  # (K,)


def timed(robot: Robot, here_rad: np.ndarray, share: float, points_rad: np.ndarray,
          caps: np.ndarray) -> Timed:
    """
    Time a way through points, at rest at the last one.

    Parameters
    ----------
    robot : Robot
        Limits.
    here_rad : (n,) array
        Where the joints are now.
    share : float
        How fast they are now.
    points_rad : (K, n) array
        Where they go.
    caps : (K,) array
        Largest share on the way to each point.

    """
    steps = np.diff(np.vstack([here_rad, points_rad]), axis=0)
    length = np.maximum(np.abs(steps / robot.velocity_rad_s).max(axis=1), 1e-5)
    along = steps / length[:, None]
    gain = ACCELERATION_SHARE * float((robot.acceleration_rad_s2 / robot.velocity_rad_s).min())
    shares = _shares(length, along / robot.velocity_rad_s, caps, share, gain)
    mean = 0.5 * (np.concatenate([[share], shares[:-1]]) + shares)
    mean = np.maximum(mean, 0.5 * np.sqrt(gain * length))  # from rest to rest in one piece
    times_s = np.cumsum(np.maximum(length / mean, SHORTEST_S))
    bends = 0.5 * (along + np.vstack([along[1:], along[-1:]]))
    return Timed(times_s, bends * shares[:, None], shares)


def _shares(length: np.ndarray, direction: np.ndarray, caps: np.ndarray, share: float,
            gain: float) -> np.ndarray:
    """Give the speed at each point: capped, slow in bends, then within the acceleration."""
    shares = np.minimum(caps, np.append(caps[1:], caps[-1]))
    bend = np.abs(np.diff(direction, axis=0)).max(axis=1)
    slow = np.sqrt(gain * 0.5 * (length[1:] + length[:-1]) / np.maximum(bend, 1e-6))
    shares[:-1] = np.minimum(shares[:-1], slow)
    shares[-1] = 0.0
    for k in range(len(shares) - 2, -1, -1):
        shares[k] = min(shares[k], np.sqrt(shares[k + 1] ** 2 + 2.0 * gain * length[k + 1]))
    before = share
    for k in range(len(shares)):
        shares[k] = before = min(shares[k], np.sqrt(before ** 2 + 2.0 * gain * length[k]))
    return shares


class Flow:
    """
    The stream of commands along a path.

    Parameters
    ----------
    robot : Robot
        Limits.
    path : (N, 4, 4) array
        Poses, all of them.
    index : int
        The pose to go to first.
    margin_rad : float
        Distance kept from joint limits.

    """

    def __init__(self, robot: Robot, path: np.ndarray, index: int, margin_rad: float) -> None:
        self._robot, self._path, self._margin_rad = robot, path, margin_rad
        self.index = index
        self.sent_s = -np.inf
        self._joints_rad: dict[int, np.ndarray] = {}
        self.ends = False  # what was sent reaches the end of the path
        self._sent_index, self._began_share = index, 0.0
        self._times_s, self._shares = np.zeros(0), np.zeros(0)

    @property
    def ends_s(self) -> float:
        """Give the time at which what was sent comes to rest."""
        return self.sent_s + (self._times_s[-1] if len(self._times_s) else 0.0)

    def follow(self, path: np.ndarray, index: int) -> None:
        """Go over to another path without a stop."""
        self._path, self.index, self._joints_rad, self.ends = path, index, {}, False

    def _share(self, now_s: float) -> float:
        if not len(self._times_s):
            return 0.0
        return float(np.interp(now_s - self.sent_s, np.append(0.0, self._times_s),
                               np.append(self._began_share, self._shares)))

    def advance(self, now_s: float) -> None:
        """Leave behind the poses that are passed by now."""
        passed = int(np.searchsorted(self._times_s, now_s - self.sent_s + LEAD_S))
        self.index = max(self.index, min(self._sent_index + passed, len(self._path) - 1))

    def command(self, model: ArmModel, here_rad: np.ndarray, speed_share: float,
                px_per_ray: float, corner_speed_px_s: float, now_s: float) -> Command | None:
        """
        Give the next points, None when a joint limit is in the way.

        Parameters
        ----------
        model : ArmModel
            The corrected arm.
        here_rad : (n,) array
            Joints now.
        speed_share : float
            Largest share of the speed limits.
        px_per_ray, corner_speed_px_s : float
            Focal length, and the largest speed of a corner in the image.
        now_s : float
            Steady time.

        """
        window = range(self.index, min(self.index + AHEAD, len(self._path)))
        points = self._solve(model, here_rad, window)
        free = self._inside(points)
        if not free[0]:
            return None
        points = points[:len(points) if free.all() else int(np.argmin(free))]
        share = self._share(now_s)
        caps = self._caps(model, here_rad, points, speed_share, px_per_ray, corner_speed_px_s)
        way = timed(self._robot, here_rad, share, points, caps)
        self.sent_s, self._sent_index, self._began_share = now_s, self.index, share
        self._times_s, self._shares = way.times_s, way.shares
        self.ends = self.index + len(points) == len(self._path)
        return Command(points, way.times_s, way.velocities_rad_s)

    def _solve(self, model: ArmModel, here_rad: np.ndarray, window: range) -> np.ndarray:
        known, last = [], here_rad
        for index in window:
            last = self._joints_rad.get(index, last)
            known.append(last)
        joints, goals = np.array(known), self._path[window.start:window.stop]
        for _ in range(NEWTON_STEPS if window[-1] in self._joints_rad else 3 * NEWTON_STEPS):
            poses, jacobians = model.posture(joints)
            step = damped_step(jacobians, displacement(poses, goals))
            largest = np.abs(step).max(axis=1, keepdims=True)
            joints = joints + step * np.minimum(1.0, LARGEST_STEP_RAD / np.maximum(largest, 1e-9))
            if largest.max() < EXACT_BELOW_RAD:
                break
        self._joints_rad = dict(zip(window, joints))
        return joints

    def _inside(self, points_rad: np.ndarray) -> np.ndarray:
        low, high = self._robot.lower_rad, self._robot.upper_rad
        return np.all((points_rad >= low + self._margin_rad)
                      & (points_rad <= high - self._margin_rad), axis=1)

    def _caps(self, model: ArmModel, here_rad: np.ndarray, points_rad: np.ndarray,
              speed_share: float, px_per_ray: float, corner_speed_px_s: float) -> np.ndarray:
        joints = np.vstack([here_rad, points_rad])
        poses = model.pose(joints)
        points = self._robot.object_points_m @ np.swapaxes(poses[:, :3, :3], 1, 2) \
            + poses[:, None, :3, 3]
        rays = points[..., :2] / np.maximum(points[..., 2:] + self._robot.home_depth_m, 0.05)
        travel_px = px_per_ray * np.linalg.norm(np.diff(rays, axis=0), axis=2).max(axis=1)
        length = np.abs(np.diff(joints, axis=0) / self._robot.velocity_rad_s).max(axis=1)
        by_tracker = corner_speed_px_s * length / np.maximum(travel_px, 1e-6)
        return np.maximum(np.minimum(speed_share, by_tracker), 0.01)
