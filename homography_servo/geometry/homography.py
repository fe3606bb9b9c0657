"""
Homographies: estimated from points, measured, and built for points off the plane.

The estimate is the paper's numerical least squares (its section 3) with
coordinates normalised first, which keeps it well conditioned in pixels.
"""

from __future__ import annotations

import math

from homography_servo.result import Rejected
import numpy as np

_DEGENERATE = 1e-9  # share of the largest singular value below which a direction is open


def estimate_homography(src: np.ndarray, dst: np.ndarray,
                        weights: np.ndarray | None = None) -> np.ndarray | Rejected:
    """
    Fit the homography that maps src to dst by normalised linear least squares.

    Parameters
    ----------
    src, dst : (N, 2) array
        Matched points, N >= 4, any unit.
    weights : (N,) array, optional
        Weights >= 0 of the squared errors; points of weight 0 are left out.

    Returns
    -------
    (3, 3) array or Rejected
        Scaled so that H33 is 1 (-1 when the origin of src lies beyond the horizon of
        the points): mapped points have a positive third coordinate.

    References
    ----------
    Hartley and Zisserman, Multiple View Geometry, 2nd ed., algorithm 4.2.

    """
    src, dst, root = _checked(src, dst, weights)
    used = root > 0.0
    if not (np.isfinite(src).all() and np.isfinite(dst).all() and np.isfinite(root).all()):
        return Rejected('a point is not finite')
    if used.sum() < 4:
        return Rejected(f'need 4 points, have {used.sum()}')
    src, dst, root = src[used], dst[used], root[used]
    src_scaling, dst_scaling = _normaliser(src, root**2), _normaliser(dst, root**2)
    if src_scaling is None or dst_scaling is None:
        return Rejected('all points coincide')
    s, d = (points * m[0, 0] + m[:2, 2] for points, m in
            ((src, src_scaling), (dst, dst_scaling)))
    rows = _equations(s, d, root / root.max())
    _, spread, axes = np.linalg.svd(rows, full_matrices=False)
    scaled = axes[8].reshape(3, 3)
    if spread[7] < _DEGENERATE * spread[0] or \
            abs(np.linalg.det(scaled)) < _DEGENERATE * np.linalg.norm(scaled)**3:
        return Rejected('the points do not fix a homography: too many of them coincide or '
                        'lie on one line')
    return _oriented(np.linalg.inv(dst_scaling) @ scaled @ src_scaling, src)


def apply_homography(dst_from_src: np.ndarray, src: np.ndarray) -> np.ndarray:
    """
    Map points through homographies.

    Parameters
    ----------
    dst_from_src : (..., 3, 3) array
        Homographies, any scale.
    src : (N, 2) array
        Points.

    Returns
    -------
    (..., N, 2) array
        Mapped points; ``inf`` where a point maps to infinity.

    """
    dst_from_src, src = np.asarray(dst_from_src, float), _points(src, 'src')
    if dst_from_src.shape[-2:] != (3, 3):
        raise ValueError(f'homographies must have shape (..., 3, 3), got {dst_from_src.shape}')
    mapped = np.column_stack([src, np.ones(len(src))]) @ np.swapaxes(dst_from_src, -1, -2)
    depth = mapped[..., 2:]
    finite = np.abs(depth) > np.finfo(float).eps * np.abs(mapped).max(axis=-1, keepdims=True)
    return np.where(finite, mapped[..., :2] / np.where(finite, depth, 1.0), np.inf)


def transfer_error(dst_from_src: np.ndarray, src: np.ndarray, dst: np.ndarray) -> np.ndarray:
    """Measure how far (N,) mapped points land from their partners; ``inf`` at infinity."""
    src, dst = _points(src, 'src'), _points(dst, 'dst')
    if src.shape != dst.shape:
        raise ValueError(f'src and dst must match, got {src.shape} and {dst.shape}')
    mapped = apply_homography(dst_from_src, src)
    with np.errstate(invalid='ignore'):
        return np.nan_to_num(np.linalg.norm(mapped - dst, axis=-1), nan=np.inf, posinf=np.inf)


