"""Where the arm holds the object, how it moves, and how to get it somewhere."""

from __future__ import annotations

import math

from homography_servo.robot.branches import is_yaw_pitch_arm
from homography_servo.robot.branches import yaw_pitch_candidates
from homography_servo.robot.chain import checked_joints
from homography_servo.robot.chain import jacobian_of
from homography_servo.robot.chain import link_frames
from homography_servo.robot.chain import object_frames
from homography_servo.robot.robot_model import Robot
import numpy as np

# A posture is a solution when the object is this near: m and rad alike.
_SOLVED = 1e-9
# Solutions nearer than this are one, and a limit overstepped by less is kept.
_SAME_RAD = 1e-6
_LIMIT_RAD = 1e-9
# One radian of rotation weighs as much as this length of translation.
_LENGTH_M = 0.1
_WEIGHTS = np.array([[1.0]] * 3 + [[_LENGTH_M]] * 3)
_STARTS = 160
_STEP_RAD = 0.5
_PATIENCE = 40  # Newton steps
_ENOUGH = 1e-12  # distance left at which no more steps are taken


def forward(robot: Robot, joints_rad: np.ndarray) -> np.ndarray:
    """Give base_from_tool (..., 4, 4) for joints (..., n)."""
    return link_frames(robot, checked_joints(robot, joints_rad), np.eye(4))[..., -1, :, :]


def object_pose(robot: Robot, joints_rad: np.ndarray) -> np.ndarray:
    """Give home_from_object (..., 4, 4) for joints (..., n)."""
    return object_frames(robot, checked_joints(robot, joints_rad))[1]


def object_jacobian(robot: Robot, joints_rad: np.ndarray) -> np.ndarray:
    """
    Give the motion of the object for each joint.

    Parameters
    ----------
    robot : Robot
        The arm.
    joints_rad : (..., n) array
        Joint angles.

    Returns
    -------
    (..., 6, n) array
        Velocity of the object's origin [m/rad], then angular velocity, in the axes of home.

    """
    return jacobian_of(*object_frames(robot, checked_joints(robot, joints_rad)))


def inverse(robot: Robot, home_from_object: np.ndarray, near_rad: np.ndarray | None = None,
            seed: int = 0) -> np.ndarray:
    """
    Find every posture inside the limits that puts the object at a pose.

    Parameters
    ----------
    robot : Robot
        The arm.
    home_from_object : (4, 4) array
        Where the object should be.
    near_rad : (n,) array, optional
        Posture to sort by; without it, by distance from the middle of the limits.
    seed : int
        Seed of the random starts; only arms of another build than yaw-yaw-pitch-pitch-roll-yaw
        need them.

    Returns
    -------
    (K, n) array
        Nearest first; K is 0 when the pose cannot be reached. Whole turns of a joint count as
        one posture, the one nearest to `near_rad`.

    """
    target = np.asarray(home_from_object, dtype=float)
    if target.shape != (4, 4) or not np.isfinite(target).all():
        raise ValueError(f'home_from_object must be a finite (4, 4) array, got {target}')
    middle = 0.5 * (robot.lower_rad + robot.upper_rad)
    near = middle if near_rad is None else checked_joints(robot, near_rad)
    starts = _starts(robot, target, seed)
    found, missed = _newton(robot, np.broadcast_to(target, (len(starts), 4, 4)), starts)
    return _sorted(_different(_inside(robot, found[missed < _SOLVED], near)), near)


def _starts(robot: Robot, target: np.ndarray, seed: int) -> np.ndarray:
    if is_yaw_pitch_arm(robot):
        base_from_tool = np.linalg.inv(robot.home_from_base) @ target \
            @ np.linalg.inv(robot.tool_from_object)
        candidates = yaw_pitch_candidates(robot, base_from_tool)
        # Newton moves a candidate little: those far outside the limits need no polish.
        return candidates[(_overstep(robot, candidates) < 0.1).all(axis=1)]
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.lower_rad, robot.upper_rad, (_STARTS, robot.count))


