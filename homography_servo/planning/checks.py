"""
The single rules of the verdict, each applied to all poses of a path at once.

Every check compares one value per pose with what is needed there and can say in a
sentence, with numbers, why a pose is bad.
"""

from __future__ import annotations

from typing import Callable, NamedTuple

from homography_servo.geometry.rigid import pose_difference
from homography_servo.planning.follow import Followed
from homography_servo.planning.settings import FeasibilitySettings
from homography_servo.planning.verdict import Check
from homography_servo.planning.verdict import PoseValues
from homography_servo.robot.kinematics import object_jacobian
from homography_servo.robot.robot_file import Robot
import numpy as np

BEHIND_PX = -1e6  # distance to the border of a point that is not in front of the camera
SLACK = 1e-9
SAME_POSTURE_RAD = 0.3
# The arm stood at the goal in another posture: how its joints come out here is less sure.
UNTRIED = 2.0


class Seen(NamedTuple):
    """What the camera sees along a path."""

    points_px: np.ndarray  # (N, M, 2)
    border_px: np.ndarray  # (N, M) distance to the border, negative outside
    facing_rad: np.ndarray  # (N,)


def required(values: np.ndarray, limit: float, worst: float,
             taught: float | None = None) -> np.ndarray:
    """
    Give the value that each pose needs when larger is better.

    Normally the limit. A path that starts below it may leave from there: until it
    has come up to the limit for the first time it must not fall below its start,
    nor below the worst value that is ever allowed. Where the arm stood at the goal
    when it was taught, the end of the path may fall to the value that it had there.
    """
    def loosened(end: float) -> float:
        return min(limit, max(end - SLACK, worst))
    fine = values >= limit
    needed = np.where(np.logical_or.accumulate(fine), limit, loosened(float(values[0])))
    if taught is None:
        return needed
    still = np.logical_or.accumulate(fine[::-1])[::-1]
    return np.minimum(needed, np.where(still, limit, loosened(taught)))


def _check(name: str, values: np.ndarray, needed: np.ndarray,
           say: Callable[[int], str]) -> Check:
    good = values >= needed
    return Check(name, good, {int(k): say(int(k)) for k in np.flatnonzero(~good)})


def check_field(seen: Seen, settings: FeasibilitySettings, worst_px: float = 0.0,
                goal_known: bool = False) -> Check:
    """Keep all points inside the image."""
    border = seen.border_px.min(axis=1)
    needed = required(border, settings.field_margin_px, worst_px,
                      float(border[-1]) if goal_known else None)

    def say(k: int) -> str:
        corner = int(np.argmin(seen.border_px[k]))
        if border[k] <= BEHIND_PX:
            return f'corner {corner + 1} is behind the camera'
        where = 'outside the image' if border[k] < 0.0 else 'from the border of the image'
        return (f'corner {corner + 1} would be {abs(border[k]):.1f} px {where}, '
                f'{needed[k]:.1f} px inside are needed')
    return _check('field of view', border, needed, say)


def check_facing(seen: Seen, settings: FeasibilitySettings,
                 worst_rad: float = np.pi / 2, goal_known: bool = False) -> Check:
    """Keep the face towards the camera."""
    limit = -np.radians(settings.facing_limit_deg)
    needed = required(-seen.facing_rad, limit, -worst_rad,
                      -float(seen.facing_rad[-1]) if goal_known else None)

    def say(k: int) -> str:
        degrees = np.degrees(seen.facing_rad[k])
        if degrees >= 90.0:
            return f'the face turns away from the camera ({degrees:.1f} deg)'
        return (f'the face is tilted {degrees:.1f} deg from the line of sight, '
                f'{-np.degrees(needed[k]):.1f} deg are allowed')
    return _check('facing', -seen.facing_rad, needed, say)


def check_mirror(ambiguity: np.ndarray, settings: FeasibilitySettings,
                 goal_known: bool = False) -> Check:
    """Keep the mirror pose apart, where that is asked for."""
    needed = required(-ambiguity, -settings.ambiguity_max, -1.0,
                      -float(ambiguity[-1]) if goal_known else None)
    return _check('mirror', -ambiguity, needed, lambda k: (
        f'the mirror pose would be hard to tell apart (ambiguity {ambiguity[k]:.2f}, '
        f'{-needed[k]:.2f} is allowed)'))


def check_agreement(poses: np.ndarray, believed: np.ndarray,
                    settings: FeasibilitySettings) -> Check:
    """Compare where the camera and the joints say that the object is at the start."""
    error = pose_difference(poses[0], believed[0])
    shift_m, turn_rad = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
    good = np.ones(len(poses), dtype=bool)
    good[0] = shift_m <= settings.disagreement_max_m and turn_rad <= settings.disagreement_max_rad
    sentence = (f'the camera sees the object {1e3 * shift_m:.0f} mm and '
                f'{np.degrees(turn_rad):.0f} deg from where the joints say it is: wrong corner '
                'order, wrong robot file, or not the object')
    return Check('agreement', good, {} if good[0] else {0: sentence})