def point_homographies(homography: np.ndarray, object_points_m: np.ndarray,
                       home_depth_m: float = 1.0) -> np.ndarray:
    """
    Build the homography of every point of an object that is not flat.

    Parameters
    ----------
    homography : (..., 3, 3) array
        Homographies of the plane z = 0, scaled as in eq. 15: the first two columns are
        r1 and r2. `decomposition.compose` gives them so.
    object_points_m : (N, 3) array
        The points at the virtual home position.
    home_depth_m : float
        cZh.

    Returns
    -------
    (..., N, 3, 3) array
        (H_k0)_j of eqs. 13 and 14; for points with z = 0 that of eq. 15.

    """
    plane, points = np.asarray(homography, float), _solid(object_points_m)
    if plane.shape[-2:] != (3, 3):
        raise ValueError(f'homography must have shape (..., 3, 3), got {plane.shape}')
    relative = points[:, 2:] / home_depth_m
    if not (relative > -1.0).all():
        raise ValueError('object points must lie before the camera at the virtual home position, '
                         f'got z down to {points[:, 2].min()} m with home_depth_m {home_depth_m}')
    homographies = np.empty((*plane.shape[:-2], len(points), 3, 3))
    homographies[..., :2] = plane[..., None, :, :2]
    normal = np.cross(plane[..., 0], plane[..., 1])  # r3 = r1 x r2
    homographies[..., 2] = ((plane[..., None, :, 2] + normal[..., None, :] * relative)
                            / (1.0 + relative))
    return homographies


def home_image(object_points_m: np.ndarray, home_depth_m: float = 1.0) -> np.ndarray:
    """Project an object (N, 3) at the virtual home position: p_0 with unit focal length."""
    points = _solid(object_points_m)
    return points[:, :2] / (points[:, 2:] + home_depth_m)


def _solid(object_points_m: np.ndarray) -> np.ndarray:
    points = np.asarray(object_points_m, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f'object_points_m must have shape (N, 3), got {points.shape}')
    return points


def _checked(src: np.ndarray, dst: np.ndarray, weights: np.ndarray | None
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    src, dst = _points(src, 'src'), _points(dst, 'dst')
    if src.shape != dst.shape:
        raise ValueError(f'src and dst must match, got {src.shape} and {dst.shape}')
    weights = np.ones(len(src)) if weights is None else np.asarray(weights, float)
    if weights.shape != (len(src),):
        raise ValueError(f'weights must have shape ({len(src)},), got {weights.shape}')
    if (weights < 0.0).any():
        raise ValueError(f'weights must be >= 0, got {weights.min()}')
    return src, dst, np.sqrt(weights)


def _points(points: np.ndarray, name: str) -> np.ndarray:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f'{name} must have shape (N, 2), got {points.shape}')
    return points


def _normaliser(points: np.ndarray, weights: np.ndarray) -> np.ndarray | None:
    """Centre the points and bring their mean distance to sqrt(2)."""
    centre = np.average(points, axis=0, weights=weights)
    size = np.average(np.linalg.norm(points - centre, axis=1), weights=weights)
    if not size > 1e-12 * max(1.0, float(np.abs(centre).max())):
        return None
    gain = math.sqrt(2.0) / size
    return np.array([[gain, 0.0, -gain * centre[0]], [0.0, gain, -gain * centre[1]],
                     [0.0, 0.0, 1.0]])


def _equations(src: np.ndarray, dst: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Write dst x (H src) = 0 as two weighted rows per point, at least nine rows in all."""
    rows = np.zeros((max(2 * len(src), 9), 9))
    ones = np.column_stack([src, np.ones(len(src))]) * root[:, None]
    rows[0:2 * len(src):2, 0:3] = rows[1:2 * len(src):2, 3:6] = ones
    rows[0:2 * len(src):2, 6:9] = -dst[:, :1] * ones
    rows[1:2 * len(src):2, 6:9] = -dst[:, 1:] * ones
    return rows


def _oriented(homography: np.ndarray, src: np.ndarray) -> np.ndarray:
    """Make mapped points positive in the third coordinate and |H33| = 1 where possible."""
    depths = src @ homography[2, :2] + homography[2, 2]
    positive = homography * (1.0 if np.median(depths) > 0.0 else -1.0)
    size = abs(positive[2, 2])
    scale = size if size > 1e-12 * np.abs(positive).max() else np.linalg.norm(positive)
    return positive / scale
