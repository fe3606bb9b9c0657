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

from homography_servo.tracking.plane import Plane
import numpy as np

CORNER_REACH_PX = 1.5  # lines go on for this much beyond the corners
CORNER_ZONE_PX = 3.0  # lines this close to a corner see the next side too
FAR_PX = 8  # pixels beyond either end of a line, for the grey levels only
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


class Layout(NamedTuple):
    """Which lines form which segment."""

    first_line: np.ndarray  # (s,) of each segment
    lines: np.ndarray  # (s,) in each segment
    segment_side: np.ndarray  # (s,)


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


class Lines(NamedTuple):
    """Scan lines before their pixels are read."""

    side: np.ndarray  # (n,)
    steep: np.ndarray  # (n,) whether the line is a row, because the side is steep
    main: np.ndarray  # (n,) the column of a flat side's line, the row of a steep one's
    base: np.ndarray  # (n,) first pixel along the line, the far ones included
    along: np.ndarray  # (n,) place on the side
    near: np.ndarray  # (c,) lines close to a corner
    across: np.ndarray  # (c,) the side across that corner


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
    lines, total = _place_lines(shown, sag, half, stride, spans)
    if outside_px + half + FAR_PX + 3 > 0.0:
        lines = _within(lines, half, image.shape)
        total = np.bincount(lines.side, minlength=len(corners)).tolist()
        if len(lines.side) < 3 * len(corners):
            return None
    return _gather(image, plane, half, lines, _layout(total, lines_per_segment))


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


def _place_lines(shown: np.ndarray, sag: np.ndarray | None, half: int, stride: int,
                 spans: np.ndarray | None) -> tuple[Lines, list[int]]:
    """Lay scan lines across all sides; give also their numbers."""
    corners, count, first = shown.tolist(), len(shown), 0
    bends = [(0.0, 0.0)] * count if sag is None else sag.tolist()
    parts = [(0.0, 1.0)] * count if spans is None else spans.tolist()
    near, across, table, total = [], [], [], []
    for here, (corner, bend, part) in enumerate(zip(corners, bends, parts)):
        before, after = (here - 1) % count, (here + 1) % count
        row, lines, ends, ahead = _side_lines(corner, corners[after], bend, part, first, half,
                                              stride)
        table.append((here, *row))
        near += [*range(first, first + ends), *range(first + lines - ends, first + lines)]
        across += [before if ahead else after] * ends + [after if ahead else before] * ends
        total.append(lines)
        first += lines
    side, low, along, along_step, cross, cross_step, bow, steep = np.repeat(
        np.array(table).T, total, axis=1)
    number = _counted(first)
    along += along_step * number
    cross += cross_step * number
    if sag is not None:
        cross += bow * along * (1.0 - along)
    low += stride * number
    return Lines(side.astype(np.intp), steep > 0.0, low, np.rint(cross) - (half + FAR_PX), along,
                 np.array(near, np.intp), np.array(across, np.intp)), total


def _side_lines(start: list[float], end: list[float], bend: list[float], span: list[float],
                before: int, half: int, stride: int) -> tuple[tuple[float, ...], int, int, bool]:
    """
    Lay scan lines across one side.

    Returns
    -------
    tuple of float, int, int, bool
        Of line 0, which comes `before` lines before the first of this side: its column
        or row, its place on the side and the step of it, the place across and the step
        of it, four times the bend across, whether the side is steep. The number of
        lines; how many at either end see the next side; whether columns or rows grow
        along the side.

    """
    steep = abs(end[1] - start[1]) > abs(end[0] - start[0])
    main, cross = start[steep], start[not steep]
    run = end[steep] - main or 1e-12
    slope = (end[not steep] - cross) / run
    # Pixels drift along a slanted side, and its lines are closer together.
    lean = 1.0 / math.sqrt(1.0 + slope * slope)
    near = lean * (CORNER_ZONE_PX + half * abs(slope) * lean)
    reach = CORNER_REACH_PX if span[0] <= 0.0 and span[1] >= 1.0 else 0.0
    one, other = main + span[0] * run, main + span[1] * run
    low = math.ceil(min(one, other) - reach)
    lines = max(math.floor(max(one, other) + reach) - low, -stride) // stride + 1
    low -= stride * before
    row = (low, (low - main) / run, stride / run, cross + slope * (low - main), stride * slope,
           4.0 * bend[not steep], steep)
    return row, lines, min(int((near + reach) / stride) + 1, lines // 2), run > 0.0


@lru_cache(maxsize=32)
def _up_to(count: int) -> np.ndarray:
    return np.arange(count)


def _counted(count: int) -> np.ndarray:
    """Give 0, 1, 2, ... without making it anew each time."""
    return _up_to(1 << count.bit_length())[:count]


def _outside(shown: np.ndarray, shape: tuple[int, ...]) -> float:
    """Tell how far a polygon reaches out of the image [px]; negative where it stays inside."""
    (left, top), (right, bottom) = shown.min(axis=0).tolist(), shown.max(axis=0).tolist()
    if not math.isfinite(left + top + right + bottom):
        return math.inf
    return max(-left, -top, right - shape[1] + 1.0, bottom - shape[0] + 1.0)


def _within(lines: Lines, half: int, shape: tuple[int, ...]) -> Lines:
    """Keep the lines that lie inside the image wholly."""
    height, width = shape
    steep, main, base = lines.steep, lines.main, lines.base
    keep = (base >= 0) & (base + 2 * (half + FAR_PX) + 1 <= np.where(steep, width, height)) \
        & (main >= 0) & (main < np.where(steep, height, width))
    near = keep[lines.near]
    return Lines(lines.side[keep], steep[keep], main[keep], base[keep], lines.along[keep],
                 (np.cumsum(keep) - 1)[lines.near[near]], lines.across[near])


def _layout(total: list[int], per_segment: int) -> Layout:
    """Cut the lines of each side into segments of about the same length."""
    parts = [max(1, round(lines / per_segment)) if lines else 0 for lines in total]
    table, line, segment = [], 0, 0
    for corner, (lines, cuts) in enumerate(zip(total, parts)):
        table.append((corner, line, segment, lines, max(cuts, 1)))
        line, segment = line + lines, segment + cuts
    side, lead, begun, length, share = np.repeat(np.array(table).T, parts, axis=1)
    first = lead + (_counted(len(side)) - begun) * length // share
    number = np.empty_like(first)
    np.subtract(first[1:], first[:-1], out=number[:-1])
    number[-1:] = sum(total) - first[-1:]
    return Layout(first, number, side)


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
