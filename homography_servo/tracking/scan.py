"""
Read the raw pixels around the sides of a polygon.

Each side is crossed by scan lines, one per pixel column (flat sides) or row (steep
sides), so that every pixel near the side is used exactly once and nothing is
interpolated. Neighbouring lines form short segments, the unit of measurement.
"""

from __future__ import annotations

from functools import lru_cache
import math
from typing import NamedTuple

from homography_servo.tracking.lines import cut_lines
from homography_servo.tracking.lines import FAR_PX
from homography_servo.tracking.lines import Layout
from homography_servo.tracking.lines import Lines
from homography_servo.tracking.lines import lines_within
from homography_servo.tracking.lines import place_lines
from homography_servo.tracking.plane import Plane
import numpy as np

FAR_STEP = 2  # every so manieth of them is read
FAR_READ = FAR_PX // FAR_STEP
FARTHEST_PX = 1e4  # corners further outside of the image are no place to look
INWARDS = np.array([[-1.0], [1.0]])  # turns an edge (v, u) into its normal (u, v)


class Geometry(NamedTuple):
    """Sides of a polygon."""

    edge: np.ndarray  # (m, 2) from corner to corner
    length: np.ndarray  # (m,)
    normal: np.ndarray  # (2, m) inwards where corners run clockwise on the screen
    level: np.ndarray  # (m,) normal . corner


class Scan(NamedTuple):
    """
    Pixels across the sides; n lines of k pixels each, in s segments.

    Points are in the plane of straight edges. The first n entries of ``side``, ``u``,
    ``v``, ``du``, ``dv`` are the lines; the other c repeat the lines close to a corner
    together with the side across that corner.
    """

    grey: np.ndarray  # (k, n) float32 grey levels
    low_sum: np.ndarray  # (s,) sum of the FAR_READ pixels before the first of each line
    high_sum: np.ndarray  # (s,) and after the last
    grey_sum: np.ndarray  # (s,) sum of the grey levels of each segment
    grey_square: np.ndarray  # (s,) and of their squares
    side: np.ndarray  # (n + c,) which side
    u: np.ndarray  # (n + c,) first pixel
    v: np.ndarray
    du: np.ndarray  # (n + c,) from pixel to pixel
    dv: np.ndarray
    along: np.ndarray  # (n,) place on the side, 0 at its first corner, 1 at its second
    near: np.ndarray  # (c,) lines close to a corner
    layout: Layout
    bent: bool  # whether the plane differs from the image


def side_geometry(corners: np.ndarray) -> Geometry:
    """Describe the sides of a polygon (m, 2)."""
    edge = corners.take(_next(len(corners)), axis=0) - corners
    across = edge.T[::-1] * INWARDS
    length = np.sqrt(np.add.reduce(edge * edge, axis=1)) + 1e-12
    normal = across / length
    return Geometry(edge, length, normal, np.add.reduce(normal * corners.T, axis=0))


@lru_cache(maxsize=8)
def _next(count: int) -> np.ndarray:
    return np.arange(1, count + 1) % count


def read_scan(image: np.ndarray, corners: np.ndarray, plane: Plane, half: int, stride: int = 1,
              lines_per_segment: int = 6, spans: np.ndarray | None = None) -> Scan | None:
    """
    Read the pixels around the sides of a polygon.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    corners : (m, 2) array
        Where the polygon is expected in the plane, clockwise on the screen.
    plane : Plane
        Straightens the lens.
    half : int
        Pixels on either side of the expected edge.
    stride : int
        Distance of the lines [px]; 1 uses every pixel.
    lines_per_segment : int
        How many lines share their grey levels.
    spans : (m, 2) array or None
        Part of each side to use, 0 to 1; None is all and a little beyond the corners.

    Returns
    -------
    Scan or None
        Lines that would leave the image are left out; None when hardly any are left.

    """
    shown, sag = _as_shown(corners, plane)
    outside_px = _outside(shown, image.shape)
    if not outside_px < FARTHEST_PX:
        return None
    lines, total = place_lines(shown, sag, half, stride, spans)
    if outside_px + half + FAR_PX + 3 > 0.0:
        lines = lines_within(lines, half, image.shape)
        total = np.bincount(lines.side, minlength=len(corners)).tolist()
        if len(lines.side) < 3 * len(corners):
            return None
    return _gather(image, plane, half, lines, cut_lines(total, lines_per_segment))


