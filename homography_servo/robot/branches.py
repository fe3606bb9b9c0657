"""
Candidates of the inverse kinematics of arms built like the Robix RCS-6.

Such an arm has two parallel yaw joints, two parallel pitch joints, then roll and yaw whose
axes meet those before. The wrist point w (where the axes of joints 4 and 5 meet) and the
roll axis r are tied to the pose: the axis of joint 6 and the point p where it meets the
roll axis are known, r is at right angles to it, and w = p - d5 r. What remains is one
angle psi of r about the axis of joint 6. Each psi gives the heading phi = joint 1 + joint 2
(the pitch axes are at right angles to the plane of r and the vertical; two choices),
joint 3 from the height of w (two choices), and one equation: the end of link 1 must be at
its distance a1 from the axis of joint 1. Its roots over psi are all the postures there are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from homography_servo.robot.chain import after_turn
from homography_servo.robot.robot_model import Robot
import numpy as np

_GRID = 120  # samples of psi, and as many of phi
_LIFTS = 49  # samples of joint 3
_SECANTS = 12  # each multiplies the digits by more than 1.4; Newton polishes the rest
_SECTIONS = 12  # each narrows by the golden section
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_NEAR_M = 1e-4  # a gap that a polish can close
_CLOSE = 1e-9
# A roll axis may turn over in no time when the axis of joint 6 is level; keep it finite.
_LEVEL = 1e-7
_CHOICES = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])  # heading, joint 3


def is_yaw_pitch_arm(robot: Robot) -> bool:
    """Say whether the arm has the build that this module solves."""
    if robot.count != 6:
        return False
    joints = robot.joints
    parallel = all(abs(math.sin(joints[i].alpha_rad)) < _CLOSE and joints[i].alpha_rad == 0.0
                   for i in (0, 2))
    square = all(abs(math.cos(joints[i].alpha_rad)) < _CLOSE for i in (1, 3, 4))
    zero = (joints[2].d_m, joints[3].d_m, joints[3].a_m, joints[4].a_m)
    return parallel and square and not any(zero) and joints[0].a_m > 0.0 and joints[2].a_m != 0.0


class _Pose(NamedTuple):
    """What is known of the arm when the pose of its flange is."""

    end: np.ndarray  # (4, 4) frame after joint 5, turned by joint 6
    point: np.ndarray  # p
    level: np.ndarray  # unit vector, horizontal, at right angles to the axis of joint 6
    rise: np.ndarray  # unit vector at right angles to both
    tilt: float  # vertical part of the axis of joint 6, never quite 0


def _pose(robot: Robot, base_from_tool: np.ndarray) -> _Pose:
    end = base_from_tool @ np.linalg.inv(after_turn(robot.joints[5]))
    axis = end[:3, 2]
    level = np.array([axis[1], -axis[0], 0.0])
    length = np.linalg.norm(level)
    level = np.array([1.0, 0.0, 0.0]) if length < _CLOSE else level / length
    tilt = axis[2] if abs(axis[2]) > _LEVEL else math.copysign(_LEVEL, axis[2])
    return _Pose(end, end[:3, 3], level, np.cross(axis, level), tilt)


class _Posture(NamedTuple):
    """The arm up to the wrist for some psi and both choices."""

    gap: np.ndarray  # m, 0 for a true posture; NaN where the height cannot be reached
    roll_axis: np.ndarray  # (..., 3)
    heading: np.ndarray  # (..., 2) unit vector of joint 1 + joint 2
    lift_rad: np.ndarray  # joint 3 with its theta0
    elbow: np.ndarray  # (..., 2) end of link 1


def _posture(robot: Robot, pose: _Pose, psi: np.ndarray, choice: np.ndarray) -> _Posture:
    one, two, three = robot.joints[:3]
    cos, sin = np.cos(psi)[..., None], np.sin(psi)[..., None]
    roll_axis = cos * pose.level + sin * pose.rise
    wrist = pose.point - robot.joints[4].d_m * roll_axis
    flat = cos * pose.level[:2] + sin * pose.tilt * np.array([-pose.level[1], pose.level[0]])
    heading = flat / np.linalg.norm(flat, axis=-1, keepdims=True) * choice[..., :1]
    side = math.sin(two.alpha_rad)
    sine = (wrist[..., 2] - one.d_m - two.d_m) / (three.a_m * side)
    sine = np.where(np.abs(sine) <= 1.0 + _CLOSE, np.clip(sine, -1.0, 1.0), np.nan)
    cosine = choice[..., 1] * np.sqrt(1.0 - sine * sine)
    reach = two.a_m + three.a_m * cosine
    elbow = wrist[..., :2] - reach[..., None] * heading
    gap = np.hypot(elbow[..., 0], elbow[..., 1]) - one.a_m
    return _Posture(gap, roll_axis, heading, np.arctan2(sine, cosine), elbow)


def _grid(robot: Robot, pose: _Pose) -> np.ndarray:
    """Sample psi so that neither psi nor phi nor joint 3 moves far from one to the next."""
    psi = np.linspace(-math.pi, math.pi, _GRID, endpoint=False)
    phi = psi + math.pi / _GRID
    psi_of_phi = np.arctan2(np.sin(phi), np.cos(phi) * abs(pose.tilt))
    grid = np.sort(np.concatenate([psi, psi_of_phi, *_psi_of_lift(robot, pose)]))
    # Two samples more than a whole turn, so that none is without neighbours.
    return np.concatenate([grid, grid[:2] + 2.0 * math.pi])


def _psi_of_lift(robot: Robot, pose: _Pose) -> tuple[np.ndarray, ...]:
    """Give psi for even samples of joint 3; the outermost are the ends of what it reaches."""
    one, two, three = robot.joints[:3]
    rise = robot.joints[4].d_m * pose.rise[2]
    if abs(rise) < _CLOSE:
        return ()
    height = three.a_m * np.sin(np.linspace(-0.5 * math.pi, 0.5 * math.pi, _LIFTS))
    sine = (pose.point[2] - one.d_m - two.d_m - height) / rise
    psi = np.arcsin(sine[np.abs(sine) <= 1.0])
    return psi, np.where(psi > 0.0, math.pi, -math.pi) - psi


def _crossings(gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find (choice, sample) pairs after which the gap changes sign."""
    with np.errstate(invalid='ignore'):
        choice, sample = np.nonzero(gap[:, :-1] * gap[:, 1:] <= 0.0)
        return choice, sample


