"""
Go along the path without stopping: the next poses as one timed trajectory.

With every look the joints of the next poses are solved anew in the corrected model,
and timed from where and how fast the arm is: as fast as joints and tracker allow, and
so that it could come to rest at the last pose sent. So an arm that hears nothing more
stands still by itself, a fraction of a second later. Of a path with poses close together
some are left out, so that what is sent reaches far enough to go at full speed.

Speeds are shares of the full speed: a share of 1 means that one joint goes as fast as
it may.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.command import Command
from homography_servo.planning.control import damped_step
from homography_servo.planning.control import displacement
from homography_servo.planning.control import LENGTH_M
from homography_servo.planning.control import rays_at
from homography_servo.planning.servo_moves import ARRIVED_RAD
from homography_servo.planning.servo_moves import OVERDUE_S
from homography_servo.robot.robot_file import Robot
import numpy as np

LEAST_AHEAD, AHEAD = 3, 10  # poses sent at once
REACH_S = 0.3  # at full speed, from the first pose; 0.2 are needed to come to rest
LEAD_S = 0.04  # a pose nearer than this in time is as good as passed
NEWTON_STEPS = 6
EXACT_BELOW_RAD = 0.01  # a step so small leaves a hundredth of itself, to the next look
ACCELERATION_SHARE = 0.6  # the rest is for bends and for corrections
LARGEST_STEP_RAD = 0.3
SHORTEST_S, SHORTEST_M = 1e-3, 1e-5
NEAREST_M = 0.05  # depth of what is nearer: its way in the image would be without bound


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
    squares, gained = (shares ** 2).tolist(), (2.0 * gain * length).tolist()
    squares[-1] = 0.0
    for k in range(len(squares) - 2, -1, -1):
        squares[k] = min(squares[k], squares[k + 1] + gained[k + 1])
    before = share ** 2
    for k, gain_here in enumerate(gained):
        squares[k] = before = min(squares[k], before + gain_here)
    return np.sqrt(squares)


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
        self._robot, self._margin_rad = robot, margin_rad
        self.sent_s = -np.inf
        self.ends = False  # what was sent reaches the end of the path
        self._began_share = 0.0
        self._left_rad: np.ndarray | None = None  # where the arm was last seen to move
        self._left_due_s = math.inf  # when what was sent there was to end
        self._times_s, self._shares = np.zeros(0), np.zeros(0)
        self.follow(path, index)

    @property
    def ends_s(self) -> float:
        """Give the time at which what was sent comes to rest."""
        return self.sent_s + (self._times_s[-1] if len(self._times_s) else 0.0)

    @property
    def last(self) -> int:
        """Give the pose at which what was sent comes to rest."""
        return int(self._sent[-1]) if len(self._sent) else self.index

    def follow(self, path: np.ndarray, index: int) -> None:
        """Go over to another path without a stop."""
        self._path, self.index, self.ends = path, index, False
        self._corners = self._rays(path)
        away = displacement(path[:-1], path[1:])
        self._way_m = np.append(0.0, np.cumsum(
            np.hypot(np.linalg.norm(away[:, :3], axis=1),
                     LENGTH_M * np.linalg.norm(away[:, 3:], axis=1))))
        self._s_per_m = 0.0  # of way at full speed; 0 until it is known
        self._sent = np.zeros(0, dtype=int)  # poses that the last command goes through
        # What was solved last: poses of the path, and their joints.
        self._window, self._joints_rad = self._sent, np.zeros((0, self._robot.count))

    def unheeded(self, now_s: float) -> bool:
        """Tell whether the arm has not begun what it should have ended long ago."""
        return now_s > self._left_due_s + OVERDUE_S

    def _share(self, now_s: float) -> float:
        if not len(self._times_s):
            return 0.0
        return float(np.interp(now_s - self.sent_s, np.append(0.0, self._times_s),
                               np.append(self._began_share, self._shares)))

    def advance(self, now_s: float) -> None:
        """Leave behind the poses that are passed by now."""
        sent = self._sent
        if not len(sent):
            return
        passed = np.interp(now_s - self.sent_s + LEAD_S, self._times_s, sent, right=sent[-1] + 1)
        self.index = max(self.index, min(int(np.ceil(passed)), len(self._path) - 1))

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
        self._solve(model, here_rad)
        points = self._inside(self._joints_rad)
        if not len(points):
            return None
        share = self._share(now_s)
        lengths_s = self._lengths_s(np.vstack([here_rad, points]))
        travel_px = px_per_ray * self._travel(model.pose(here_rad), len(points))
        by_tracker = corner_speed_px_s * lengths_s / np.maximum(travel_px, 1e-6)
        caps = np.maximum(np.minimum(speed_share, by_tracker), 0.01)
        way = timed(self._robot, here_rad, share, points, caps)
        if self._left_rad is None or np.abs(here_rad - self._left_rad).max() > ARRIVED_RAD:
            self._left_rad, self._left_due_s = here_rad, now_s + float(way.times_s[-1])
        self.sent_s, self._began_share = now_s, share
        self._times_s, self._shares = way.times_s, way.shares
        self._sent = sent = self._window[:len(points)]
        self.ends = bool(sent[-1] == len(self._path) - 1)
        way_m = self._way_m[sent[-1]] - self._way_m[sent[0]]
        if way_m > SHORTEST_M:
            self._s_per_m = lengths_s[1:].sum() / way_m
        return Command(points, way.times_s, way.velocities_rad_s)

    def _ahead(self) -> np.ndarray:
        """Choose the poses within reach: the next, the farthest, not too many between."""
        way, last = self._way_m, len(self._path) - 1
        farthest = self.index + AHEAD - 1
        if self._s_per_m > 0.0:
            farthest = int(np.searchsorted(way, way[self.index] + REACH_S / self._s_per_m))
        farthest = min(max(farthest, self.index + LEAST_AHEAD - 1), last)
        stride = math.ceil((farthest + 1 - self.index) / AHEAD)
        if stride == 1:
            return np.arange(self.index, farthest + 1)
        even = np.append(np.arange(self.index, farthest, stride), farthest)
        marks_m = np.linspace(way[self.index], way[farthest], len(even))
        return np.unique(np.clip(np.searchsorted(way, marks_m - 1e-9), self.index, farthest))

    def _solve(self, model: ArmModel, here_rad: np.ndarray) -> None:
        """Find the joints of the poses ahead, from those that were found before."""
        window, before, known = self._ahead(), self._window, self._joints_rad
        if len(known):
            joints = np.array([np.interp(window, before, column) for column in known.T]).T
        else:
            joints = np.repeat(here_rad[None], len(window), axis=0)
        for _ in range(NEWTON_STEPS):
            poses, jacobians = model.posture(joints)
            step = damped_step(jacobians, displacement(poses, self._path[window]))
            largest = np.abs(step).max(axis=1, keepdims=True)
            joints = joints + step * np.minimum(1.0, LARGEST_STEP_RAD / np.maximum(largest, 1e-9))
            if largest.max() < EXACT_BELOW_RAD:
                break
        self._window, self._joints_rad = window, joints

    def _inside(self, points_rad: np.ndarray) -> np.ndarray:
        """Give the points before the first one that is too near to a joint limit."""
        low, high = self._robot.lower_rad, self._robot.upper_rad
        free = np.all((points_rad >= low + self._margin_rad)
                      & (points_rad <= high - self._margin_rad), axis=1)
        return points_rad if free.all() else points_rad[:int(np.argmin(free))]

    def _lengths_s(self, joints_rad: np.ndarray) -> np.ndarray:
        """Give how long the ways between postures take at full speed."""
        return np.abs(np.diff(joints_rad, axis=0) / self._robot.velocity_rad_s).max(axis=1)

    def _rays(self, poses: np.ndarray) -> np.ndarray:
        """Project the corners (..., P, 2) of the object at poses (..., 4, 4)."""
        return rays_at(poses, self._robot.object_points_m, self._robot.home_depth_m, NEAREST_M)

    def _travel(self, here: np.ndarray, count: int) -> np.ndarray:
        """Give how far the fastest corner goes from here to each of the poses ahead."""
        rays = np.concatenate([self._rays(here)[None], self._corners[self._window[:count]]])
        way = np.diff(rays, axis=0)
        return np.sqrt((way * way).sum(axis=2).max(axis=1))
