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
MEMORY_OF_SPREAD = 0.8  # share of earlier pictures in the spread that counts


class Sums(NamedTuple):
    """Sums over the pixels of each segment."""

    one: np.ndarray
    grey: np.ndarray
    share: np.ndarray
    share_share: np.ndarray
    share_grey: np.ndarray
    slope: np.ndarray
    slope_share: np.ndarray
    slope_slope: np.ndarray
    slope_grey: np.ndarray
    slope_along: np.ndarray


class Known(NamedTuple):
    """Grey levels from other pixels than those across the edge, outside and inside."""

    pixels: np.ndarray  # (4, s) how many they count for: two rows of far, two of common levels
    grey: np.ndarray  # (4, s) sum of their grey levels
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
    inverse = 1.0 / _determinant(sums)
    outside, contrast = _two_levels(sums, inverse)
    # At the least squares solution the explained part is the product with the data.
    missed = scan.grey_square - outside * sums.grey - contrast * sums.share_grey
    residual = np.maximum(missed, 0.01) / (sums.one - 2.0)
    if known is None:
        known = _learn(np.array((outside, outside + contrast)), scan, middle(residual), memory)
    sums = with_pixels(sums, known.pixels[:2] + known.pixels[2:],
                       known.grey[:2] + known.grey[2:])
    inverse = 1.0 / _determinant(sums)
    return Levels(*_two_levels(sums, inverse), _kept(sums, inverse), residual, known)


def _learn(levels: np.ndarray, scan: Scan, noise: float,
           memory: LevelMemory | None) -> Known:
    """Let far pixels and other segments pin the levels down as far as they are alike."""
    lines, common = scan.layout.lines, middles(levels)
    table, away = np.empty((4, len(lines))), np.empty((4, len(lines)))
    table[:2] = scan.far
    np.subtract(scan.far, levels, out=away[:2])
    np.subtract(common, levels, out=away[2:])
    np.abs(away, out=away)
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
    table[2], table[3] = believed
    pixels = (away < limit) * counted  # others have a level of their own
    return Known(pixels, table * pixels, own, spread, doubt)


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
    sums = with_pixels(sums, known.pixels[:2], known.grey[:2])
    return _kept(sums, 1.0 / _determinant(sums))


def _two_levels(sums: Sums, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve for the level outside and the contrast."""
    contrast = (sums.one * sums.share_grey - sums.share * sums.grey) * inverse
    return (sums.grey - contrast * sums.share) / sums.one, contrast


def _determinant(sums: Sums) -> np.ndarray:
    return np.maximum(sums.one * sums.share_share - sums.share * sums.share, 1e-6)


def _kept(sums: Sums, inverse: np.ndarray) -> np.ndarray:
    """Give the share of the offset's information that unknown levels leave."""
    slope, slope_share = sums.slope, sums.slope_share
    taken = slope * (sums.share_share * slope - 2.0 * sums.share * slope_share) \
        + sums.one * slope_share * slope_share
    return np.maximum(1.0 - taken * inverse / (sums.slope_slope + 1e-9), 0.1)


def with_pixels(sums: Sums, pixels: np.ndarray, grey: np.ndarray) -> Sums:
    """Add pixels of known grey level far outside and far inside."""
    inside, grey_inside = pixels[1], grey[1]
    return Sums(sums.one + (pixels[0] + inside), sums.grey + (grey[0] + grey_inside),
                sums.share + inside, sums.share_share + inside, sums.share_grey + grey_inside,
                *sums[5:])


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
