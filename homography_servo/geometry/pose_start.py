"""
Where the refinement of a pose starts: both poses that a plane suggests.

A homography is first order known at the centre of the face: there the image of
the plane is an affine map, the same for two orientations that are mirror images of
each other about the line of sight. The closed form follows
Collins and Bartoli, Infinitesimal Plane-Based Pose Estimation, IJCV 109, 2014,
DOI 10.1007/s11263-014-0725-5.

The formulas are written by elements with + - * / and powers only, so that they work
on plain floats (one view, where array calls would cost more than arithmetic) and on
arrays (M views) alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from homography_servo.result import Rejected
import numpy as np

_FLAT = 1e-6  # thickness over length below which an object counts as flat
_LINE = 1e-7  # area over squared size below which three points are on a line


@dataclass(frozen=True)
class Shape:
    """An object's points in their own principal axes, and what follows from them once."""

    centre_m: np.ndarray  # (3,)
    object_from_axes: np.ndarray  # (3, 3), third axis across the object's best plane
    plane_m: np.ndarray  # (N, 2) points in that plane
    flat: bool
    faces_camera: bool  # flat and z = const: seen from its -z side only
    basis: np.ndarray | None = None  # (3, 4): for four points, see `_basis`


def shape_of(points_m: np.ndarray) -> Shape | Rejected:
    """Describe an object's points (N, 3), N >= 4; remembered, as objects seldom change."""
    return _shape_of(points_m.tobytes(), len(points_m))


@lru_cache(maxsize=64)
def _shape_of(data: bytes, count: int) -> Shape | Rejected:
    points = np.frombuffer(data).reshape(count, 3)
    if not np.isfinite(points).all():
        return Rejected('a point of the object is not finite')
    centre = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - centre)
    if spread[0] <= 1e-12 * max(1.0, np.abs(points).max()):
        return Rejected('all points of the object coincide')
    if spread[1] < _FLAT * spread[0]:
        return Rejected('the points of the object lie on one line')
    flat = bool(spread[2] < _FLAT * spread[0])
    level = flat and abs(axes[2, 2]) > 1.0 - 1e-9
    rotation = np.eye(3) if level else axes.T * (1.0, 1.0, np.linalg.det(axes))
    plane = ((points - centre) @ rotation)[:, :2]
    basis = None
    if flat and count == 4:
        basis = _basis(plane)
        if basis is None:
            return Rejected('three of the four points of the object lie on one line')
    return Shape(centre, rotation, plane, flat, level, basis)


