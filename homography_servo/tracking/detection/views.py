"""
Poses of many rectangles at once: which quadrilaterals can be views of the face.

A pose begins with the parallelogram in space that has the corners on its rays, and is
refined by Gauss-Newton steps on the projection error of all corners.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from homography_servo.geometry.face import face_corners
from homography_servo.tracking.plane import Plane
import numpy as np

STEPS = 2
MOST_SKEW, MOST_STRETCH = 0.45, 0.45  # of rough corners: cosine, log of the aspect
MOST_DEEPER = 1.3  # than a rough parallelogram is the rectangle that fits best
DAMPING = 1e-6  # keeps the step of a degenerate view finite
MOST_TURN_RAD = 0.5  # in one step


class Views(NamedTuple):
    """Views of the face; n of them."""

    corners: np.ndarray  # (n, 4, 2) projected, in the plane
    rotation: np.ndarray  # (n, 3, 3) camera from object
    translation: np.ndarray  # (n, 3) [m]
    miss_px: np.ndarray  # (n,) RMS of what the projected corners miss of the given ones

    def chosen(self, which: np.ndarray) -> Views:
        """Select some."""
        return Views(*(part[which] for part in self))

    @property
    def facing(self) -> np.ndarray:
        """Give the cosine of the angle between line of sight and normal (n,)."""
        away = np.linalg.norm(self.translation, axis=1)
        return (self.rotation[:, :, 2] * self.translation).sum(axis=1) / away


def views_of_face(quads: np.ndarray, face_size_m: tuple[float, float], plane: Plane,
                  depth_m: tuple[float, float] = (0.0, np.inf)) -> Views:
    """
    Fit the pose of the face to quadrilaterals.

    Parameters
    ----------
    quads : (N, 4, 2) array
        Corners clockwise on the screen, in the plane.
    face_size_m : (float, float)
        Width and height of the face.
    plane : Plane
        With a camera.
    depth_m : (float, float)
        Views that are clearly not between these are left out.

    Returns
    -------
    Views
        Up to two of each quadrilateral: either of its sides may be the width. Those
        far out of proportion are left out. The corners begin with the face's first.

    """
    across, down, near = parallelograms(quads, plane)
    rays = plane.rays(quads)
    # Once more beginning with the second corner.
    rays = np.concatenate([rays, rays[:, [1, 2, 3, 0]]])
    across, down, near = (np.concatenate([one, two]) for one, two in (
        (across, down), (down, -across), (near, near + across)))
    long, short = (np.sqrt((way * way).sum(axis=1)) + 1e-12 for way in (across, down))
    skew = np.abs((across * down).sum(axis=1)) / (long * short)
    stretch = np.abs(np.log(long / short * (face_size_m[1] / face_size_m[0])))
    likely = (skew < MOST_SKEW) & (stretch < MOST_STRETCH) & (near[:, 2] > 0.0)
    depth = (near + 0.5 * (across + down))[:, 2] * math.sqrt(face_size_m[0] * face_size_m[1]) \
        / np.sqrt(long * short)
    likely &= (depth > depth_m[0] / MOST_DEEPER) & (depth < depth_m[1] * MOST_DEEPER)
    return _refined(rays[likely], across[likely], down[likely], near[likely], face_size_m, plane)


def parallelograms(quads: np.ndarray,
                   plane: Plane) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Find parallelograms in space that look like quadrilaterals.

    Parameters
    ----------
    quads : (N, 4, 2) array
        Corners in the plane.
    plane : Plane
        With a camera.

    Returns
    -------
    (N, 3) array, (N, 3) array, (N, 3) array
        The side from the first corner to the second, that from the first to the fourth,
        and the first corner, in the camera's frame; up to one scale for each of them.

    """
    first, second, third, fourth = plane.rays_in_space(quads).transpose(1, 0, 2)

    def volume(one: np.ndarray, two: np.ndarray, three: np.ndarray) -> np.ndarray:
        return (cross(one, two) * three).sum(axis=1)[:, None]

    near = volume(second, third, fourth) * first
    across = volume(first, third, fourth) * second - near
    down = volume(first, second, third) * fourth - near
    return across, down, near


def _refined(rays: np.ndarray, across: np.ndarray, down: np.ndarray, near: np.ndarray,
             face_size_m: tuple[float, float], plane: Plane) -> Views:
    """Begin with parallelograms and fit rectangles."""
    points_m = face_corners(*face_size_m)
    scale = np.sqrt(face_size_m[0] * face_size_m[1]
                    / (np.linalg.norm(cross(across, down), axis=1) + 1e-30))[:, None]
    centre = scale * (near + 0.5 * (across + down))
    right, below = unit(across), unit(down)
    middle, apart = (unit(way) * np.sqrt(0.5) for way in (right + below, right - below))
    right, below = middle + apart, middle - apart
    rotation = np.stack([right, below, cross(right, below)], axis=2)
    for _ in range(STEPS):
        seen, slope = linearise(points_m, rotation, centre)
        across_slope = slope.transpose(0, 2, 1)
        step = np.linalg.solve(across_slope @ slope + DAMPING * np.eye(6),
                               across_slope @ (rays - seen).reshape(len(rays), 8, 1))[..., 0]
        rotation, centre = _turned(rotation, step[:, :3]), centre + step[:, 3:]
    corners = projected(points_m, rotation, centre, plane)
    miss_px = plane.rms_px(rays - plane.rays(corners))
    good = np.isfinite(miss_px) & (centre[:, 2] > 1e-3)
    return Views(corners, rotation, centre, miss_px).chosen(good)


