"""What is to be planned, and the few things that every planning method does with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.path import choose_count
from homography_servo.geometry.path import interpolate
from homography_servo.geometry.rigid import inverse as inverted
from homography_servo.geometry.rigid import pose_difference
from homography_servo.planning.checks import same_posture
from homography_servo.planning.feasibility import check_path
from homography_servo.planning.feasibility import look
from homography_servo.planning.follow import path_lengths
from homography_servo.planning.settings import PlannerSettings
from homography_servo.planning.verdict import Verdict
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.kinematics import inverse
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
import numpy as np

MOST_POSES = 2000


class Proposal(NamedTuple):
    """A path to be checked, or the reason why there is none."""

    name: str
    poses: np.ndarray | None  # (N, 4, 4) home_from_object
    joints_rad: np.ndarray | None = None  # (N, n) where they lead the way
    reason: str = ''


@dataclass(frozen=True, eq=False)
class Task:
    """A start, a goal, and what is known of camera, object and arm."""

    start: np.ndarray  # (4, 4) home_from_object, measured
    goal: np.ndarray
    camera: Camera
    object_points_m: np.ndarray
    robot: Robot | None
    joints_rad: np.ndarray | None  # (n,) at the start
    settings: PlannerSettings
    goal_joints_rad: np.ndarray | None = None  # (n,) where the arm stood at the goal

    @property
    def goal_known(self) -> bool:
        """Tell whether the arm stood at the goal when it was taught."""
        return self.goal_joints_rad is not None

    @cached_property
    def arm(self) -> Robot:
        """Give the arm; ValueError without one."""
        return required(self.robot, 'arm to plan for')

    @cached_property
    def start_joints_rad(self) -> np.ndarray:
        """Give the joints (n,) at the start; ValueError without an arm."""
        return required(self.joints_rad, 'joints at the start')

    @property
    def home_depth_m(self) -> float:
        """Depth of the virtual home pose."""
        return self.settings.home_depth_m if self.robot is None else self.robot.home_depth_m

    def check(self, proposal: Proposal) -> Verdict:
        """Judge a path in full."""
        return check_path(required(proposal.poses, 'path to check'), self.camera,
                          self.object_points_m, self.robot, self.joints_rad, self.settings,
                          proposal.joints_rad, self.goal_joints_rad)

    def path(self, family: str = 'paper', turn: str = 'shorter') -> np.ndarray | Rejected:
        """Interpolate from the start to the goal, with as many poses as asked for."""
        return self.between(self.start, self.goal, self.count, family, turn)

    def between(self, start: np.ndarray, goal: np.ndarray, count: int, family: str,
                turn: str = 'shorter') -> np.ndarray | Rejected:
        """Interpolate between any two poses."""
        return interpolate(start, goal, count, self.home_depth_m, family=family, turn=turn)

    def through(self, stops: list[np.ndarray], family: str) -> np.ndarray:
        """Interpolate from stop to stop, the poses shared out by the length of the ways."""
        ways = [max(path_lengths(np.array(pair))[-1], 1e-9) for pair in zip(stops, stops[1:])]
        counts = shared_out(self.count - 1, ways)
        parts = [required(self.between(a, b, n + 1, family), 'way between stops')[1:]
                 for a, b, n in zip(stops, stops[1:], counts)]
        return np.concatenate([stops[0][None], *parts])

    @cached_property
    def count(self) -> int:
        """Count the poses of a path."""
        limits = self.settings
        if limits.poses:
            return max(limits.poses, 2)
        count = choose_count(
            self.start, self.goal, self.home_depth_m, max_step_m=limits.step_max_m,
            max_step_rad=limits.step_max_rad, max_step_px=limits.step_max_px,
            camera=self.camera, object_points_m=self.object_points_m)
        # A path that leaves the view has steps without bound there; it is vetoed later.
        return MOST_POSES if isinstance(count, Rejected) else min(count, MOST_POSES)

    @cached_property
    def seen_from_arm(self) -> np.ndarray:
        """Give the shift (4, 4) from measured poses to those of the arm's model."""
        return object_pose(self.arm, self.start_joints_rad) @ inverted(self.start)

    @cached_property
    def seen_from_camera(self) -> np.ndarray:
        """Give the shift (4, 4) back."""
        return inverted(self.seen_from_arm)

    @cached_property
    def goal_branches(self) -> np.ndarray:
        """
        Find all joints (K, n) at the goal, the nearest to the start first.

        Joints at which the goal was taught count in any case: where the arm's model is a
        little wrong, it may find none or slightly others.
        """
        target = self.seen_from_arm @ self.goal
        found = inverse(self.arm, target, self.joints_rad, self.settings.seed)
        if self.goal_joints_rad is None:
            return found
        others = [q for q in found if not same_posture(q, self.goal_joints_rad)]
        return np.array([self.goal_joints_rad, *others])

    @cached_property
    def goal_shift(self) -> np.ndarray:
        """Give what the arm's model lacks (6,) of the goal where it was taught, 0 elsewhere."""
        if self.goal_joints_rad is None:
            return np.zeros(6)
        return pose_difference(self.goal, self.poses_of(self.goal_joints_rad[None])[0])

    def poses_of(self, joints_rad: np.ndarray) -> np.ndarray:
        """Give the poses (N, 4, 4), as the camera would measure them, of joints (N, n)."""
        return self.seen_from_camera @ object_pose(self.arm, joints_rad)

    def corners(self, poses: np.ndarray) -> np.ndarray:
        """Project the object's points (N, M, 2) at poses."""
        return look(poses, self.camera, self.object_points_m, self.home_depth_m).points_px


def shared_out(total: int, weights: list[float]) -> list[int]:
    """Split a number of steps in proportion to weights, at least one each."""
    shares = np.cumsum(weights) / np.sum(weights)
    ends = np.round(shares * max(total, len(weights))).astype(int)
    counts = np.maximum(np.diff(ends, prepend=0), 1)
    counts[int(np.argmax(counts))] += max(total, len(weights)) - counts.sum()
    return [int(n) for n in np.maximum(counts, 1)]
