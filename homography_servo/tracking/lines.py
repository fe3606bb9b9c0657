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
from typing import Sequence

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

    side: np.ndarray  # (n + c,) the line's side; for the repeated ones, that across the corner
    total: int  # n
    near: int  # c
    corner: np.ndarray  # (c,) at which corner, which begins the side of the same number
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
        place[0] += np.abs(place[1]) * (sag.T @ spread[:len(corners)]) \
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
    while rounding > 1 and lines < LEAST_PARTS * rounding:
        rounding //= 2  # it would cost too much of a short side
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
    cuts = [_cut(number, len(sides), side.lines, side.ends, per_segment)
            for number, side in enumerate(sides)]
    near, between = [cut.near for cut in cuts], [cut.between for cut in cuts]
    lines = np.concatenate([part.lines for part in near + between])
    layout = _layout(lines, _ends_first([cut.blocks for cut in cuts]),
                     _ends_first([cut.segments for cut in cuts]),
                     tuple([side[2:] for side in sides]))
    return layout, np.concatenate([part.spread for part in near + between + near], axis=1)


def _ends_first(sides: list[tuple[int, ...]]) -> list[int]:
    """Order numbers of both ends of each side, and of what is between, as the blocks are."""
    return [number for side in sides for number in side[:2]] + [side[2] for side in sides]


class Part(NamedTuple):
    """Lines of one side: those at both of its ends, or those between."""

    lines: np.ndarray  # in each segment
    spread: np.ndarray  # (2 m, n) as of `layout_of`


class Cut(NamedTuple):
    """How one side is cut into segments."""

    blocks: tuple[int, ...]  # lines at its ends, and between
    segments: tuple[int, ...]  # the same of segments
    near: Part
    between: Part


@lru_cache(maxsize=512)
def _cut(side: int, count: int, lines: int, ends: int, per_segment: int) -> Cut:
    """Cut one of so many sides into segments: those that hold the lines at its ends, others."""
    cut = _segments(lines, per_segment)
    low, high = (bisect_left(list(accumulate(part)), ends) + 1 for part in (cut, cut[::-1]))
    parts = cut[:low], cut[-high:], cut[low:-high]
    if low + high > len(cut):
        at_end = _segments(ends, per_segment)
        parts = at_end, at_end, _segments(lines - 2 * ends, per_segment)
    low, high, _ = blocks = tuple(map(sum, parts))
    return Cut(blocks, tuple(map(len, parts)),
               _part(parts[0] + parts[1], side, count, [*range(low), *range(lines - high, lines)]),
               _part(parts[2], side, count, range(low, lines - high)))


def _part(segments: list[int], side: int, count: int, numbers: Sequence[int]) -> Part:
    """Describe lines with these numbers of one of so many sides."""
    spread = np.zeros((2, count, len(numbers)))
    spread[0, side], spread[1, side] = 1.0, numbers
    return Part(np.array(segments, int), spread.reshape(2 * count, -1))


def _segments(lines: int, per_segment: int) -> list[int]:
    """Cut lines into segments of about the same length."""
    count = max(round(lines / per_segment), 1) if lines else 0
    ends = [number * lines // count for number in range(count)] + [lines]
    return [end - begin for begin, end in zip(ends, ends[1:])]


def _layout(lines: np.ndarray, blocks: list[int], segments: list[int],
            facing: tuple[tuple[bool, bool], ...]) -> Layout:
    """Arrange the lines of segments; their numbers are given for each block (3 m,)."""
    count, (own, across, corner) = len(facing), _seen(facing)
    ends, last = 2 * count, list(accumulate(segments, initial=0))
    parts = [(slice(last[2 * side], last[2 * side + 2]),
              slice(last[ends + side], last[ends + side + 1])) for side in range(count)]
    side_lines = [low + high + between for low, high, between in zip(
        blocks[:ends:2], blocks[1:ends:2], blocks[ends:])]
    return Layout(across.repeat(blocks + blocks[:ends]), sum(blocks), sum(blocks[:ends]),
                  corner.repeat(blocks[:ends]), blocks, facing,
                  np.add.accumulate(lines) - lines, lines, own.repeat(segments), parts, side_lines)


@lru_cache(maxsize=64)
def _seen(facing: tuple[tuple[bool, bool], ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Give the blocks of lines their side (3 m,), the side that they are seen from (5 m,), corners.

    The second repeats the blocks at the ends, which the next side is to see; only those
    have a corner (2 m,).
    """
    side, ahead = np.arange(len(facing)), np.array(facing)[:, 1]
    before, behind = np.roll(side, 1), np.roll(side, -1)
    across = np.where(ahead, (before, behind), (behind, before)).T.ravel()  # at either end
    corner = np.where(ahead, (side, behind), (behind, side)).T.ravel()
    own = np.concatenate((side.repeat(2), side))
    return own, np.concatenate((own, across)), corner


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
    layout = _layout(np.array(list(chain.from_iterable(cuts)), int), blocks,
                     list(map(len, cuts)), layout.facing)
    return Lines(layout, lines.place[:, :, keep], lines.along[keep[:total]])
