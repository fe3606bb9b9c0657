"""
Join straight edges that lie on one line with the same level inside.

A side of the face is interrupted where what lies behind it has the same grey level.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.detection.segments import EVEN_GREY
from homography_servo.tracking.detection.segments import Pieces
import numpy as np

LEAST_SEEN_PX = 12.0  # of a side
IN_LINE_RAD, IN_LINE_PX = 0.24, 2.4


class Sides(NamedTuple):
    """Straight edges, perhaps with gaps."""

    pieces: Pieces  # from the first to the last visible point
    seen: np.ndarray  # (N,) length that is visible [px]

    def chosen(self, which: np.ndarray | slice) -> Sides:
        """Select some."""
        return Sides(self.pieces.chosen(which), self.seen[which])


def join_pieces(pieces: Pieces) -> Sides:
    """Join every piece with the shorter ones on its line; longest first."""
    pieces = pieces.chosen(np.argsort(-pieces.length))
    start, direction, length, level = pieces
    line, other = _parallel_pairs(direction)
    alike = np.abs(level.take(line) - level.take(other)) < EVEN_GREY
    line, other = line[alike], other[alike]
    along, beside = direction.take(line, axis=0), direction.take(other, axis=0)
    away = start.take(other, axis=0) - start.take(line, axis=0)
    away = np.stack([away, away + length.take(other)[:, None] * beside])
    aside = along[:, 0] * away[..., 1] - along[:, 1] * away[..., 0]
    low, high = (along * away).sum(axis=2)
    gap = np.maximum(low - length[line], -high)
    same = (np.abs(aside) < IN_LINE_PX).all(axis=0) & (gap < length[line])
    line, other, low, high = line[same], other[same], low[same], high[same]
    first, last, seen = np.zeros(len(length)), length.copy(), length.copy()
    np.minimum.at(first, line, low)
    np.maximum.at(last, line, high)
    np.add.at(seen, line, length[other])
    alone = np.ones(len(length), bool)
    alone[other] = False
    joined = Pieces(start + first[:, None] * direction, direction, last - first, level)
    return Sides(joined, np.minimum(seen, last - first)).chosen(alone & (seen > LEAST_SEEN_PX))


def _parallel_pairs(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pair edges (n,) that run the same way, each once: the first of them, and the other (p,)."""
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    order = np.argsort(angle)
    ordered = angle[order]
    around = np.concatenate([ordered, ordered + 2.0 * np.pi])
    first, second = matches(ordered, ordered + IN_LINE_RAD, around)
    later = second > first  # of those at the same angle, each pair once
    first, second = order.take(first[later]), np.tile(order, 2).take(second[later])
    return np.minimum(first, second), np.maximum(first, second)


def matches(low: np.ndarray, high: np.ndarray,
            ordered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pair each range low..high (n,) with all places of an ordered array in it."""
    begin = np.searchsorted(ordered, low, 'left')
    count = np.searchsorted(ordered, high, 'right') - begin
    one = np.repeat(np.arange(len(low)), count)
    return one, np.arange(len(one)) + (begin - np.cumsum(count) + count).take(one)
