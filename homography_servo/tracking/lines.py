"""
Lay scan lines across the sides of a polygon.

Each line is a pixel column (flat sides) or row (steep sides), so that every pixel near
a side lies on exactly one. How many lines there are, and which belong together, seldom
changes from picture to picture and is worked out once.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from itertools import chain
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


@dataclass(eq=False)
class Layout:
    """
    Which lines belong to which side and segment.

    There are n lines in s segments: first the c lines of segments that are close to a
    corner, at both ends of each of the m sides, then those between them. Arrays of n + c
    entries repeat the former at the end. Equal only to itself, so that what follows from it can
    be cached.
    """

    own: np.ndarray  # (n + c,) the line's side
    side: np.ndarray  # (n + c,) the same; for the repeated ones, the side across the corner
    total: int  # n
    near: int  # c
    blocks: list[int]  # (3 m,) lines at both ends of each side, then between them
    facing: tuple[tuple[bool, bool], ...]  # (m,) whether steep, and ahead, as in Side
    first_line: np.ndarray  # (s,) of each segment
    lines: np.ndarray  # (s,) in each segment
    segment_side: np.ndarray  # (s,)
    parts: list[tuple[slice, slice]]  # (m,) segments of each side: at its ends, and between
    side_lines: list[int]  # (m,) in each side


class Lines(NamedTuple):
    """Scan lines before their pixels are read."""

    layout: Layout
    place: np.ndarray  # (2, 2, n + c) first pixel, far ones not counted, and step to the next
    along: np.ndarray  # (n,) place on the side, 0 at its first corner, 1 at its second


def place_lines(shown: np.ndarray, sag: np.ndarray | None, half: int, stride: int,
                per_segment: int, spans: np.ndarray | None, round_px: int) -> Lines:
    """Lay scan lines across all sides; those of a side cover a multiple of `round_px`."""
    corners, sides, firsts, steps = shown.tolist(), [], [], []
    parts = [(0.0, 1.0)] * len(corners) if spans is None else spans.tolist()
    for corner, after, part in zip(corners, corners[1:] + corners[:1], parts):
        first, step, side = _side_lines(corner, after, part, half, stride, round_px)
        firsts.append(first)
        steps.append(step)
        sides.append(side)
    layout, spread = layout_of(tuple(sides), per_segment)
    table = np.array(firsts + steps).T @ spread
    place, along = table[:4].reshape(2, 2, -1), table[4]
    if sag is not None:  # across the side only
        place[0] += np.abs(place[1]) * sag.T.take(layout.own, axis=1) \
            * (4.0 * along * (1.0 - along))
    return Lines(layout, np.rint(place), along[:layout.total])


def _side_lines(start: list[float], end: list[float], span: list[float], half: int, stride: int,
                round_px: int) -> tuple[tuple[float, ...], tuple[float, ...], Side]:
    """
    Lay scan lines across one side.

    Returns
    -------
    tuple of float, tuple of float, Side
        First pixel of the first line, step to the next pixel, and place on the side; the
        change of these five numbers from line to line.

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
    low -= stride * ((rounded - lines) // 2)
    ends = min(2 * (int((near + reach) / stride) // 2 + 1), rounded // 2)
    side = Side(rounded, ends, steep, run > 0.0)
    across, along = cross + slope * (low - main), (low - main) / run
    inwards = -1.0 if steep == side.ahead else 1.0
    across -= half * inwards
    if steep:
        return ((across, low, inwards, 0.0, along),
                (stride * slope, stride, 0.0, 0.0, stride / run), side)
    return ((low, across, 0.0, inwards, along),
            (stride, stride * slope, 0.0, 0.0, stride / run), side)


@lru_cache(maxsize=64)
def layout_of(sides: tuple[Side, ...], per_segment: int) -> tuple[Layout, np.ndarray]:
    """
    Say which lines belong together.

    Returns
    -------
    Layout, (2 m, n + c) array
        What turns values at line 0 of each side and their steps from line to line into
        those of all lines.

    """
    parts = [_parts(lines, near, per_segment) for lines, near, _, _ in sides]
    cuts = [end for part in parts for end in part[:2]] + [between for _, _, between in parts]
    layout = _layout(cuts, tuple([side[2:] for side in sides]))
    count, total, blocks = len(sides), len(layout.own), layout.blocks
    ends = 2 * count
    first = [number for side, high in zip(sides, blocks[1:ends:2])
             for number in (0, side.lines - high)]
    begun = accumulate(blocks + blocks[:ends], initial=0)
    shift = np.array([number - before
                      for number, before in zip(first + blocks[:ends:2] + first, begun)])
    spread = np.empty((2, count, total))
    _unit(count).take(layout.own, axis=1, out=spread[0], mode='clip')
    np.multiply(spread[0], shift.repeat(blocks + blocks[:ends]) + np.arange(total), out=spread[1])
    return layout, spread.reshape(2 * count, total)


@lru_cache(maxsize=1024)
def _parts(lines: int, ends: int, per_segment: int) -> tuple[list[int], list[int], list[int]]:
    """Cut a side into segments: those that hold the lines at its ends, and those between."""
    cut = _segments(lines, per_segment)
    low, high = (bisect_left(list(accumulate(part)), ends) + 1 for part in (cut, cut[::-1]))
    if low + high <= len(cut):
        return cut[:low], cut[-high:], cut[low:-high]
    return (_segments(ends, per_segment), _segments(ends, per_segment),
            _segments(lines - 2 * ends, per_segment))


def _segments(lines: int, per_segment: int) -> list[int]:
    """Cut lines into segments of about the same length."""
    count = max(round(lines / per_segment), 1) if lines else 0
    ends = [number * lines // count for number in range(count)] + [lines]
    return [end - begin for begin, end in zip(ends, ends[1:])]


def _layout(cuts: list[list[int]], facing: tuple[tuple[bool, bool], ...]) -> Layout:
    """Arrange the lines of segments, which are given for each block (3 m,)."""
    count, (own, across) = len(facing), _seen(facing)
    blocks, ends = list(map(sum, cuts)), 2 * count
    repeated = blocks + blocks[:ends]
    line_own, lines = own.repeat(repeated), np.array(list(chain.from_iterable(cuts)))
    last = list(accumulate(map(len, cuts), initial=0))
    parts = [(slice(last[2 * side], last[2 * side + 2]),
              slice(last[ends + side], last[ends + side + 1])) for side in range(count)]
    side_lines = [low + high + between for low, high, between in zip(
        blocks[:ends:2], blocks[1:ends:2], blocks[ends:])]
    return Layout(line_own, across.repeat(repeated), sum(blocks), sum(blocks[:ends]), blocks,
                  facing, np.add.accumulate(lines) - lines, lines,
                  own[:3 * count].repeat(list(map(len, cuts))), parts, side_lines)


@lru_cache(maxsize=64)
def _seen(facing: tuple[tuple[bool, bool], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Give the blocks of lines their side, and the side that they are seen from."""
    side, ahead = np.arange(len(facing)), np.array(facing)[:, 1]
    before, behind = np.roll(side, 1), np.roll(side, -1)
    across = np.where(ahead, (before, behind), (behind, before)).T.ravel()  # at either end
    own = np.concatenate((side.repeat(2), side, side.repeat(2)))
    return own, np.concatenate((own[:3 * len(facing)], across))


@lru_cache(maxsize=8)
def _unit(size: int) -> np.ndarray:
    return np.eye(size)


def lines_within(lines: Lines, half: int, shape: tuple[int, ...], per_segment: int) -> Lines:
    """Keep the lines that lie inside the image wholly."""
    layout, total = lines.layout, lines.layout.total
    start, step = lines.place
    both = np.array((start - FAR_PX * step, start + (FAR_PX + 2 * half) * step))
    inside = (both >= 0.0) & (both < [[shape[1]], [shape[0]]])
    keep = np.logical_and.reduce(inside, axis=(0, 1))
    block = np.arange(len(layout.blocks)).repeat(layout.blocks)[keep[:total]]
    blocks = np.bincount(block, minlength=len(layout.blocks)).tolist()
    cuts = [_segments(length, per_segment) for length in blocks]
    return Lines(_layout(cuts, layout.facing), lines.place[:, :, keep], lines.along[keep[:total]])