def planar_starts(shape: Shape, rays: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Find both starting poses of a flat object.

    Parameters
    ----------
    shape : Shape
        The object.
    rays : (M, 2, N) array
        Normalised image coordinates.

    Returns
    -------
    rotation : (2, M, 3, 3) array
        Of the object in the camera.
    translation_m : (M, 3) array
        Of the centre of the points, the same for both.
    fault : (M,) int array
        0, or the key of `FAULTS`.

    """
    if shape.basis is not None:
        u, v = rays[0].tolist() if len(rays) == 1 else rays.transpose(1, 2, 0)
        elements, fault = _four_point_homography(shape.basis.tolist(), u, v)
    else:
        elements, fault = _many_point_homography(shape.plane_m, rays)
    if np.all(fault):
        empty = np.zeros((len(rays), 3, 3))
        return np.stack([empty, empty]), empty[:, 0], np.atleast_1d(fault)
    parts = np.array(_mirror_pair(*elements)).reshape(30, -1).T
    view, pair = parts[:, :9].reshape(-1, 3, 3), parts[:, 9:27].reshape(-1, 2, 3, 3)
    rotation = view @ pair.swapaxes(0, 1) @ shape.object_from_axes.T
    if shape.faces_camera:
        fault = np.where((pair[:, 0, 2, 2] <= 0.0) & (fault == 0), 3, fault)
    return rotation, parts[:, 27:], np.atleast_1d(fault)


FAULTS = {
    1: 'the points in the image coincide or lie on one line',
    2: 'the points are not in the order of the object: its plane would cut the camera',
    3: 'the face is seen mirrored: it looks away from the camera, or the points are in '
       'the wrong order',
}


def mirrored_rotation(rotation: np.ndarray, line_of_sight: np.ndarray, shape: Shape
                      ) -> np.ndarray:
    """
    Mirror orientations about the line of sight.

    Parameters
    ----------
    rotation : (M, 3, 3) array
        The object in the camera.
    line_of_sight : (M, 3) array
        From the camera to the object's centre.
    shape : Shape
        The object.

    Returns
    -------
    (M, 3, 3) array
        The orientations whose view from afar is the same for a flat object.

    """
    sight = line_of_sight / np.linalg.norm(line_of_sight, axis=-1, keepdims=True)
    flip_sight = np.eye(3) - 2.0 * sight[:, :, None] * sight[:, None, :]
    normal = shape.object_from_axes[:, 2]
    return flip_sight @ rotation @ (np.eye(3) - 2.0 * np.outer(normal, normal))


def _basis(plane_m: np.ndarray) -> np.ndarray | None:
    """
    Prepare four points for `_four_point_homography`.

    With s_3 = sum mu_i s_i, row i holds mu_i and row i of the inverse of [s_0 s_1 s_2],
    divided by mu_i. None if three of the points are on a line.
    """
    columns = np.vstack([plane_m.T, np.ones(4)])
    areas = [abs(np.linalg.det(np.delete(columns, i, axis=1))) for i in range(4)]
    if min(areas) < _LINE * np.square(plane_m).sum():
        return None
    inverse = np.linalg.inv(columns[:, :3])
    weights = (inverse @ columns[:, 3])[:, None]
    return np.hstack([weights, inverse / weights])


def _four_point_homography(basis, u, v):
    """
    Give the homography of four points exactly, as nine elements, and its fault.

    With m_i the homogeneous image points and m_3 = sum k_i m_i, it is
    H = sum k_i m_i (row i of the basis); the third coordinate of s_i becomes k_i / mu_i,
    which is positive for points before the camera.
    """
    u0, u1, u2, u3 = u
    v0, v1, v2, v3 = v
    a0, b0, a1, b1, a2, b2 = u0 - u3, v0 - v3, u1 - u3, v1 - v3, u2 - u3, v2 - v3
    area0, area1, area2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    whole = area0 + area1 + area2
    size = _LINE * (a0 * a0 + b0 * b0 + a1 * a1 + b1 * b1 + a2 * a2 + b2 * b2)
    line = ((abs(area0) <= size) | (abs(area1) <= size) | (abs(area2) <= size)
            | (abs(whole) <= size))
    safe = whole + line * (1.0 - whole)
    (mu0, *s0), (mu1, *s1), (mu2, *s2) = basis
    k0, k1, k2 = area0 / safe, area1 / safe, area2 / safe
    crossed = (k0 * mu0 <= 0.0) | (k1 * mu1 <= 0.0) | (k2 * mu2 <= 0.0)
    elements = []
    for m0, m1, m2 in ((u0 * k0, u1 * k1, u2 * k2), (v0 * k0, v1 * k1, v2 * k2), (k0, k1, k2)):
        elements += [m0 * p + m1 * q + m2 * r for p, q, r in zip(s0, s1, s2)]
    return elements, line * 1 + crossed * 2 * (1 - line)


def _many_point_homography(plane_m: np.ndarray, rays: np.ndarray):
    """Fit the homographies of M views by normalised least squares, nine elements and fault."""
    size_m = np.abs(plane_m).max()
    middle = rays.mean(axis=-1, keepdims=True)
    offset = rays - middle
    moments = offset @ offset.swapaxes(-1, -2)
    trace = moments[:, 0, 0] + moments[:, 1, 1]
    line = np.linalg.det(moments) <= _LINE**2 * trace**2
    scale = np.sqrt(np.where(line, 1.0, trace / plane_m.shape[0]))[:, None, None]
    ones = np.column_stack([plane_m / size_m, np.ones(len(plane_m))])
    target = offset / scale
    rows = np.zeros((len(rays), 2, len(plane_m), 8))
    rows[:, 0, :, 0:3] = rows[:, 1, :, 3:6] = ones
    rows[..., 6:8] = -target[..., None] * ones[:, :2]
    design, right = rows.reshape(len(rays), -1, 8), target.reshape(len(rays), -1, 1)
    normal = design.swapaxes(-1, -2) @ design + 1e-13 * len(plane_m) * np.eye(8)
    solution = np.linalg.solve(normal, design.swapaxes(-1, -2) @ right)
    homography = np.concatenate([solution[..., 0], np.ones((len(rays), 1))], axis=1)
    homography = homography.reshape(-1, 3, 3)
    crossed = (ones @ homography[:, 2, :, None] <= 0.0).any(axis=(1, 2))
    homography[:, :2] *= scale
    homography[:, :2] += middle * homography[:, 2:]
    homography[..., :2] /= size_m
    return homography.reshape(-1, 9).T, np.where(line, 1, 2 * crossed)


def _mirror_pair(h11, h12, h13, h21, h22, h23, h31, h32, h33):
    """Give the frame of sight (9), both orientations in it (2 x 9), and the centre (3)."""
    p, q = h13 / h33, h23 / h33
    length = (p * p + q * q + 1.0) ** 0.5
    x, y, z = p / length, q / length, 1.0 / length
    lean = 1.0 / (1.0 + z)
    v11, v12, v22 = 1.0 - x * x * lean, -x * y * lean, 1.0 - y * y * lean
    # Derivative of the image at the centre, then as seen along the line of sight.
    j11, j12 = (h11 - p * h31) / h33, (h12 - p * h32) / h33
    j21, j22 = (h21 - q * h31) / h33, (h22 - q * h32) / h33
    a11, a12 = z * (v11 * j11 + v12 * j21), z * (v11 * j12 + v12 * j22)
    a21, a22 = z * (v12 * j11 + v22 * j21), z * (v12 * j12 + v22 * j22)
    # It is the upper left of a rotation over the distance: its larger singular value is 1.
    square, twice = a11 * a11 + a12 * a12 + a21 * a21 + a22 * a22, 2 * (a11 * a22 - a12 * a21)
    distance_m = (0.5 * (square + abs((square - twice) * (square + twice)) ** 0.5)) ** -0.5
    b11, b12, b21, b22 = (a11 * distance_m, a12 * distance_m, a21 * distance_m, a22 * distance_m)
    c1, c2 = 1.0 - b11 * b11 - b21 * b21, 1.0 - b12 * b12 - b22 * b22
    c1, c2 = (0.5 * (c1 + abs(c1))) ** 0.5, (0.5 * (c2 + abs(c2))) ** 0.5
    c2 = c2 * (1.0 - 2.0 * (b11 * b12 + b21 * b22 > 0.0))
    d1, d2, d3 = b21 * c2 - c1 * b22, c1 * b12 - b11 * c2, b11 * b22 - b21 * b12
    first = (b11, b12, d1, b21, b22, d2, c1, c2, d3)
    second = (b11, b12, -d1, b21, b22, -d2, -c1, -c2, d3)
    view = (v11, v12, x, v12, v22, y, -x, -y, z)
    return view + first + second + (distance_m * x, distance_m * y, distance_m * z)