def _overstep(robot: Robot, joints_rad: np.ndarray) -> np.ndarray:
    """Measure how far joints are outside the limits, whole turns taken off."""
    span = robot.upper_rad - robot.lower_rad
    above = np.mod(joints_rad - robot.lower_rad, 2.0 * math.pi)
    return np.maximum(np.minimum(above - span, 2.0 * math.pi - above), 0.0)


def _inside(robot: Robot, joints_rad: np.ndarray, near_rad: np.ndarray) -> np.ndarray:
    """Keep the postures inside the limits, with the turns nearest to a posture."""
    kept = joints_rad[(_overstep(robot, joints_rad) <= _LIMIT_RAD).all(axis=1)]
    turn = 2.0 * math.pi
    kept = kept - turn * np.round((kept - near_rad) / turn)
    kept = kept + turn * np.ceil((robot.lower_rad - _LIMIT_RAD - kept) / turn).clip(min=0.0)
    kept = kept - turn * np.ceil((kept - robot.upper_rad - _LIMIT_RAD) / turn).clip(min=0.0)
    return np.clip(kept, robot.lower_rad, robot.upper_rad)


def _different(joints_rad: np.ndarray) -> np.ndarray:
    kept: list[np.ndarray] = []
    for joints in joints_rad:
        if all(np.abs(joints - other).max() > _SAME_RAD for other in kept):
            kept.append(joints)
    return np.array(kept).reshape(len(kept), joints_rad.shape[1])


def _sorted(joints_rad: np.ndarray, near_rad: np.ndarray) -> np.ndarray:
    return joints_rad[np.argsort(np.linalg.norm(joints_rad - near_rad, axis=1), kind='stable')]


def _newton(robot: Robot, targets: np.ndarray, joints_rad: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Solve poses by damped Newton steps, all at once.

    The damping follows the distance left (Sugihara, 2011, doi:10.1109/TRO.2011.2148230), so
    the last steps converge quadratically and no step is wild near a singularity.

    Parameters
    ----------
    robot : Robot
        The arm.
    targets : (B, 4, 4) array
        home_from_object.
    joints_rad : (B, n) array
        Starts.

    Returns
    -------
    (B, n) array, (B,) array
        Joints, and the distance left.

    """
    joints = np.array(joints_rad, dtype=float)
    missed = np.full(len(joints), np.inf)
    active = np.arange(len(joints))
    for _ in range(_PATIENCE + 1):
        frames, tips = object_frames(robot, joints[active])
        error = _pose_error(tips, targets[active])
        missed[active] = np.sqrt(np.einsum('bi,bi->b', error, error))
        going = missed[active] > _ENOUGH
        if not going.any():
            break
        active, error = active[going], error[going]
        jacobian = jacobian_of(frames[going], tips[going])
        joints[active] += _damped_step(jacobian, error, missed[active])
    return joints, missed


def _pose_error(tips: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Subtract poses: translation [m], rotation vector weighted to m; (B, 6)."""
    error = np.empty((len(tips), 6))
    error[:, :3] = targets[:, :3, 3] - tips[:, :3, 3]
    turn = targets[:, :3, :3] @ np.swapaxes(tips[:, :3, :3], 1, 2)
    axial = 0.5 * (turn[:, (2, 0, 1), (1, 2, 0)] - turn[:, (1, 2, 0), (2, 0, 1)])
    sine = np.sqrt(np.einsum('bi,bi->b', axial, axial))
    angle = np.arctan2(sine, 0.5 * (np.einsum('bii->b', turn) - 1.0))
    per_sine = np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-9)
    error[:, 3:] = axial * (_LENGTH_M * per_sine)[:, None]
    return error


def _damped_step(jacobian: np.ndarray, error: np.ndarray, missed: np.ndarray) -> np.ndarray:
    weighted = jacobian * _WEIGHTS
    across = np.swapaxes(weighted, 1, 2)
    damping = (0.01 * missed * missed + 1e-14)[:, None, None] * np.eye(jacobian.shape[-1])
    step = np.linalg.solve(across @ weighted + damping, across @ error[:, :, None])[:, :, 0]
    largest = np.abs(step).max(axis=1, keepdims=True)
    return step * np.minimum(1.0, _STEP_RAD / np.maximum(largest, _STEP_RAD))
