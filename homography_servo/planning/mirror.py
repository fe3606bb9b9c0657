"""
How easily a plane's pose could be taken for its mirror, predicted without an image.

Seen from afar, a plane and the plane mirrored about the line of sight look alike.
The mirror is refined by reprojection as the estimator would do it, and what it
cannot explain away is compared with the noise.
"""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import erfc

_ITERATIONS = 3
_SAME_RAD = 0.01  # closer minima are one
_FLIP = np.diag([1.0, 1.0, -1.0])


def predicted_ambiguity(poses: np.ndarray, points_px: np.ndarray, camera: Camera,
                        object_points_m: np.ndarray, home_depth_m: float,
                        sigma_px: float) -> np.ndarray:
    """
    Predict the share of looks at which corners alone cannot tell the mirror.

    Parameters
    ----------
    poses : (N, 4, 4) array
        ``home_from_object``.
    points_px : (N, M, 2) array
        Where the points are seen at these poses.
    camera : Camera
        What looks; only its focal length matters here.
    object_points_m : (M, 3) array
        The points on the object.
    home_depth_m : float
        Distance of the home frame from the camera.
    sigma_px : float
        Standard deviation of a measured coordinate.

    Returns
    -------
    (N,) array
        Twice the probability that the mirror fits the noisy points better, from 0
        (certain) to 1 (toss-up); 0 where the two minima are one.

    """
    turn, place = poses[:, :3, :3], poses[:, :3, 3] + (0.0, 0.0, home_depth_m)
    if not np.isfinite(points_px).all() or (place[:, 2] <= 0.0).any():
        return np.where(place[:, 2] <= 0.0, 1.0, 0.0)
    sight = place / np.linalg.norm(place, axis=1, keepdims=True)
    reflect = np.eye(3) - 2.0 * sight[:, :, None] * sight[:, None, :]
    points = object_points_m @ np.swapaxes(turn, 1, 2) + place[:, None, :]
    rays = points[..., :2] / points[..., 2:]
    mirror, residual = _refine(reflect @ turn @ _FLIP, place, rays, object_points_m)
    focal_px = 0.5 * (camera.fx + camera.fy)
    separation = (residual**2).sum(axis=(1, 2)) * (focal_px / sigma_px) ** 2
    apart_rad = Rotation.from_matrix(np.swapaxes(mirror, 1, 2) @ turn).magnitude()
    wrong = erfc(np.sqrt(np.nan_to_num(separation, nan=np.inf) / 8.0))
    return np.where(apart_rad < _SAME_RAD, 0.0, wrong)


def _refine(turn: np.ndarray, place: np.ndarray, rays: np.ndarray,
            object_points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit poses to rays by a few Gauss-Newton steps; give rotations and residuals."""
    place = place.copy()
    for _ in range(_ITERATIONS):
        arm, residual, jacobian = _linearise(turn, place, rays, object_points_m)
        gram = np.swapaxes(jacobian, 1, 2) @ jacobian
        gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        rhs = np.swapaxes(jacobian, 1, 2) @ residual.reshape(len(turn), -1, 1)
        step = np.clip(np.linalg.solve(gram, rhs)[..., 0], -0.5, 0.5)
        place += step[:, :3]
        turn = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ turn
    return turn, _linearise(turn, place, rays, object_points_m)[1]


def _linearise(turn: np.ndarray, place: np.ndarray, rays: np.ndarray,
               object_points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    arm = object_points_m @ np.swapaxes(turn, 1, 2)
    points = arm + place[:, None, :]
    depth = np.maximum(points[..., 2], 1e-6)
    u, v = points[..., 0] / depth, points[..., 1] / depth
    residual = rays - np.stack([u, v], axis=-1)
    x, y, z = np.moveaxis(arm, -1, 0)
    zero, one = np.zeros_like(u), np.ones_like(u)
    row_u = np.stack([one, zero, -u, -u * y, z + u * x, -y], axis=-1)
    row_v = np.stack([zero, one, -v, -z - v * y, v * x, x], axis=-1)
    jacobian = np.stack([row_u, row_v], axis=-2) / depth[..., None, None]
    return arm, residual, jacobian.reshape(len(turn), -1, 6)