def judge_joints(robot: Robot, followed: Followed, values: PoseValues,
                 settings: FeasibilitySettings, led: bool,
                 goal_joints_rad: np.ndarray | None = None
                 ) -> tuple[PoseValues, list[Check]]:
    """
    Add what the joints along the path say to the values, and judge it.

    Where joints lead the way (`led`), a singularity does no harm: the joints are known
    there and need not be found from the pose.
    """
    joints = followed.joints_rad
    room = np.minimum(joints - robot.lower_rad, robot.upper_rad - joints)
    index = np.argmin(room, axis=1)
    step = np.abs(np.diff(joints, axis=0, append=joints[-1:]))
    found = conditioning(robot, joints, settings.conditioning_length_m)
    near = (np.abs(found) < settings.lead_below) | _flips(found)
    found = np.abs(found) if led else found
    values = values._replace(
        reached=followed.reached, joint_index=index, joint_step_rad=step.max(axis=1),
        joint_margin_rad=room.min(axis=1), conditioning=found,
        led=followed.reached & near)
    checks = [_reach(followed), _limits(robot, joints, values, settings, goal_joints_rad),
              _steps(robot, step, values, settings)]
    if led:
        return values, checks
    taught = None if goal_joints_rad is None else float(
        conditioning(robot, goal_joints_rad[None], settings.conditioning_length_m)[0])
    return values, [*checks, _condition(values, settings, taught)]


def _flips(signed: np.ndarray) -> np.ndarray:
    """Mark both poses between which a singularity lies."""
    flip = signed[1:] * signed[:-1] < 0.0
    return np.append(flip, False) | np.insert(flip, 0, False)


def conditioning(robot: Robot, joints_rad: np.ndarray, length_m: float) -> np.ndarray:
    """
    Measure how far joints are from a singularity.

    Returns
    -------
    (N,) array
        Smallest singular value of the object Jacobian with lengths in units of
        ``length_m``: object motion per joint motion in the worst direction. Negative
        where the determinant has another sign than at the first joints (six-joint
        arms), since a singularity lies in between.

    """
    scale = np.array([1.0 / length_m] * 3 + [1.0] * 3)
    jacobian = object_jacobian(robot, joints_rad) * scale[:, None]
    smallest = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    if jacobian.shape[-1] != 6:
        return smallest
    sign = np.sign(np.linalg.det(jacobian))
    return smallest * np.where(sign * sign[0] < 0.0, -1.0, 1.0)


def _reach(followed: Followed) -> Check:
    first = int(np.argmin(followed.reached))

    def say(k: int) -> str:
        if k > first:
            return f'not reached after pose {first + 1}'
        return (f'the arm cannot follow: no inverse kinematics near the last joints, the '
                f'nearest is {1e3 * followed.miss_m:.1f} mm and '
                f'{np.degrees(followed.miss_rad):.1f} deg away')
    bad = np.flatnonzero(~followed.reached)
    return Check('inverse kinematics', followed.reached, {int(k): say(int(k)) for k in bad})


def _limits(robot: Robot, joints: np.ndarray, values: PoseValues,
            settings: FeasibilitySettings, goal_joints_rad: np.ndarray | None) -> Check:
    room, index = values.joint_margin_rad, values.joint_index
    taught = None if goal_joints_rad is None else float(np.minimum(
        goal_joints_rad - robot.lower_rad, robot.upper_rad - goal_joints_rad).min())
    limit = settings.joint_margin_rad
    if goal_joints_rad is not None and not same_posture(joints[-1], goal_joints_rad):
        limit, taught = UNTRIED * limit, None
    needed = required(room, limit, 0.0, taught)

    def say(k: int) -> str:
        angle, name = np.degrees(joints[k, index[k]]), robot.joint_names[index[k]]
        low, high = np.degrees(robot.lower_rad[index[k]]), np.degrees(robot.upper_rad[index[k]])
        over = 'beyond' if room[k] < 0.0 else 'from'
        return (f'{name} would be at {angle:.1f} deg, {abs(np.degrees(room[k])):.1f} deg '
                f'{over} its limit ({low:.0f} to {high:.0f} deg, margin '
                f'{np.degrees(needed[k]):.1f} deg)')
    return _check('joint limits', room, needed, say)


def same_posture(joints_rad: np.ndarray, others_rad: np.ndarray) -> bool:
    """Tell whether joints are the same but for errors of the arm's model."""
    return bool(np.abs(joints_rad - others_rad).max() <= SAME_POSTURE_RAD)


def _condition(values: PoseValues, settings: FeasibilitySettings,
               taught: float | None) -> Check:
    found = values.conditioning
    needed = required(found, settings.conditioning_min, 0.0, taught)

    def say(k: int) -> str:
        if found[k] < 0.0:
            return 'the arm would have to pass through a singularity'
        return (f'the arm is near a singularity: smallest singular value {found[k]:.4f}, '
                f'at least {needed[k]:.4f} is needed')
    return _check('conditioning', found, needed, say)


def _steps(robot: Robot, step: np.ndarray, values: PoseValues,
           settings: FeasibilitySettings) -> Check:
    largest = values.joint_step_rad

    def say(k: int) -> str:
        name = robot.joint_names[int(np.argmax(step[k]))]
        return (f'{name} would jump {np.degrees(largest[k]):.1f} deg to the next pose, '
                f'{np.degrees(settings.joint_step_rad):.1f} deg are allowed')
    needed = np.full(len(step), -settings.joint_step_rad)
    return _check('joint step', -largest, needed, say)
