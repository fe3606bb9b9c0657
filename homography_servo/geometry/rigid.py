"""
Rigid motions: SE(3) and its twists, on single matrices or stacks of them.

Conventions
-----------
``a_from_b`` is a (4, 4) matrix that maps coordinates in b to coordinates in a.
A twist is (vx, vy, vz, wx, wy, wz): linear part first, the order of ROS.

Two kinds of six numbers between two poses are used, and must not be mixed up:

- a *screw* (`log_transform`, `screw_between`) is one motion along and about a
  fixed axis; its linear part is the velocity of the point at the parent's origin;
- a *difference* (`pose_difference`) keeps translation of the object's origin and
  rotation apart. Covariances of poses are covariances of this difference.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from homography_servo.geometry.rigid_single import cubic_series
from homography_servo.geometry.rigid_single import exp_one
from homography_servo.geometry.rigid_single import HALF_TURN
from homography_servo.geometry.rigid_single import log_one
from homography_servo.geometry.rigid_single import SMALL_RAD
import numpy as np
from scipy.spatial.transform import Rotation


def transform(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Build ``a_from_b`` (..., 4, 4) from a rotation (..., 3, 3) and a translation (..., 3)."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    if rotation.shape[-2:] != (3, 3) or translation.shape[-1:] != (3,):
        raise ValueError('rotation must have shape (..., 3, 3) and translation (..., 3), '
                         f'got {rotation.shape} and {translation.shape}')
    stack = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    a_from_b = np.zeros((*stack, 4, 4))
    a_from_b[..., :3, :3] = rotation
    a_from_b[..., :3, 3] = translation
    a_from_b[..., 3, 3] = 1.0
    return a_from_b


def inverse(a_from_b: np.ndarray) -> np.ndarray:
    """Invert transforms (..., 4, 4) without a linear solver."""
    a_from_b = checked_transforms(a_from_b)
    back = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    return transform(back, -(back @ a_from_b[..., :3, 3:])[..., 0])


def transform_points(a_from_b: np.ndarray, points_b: np.ndarray) -> np.ndarray:
    """Map points (N, 3) through transforms (..., 4, 4) to (..., N, 3)."""
    a_from_b = checked_transforms(a_from_b)
    turned = points_b @ np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    return turned + a_from_b[..., None, :3, 3]


def skew(vector: np.ndarray) -> np.ndarray:
    """Give the (..., 3, 3) matrices that turn a product into a cross product."""
    vector = np.asarray(vector, float)
    return (vector @ _CROSS).reshape(*vector.shape, 3)


def exp_twist(twist: np.ndarray) -> np.ndarray:
    """
    Move along a screw: the exponential map of SE(3).

    Parameters
    ----------
    twist : (..., 6) array
        Linear part [m] and rotation vector [rad].

    Returns
    -------
    (..., 4, 4) array
        The rigid motion.

    References
    ----------
    Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation, eq. (2.36).

    """
    twist = _twists(twist)
    if twist.ndim == 1:
        return exp_one(twist.tolist())
    cross = skew(twist[..., 3:])
    square = cross @ cross
    first, second, third = _coefficients(np.linalg.norm(twist[..., 3:], axis=-1))
    spiral = _EYE + second * cross + third * square
    return transform(_EYE + first * cross + second * square,
                     (spiral @ twist[..., :3, None])[..., 0])


def log_transform(a_from_b: np.ndarray) -> np.ndarray:
    """
    Find the screw of a rigid motion: the inverse of `exp_twist`.

    Parameters
    ----------
    a_from_b : (..., 4, 4) array
        Rigid motions.

    Returns
    -------
    (..., 6) array
        Twists with a rotation of at most pi.

    """
    a_from_b = checked_transforms(a_from_b)
    return twist_about(rotation_log(a_from_b[..., :3, :3]), a_from_b[..., :3, 3])


def twist_about(rotation_vector: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """
    Find the twist of a rigid motion whose rotation vector is given, of any length.

    Parameters
    ----------
    rotation_vector : (..., 3) array
        Rotation [rad]; unlike that of `log_transform` it may be longer than pi, which is
        the way round the other side. Multiples of a full turn have no such twist.
    translation : (..., 3) array
        Translation of the motion.

    Returns
    -------
    (..., 6) array
        The twist.

    """
    rotation_vector = np.asarray(rotation_vector, float)
    angle_rad = np.linalg.norm(rotation_vector, axis=-1)[..., None, None]
    cross = skew(rotation_vector)
    unspiral = np.eye(3) - 0.5 * cross + _cotangent(angle_rad) * (cross @ cross)
    linear = (unspiral @ np.asarray(translation, float)[..., None])[..., 0]
    return np.concatenate([linear, rotation_vector], axis=-1)


def adjoint(a_from_b: np.ndarray) -> np.ndarray:
    """Give the (..., 6, 6) matrices that express screws of frame b in frame a."""
    a_from_b = checked_transforms(a_from_b)
    rotation = a_from_b[..., :3, :3]
    matrix = np.zeros((*a_from_b.shape[:-2], 6, 6))
    matrix[..., :3, :3] = matrix[..., 3:, 3:] = rotation
    matrix[..., :3, 3:] = skew(a_from_b[..., :3, 3]) @ rotation
    return matrix


def rotation_log(rotation: np.ndarray) -> np.ndarray:
    """Give the rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3)."""
    rotation = np.array(rotation, float)  # a copy: scipy 1.11 refuses what may not be written
    if rotation.shape[-2:] != (3, 3) or not np.isfinite(rotation).all():
        raise ValueError('rotation must be finite and have shape (..., 3, 3), got '
                         f'{rotation.shape}{"" if np.isfinite(rotation).all() else " with nan"}')
    if rotation.ndim == 2:
        vector = log_one(rotation.tolist())
        if vector is not None:
            return vector
    flat = rotation.reshape(*rotation.shape[:-2], 9)
    axial = 0.5 * (flat[..., _LOWER] - flat[..., _UPPER])
    sine = np.sqrt((axial * axial).sum(axis=-1))
    cosine = 0.5 * (flat[..., 0] + flat[..., 4] + flat[..., 8] - 1.0)
    tiny = sine < 1e-12
    vector = axial * np.where(tiny, 1.0, np.arctan2(sine, cosine)
                              / np.where(tiny, 1.0, sine))[..., None]
    # Near half a turn the axis vanishes from the odd part of the matrix.
    turned = cosine < HALF_TURN
    if turned.any():
        vector[turned] = Rotation.from_matrix(rotation[turned].reshape(-1, 3, 3)).as_rotvec() \
            .reshape(vector[turned].shape)
    return vector


def rotation_angle(rotation: np.ndarray) -> np.ndarray | float:
    """Measure the angle [rad], 0 to pi, of rotation matrices (..., 3, 3)."""
    rotation = np.asarray(rotation, float)
    axial = rotation - np.swapaxes(rotation, -1, -2)
    sine = np.linalg.norm(axial, axis=(-2, -1)) / math.sqrt(8.0)
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0)
    angle_rad = np.arctan2(sine, cosine)
    return float(angle_rad) if angle_rad.ndim == 0 else angle_rad


def pose_difference(parent_from_a: np.ndarray, parent_from_b: np.ndarray) -> np.ndarray:
    """
    Subtract pose b from pose a, translation and rotation apart.

    Parameters
    ----------
    parent_from_a, parent_from_b : (..., 4, 4) array
        Two poses in the same parent frame.

    Returns
    -------
    (..., 6) array
        Translation of the origin [m] and rotation vector [rad] that lead from b to a,
        both along the axes of the parent. Covariances of poses refer to it.

    """
    a, b = checked_transforms(parent_from_a), checked_transforms(parent_from_b)
    turn = rotation_log(a[..., :3, :3] @ np.swapaxes(b[..., :3, :3], -1, -2))
    return np.concatenate([a[..., :3, 3] - b[..., :3, 3], turn], axis=-1)


def displaced(parent_from_a: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Add a difference (..., 6) to poses (..., 4, 4): undoes `pose_difference`."""
    a, difference = checked_transforms(parent_from_a), _twists(difference)
    turned = _rotations(difference[..., 3:]) @ a[..., :3, :3]
    return transform(turned, a[..., :3, 3] + difference[..., :3])


