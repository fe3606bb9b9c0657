"""
Pose of a rectangle of known size, quick enough to be asked for every frame.

The tracker needs it to tell a face from some other quadrilateral, and to know where
the sides of the box behind the face must appear. The pose that goes to the robot
comes from `geometry.pose`, which weighs covariances and keeps both minima.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
from homography_servo.result import Rejected
import numpy as np

STEADY = 1e-6  # step [rad, m] after which the next one would change nothing that counts
TWO = np.eye(2)
# p @ CROSS is the matrix (3, 3), flat, that takes the cross product of p with what it is
# multiplied by from the left: a turn w moves p by w x p, and d . (w x p) = (p x d) . w.
CROSS = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0],
                  [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
                  [0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]])


class FacePose(NamedTuple):
    """Where the rectangle is, and how well its projection fits."""

    rotation: np.ndarray  # (3, 3) camera from object
    translation: np.ndarray  # (3,) [m]
    miss: np.ndarray  # (N, 2) measured minus projected, normalised coordinates


def pose_of_face(points_m: np.ndarray, rays: np.ndarray, start: FacePose | None = None,
                 iterations: int = 4) -> FacePose | Rejected:
    """
    Fit a pose by Gauss-Newton on the projection error.

    Parameters
    ----------
    points_m : (N, 3) array
        Points of the object; the first four lie in z = 0 and are no three on a line.
    rays : (N, 2) array
        Their ideal normalised coordinates.
    start : FacePose or None
        A pose near by; None begins with the homography of the first four points.
    iterations : int
        Gauss-Newton steps at most.

    Returns
    -------
    FacePose or Rejected

    """
    first = _from_homography(points_m[:4, :2], rays[:4]) if start is None else start
    if isinstance(first, Rejected):
        return first
    rotation, translation = first.rotation, first.translation
    for _ in range(iterations):
        miss, jacobian = _linearise(points_m, rays, rotation, translation)
        step = cv2.solve(jacobian.T @ jacobian, jacobian.T @ miss.reshape(-1, 1),
                         flags=cv2.DECOMP_CHOLESKY)[1][:, 0]
        rotation, translation = _turned(rotation, step[:3]), translation + step[3:]
        if not (np.isfinite(translation).all() and translation[2] > 1e-3):
            return Rejected('the pose of the face does not converge')
        if max(map(abs, step.tolist())) < STEADY:
            return FacePose(rotation, translation, miss - (jacobian @ step).reshape(miss.shape))
    miss, _ = _linearise(points_m, rays, rotation, translation)
    return FacePose(rotation, translation, miss)


def project_with_slopes(points_m: np.ndarray, rotation: np.ndarray,
                        translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Project points and differentiate them by a small turn (camera axes) and shift.

    Returns
    -------
    (N, 2) array, (N, 2, 6) array
        Normalised coordinates; their derivatives, columns rx, ry, rz, x, y, z.

    """
    turned = points_m @ rotation.T
    points = turned + translation
    inverse = 1.0 / points[:, 2:]
    rays = points[:, :2] * inverse
    slopes = np.zeros((len(points), 2, 6))
    slopes[:, :, 3:5] = inverse[:, None] * TWO
    slopes[:, :, 5] = -inverse * rays
    slopes[:, :, :3] = slopes[:, :, 3:] @ (turned @ CROSS).reshape(-1, 3, 3)
    return rays, slopes


def next_pose(points_m: np.ndarray, rays: np.ndarray, near: FacePose) -> FacePose | Rejected:
    """
    Take one step to the pose of points that were close to another pose just before.

    Returns
    -------
    FacePose or Rejected
        The pose; what its projection misses is right to first order.

    """
    predicted, slope = project_with_slopes(points_m, near.rotation, near.translation)
    slope, miss = slope.reshape(-1, 6), (rays - predicted).reshape(-1, 1)
    solved, step = cv2.solve(slope.T @ slope, slope.T @ miss, flags=cv2.DECOMP_CHOLESKY)
    if not solved:
        return Rejected('the pose of the face is not determined')
    return moved_pose(near, step[:, 0], (miss - slope @ step).reshape(-1, 2))


def moved_pose(near: FacePose, step: np.ndarray, miss: np.ndarray) -> FacePose:
    """Move a pose by a small turn and shift (6,); say what its projection misses then."""
    return FacePose(_turned(near.rotation, step[:3]), near.translation + step[3:], miss)


def _linearise(points_m: np.ndarray, rays: np.ndarray, rotation: np.ndarray,
               translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    predicted, slope = project_with_slopes(points_m, rotation, translation)
    return rays - predicted, slope.reshape(-1, 6)


def _turned(rotation: np.ndarray, small: np.ndarray) -> np.ndarray:
    """Turn by a small rotation vector (Cayley's formula: stays a rotation)."""
    x, y, z = (0.5 * small).tolist()
    xx, yy, zz, one = x * x, y * y, z * z, 1.0 + x * x + y * y + z * z
    cayley = np.array([
        [1.0 + xx - yy - zz, 2.0 * (x * y - z), 2.0 * (x * z + y)],
        [2.0 * (x * y + z), 1.0 - xx + yy - zz, 2.0 * (y * z - x)],
        [2.0 * (x * z - y), 2.0 * (y * z + x), 1.0 - xx - yy + zz]])
    return (cayley / one) @ rotation


def _from_homography(points_m: np.ndarray, rays: np.ndarray) -> FacePose | Rejected:
    """Decompose the homography of four points."""
    matrix = cv2.getPerspectiveTransform(points_m.astype(np.float32), rays.astype(np.float32))
    right, down, centre = matrix.T.astype(float)
    long, short = math.sqrt(float(right @ right)), math.sqrt(float(down @ down))
    if not (math.isfinite(long + short) and min(long, short) > 1e-9):
        return Rejected('the corners lie on a line')
    scale = math.copysign(1.0 / math.sqrt(long * short), centre[2])
    # The rotation nearest to the two columns turns them apart about their middle.
    middle, apart = right / long + down / short, right / long - down / short
    both, between = float(middle @ middle), float(apart @ apart)
    if min(both, between) < 1e-9:
        return Rejected('the corners lie on a line')
    middle, apart = middle / math.sqrt(2.0 * both), apart / math.sqrt(2.0 * between)
    right, down = (math.copysign(1.0, scale) * (middle + side * apart) for side in (1.0, -1.0))
    (a, b, c), (d, e, f) = right.tolist(), down.tolist()
    rotation = np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])
    return FacePose(rotation, scale * centre, np.zeros((4, 2)))
