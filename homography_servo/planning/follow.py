"""
The joints along a path of object poses, followed continuously from the start.

Newton steps on the object Jacobian run along a few anchor poses one after the other,
so that the branch of the inverse kinematics can never be left unseen; the poses in
between are then solved all at once.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.rigid import inverse
from homography_servo.geometry.rigid import pose_difference
from homography_servo.robot.chain import jacobian_of
from homography_servo.robot.chain import object_frames
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
import numpy as np

DAMPING = 1e-4  # in units where 0.1 m counts as 1 rad; below any useful conditioning
LENGTH_M = 0.1
ANCHOR_STRIDE = 0.2  # rad, or units of LENGTH_M
LARGEST_MOVE_RAD = 0.35
ITERATIONS = 12
ROUGH = (1e-3, 3e-3)  # m, rad: near enough for an anchor, which is solved again later
_CYCLE, _BACK = np.array([2, 0, 1]), np.array([1, 2, 0])


class Followed(NamedTuple):
    """Joints along a path, as far as the arm can follow it."""

    joints_rad: np.ndarray  # (N, n); from the first miss on the last joints that fit
    reached: np.ndarray  # (N,) bool, true up to the first pose that the arm misses
    miss_m: float  # how far the arm stays away from the first missed pose
    miss_rad: float


def small_difference(target: np.ndarray, current: np.ndarray) -> np.ndarray:
    """
    Give what `pose_difference` gives, quickly, for turns well below half a turn.

    Newton's method needs it many times per path, and a general rotation logarithm
    costs more than all the rest of a step.
    """
    turn = target[..., :3, :3] @ np.swapaxes(current[..., :3, :3], -1, -2)
    axial = 0.5 * (turn[..., _CYCLE, _BACK] - turn[..., _BACK, _CYCLE])
    sine = np.sqrt((axial * axial).sum(axis=-1, keepdims=True))
    cosine = 0.5 * (np.trace(turn, axis1=-2, axis2=-1)[..., None] - 1.0)
    angle = np.arctan2(sine, cosine)
    stretch = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-12), 1.0)
    shift = target[..., :3, 3] - current[..., :3, 3]
    return np.concatenate([shift, axial * stretch], axis=-1)


def joint_step(jacobian: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Solve ``jacobian @ step = twist`` with slight damping, for (..., 6, n) stacks."""
    scale = np.array([1.0 / LENGTH_M] * 3 + [1.0] * 3)
    a = jacobian * scale[:, None]
    gram = a @ np.swapaxes(a, -1, -2) + DAMPING**2 * np.eye(6)
    solved = np.linalg.solve(gram, (twist * scale)[..., None])
    return (np.swapaxes(a, -1, -2) @ solved)[..., 0]


def solve_near(robot: Robot, target: np.ndarray, joints_rad: np.ndarray,
               tolerance: tuple[float, float]) -> tuple[np.ndarray, bool]:
    """Move joints by Newton steps until the object is at the target, or give up."""
    joints_rad = np.array(joints_rad, dtype=float)
    for _ in range(ITERATIONS):
        frames, current = object_frames(robot, joints_rad)
        error = small_difference(target, current)
        if _small(error, tolerance):
            return joints_rad, True
        step = joint_step(jacobian_of(frames, current), error)
        joints_rad = joints_rad + step / max(1.0, np.abs(step).max() / LARGEST_MOVE_RAD)
    return joints_rad, False


def _small(error: np.ndarray, tolerance: tuple[float, float]) -> np.ndarray:
    squared = error * error
    return (squared[..., :3].sum(axis=-1) <= tolerance[0]**2) \
        & (squared[..., 3:].sum(axis=-1) <= tolerance[1]**2)


def path_lengths(poses: np.ndarray) -> np.ndarray:
    """Measure the way to each of (N, 4, 4) poses, in rad with LENGTH_M as one."""
    step = pose_difference(poses[1:], poses[:-1])
    length = np.maximum(np.linalg.norm(step[:, :3], axis=1) / LENGTH_M,
                        np.linalg.norm(step[:, 3:], axis=1))
    return np.concatenate([[0.0], np.cumsum(length)])


