"""
Put straight edges together to quadrilaterals that may be the face.

Two sides make a corner where their lines meet near the end of one and the beginning of
the other, with one grey level inside. Two corners that share a side make three sides;
two of those make a quadrilateral. One of three sides is completed as well: the
vanishing points of a rectangle's sides are at right angles, so that three sides show
how it is turned, and its proportions or the visible ends of the outer sides show where
the fourth is.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.detection.sides import matches
from homography_servo.tracking.detection.sides import Sides
from homography_servo.tracking.detection.views import cross
from homography_servo.tracking.detection.views import unit
from homography_servo.tracking.plane import Plane
import numpy as np

ALIKE_GREY = 13.0  # levels inside of two sides, in uneven light
LEAST_SINE = 0.3  # of a corner
OVERSHOT_PX = 6.0  # how far a side may run beyond its corner
UNSEEN = 1.5  # most of a side's end that may be unseen, over the length of the side
OPPOSITE_COSINE = -0.75
SUPPORTED = 0.25  # share of the middle one of three sides that must be seen
LEAST_RUN_PX = 8.0


class Corners(NamedTuple):
    """Where one side meets the next."""

    first: np.ndarray  # (c,) number of the side
    second: np.ndarray  # (c,) of the next one, clockwise on the screen
    place: np.ndarray  # (c, 2) [px]


class Threes(NamedTuple):
    """Three sides in a row, t of them."""

    sides: np.ndarray  # (t, 3) numbers
    corners: np.ndarray  # (t, 2) numbers of the two corners


def find_quads(sides: Sides, face_size_m: tuple[float, float], plane: Plane) -> np.ndarray:
    """
    List quadrilaterals that may be the face.

    Parameters
    ----------
    sides : Sides
        In the plane.
    face_size_m : (float, float)
        Width and height of the face.
    plane : Plane
        With a camera.

    Returns
    -------
    (N, 4, 2) array
        Corners clockwise on the screen.

    """
    corners = find_corners(sides)
    threes = find_threes(sides, corners)
    return np.concatenate([quads_of_four(corners, threes, len(sides.seen)),
                           quads_of_three(sides, corners, threes, face_size_m, plane)])


def find_corners(sides: Sides) -> Corners:
    """Pair sides that meet."""
    start, direction, length, level = sides.pieces
    u, v = direction.astype(np.float32).T
    shade = level.astype(np.float32)
    sine = np.multiply.outer(u, v)
    sine = sine - sine.T
    pair = np.flatnonzero((sine > LEAST_SINE)
                          & (np.abs(np.subtract.outer(shade, shade)) < ALIKE_GREY))
    first, second = np.divmod(pair, len(u))
    sine = sine.ravel().take(pair)
    away_u, away_v = start.T.take(second, axis=1) - start.T.take(first, axis=1)
    out = (away_u * v.take(second) - away_v * u.take(second)) / sine
    own = length.take(first)
    meet = (out > own - OVERSHOT_PX) & (out < (1.0 + UNSEEN) * own + OVERSHOT_PX)
    first, second, out = first[meet], second[meet], out[meet]
    into = _cross(np.stack([away_u[meet], away_v[meet]], axis=1), direction[first]) / sine[meet]
    meet = (into < OVERSHOT_PX) & (into > -UNSEEN * length[second] - OVERSHOT_PX)
    first, out = first[meet], out[meet]
    return Corners(first, second[meet], start[first] + out[:, None] * direction[first])


def find_threes(sides: Sides, corners: Corners) -> Threes:
    """Join corners that share a side."""
    order = np.argsort(corners.first, kind='stable')
    before, after = matches(corners.second, corners.second, corners.first[order])
    after = order[after]
    side = np.stack([corners.first[before], corners.second[before], corners.second[after]], axis=1)
    direction = sides.pieces.direction
    run = ((corners.place[after] - corners.place[before]) * direction[side[:, 1]]).sum(axis=1)
    opposite = (direction[side[:, 0]] * direction[side[:, 2]]).sum(axis=1)
    good = (opposite < OPPOSITE_COSINE) & (run > LEAST_RUN_PX) \
        & (sides.seen[side[:, 1]] > SUPPORTED * run)
    return Threes(side[good], np.stack([before, after], axis=1)[good])


def quads_of_four(corners: Corners, threes: Threes, count: int) -> np.ndarray:
    """Join threes (of `count` sides) that share their outer sides: (N, 4, 2), each once."""
    begin, _, end = threes.sides.T
    closing = end * count + begin
    order = np.argsort(closing, kind='stable')
    one, two = matches(begin * count + end, begin * count + end, closing[order])
    two = order[two]
    once = begin[one] < end[one]
    return corners.place[np.concatenate([threes.corners[one[once]],
                                         threes.corners[two[once]]], axis=1)]


def quads_of_three(sides: Sides, corners: Corners, threes: Threes,
                   face_size_m: tuple[float, float], plane: Plane) -> np.ndarray:
    """
    Complete three sides by a fourth in several ways.

    Parameters
    ----------
    sides, corners, threes
        What was found in the plane.
    face_size_m : (float, float)
        Width and height of the face.
    plane : Plane
        With a camera.

    Returns
    -------
    (N, 4, 2) array

    """
    before, _, after = threes.sides.T
    pieces = sides.pieces
    near, far = corners.place[threes.corners[:, 0]], corners.place[threes.corners[:, 1]]
    ends = pieces.start[before], pieces.start[after] \
        + pieces.length[after, None] * pieces.direction[after]
    across, down, first = _turned_rectangle(plane, near, far, pieces.direction[before],
                                            pieces.direction[after])
    normal = cross(across, down)
    height = (normal * first).sum(axis=1)[:, None]
    reach = np.linalg.norm(across, axis=1)[:, None]
    proportion = face_size_m[1] / face_size_m[0]
    fourths = [ends]
    for ratio in (proportion, 1.0 / proportion):
        lowest = first + ratio * reach * down
        fourths.append((plane.from_space(lowest), plane.from_space(lowest + across)))
    for end, side in zip(ends, (1.0, -1.0)):
        ray = plane.rays_in_space(end)
        lowest = ray * height / ((normal * ray).sum(axis=1)[:, None] + 1e-12)
        other = plane.from_space(lowest + side * across)
        fourths.append((end, other) if side > 0.0 else (other, end))
    quads = np.concatenate([np.stack([near, far, third, fourth], axis=1)
                            for fourth, third in fourths])
    edge = np.roll(quads, -1, axis=1) - quads
    after_edge = np.roll(edge, -1, axis=1)
    convex = edge[..., 0] * after_edge[..., 1] - edge[..., 1] * after_edge[..., 0] > 0.0
    return quads[convex.all(axis=1)]


def _turned_rectangle(plane: Plane, near: np.ndarray, far: np.ndarray, into: np.ndarray,
                      out: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Find how the rectangle is turned whose side runs from near to far, others into and out.

    Returns
    -------
    (t, 3) array, (t, 3) array, (t, 3) array
        The middle side in space, the unit vector along the outer ones, the first corner;
        up to one scale.

    """
    near_ray, far_ray = plane.rays_in_space(near), plane.rays_in_space(far)
    line = cross(near_ray, plane.rays_in_space(near - into))
    down = unit(cross(line, cross(far_ray, plane.rays_in_space(far + out))))
    down *= np.where((cross(line, near_ray) * down).sum(axis=1) > 0.0, 1.0, -1.0)[:, None]
    level = unit(cross(cross(near_ray, far_ray), down))
    normal = cross(level, down)
    depth = [1.0 / ((normal * ray).sum(axis=1)[:, None] + 1e-12) for ray in (near_ray, far_ray)]
    first = near_ray
    return far_ray * depth[1] / depth[0] - first, down, first


def _cross(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