def _dips(gap: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Find where the gap comes near zero and turns back: two roots, or one, or none.

    Gives the choice, and the samples before and after. At the end of what joint 3 reaches
    the last sample is one of the two.
    """
    known = ~np.isnan(gap)
    size = np.where(known, np.abs(gap), np.inf)
    sign = np.where(known, np.sign(gap), 0.0)
    lowest = known[:, 1:-1] & (size[:, 1:-1] <= size[:, :-2]) & (size[:, 1:-1] <= size[:, 2:])
    same = (sign[:, :-2] * sign[:, 1:-1] >= 0.0) & (sign[:, 1:-1] * sign[:, 2:] >= 0.0)
    rows, columns = np.nonzero(lowest & same)
    before, after = known[rows, columns], known[rows, columns + 2]
    return rows, np.where(before, columns, columns + 1), columns + np.where(after, 2, 1)


def _bottoms(robot: Robot, pose: _Pose, choice: np.ndarray, low: np.ndarray,
             high: np.ndarray) -> np.ndarray:
    """Find psi between low and high where the gap comes nearest to changing its sign."""
    sign = np.sign(_posture(robot, pose, low, choice).gap)
    both = np.stack([choice, choice])
    for _ in range(_SECTIONS):
        step = _GOLDEN * (high - low)
        left, right = high - step, low + step
        size = _posture(robot, pose, np.stack([left, right]), both).gap * sign
        lower = size[0] < size[1]
        low, high = np.where(lower, low, left), np.where(lower, right, high)
    return 0.5 * (low + high)


def _secants(robot: Robot, pose: _Pose, choice: np.ndarray, low: np.ndarray,
             high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Close in on the roots between low and high (Illinois form of the false position).

    Gives psi and the gap that is left. Where the gap has the same sign at both ends it gives
    the end with the smaller gap, which is where two roots are about to meet or to part.
    """
    gap_low = _posture(robot, pose, low, choice).gap
    gap_high = _posture(robot, pose, high, choice).gap
    lower = np.abs(gap_low) < np.abs(gap_high)
    apart = gap_low * gap_high > 0.0
    end, end_gap = np.where(lower, low, high), np.where(lower, gap_low, gap_high)
    for _ in range(_SECANTS):
        span = gap_high - gap_low
        share = np.where(span == 0.0, 0.5, gap_high / np.where(span == 0.0, 1.0, span))
        middle = high - np.clip(share, 0.0, 1.0) * (high - low)
        gap = _posture(robot, pose, middle, choice).gap
        crossed = gap * gap_high < 0.0
        low = np.where(crossed, high, low)
        gap_low = np.where(crossed, gap_high, 0.5 * gap_low)
        high, gap_high = middle, gap
    return np.where(apart, end, high), np.where(apart, end_gap, gap_high)


def _joints(robot: Robot, pose: _Pose, psi: np.ndarray, choice: np.ndarray) -> np.ndarray:
    """Read all six joints off postures of the wrist; (K, 6), theta0 taken off."""
    at = _posture(robot, pose, psi, choice)
    heading = np.arctan2(at.heading[:, 1], at.heading[:, 0])
    first = np.arctan2(at.elbow[:, 1], at.elbow[:, 0])
    angles = [first, heading - first, at.lift_rad]
    rotation = _turned(_turned(np.eye(3), heading, robot.joints[1]), at.lift_rad,
                       robot.joints[2])
    for axis, joint in ((at.roll_axis, robot.joints[3]), (pose.end[:3, 2], robot.joints[4])):
        seen = np.einsum('kji,kj->ki', rotation, np.broadcast_to(axis, at.roll_axis.shape))
        side = math.sin(joint.alpha_rad)
        angles.append(np.arctan2(seen[:, 0] * side, -seen[:, 1] * side))
        rotation = _turned(rotation, angles[-1], joint)
    last = np.einsum('kji,j->ki', rotation, pose.end[:3, 0])
    angles.append(np.arctan2(last[:, 1], last[:, 0]))
    return np.stack(angles, axis=1) - [joint.theta0_rad for joint in robot.joints]


def _turned(rotation: np.ndarray, angle: np.ndarray, joint) -> np.ndarray:
    cos, sin, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    turn = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1.0], axis=1)
    return rotation @ turn.reshape(-1, 3, 3) @ after_turn(joint)[:3, :3]


def yaw_pitch_candidates(robot: Robot, base_from_tool: np.ndarray) -> np.ndarray:
    """
    Find all postures of a yaw-pitch arm that put its flange at a pose.

    Parameters
    ----------
    robot : Robot
        For which `is_yaw_pitch_arm` holds.
    base_from_tool : (4, 4) array
        Where the flange should be.

    Returns
    -------
    (K, 6) array
        Joints, limits not looked at, good to about 1e-9; a few may be no solutions at all.

    """
    pose = _pose(robot, base_from_tool)
    psi = _grid(robot, pose)
    gap = _posture(robot, pose, psi[None, :], _CHOICES[:, None, :]).gap
    rows, columns = _crossings(gap)
    dip_rows, before, after = _dips(gap)
    bottom = _bottoms(robot, pose, _CHOICES[dip_rows], psi[before], psi[after])
    choice = _CHOICES[np.concatenate([rows, dip_rows, dip_rows])]
    low = np.concatenate([psi[columns], psi[before], bottom])
    high = np.concatenate([psi[columns + 1], bottom, psi[after]])
    root, gap_m = _secants(robot, pose, choice, low, high)
    near = np.abs(gap_m) < _NEAR_M
    return _joints(robot, pose, root[near], choice[near])
