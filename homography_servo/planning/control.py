"""
The control law of look-then-move: from where the object is to where it should be.

The displacement from the measured to the desired pose goes through the object
Jacobian of the (corrected) model, damped near singularities; where it is not small
the step is repeated inside the model, without looking. All joints scale together,
so that the object stays on its way when a limit shortens a move.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.rigid import pose_difference
from homography_servo.planning.arm_model import ArmModel
from homography_servo.robot.robot_file import Robot
import numpy as np

LENGTH_M = 0.1  # 1 rad of rotation weighs as much as this displacement
SINGULAR = 0.002  # smallest singular value (m and LENGTH_M rad per rad) without damping
DAMPING = 0.002  # as small as the limit of the verdict, conditioning_min * LENGTH_M
AT_FIRST = 0.3  # rad, or units of LENGTH_M: further from the first pose is not at its place
MODEL_STEPS = 12
LARGEST_MODEL_STEP_RAD = 0.3
_SCALE = np.array([1.0] * 3 + [LENGTH_M] * 3)


class Errors(NamedTuple):
    """A displacement by degrees of freedom; the optical axis is home z."""

    lateral_m: float
    depth_m: float
    gamma_rad: float
    tilt_rad: float

    def over(self, tolerance: Errors) -> float:
        """Give the largest error in units of its tolerance."""
        return max(error / allowed for error, allowed in zip(self, tolerance))


class Step(NamedTuple):
    """Where the joints go, by which share of the way, and what shortened it."""

    joints_rad: np.ndarray
    share: float
    limited_by: str


def displacement(home_from_current: np.ndarray, home_from_goal: np.ndarray) -> np.ndarray:
    """
    Give the screw from one pose to another as a twist of the object in unit time.

    Returns
    -------
    (6,) array
        Home axes; the linear part is the way of the object's origin.

    """
    return pose_difference(home_from_goal, home_from_current)


def errors_of(twist: np.ndarray) -> Errors:
    """Sort a displacement by degrees of freedom."""
    return Errors(float(np.hypot(twist[0], twist[1])), float(abs(twist[2])),
                  float(abs(twist[5])), float(np.hypot(twist[3], twist[4])))


def next_pose(path: np.ndarray, here: np.ndarray) -> int:
    """Find the pose of a path (N, 4, 4) to go on to: the first unless another is nearer."""
    away = displacement(here, path)
    far = np.hypot(np.linalg.norm(away[:, :3], axis=1) / LENGTH_M,
                   np.linalg.norm(away[:, 3:], axis=1))
    spacing = np.median(np.abs(np.diff(far))) if len(far) > 1 else 0.0
    nearest = int(np.argmin(far))
    slack = min(1.5 * spacing, AT_FIRST)
    return 0 if far[0] <= far[nearest] + slack else nearest


def sigmas_of(covariance: np.ndarray) -> Errors:
    """Give the standard deviations of a pose by degrees of freedom, worst directions."""
    side = np.linalg.eigvalsh(covariance[:2, :2])[-1]
    tilt = np.linalg.eigvalsh(covariance[3:5, 3:5])[-1]
    return Errors(*(float(np.sqrt(max(v, 0.0)))
                    for v in (side, covariance[2, 2], covariance[5, 5], tilt)))


def damped_step(jacobian: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """
    Solve for the joint step of a displacement.

    For (..., 6, n) and (..., 6) stacks. Damping comes in smoothly where the smallest
    singular value falls below ``SINGULAR`` (Nakamura and Hanafusa, 1986); elsewhere the
    step is exact.
    """
    scaled = jacobian * _SCALE[:, None]
    exact = _exact_inverse(scaled)
    if exact is not None:
        return (exact @ (twist * _SCALE)[..., None])[..., 0]
    left, values, right = np.linalg.svd(scaled, full_matrices=False)
    damping = DAMPING ** 2 * np.maximum(0.0, 1.0 - (values[..., -1:] / SINGULAR) ** 2)
    along = (np.swapaxes(left, -1, -2) @ (twist * _SCALE)[..., None])[..., 0]
    factor = values / (values ** 2 + damping)
    return (np.swapaxes(right, -1, -2) @ (factor * along)[..., None])[..., 0]


def _exact_inverse(scaled: np.ndarray) -> np.ndarray | None:
    """Invert Jacobians (..., 6, 6) if that shows all of them to be far from singular."""
    if scaled.shape[-1] != scaled.shape[-2]:
        return None
    try:
        inverse = np.linalg.inv(scaled)
    except np.linalg.LinAlgError:
        return None
    # The norm of an inverse is at least one over the smallest singular value.
    squares = np.einsum('...ij,...ij->...', inverse, inverse)
    return inverse if np.all(squares <= SINGULAR ** -2) else None


def joints_for(model: ArmModel, joints_rad: np.ndarray, home_from_goal: np.ndarray) -> np.ndarray:
    """Find the joints near the given ones that bring the object closest to a pose."""
    target = np.array(joints_rad, dtype=float)
    for _ in range(MODEL_STEPS):
        pose, jacobian = model.posture(target)
        step = damped_step(jacobian, displacement(pose, home_from_goal))
        largest = np.abs(step).max()
        target += step * min(1.0, LARGEST_MODEL_STEP_RAD / max(largest, 1e-12))
        if largest < 1e-7:
            break
    return target


def limit_step(robot: Robot, joints_rad: np.ndarray, target_rad: np.ndarray,
               margin_rad: float, largest_rad: float) -> Step:
    """
    Shorten a joint step so that no joint leaves its limits or goes too far at once.

    All joints scale together. A joint that stands in its margin already may move
    away from the limit, never towards it.
    """
    step = target_rad - joints_rad
    room = np.where(step > 0.0, robot.upper_rad - margin_rad - joints_rad,
                    joints_rad - robot.lower_rad - margin_rad)
    size = np.abs(step)
    moving = size > 1e-9
    shares = np.full(len(step), np.inf)
    shares[moving] = np.maximum(room[moving], 0.0) / size[moving]
    worst = int(np.argmin(shares))
    reach = largest_rad / max(size.max(), 1e-12)
    share = min(1.0, shares[worst], reach)
    limited_by = ''
    if share < 1.0:
        limited_by = robot.joint_names[worst] if shares[worst] <= reach else 'step'
    return Step(joints_rad + share * step, float(share), limited_by)


def rays_at(poses: np.ndarray, points_m: np.ndarray, home_depth_m: float,
            nearest_m: float = 1e-3) -> np.ndarray:
    """
    Project points of the object to unit focal length.

    Parameters
    ----------
    poses : (..., 4, 4) array
        home_from_object.
    points_m : (N, 3) array
        Points of the object.
    home_depth_m : float
        Depth of home in front of the camera.
    nearest_m : float
        Points nearer than this, or behind the camera, count as at this depth.

    Returns
    -------
    (..., N, 2) array

    """
    points = points_m @ np.swapaxes(poses[..., :3, :3], -1, -2) + poses[..., None, :3, 3]
    return points[..., :2] / np.maximum(points[..., 2:] + home_depth_m, nearest_m)


def corner_travel(model: ArmModel, from_rad: np.ndarray, to_rad: np.ndarray,
                  points_m: np.ndarray, home_depth_m: float) -> float:
    """Give the largest way of an object point in the image, at unit focal length."""
    start, end = (rays_at(model.pose(joints_rad), points_m, home_depth_m)
                  for joints_rad in (from_rad, to_rad))
    return float(np.linalg.norm(end - start, axis=1).max())


def move_time(robot: Robot, step_rad: np.ndarray) -> float:
    """
    Give the time of a move from rest to rest inside the joints' speed limits.

    For a cubic in time: peak speed 1.5 d / T, peak acceleration 6 d / T^2.
    """
    size = np.abs(step_rad)
    return float(max((1.5 * size / robot.velocity_rad_s).max(),
                     np.sqrt(6.0 * size / robot.acceleration_rad_s2).max()))