def follow(robot: Robot, poses: np.ndarray, start_joints_rad: np.ndarray,
           tolerance: tuple[float, float] = (1e-6, 1e-5)) -> Followed:
    """
    Follow a path from given joints without ever leaving their branch.

    Parameters
    ----------
    robot : Robot
        The arm.
    poses : (N, 4, 4) array
        ``home_from_object`` as the arm's model sees it; the first belongs to the
        start joints.
    start_joints_rad : (n,) array
        Joints at the first pose.
    tolerance : (float, float)
        When a pose counts as reached [m, rad].

    Returns
    -------
    Followed
        Joint limits are not looked at here.

    """
    anchors, joints, reached_to = _follow_anchors(robot, poses, start_joints_rad)
    joints_rad = _fill(anchors, joints, len(poses))
    joints_rad, fits = _polish(robot, poses, joints_rad, reached_to, tolerance)
    reached = np.logical_and.accumulate(fits)
    first = int(np.argmin(reached))
    if reached.all():
        return Followed(joints_rad, reached, 0.0, 0.0)
    joints_rad[first:] = joints_rad[max(first - 1, 0)]
    nearest, _ = solve_near(robot, poses[first], joints_rad[first], tolerance)
    miss = pose_difference(poses[first], object_pose(robot, nearest))
    return Followed(joints_rad, reached, *(float(np.linalg.norm(m)) for m in (miss[:3], miss[3:])))


def _follow_anchors(robot: Robot, poses: np.ndarray, start: np.ndarray
                    ) -> tuple[list[int], list[np.ndarray], int]:
    way = path_lengths(poses)
    anchors, joints, last, stride = [0], [np.asarray(start, dtype=float)], len(poses) - 1, None
    while anchors[-1] < last:
        here = anchors[-1]
        reach = int(np.searchsorted(way, way[here] + ANCHOR_STRIDE, 'right')) - 1
        ahead = max(1, min(stride or last, reach - here, last - here))
        found, fits = solve_near(robot, poses[here + ahead], joints[-1], ROUGH)
        if fits and np.abs(found - joints[-1]).max() <= LARGEST_MOVE_RAD or fits and ahead == 1:
            anchors.append(here + ahead)
            joints.append(found)
            stride = None if stride is None else 2 * ahead
        elif ahead == 1:
            break
        else:
            stride = ahead // 2
    return anchors, joints, anchors[-1]


def _fill(anchors: list[int], joints: list[np.ndarray], count: int) -> np.ndarray:
    table = np.array(joints)
    index = np.arange(count)
    return np.column_stack([np.interp(index, anchors, table[:, j]) for j in range(table.shape[1])])


def _polish(robot: Robot, poses: np.ndarray, joints_rad: np.ndarray, reached_to: int,
            tolerance: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    fits = np.zeros(len(poses), dtype=bool)
    todo = np.arange(reached_to + 1)
    for _ in range(ITERATIONS):
        frames, current = object_frames(robot, joints_rad[todo])
        error = small_difference(poses[todo], current)
        left = ~_small(error, tolerance)
        fits[todo[~left]] = True
        todo = todo[left]
        if not len(todo):
            break
        joints_rad[todo] += joint_step(jacobian_of(frames[left], current[left]), error[left])
    return joints_rad, fits


def arm_poses(robot: Robot, poses: np.ndarray, start_joints_rad: np.ndarray) -> np.ndarray:
    """
    Carry measured poses over into the arm's model, anchored at the start.

    A camera or robot that stands elsewhere than believed moves all poses alike, seen
    from ``home``; what the first pose and the start joints disagree by is taken as
    this shift, so the first pose belongs to the start joints exactly.
    """
    believed = object_pose(robot, np.asarray(start_joints_rad, dtype=float))
    return believed @ inverse(poses[0]) @ poses
