"""
Lay scan lines across the sides of a polygon.

Each line is a pixel column (flat sides) or row (steep sides), so that every pixel near
a side lies on exactly one.
"""

from __future__ import annotations

from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np

CORNER_REACH_PX = 1.5  # lines go on for this much beyond the corners
CORNER_ZONE_PX = 3.0  # lines this close to a corner see the next side too
FAR_PX = 8  # pixels beyond either end of a line, for the grey levels only


class Layout(NamedTuple):
    """Which lines form which segment."""

    first_line: np.ndarray  # (s,) of each segment
    lines: np.ndarray  # (s,) in each segment
    segment_side: np.ndarray  # (s,)


class Lines(NamedTuple):
    """Scan lines before their pixels are read."""

    side: np.ndarray  # (n,)
    steep: np.ndarray  # (n,) whether the line is a row, because the side is steep
    main: np.ndarray  # (n,) the column of a flat side's line, the row of a steep one's
    base: np.ndarray  # (n,) first pixel along the line, the far ones included
    along: np.ndarray  # (n,) place on the side
    near: np.ndarray  # (c,) lines close to a corner
    across: np.ndarray  # (c,) the side across that corner


def place_lines(shown: np.ndarray, sag: np.ndarray | None, half: int, stride: int,
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


def lines_within(lines: Lines, half: int, shape: tuple[int, ...]) -> Lines:
    """Keep the lines that lie inside the image wholly."""
    height, width = shape
    steep, main, base = lines.steep, lines.main, lines.base
    keep = (base >= 0) & (base + 2 * (half + FAR_PX) + 1 <= np.where(steep, width, height)) \
        & (main >= 0) & (main < np.where(steep, height, width))
    near = keep[lines.near]
    return Lines(lines.side[keep], steep[keep], main[keep], base[keep], lines.along[keep],
                 (np.cumsum(keep) - 1)[lines.near[near]], lines.across[near])


def cut_lines(total: list[int], per_segment: int) -> Layout:
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
def _up_to(count: int) -> np.ndarray:
    return np.arange(count)


def _counted(count: int) -> np.ndarray:
    """Give 0, 1, 2, ... without making it anew each time."""
    return _up_to(1 << count.bit_length())[:count]