def linearise(points_m: np.ndarray, rotation: np.ndarray,
              centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Project points (p, 3) and differentiate by small turns and shifts of the object.

    Returns
    -------
    (n, p, 2) array, (n, 2 p, 6) array
        Normalised coordinates; their change with rx, ry, rz (camera axes), x, y, z.

    """
    turned = points_m @ rotation.transpose(0, 2, 1)
    points = turned + centre[:, None]
    inverse = 1.0 / np.where(np.abs(points[..., 2]) > 1e-6, points[..., 2], 1e-6)
    x, y = points[..., 0] * inverse, points[..., 1] * inverse
    a, b, c = (turned * inverse[..., None]).transpose(2, 0, 1)
    slope = np.zeros((*x.shape, 2, 6))
    slope[..., 0, 0], slope[..., 0, 1], slope[..., 0, 2] = -x * b, c + x * a, -b
    slope[..., 1, 0], slope[..., 1, 1], slope[..., 1, 2] = -c - y * b, y * a, a
    slope[..., 0, 3] = slope[..., 1, 4] = inverse
    slope[..., 0, 5], slope[..., 1, 5] = -x * inverse, -y * inverse
    return np.stack([x, y], axis=-1), slope.reshape(len(x), 2 * len(points_m), 6)


def moved(views: Views, step: np.ndarray, points_m: np.ndarray, plane: Plane) -> Views:
    """Turn and shift views of the face's corners (4, 3) by small steps (n, 6)."""
    rotation = _turned(views.rotation, step[:, :3])
    centre = views.translation + step[:, 3:]
    corners = projected(points_m, rotation, centre, plane)
    return Views(corners, rotation, centre, views.miss_px)


def projected(points_m: np.ndarray, rotation: np.ndarray, translation: np.ndarray,
              plane: Plane) -> np.ndarray:
    """Show points (p, 3) of an object in n poses, in the plane (n, p, 2)."""
    return plane.from_space(points_m @ rotation.transpose(0, 2, 1) + translation[:, None])


def with_mirrored(views: Views) -> Views:
    """
    Add the views (2 n) tilted to the other side.

    A rectangle that is far away looks nearly the same tilted to either side.
    """
    sight = unit(views.translation)[:, :, None]
    right, below = (views.rotation[:, :, :2] - 2.0 * sight * (
        sight.transpose(0, 2, 1) @ views.rotation[:, :, :2])).transpose(2, 0, 1)
    mirrored = views._replace(rotation=np.stack([right, below, cross(right, below)], axis=2))
    return Views(*(np.concatenate(part) for part in zip(views, mirrored)))


def _turned(rotation: np.ndarray, small: np.ndarray) -> np.ndarray:
    """Turn by small rotation vectors (Cayley's formula: stays a rotation)."""
    x, y, z = 0.5 * np.minimum(np.maximum(small, -MOST_TURN_RAD), MOST_TURN_RAD).T
    xx, yy, zz = x * x, y * y, z * z
    turn = np.empty((len(small), 3, 3))
    turn[:, 0, 0], turn[:, 1, 1], turn[:, 2, 2] = xx - yy - zz, yy - zz - xx, zz - xx - yy
    turn[:, [0, 1, 2], [0, 1, 2]] += 1.0
    for row, column, even, odd in ((0, 1, x * y, z), (1, 2, y * z, x), (2, 0, z * x, y)):
        turn[:, row, column], turn[:, column, row] = 2.0 * (even - odd), 2.0 * (even + odd)
    turn /= (1.0 + xx + yy + zz)[:, None, None]
    return turn @ rotation


def cross(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Multiply vectors (..., 3); for few of them much quicker than numpy's own."""
    product = np.empty(np.broadcast_shapes(one.shape, two.shape))
    x, y, z = (product[..., axis] for axis in range(3))
    (a, b, c), (d, e, f) = ((way[..., 0], way[..., 1], way[..., 2]) for way in (one, two))
    x[...], y[...], z[...] = b * f - c * e, c * d - a * f, a * e - b * d
    return product


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scale vectors (n, 3) to length 1."""
    return vectors / (np.linalg.norm(vectors, axis=1, keepdims=True) + 1e-12)
