"""
Grey levels outside and inside of every segment of an edge.

The few pixels across the edge tell them poorly, and an unknown level takes part of
what a segment tells about its offset. Pixels further away, the other segments and
earlier pictures pin them down as far as they are alike.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.level_memory import Alike
from homography_servo.tracking.level_memory import Known
from homography_servo.tracking.level_memory import LevelMemory
from homography_servo.tracking.scan import FAR_READ
from homography_servo.tracking.scan import Scan
import numpy as np

FAR_SIGMAS = 3.0  # far pixels that differ by more than this have another grey level
FLAT_GREY = 1.0  # and uneven light makes them differ by this much
MOST_POOLED = 300.0  # pixels that the other segments may stand for
MEDIAN_TO_SIGMA = 1.48
LEAST_SQUARE = 1e-8  # of shares about their mean, and of slopes
SPREAD_GAIN = 0.1  # of a picture that is looked at, in how far levels are alike
LOOK_EVERY = 4  # pictures: how far levels are alike changes slowly


class Sums(NamedTuple):
    """Sums over the pixels of each segment; one table, so that all are added to at once."""

    table: np.ndarray  # (14, s) in the order of the properties below

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
        return self.table[7:11]

    @property
    def far(self) -> np.ndarray:
        """Sum up the grey levels of the pixels further away, outside and inside (2, s)."""
        return self.table[11:13]

    @property
    def square(self) -> np.ndarray:
        """Sum up the squared grey levels of the pixels (s,)."""
        return self.table[13]


class Levels(NamedTuple):
    """Grey levels of each segment, fitted to its pixels and what else is known."""

    outside: np.ndarray  # (s,)
    contrast: np.ndarray  # (s,) inside minus outside
    slope_left: np.ndarray  # (s,) squared slopes less what these unknown levels take of them
    residual: np.ndarray  # (s,) mean squared deviation of the pixels from the model
    known: Known


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
    missed = sums.square - own.outside * sums.plain[2] - own.contrast * sums.by_share[2]
    residual = np.maximum(missed, 0.01) / (sums.one - 2.0)
    if known is None:
        known = _learn(own, sums, len(scan.grey), residual, memory)
    sums = _with_known(sums, known, ALL_KNOWN)
    fit = _two_levels(sums)
    return Levels(fit.outside, fit.contrast, _slope_left(sums, fit), residual, known)


def _learn(fit: TwoLevels, sums: Sums, across: int, residual: np.ndarray,
           memory: LevelMemory | None) -> Known:
    """Let far pixels and other segments pin the levels down as far as they are alike."""
    count = len(residual)
    levels, table = np.empty((2, count)), np.empty((2, 2, 2, count))
    levels[0] = fit.outside
    np.add(fit.outside, fit.contrast, out=levels[1])
    common, (pixels, (far, shared)) = middles(levels), table
    np.divide(sums.far, (FAR_READ / across) * sums.one, out=far)
    shared[:] = common
    away = np.abs(table[1] - levels)
    own = [value for (value,) in common.tolist()]
    doubt = 1.0
    if memory is not None:
        gain = memory.gain()
        doubt = max(gain)
        shared[0], shared[1] = [old + share * (new - old)
                                for old, share, new in zip(memory.level, gain, own)]
    alike = memory.alike if memory is not None and memory.age % LOOK_EVERY \
        else _alike(away, middle(residual), float(sums.one[count // 2]), across, memory)
    np.multiply(away < alike.limit, alike.pixels, out=pixels)  # others have a level of their own
    table[1] *= pixels
    return Known(table.reshape(8, count), own, alike, doubt)


def _alike(away: np.ndarray, noise: float, pixels: float, across: int,
           memory: LevelMemory | None) -> Alike:
    """
    Look how far other levels are from those of the segments.

    Parameters
    ----------
    away : (2, 2, s) array
        Distance of far and common levels, outside and inside.
    noise : float
        Variance of a pixel.
    pixels, across : float, int
        Pixels of a segment, and of one of its lines.
    memory : LevelMemory or None
        How far they were in earlier pictures.

    Returns
    -------
    Alike

    """
    spread = [MEDIAN_TO_SIGMA * value for (value,) in middles(away.reshape(4, -1)).tolist()]
    if memory is not None:
        spread = [old + SPREAD_GAIN * (new - old) for old, new in zip(memory.alike.spread, spread)]
    of_far, of_own = noise * across / (FAR_READ * pixels), noise / (0.5 * pixels)
    counted, limit = [], []
    for seen in spread[:2]:
        uneven = max(seen * seen - of_far - of_own, 0.0)
        counted.append(noise / (of_far + uneven))
        limit.append(FAR_SIGMAS * (of_far + of_own + uneven) ** 0.5)
    for seen in spread[2:]:
        scatter = max(seen * seen - of_own, 1e-3 * noise)
        counted.append(min(noise / scatter, MOST_POOLED))
        limit.append(FAR_SIGMAS * seen + FLAT_GREY)
    return Alike(spread, *np.array((counted, limit)).reshape(2, 2, 2, 1))


def left_alone(sums: Sums, known: Known) -> np.ndarray:
    """Give the squared slopes (s,) that levels leave without other segments."""
    sums = _with_known(sums, known, FAR_KNOWN)
    return _slope_left(sums, _two_levels(sums))


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


def _slope_left(sums: Sums, fit: TwoLevels) -> np.ndarray:
    """Give the part of the squared slopes that unknown levels cannot explain."""
    square = sums.by_slope[1]
    left = square - sums.plain[1] * fit.mean[1]
    left -= fit.centred[1] * fit.slant
    return np.maximum(left, 0.1 * square + LEAST_SQUARE)  # where all pixels lie off the edge


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
