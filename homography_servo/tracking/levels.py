"""
Grey levels outside and inside of every segment of an edge.

The few pixels across the edge tell them poorly, and an unknown level takes part of
what a segment tells about its offset. Pixels further away, the other segments and
earlier pictures pin them down as far as they are alike.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.scan import FAR_READ
from homography_servo.tracking.scan import Scan
import numpy as np

FAR_SIGMAS = 3.0  # far pixels that differ by more than this have another grey level
FLAT_GREY = 1.0  # and uneven light makes them differ by this much
MOST_POOLED = 300.0  # pixels that the other segments may stand for
MEMORY_GAIN = 0.1  # of a picture among earlier ones
STEADY_GREY = 0.8  # grey levels that change less from picture to picture are remembered
FIRST_SPREAD_GREY = 1.0  # of grey levels from picture to picture before that is known
MEDIAN_TO_SIGMA = 1.48
LEAST_SQUARE = 1e-8  # of the shares about their mean
MEMORY_OF_SPREAD = 0.8  # share of earlier pictures in the spread that counts


class Sums(NamedTuple):
    """Sums over the pixels of each segment; one table, so that all are added to at once."""

    table: np.ndarray  # (11, s) in the order of the properties below

    @property
    def one(self) -> np.ndarray:
        """Count the pixels (s,)."""
        return self.table[0]

    @property
    def plain(self) -> np.ndarray:
        """Sum up share, slope and grey level of the pixels (3, s)."""
        return self.table[1:4]

    @property
    def by_share(self) -> np.ndarray:
        """Sum up the products of these with the share (3, s)."""
        return self.table[4:7]

    @property
    def by_slope(self) -> np.ndarray:
        """Sum up the products of share, slope, grey level and place with the slope (4, s)."""
        return self.table[7:]


class Known(NamedTuple):
    """Grey levels from other pixels than those across the edge, outside and inside."""

    table: np.ndarray  # (8, s) how many they count for, far and common; sums of their grey
    common: list[float]  # two levels that most segments share in this picture
    spread: list[float]  # four, of far and of common levels about the segments' own
    doubt: float  # how far the common level could give in to an offset of all sides, 0 to 1


class Levels(NamedTuple):
    """Grey levels of each segment, fitted to its pixels and what else is known."""

    outside: np.ndarray  # (s,)
    contrast: np.ndarray  # (s,) inside minus outside
    kept: np.ndarray  # (s,) share of the offset's information that is left
    residual: np.ndarray  # (s,) mean squared deviation of the pixels from the model
    known: Known


class LevelMemory(NamedTuple):
    """What most segments had in earlier pictures, outside and inside."""

    level: list[float]  # two common grey levels
    variance: list[float]  # of one picture's level about them
    spread: list[float]  # four, of far and common levels about the segments' own

    @staticmethod
    def first(known: Known) -> LevelMemory:
        """Begin with one picture."""
        return LevelMemory(known.common, [FIRST_SPREAD_GREY ** 2] * 2, known.spread)

    def updated(self, known: Known) -> LevelMemory:
        """Take in another picture."""
        away = [new - old for new, old in zip(known.common, self.level)]
        return LevelMemory(
            [old + MEMORY_GAIN * change for old, change in zip(self.level, away)],
            [old + MEMORY_GAIN * (change * change - old)
             for old, change in zip(self.variance, away)],
            [old + MEMORY_GAIN * (new - old) for old, new in zip(self.spread, known.spread)])

    def gain(self) -> list[float]:
        """Say how much of a new level to believe, 0 to 1, outside and inside."""
        return [variance / (variance + STEADY_GREY ** 2) for variance in self.variance]


def fit_levels(sums: Sums, scan: Scan, known: Known | None,
               memory: LevelMemory | None) -> Levels:
    """
    Fit the grey levels of each segment.

    Parameters
    ----------
    sums : Sums
        Of the pixels across the edge.
    scan : Scan
        Has the pixels further away.
    known : Known or None
        What an earlier step in the same picture found out.
    memory : LevelMemory or None
        What earlier pictures found out.

    Returns
    -------
    Levels

    """
    own = _two_levels(sums)
    # At the least squares solution the explained part is the product with the data.
    missed = scan.grey_square - own.outside * sums.plain[2] - own.contrast * sums.by_share[2]
    residual = np.maximum(missed, 0.01) / (sums.one - 2.0)
    if known is None:
        known = _learn(own, scan, middle(residual), memory)
    sums = _with_known(sums, known, ALL_KNOWN)
    fit = _two_levels(sums)
    return Levels(fit.outside, fit.contrast, _kept(sums, fit), residual, known)


def _learn(fit: TwoLevels, scan: Scan, noise: float, memory: LevelMemory | None) -> Known:
    """Let far pixels and other segments pin the levels down as far as they are alike."""
    lines = scan.layout.lines
    levels, table = np.empty((2, len(lines))), np.empty((8, len(lines)))
    levels[0] = fit.outside
    np.add(fit.outside, fit.contrast, out=levels[1])
    common, (pixels, grey) = middles(levels), table.reshape(2, 4, -1)
    grey[:2], grey[2:] = scan.far, common
    away = np.abs(grey.reshape(2, 2, -1) - levels).reshape(4, -1)
    spread = [MEDIAN_TO_SIGMA * value for (value,) in middles(away).tolist()]
    own = believed = [value for (value,) in common.tolist()]
    doubt = 1.0
    if memory is not None:
        gain = memory.gain()
        doubt = max(gain)
        believed = [old + share * (new - old)
                    for old, share, new in zip(memory.level, gain, own)]
        spread = [new + MEMORY_OF_SPREAD * (old - new)
                  for old, new in zip(memory.spread, spread)]
    counted, limit = _pixels(spread, noise, float(lines[len(lines) // 2]), len(scan.grey))
    grey[2], grey[3] = believed
    np.multiply(away < limit, counted, out=pixels)  # others have a level of their own
    grey *= pixels
    return Known(table, own, spread, doubt)


def _pixels(spread: list[float], noise: float, lines: float, across: int) -> np.ndarray:
    """
    Say how many pixels other levels stand for, and how far from a segment's own they may be.

    Parameters
    ----------
    spread : list of float
        Of far levels outside and inside, and of common ones.
    noise : float
        Variance of a pixel.
    lines, across : float, int
        Lines of a segment, pixels of a line.

    Returns
    -------
    (2, 4, 1) array
        Pixels; limits.

    """
    of_far, of_own = noise / (FAR_READ * lines), noise / (0.5 * lines * across)
    counted, limit = [], []
    for seen in spread[:2]:
        uneven = max(seen * seen - of_far - of_own, 0.0)
        counted.append(noise / (of_far + uneven))
        limit.append(FAR_SIGMAS * (of_far + of_own + uneven) ** 0.5)
    for seen in spread[2:]:
        scatter = max(seen * seen - of_own, 1e-3 * noise)
        counted.append(min(noise / scatter, MOST_POOLED))
        limit.append(FAR_SIGMAS * seen + FLAT_GREY)
    return np.array((counted, limit))[:, :, None]


def kept_alone(sums: Sums, known: Known) -> np.ndarray:
    """Give the share of the offset's information that is kept without other segments (s,)."""
    sums = _with_known(sums, known, FAR_KNOWN)
    return _kept(sums, _two_levels(sums))