def _as_shown(corners: np.ndarray,
              plane: Plane) -> tuple[np.ndarray, np.ndarray | None]:
    """Give the corners in the image, and how far each side's middle bends away."""
    if not plane.bent:
        return corners, None
    after = _next(len(corners))
    middle = 0.5 * (corners + corners[after])
    shown = plane.to_image(np.concatenate([corners, middle]))
    shown, middle = shown[:len(corners)], shown[len(corners):]
    return shown, middle - 0.5 * (shown + shown[after])


def _outside(shown: np.ndarray, shape: tuple[int, ...]) -> float:
    """Tell how far a polygon reaches out of the image [px]; negative where it stays inside."""
    (left, top), (right, bottom) = shown.min(axis=0).tolist(), shown.max(axis=0).tolist()
    if not math.isfinite(left + top + right + bottom):
        return math.inf
    return max(-left, -top, right - shape[1] + 1.0, bottom - shape[0] + 1.0)


@lru_cache(maxsize=32)
def _read(half: int) -> np.ndarray:
    """Give the pixels of a line that are read, as a column."""
    length = 2 * half + 1
    low = np.arange(0, FAR_PX, FAR_STEP)
    return np.concatenate([low, FAR_PX + np.arange(length),
                           FAR_PX + length + FAR_STEP - 1 + low])[:, None]


def _gather(image: np.ndarray, plane: Plane, half: int, lines: Lines, layout: Layout) -> Scan:
    width, total, read = image.shape[1], len(lines.side), _read(half)
    step = np.where(lines.steep, 1, width)
    first = ((width + 1 - step) * lines.main + step * lines.base).astype(np.intp)
    pixel = read * step
    pixel += first
    grey = image.reshape(-1).take(pixel).astype(np.float32)
    close = grey[FAR_READ:-FAR_READ]
    table = np.empty((4, total), np.float32)
    np.add.reduce(grey[:FAR_READ], axis=0, out=table[0])
    np.add.reduce(grey[-FAR_READ:], axis=0, out=table[1])
    np.add.reduce(close, axis=0, out=table[2])
    np.einsum('ij,ij->j', close, close, out=table[3])
    sums = np.add.reduceat(table, layout.first_line, axis=1, dtype=float)
    place = np.empty((4, total + len(lines.near)))
    if plane.bent:
        _in_plane(plane, first, step, half, place[:, :total])
    else:
        _in_image(lines, place[:, :total])
    place[:, total:] = place.take(lines.near, axis=1)
    low, high, grey_sum, grey_square = sums
    u, v, du, dv = place
    return Scan(close, low, high, grey_sum, grey_square,
                np.concatenate((lines.side, lines.across)), u, v, du, dv, lines.along, lines.near,
                layout, plane.bent)


def _in_image(lines: Lines, place: np.ndarray) -> None:
    """Write each line's first pixel and its advance in the image: u, v, du, dv."""
    steep, near = lines.steep, lines.base + FAR_PX
    place[0], place[1] = lines.main, near
    np.copyto(place[0], near, where=steep)
    np.copyto(place[1], lines.main, where=steep)
    place[2] = steep
    np.subtract(1.0, place[2], out=place[3])


def _in_plane(plane: Plane, first: np.ndarray, step: np.ndarray, half: int,
              place: np.ndarray) -> None:
    """Write the same in the plane of a lens that bends."""
    first = first + FAR_PX * step
    last = first + 2 * half * step
    for axis, straight in enumerate(plane.maps):
        place[axis] = straight.take(first)
        place[2 + axis] = (straight.take(last) - place[axis]) / (2 * half)