def screw_between(parent_from_start: np.ndarray, parent_from_goal: np.ndarray) -> np.ndarray:
    """Find the twist (..., 6) in the parent with ``exp_twist(twist) @ start == goal``."""
    return log_transform(checked_transforms(parent_from_goal) @ inverse(parent_from_start))


class Screw(NamedTuple):
    """A finite motion: along and about one line."""

    direction: np.ndarray  # (3,) unit vector
    point_m: np.ndarray  # (3,) the point of the axis nearest the origin
    advance_m: float  # along the direction
    angle_rad: float  # about the direction


def screw_axis(twist: np.ndarray) -> Screw:
    """Give the axis of a twist (6,); a pure translation has its line through the origin."""
    twist = _twists(twist)
    linear, angular = twist[:3], twist[3:]
    angle_rad = float(np.linalg.norm(angular))
    if angle_rad < 1e-12:
        advance_m = float(np.linalg.norm(linear))
        direction = linear / advance_m if advance_m > 0.0 else np.array([0.0, 0.0, 1.0])
        return Screw(direction, np.zeros(3), advance_m, 0.0)
    direction = angular / angle_rad
    point_m = np.cross(direction, linear) / angle_rad
    return Screw(direction, point_m, float(direction @ linear), angle_rad)


def _rotations(vector: np.ndarray) -> np.ndarray:
    cross = skew(vector)
    first, second, _ = _coefficients(np.linalg.norm(vector, axis=-1))
    return _EYE + first * cross + second * (cross @ cross)


