"""
Lay scan lines across the sides of a polygon.

Each line is a pixel column (flat sides) or row (steep sides), so that every pixel near
a side lies on exactly one. How many lines there are, and which belong together, seldom
changes from picture to picture and is worked out once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from functools import lru_cache
import math
from typing import NamedTuple

import numpy as np

CORNER_REACH_PX = 1.5  # lines go on for about this much beyond the corners
CORNER_ZONE_PX = 3.0  # lines this close to a corner see the next side too
LEAST_PARTS = 6  # of a side whose lines are rounded
FAR_PX = 8  # pixels beyond either end of a line, for the grey levels only


class Side(NamedTuple):
    """How scan lines cross one side."""

    lines: int
    ends: int  # lines at either end that see the next side too
    steep: bool  # whether lines are rows, because the side is steep
    ahead: bool  # whether columns or rows grow along the side


@dataclass(frozen=True, eq=False)
class Layout:
    """
    Which lines belong to which side and segment.

    There are n lines in s segments. Arrays of n + c entries repeat the c lines that are
    close to a corner. Equal only to itself, so that what follows from it can be cached.
    """

    own: np.ndarray  # (n + c,) the line's side
    side: np.ndarray  # (n + c,) the same; for the repeated ones, the side across the corner
    number: np.ndarray  # (n + c,) counts the lines
    steep: np.ndarray  # (n + c,) whether it is a row
    step: np.ndarray  # (2, n + c) from pixel to pixel, u and v
    near: np.ndarray  # (c,) which lines are repeated
    first_line: np.ndarray  # (s,) of each segment
    lines: np.ndarray  # (s,) in each segment
    segment_side: np.ndarray  # (s,)
    rising: np.ndarray  # (s,) whether lines run towards the inside

    @cached_property
    def total(self) -> int:
        """Give the number of lines."""
        return len(self.own) - len(self.near)

    @cached_property
    def outside_inside(self) -> np.ndarray:
        """Order the sums before and after the lines of the segments, flat, that way: (2, s)."""
        count = len(self.lines)
        before, after = np.arange(count), count * self.rising
        return np.array((before + (count - after), before + after))


class Lines(NamedTuple):
    """Scan lines before their pixels are read."""

    layout: Layout
    start: np.ndarray  # (2, n + c) u and v of the first pixel, far ones not counted
    along: np.ndarray  # (n,) place on the side, 0 at its first corner, 1 at its second


def place_lines(shown: np.ndarray, sag: np.ndarray | None, half: int, stride: int,
                per_segment: int, spans: np.ndarray | None, round_px: int) -> Lines:
    """Lay scan lines across all sides; those of a side cover a multiple of `round_px`."""
    corners, count, first = shown.tolist(), len(shown), 0
    bends = [(0.0, 0.0)] * count if sag is None else sag.tolist()
    parts = [(0.0, 1.0)] * count if spans is None else spans.tolist()
    sides, rows = [], []
    for here, (corner, bend, part) in enumerate(zip(corners, bends, parts)):
        row, side = _side_lines(corner, corners[(here + 1) % count], bend, part, first, half,
                                stride, round_px)
        rows.append(row)
        sides.append(side)
        first += side.lines
    layout = layout_of(tuple(sides), per_segment)
    table = np.array(rows).T.take(layout.own, axis=1)
    table[:3] += table[3:6] * layout.number
    along = table[2]
    if sag is not None:
        table[:2] += table[6:] * (along * (1.0 - along))
    start = np.rint(table[:2])
    return Lines(layout, start, along[:layout.total])


def _side_lines(start: list[float], end: list[float], bend: list[float], span: list[float],
                before: int, half: int, stride: int,
                round_px: int) -> tuple[tuple[float, ...], Side]:
    """
    Lay scan lines across one side.

    Returns
    -------
    tuple of float, Side
        Of line 0, which comes `before` lines before the first of this side: u and v of
        its first pixel and its place on the side; the steps of these three from line to
        line; four times the bend in u and v.

    """
    steep = abs(end[1] - start[1]) > abs(end[0] - start[0])
    main, cross = start[steep], start[not steep]
    run = end[steep] - main or 1e-12
    slope = (end[not steep] - cross) / run
    # Pixels drift along a slanted side, and its lines are closer together.
    lean = 1.0 / math.sqrt(1.0 + slope * slope)
    near = lean * (CORNER_ZONE_PX + half * abs(slope) * lean)
    reach = CORNER_REACH_PX + 0.125 * (round_px - 1) \
        if span[0] <= 0.0 and span[1] >= 1.0 else 0.0
    one, other = main + span[0] * run, main + span[1] * run
    low = math.ceil(min(one, other) - reach)
    lines = max(math.floor(max(one, other) + reach) - low, -stride) // stride + 1
    rounding = max(round_px // stride, 1)
    if lines < LEAST_PARTS * rounding:
        rounding = 1  # it would cost too much of a short side
    rounded = rounding * (lines // rounding)
    low -= stride * ((rounded - lines) // 2 + before)
    across, bow = cross + slope * (low - main) - half, 4.0 * bend[not steep]
    along, along_step = (low - main) / run, stride / run
    row: tuple[float, ...]
    if steep:
        row = (across, low, along, stride * slope, stride, along_step, bow, 0.0)
    else:
        row = (low, across, along, stride, stride * slope, along_step, 0.0, bow)
    ends = min(2 * (int((near + reach) / stride) // 2 + 1), rounded // 2)
    return row, Side(rounded, ends, steep, run > 0.0)


@lru_cache(maxsize=64)
def layout_of(sides: tuple[Side, ...], per_segment: int) -> Layout:
    """Say which lines belong together."""
    near: list[int] = []
    across: list[int] = []
    count, first = len(sides), 0
    for here, side in enumerate(sides):
        after = first + side.lines
        near += [*range(first, first + side.ends), *range(after - side.ends, after)]
        before, behind = (here - 1) % count, (here + 1) % count
        first_across, last_across = (before, behind) if side.ahead else (behind, before)
        across += [first_across] * side.ends + [last_across] * side.ends
        first = after
    own = np.repeat(np.arange(count), [side.lines for side in sides])
    steep = np.array([side.steep for side in sides])
    rising = np.array([side.steep != side.ahead for side in sides])
    return _cut(own, steep, rising, np.array(near, np.intp), np.array(across, np.intp),
                per_segment)


def _cut(own: np.ndarray, steep: np.ndarray, rising: np.ndarray, near: np.ndarray,
         across: np.ndarray, per_segment: int) -> Layout:
    """Cut the lines of each side into segments of about the same length."""
    begun, firsts, lengths, cuts = 0, [], [], []
    for total in np.bincount(own, minlength=len(steep)).tolist():
        first, length = _segments(total, per_segment)
        firsts.append(first + begun)
        lengths.append(length)
        cuts.append(len(first))
        begun += total
    segment_side = np.repeat(np.arange(len(steep)), cuts)
    number = np.concatenate((np.arange(begun), near))
    both = np.concatenate((own, own.take(near)))
    row = steep.take(both)
    return Layout(both, np.concatenate((own, across)), number.astype(float), row,
                  np.array((row, ~row), float), near, np.concatenate(firsts),
                  np.concatenate(lengths), segment_side, rising.take(segment_side))


@lru_cache(maxsize=1024)
def _segments(lines: int, per_segment: int) -> tuple[np.ndarray, np.ndarray]:
    """Give the first line of each segment of a side, and how many it has."""
    count = max(round(lines / per_segment), 1) if lines else 0
    ends = [number * lines // count for number in range(count)] + [lines]
    return np.array(ends[:-1], np.intp), np.diff(np.array(ends, np.intp))


def lines_within(lines: Lines, corner_count: int, half: int, shape: tuple[int, ...],
                 per_segment: int) -> Lines:
    """Keep the lines that lie inside the image wholly."""
    layout, total = lines.layout, lines.layout.total
    before = FAR_PX * layout.step
    low, high = lines.start - before, lines.start + before + (2 * half) * layout.step
    limit = np.array([[shape[1]], [shape[0]]])
    keep = ((low >= 0.0) & (high < limit)).all(axis=0)
    own, near = keep[:total], keep[total:]
    steep, rising = np.zeros((2, corner_count), bool)
    steep[layout.own], rising[layout.segment_side] = layout.steep, layout.rising
    kept = _cut(layout.own[:total][own], steep, rising, (np.cumsum(own) - 1)[layout.near[near]],
                layout.side[total:][near], per_segment)
    return Lines(kept, lines.start[:, keep], lines.along[own])