class TwoLevels(NamedTuple):
    """Levels fitted to the sums over each segment; arrays (s,)."""

    outside: np.ndarray
    contrast: np.ndarray
    slant: np.ndarray  # of the slope over the share
    mean: np.ndarray  # (3, s) of share, slope and grey level
    centred: np.ndarray  # (3, s) products with the share about these means


def _two_levels(sums: Sums) -> TwoLevels:
    """Solve for the level outside and the contrast by elimination of the former."""
    plain = sums.plain
    mean = plain / sums.one
    centred = sums.by_share - mean[0] * plain
    slant, contrast = centred[1:] / np.maximum(centred[0], LEAST_SQUARE)
    return TwoLevels(mean[2] - contrast * mean[0], contrast, slant, mean, centred)


def _kept(sums: Sums, fit: TwoLevels) -> np.ndarray:
    """Give the share of the offset's information that unknown levels leave."""
    taken = sums.plain[1] * fit.mean[1] + fit.centred[1] * fit.slant
    return np.maximum(1.0 - taken / (sums.by_slope[1] + 1e-9), 0.1)


def _with_known(sums: Sums, known: Known, adds: np.ndarray) -> Sums:
    """Add pixels of known grey level far outside and far inside."""
    table = sums.table.copy()
    table[:7] += adds @ known.table
    return Sums(table)


def _adds() -> np.ndarray:
    """Say which sums (7) pixels outside and inside and their grey levels add to: (7, 8)."""
    adds = np.zeros((7, 2, 2, 2))  # counts or grey levels; far or common; outside or inside
    adds[0, 0] = adds[3, 1] = 1.0
    adds[[1, 4], 0, :, 1] = adds[6, 1, :, 1] = 1.0
    return adds.reshape(7, 8)


ALL_KNOWN = _adds()
FAR_KNOWN = ALL_KNOWN * (1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)


def middle(values: np.ndarray) -> float:
    """Give the median of a short array, quickly."""
    half, ordered = len(values) // 2, values.copy()
    ordered.partition(half)
    return float(ordered[half])


def middles(values: np.ndarray) -> np.ndarray:
    """Give the medians of the rows (r, s) as a column (r, 1), quickly."""
    half, ordered = values.shape[1] // 2, values.copy()
    ordered.partition(half, axis=1)
    return ordered[:, half:half + 1]