def _coefficients(angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate sin x / x, (1 - cos x) / x^2 and (x - sin x) / x^3, (..., 1, 1) each."""
    angle_rad = np.asarray(angle_rad)[..., None, None]
    half = np.maximum(0.5 * angle_rad, 1e-150)
    second = 0.5 * (np.sin(half) / half) ** 2
    squared = angle_rad ** 2
    safe = np.maximum(angle_rad, SMALL_RAD)
    third = np.where(angle_rad < SMALL_RAD, cubic_series(squared),
                     (safe - np.sin(safe)) / safe ** 3)
    return 1.0 - squared * third, second, third


def _cotangent(angle_rad: np.ndarray) -> np.ndarray:
    """Evaluate (1 - x/2 cot(x/2)) / x^2 without cancellation."""
    squared = angle_rad**2
    series = 1 / 12 + squared / 720 * (1 + squared / 42 * (1 + squared / 40))
    safe = np.where(angle_rad < SMALL_RAD, 1.0, angle_rad)
    closed = (1.0 - 0.5 * safe * np.cos(0.5 * safe) / np.sin(0.5 * safe)) / safe**2
    return np.where(angle_rad < SMALL_RAD, series, closed)


def checked_transforms(a_from_b: np.ndarray) -> np.ndarray:
    """Give transforms as an array (..., 4, 4), or refuse the shape."""
    a_from_b = np.asarray(a_from_b, float)
    if a_from_b.shape[-2:] != (4, 4):
        raise ValueError(f'transforms must have shape (..., 4, 4), got {a_from_b.shape}')
    return a_from_b


def _twists(twist: np.ndarray) -> np.ndarray:
    twist = np.asarray(twist, float)
    if twist.shape[-1:] != (6,):
        raise ValueError(f'twists must have shape (..., 6), got {twist.shape}')
    if not np.isfinite(twist).all():
        raise ValueError('twists must be finite')
    return twist


_EYE = np.eye(3)
_LOWER, _UPPER = np.array([7, 2, 3]), np.array([5, 6, 1])  # of a flat matrix, by axis
_CROSS = np.zeros((3, 9))  # v @ _CROSS is the cross product matrix of v, by rows
_CROSS[0, 7], _CROSS[0, 5], _CROSS[1, 2], _CROSS[1, 6], _CROSS[2, 3], _CROSS[2, 1] = (
    1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
