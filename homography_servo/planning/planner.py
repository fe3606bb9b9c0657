"""
A path from here to the goal: the paper's, or the first repair that can be executed.

The order is fixed: the paper's path; the other turn of gamma; the same path on another
branch of the inverse kinematics; the other families; via-poses; a path in joint space,
checked in the image; at last one in joint space that passes a singularity of the arm,
where the planned joints lead. Each is checked in full, and the same input gives the
same plan.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator

from homography_servo.geometry.camera import Camera
from homography_servo.planning.repair import divided
from homography_servo.planning.repair import hopeless
from homography_servo.planning.repair import REPAIRS
from homography_servo.planning.repair import through_singularity
from homography_servo.planning.settings import PlannerSettings
from homography_servo.planning.task import Proposal
from homography_servo.planning.task import Task
from homography_servo.planning.verdict import Verdict
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.robot_file import Robot
import numpy as np

FIRST = "the paper's path"
NO_OTHER = 'any other way'
SAME_SIDE = 'any way that keeps off singularities'


@dataclass(frozen=True)
class Attempt:
    """One way that was tried, and what came of it."""

    name: str
    ok: bool
    sentence: str


@dataclass(frozen=True)
class Plan:
    """A path with its verdict; only one whose verdict is ok may be executed."""

    poses: np.ndarray  # (N, 4, 4) home_from_object
    joints_rad: np.ndarray | None  # (N, n) predicted
    verdict: Verdict
    family: str  # which way was taken, or came furthest
    attempts: tuple[Attempt, ...]
    corners_px: np.ndarray  # (N, M, 2) where the points will be seen

    @property
    def ok(self) -> bool:
        """Whether the path may be executed."""
        return self.verdict.ok

    @property
    def sentence(self) -> str:
        """Say in one sentence what was planned and why other ways were not taken."""
        if self.ok and len(self.attempts) == 1:
            return self.verdict.sentence
        first = self.attempts[0]
        if self.ok:
            return (f'repaired by {self.family}: {self.verdict.sentence}; {first.name} failed: '
                    f'{first.sentence}')
        if self.attempts[-1].name in (NO_OTHER, SAME_SIDE):
            return (f'no path can be executed: {self.attempts[-1].sentence}; {first.name} '
                    f'fails at {first.sentence}')
        if len(self.attempts) == 1:
            return f'the path cannot be executed: {self.verdict.sentence}'
        return (f'no path can be executed, {len(self.attempts)} ways tried; best was '
                f'{self.family}: {self.verdict.sentence}')


def plan(start_home_from_object: np.ndarray, goal_home_from_object: np.ndarray, camera: Camera,
         robot: Robot | None = None, start_joints_rad: np.ndarray | None = None,
         settings: PlannerSettings = PlannerSettings(),
         object_points_m: np.ndarray | None = None,
         goal_joints_rad: np.ndarray | None = None) -> Plan | Rejected:
    """
    Plan a path and repair it when it is vetoed.

    Parameters
    ----------
    start_home_from_object, goal_home_from_object : (4, 4) array
        Measured pose, and where it has to go.
    camera : Camera
        What looks.
    robot : Robot, optional
        The arm; without it the object flies freely.
    start_joints_rad : (n,) array, optional
        Joints at the start; needed with a robot.
    settings : PlannerSettings
        Limits and tries.
    object_points_m : (M, 3) array, optional
        Points of the object; those of the robot file by default.
    goal_joints_rad : (n,) array, optional
        Where the arm stood when the goal was taught, if it did.

    Returns
    -------
    Plan or Rejected
        Executable only if its verdict is ok; rejected when there is no path at all,
        since an end is behind the camera.

    """
    task = _task(start_home_from_object, goal_home_from_object, camera, robot,
                 start_joints_rad, settings, object_points_m, goal_joints_rad)
    for name, pose in (('object', task.start), ('goal', task.goal)):
        depth_m = pose[2, 3] + task.home_depth_m
        if depth_m <= 0.0:
            return Rejected(f'the {name} is behind the camera (depth {depth_m:.3f} m)')
    first = task.path()
    return first if isinstance(first, Rejected) else _best(task, first)


def _best(task: Task, first: np.ndarray) -> Plan:
    attempts: list[Attempt] = []
    best: tuple[Verdict, Proposal] | None = None
    for proposal in _proposals(task, first):
        if proposal.poses is None:
            attempts.append(Attempt(proposal.name, False, proposal.reason))
            continue
        verdict = task.check(proposal)
        attempts.append(Attempt(proposal.name, verdict.ok, verdict.sentence))
        if best is None or verdict.ok or _further(verdict, best[0]):
            best = (verdict, proposal)
        if verdict.ok or _start_is_bad(verdict):
            break
    verdict, taken = required(best, 'path that was tried')
    poses = required(taken.poses, 'path')
    return Plan(poses, verdict.joints_rad, verdict, taken.name, tuple(attempts),
                task.corners(poses))


def _task(start: np.ndarray, goal: np.ndarray, camera: Camera, robot: Robot | None,
          joints_rad: np.ndarray | None, settings: PlannerSettings,
          points: np.ndarray | None, goal_joints_rad: np.ndarray | None) -> Task:
    for name, pose in (('start', start), ('goal', goal)):
        if np.shape(pose) != (4, 4) or not np.isfinite(pose).all():
            raise ValueError(f'{name} must be a finite (4, 4) array, got {pose!r}')
    if points is None:
        if robot is None:
            raise ValueError('without a robot, object_points_m must be given')
        points = robot.object_points_m
    for name, joints in (('start_joints_rad', joints_rad), ('goal_joints_rad', goal_joints_rad)):
        missing = joints is None and name == 'goal_joints_rad'
        shape = () if joints is None else np.shape(joints)
        if robot is not None and not missing and shape != (robot.count,):
            raise ValueError(f'{name} must have shape ({robot.count},), got {shape}')
    joints_rad = None if joints_rad is None else np.asarray(joints_rad, dtype=float)
    if goal_joints_rad is not None:
        goal_joints_rad = np.asarray(goal_joints_rad, dtype=float)
    return Task(np.asarray(start, dtype=float), np.asarray(goal, dtype=float), camera,
                np.asarray(points, dtype=float), robot, joints_rad, settings,
                None if robot is None else goal_joints_rad)


def _proposals(task: Task, first: np.ndarray) -> Iterator[Proposal]:
    yield Proposal(FIRST, first)
    if not task.settings.repair:
        return
    reason = hopeless(task)
    if reason:
        yield Proposal(NO_OTHER, None, reason=reason)
        return
    reason = '' if task.robot is None else divided(task)
    if reason:
        yield Proposal(SAME_SIDE, None, reason=reason)
    for method in () if reason else REPAIRS:
        yield from method(task)
    if task.robot is not None and task.settings.pass_singularities:
        yield from through_singularity(task)


def _start_is_bad(verdict: Verdict) -> bool:
    """Tell whether every path would fail at once, since all begin alike."""
    return verdict.first_bad == 0 and verdict.check != 'joint step'


def _further(verdict: Verdict, other: Verdict) -> bool:
    share, before = (v.good_poses / len(v.reasons) for v in (verdict, other))
    return share > before
