"""
Measure where the sides of a polygon run: a blurred step fitted to raw pixels.

A pixel at signed distance d inside a side is expected to have the grey level
outside + contrast * share(d), where share is the profile of a blurred edge. Both
levels are fitted per segment of a few scan lines; the segment's offset is the linear
least squares step of that model, its variance that of the same step.

Where a darker side of a box can be seen as a narrow strip beside the face, the profile
is that of two edges a known distance apart, and the distance is measured too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from homography_servo.tracking.profile import EdgeProfile
from homography_servo.tracking.scan import FAR_PX
from homography_servo.tracking.scan import Geometry
from homography_servo.tracking.scan import Scan
from homography_servo.tracking.scan import side_geometry
from homography_servo.tracking.strips import Strips
import numpy as np

FAR_SIGMAS = 3.0  # far pixels that differ by more than this have another grey level
FLAT_GREY = 1.0  # and uneven light makes them differ by this much
MOST_POOLED = 300.0  # pixels that the other segments may stand for
SQUARE = 0.08  # cosine of a corner that may be taken for a right angle
MEMORY_GAIN = 0.1  # of a picture among earlier ones
STEADY_GREY = 0.8  # grey levels that change less from picture to picture are remembered
LINEAR_SHARE = 0.85  # of the largest offset that the linear step can show


class Edges(NamedTuple):
    """What the segments say about the sides; arrays with one entry per segment."""

    side: np.ndarray
    along: np.ndarray  # where on the side, 0 to 1
    normal_u: np.ndarray  # unit vector towards the inside
    normal_v: np.ndarray
    inward: np.ndarray  # how far the edge lies inside of where it was expected
    variance: np.ndarray  # of inward, by the noise found in this segment
    contrast: np.ndarray  # grey levels inside minus outside
    outside: np.ndarray  # grey level
    residual: np.ndarray  # mean squared deviation of the pixels from the model
    lines: np.ndarray  # scan lines in the segment
    known: Known
    common: float  # offset that all segments share
    second: SecondEdge | None

    @property
    def single(self) -> np.ndarray:
        """Tell which segments show one edge only."""
        single = np.ones(len(self.side), bool)
        if self.second is not None:
            single[self.second.segment] = False
        return single


class Known(NamedTuple):
    """Grey levels from other pixels than those across the edge, outside and inside."""

    pixels: np.ndarray  # (2, s) how many they count for
    grey: np.ndarray  # (2, s) sum of their grey levels
    alone: np.ndarray  # (s,) share of the offset's information kept without other segments
    common: np.ndarray  # (2, 1) level that most segments share in this picture
    doubt: float  # how far that level could give in to an offset of all sides, 0 to 1


class LevelMemory(NamedTuple):
    """Grey levels outside and inside that most segments had in earlier pictures."""

    level: np.ndarray  # (2, 1)
    variance: np.ndarray  # (2, 1) of one picture's level about it

    def updated(self, common: np.ndarray) -> LevelMemory:
        """Take in another picture."""
        away = common - self.level
        return LevelMemory(self.level + MEMORY_GAIN * away,
                           self.variance + MEMORY_GAIN * (away * away - self.variance))

    @property
    def gain(self) -> np.ndarray:
        """Say how much of a new level to believe, 0 to 1 (2, 1)."""
        return self.variance / (self.variance + STEADY_GREY ** 2)


class SecondEdge(NamedTuple):
    """Normal equations of the strips' widths; one entry per segment with a strip."""

    segment: np.ndarray
    mixed: np.ndarray  # information between inward offset and width
    own: np.ndarray  # information about the width
    pull: np.ndarray  # right-hand side of the width
    level_pull: np.ndarray  # the strip's grey level: right-hand side
    level_own: np.ndarray  # and information, both times the noise variance


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


def measure_edges(scan: Scan, corners: np.ndarray, profile: EdgeProfile,
                  strips: Strips | None = None, known: Known | None = None,
                  memory: LevelMemory | None = None) -> Edges:
    """
    Fit the edge profile in every segment.

    Parameters
    ----------
    scan : Scan
        Pixels, read around some polygon close to this one.
    corners : (m, 2) array
        Where the corners are thought to be now, in the plane of the scan.
    profile : EdgeProfile
        The blurred edge.
    strips : Strips or None
        Sides of a box that show beside the face.
    known : Known or None
        What an earlier step in the same picture found out about the grey levels.
    memory : LevelMemory or None
        What earlier pictures found out about them.

    Returns
    -------
    Edges

    """
    geometry = side_geometry(corners)
    first, step, scale = line_distances(scan, geometry)
    place = profile.places(first, step, len(scan.grey))
    share, slope = profile.share(place), profile.slope(place)
    total = scan.grey.shape[1]
    _cut_corners(scan, geometry, profile, first, step, share, slope)
    share, slope = share[:, :total], slope[:, :total]
    back = None
    if strips is not None:
        back = strips.mix_in(scan, profile, place, scale, share, slope)
    sums = _sums(scan, share, slope)
    levels, kept, residual, known = _levels(sums, scan, step, known, memory)
    outside, contrast = levels[0], levels[1] - levels[0]
    response = sums.slope_grey - outside * sums.slope - contrast * sums.slope_share
    energy = np.maximum(sums.slope_slope * kept, 1e-9)
    safe = np.where(np.abs(contrast) < 1e-3, 1e-3, contrast)
    pixel = 1.0 if scale is None else 1.0 / scale.take(scan.layout.first_line)
    offset = -pixel * _straightened(response / (safe * energy), profile.sigma_px)
    inward, common = _with_common(offset, safe * safe * energy / residual, kept / known.alone,
                                  known.doubt)
    side = scan.layout.segment_side
    second = None
    if back is not None:
        second = _second(scan, back, share, slope, outside, contrast, residual / kept)
    return Edges(side, sums.slope_along / np.maximum(sums.slope_slope, 1e-9),
                 geometry.normal_u.take(side), geometry.normal_v.take(side),
                 inward, pixel * pixel * residual / (safe * safe * energy), contrast, outside,
                 residual, scan.layout.lines, known, common, second)


def line_distances(scan: Scan, geometry: Geometry) -> tuple[np.ndarray, ...]:
    """
    Give each line's first signed distance, its step, and image pixels per plane unit.

    Distances are in pixels of the image; the scale is None where the plane is the image.
    """
    normal_u, normal_v = geometry.normal_u.take(scan.side), geometry.normal_v.take(scan.side)
    first = normal_u * scan.u + normal_v * scan.v - geometry.level.take(scan.side)
    step = normal_u * scan.du + normal_v * scan.dv
    if not scan.bent:
        return first, step, None
    scale = 1.0 / np.sqrt(scan.du * scan.du + scan.dv * scan.dv)
    return first * scale, step * scale, scale


def _cut_corners(scan: Scan, geometry: Geometry, profile: EdgeProfile, first: np.ndarray,
                 step: np.ndarray, share: np.ndarray, slope: np.ndarray) -> None:
    """
    Let the next side cut off the lines close to a corner, in place.

    The share of a blurred wedge is that of two correlated normal variables, by its
    series in the correlation (which is 0 at a right angle).
    """
    total, near = scan.grey.shape[1], scan.near
    own, other = scan.side[near], scan.side[total:]
    skew = -(geometry.normal_u.take(own) * geometry.normal_u.take(other)
             + geometry.normal_v.take(own) * geometry.normal_v.take(other)).astype(np.float32)
    cut_share, cut_slope = share[:, total:], slope[:, total:]
    own_share, own_slope = share.take(near, axis=1), slope.take(near, axis=1)
    if np.abs(skew).max(initial=0.0) < SQUARE:
        share[:, near], slope[:, near] = own_share * cut_share, own_slope * cut_share
        return
    count = np.arange(len(share), dtype=np.float32)[:, None]
    away = (first[near] + count * step[near]).astype(np.float32)
    beyond = (first[total:] + count * step[total:]).astype(np.float32)
    twist = -skew * cut_slope
    variance = np.float32(profile.sigma_px ** 2)
    half = 0.5 * twist * skew * beyond
    share[:, near] = own_share * cut_share + own_slope * (variance * twist - half * away)
    slope[:, near] = own_slope * (cut_share - twist * away
                                  + half * (away * away / variance - 1.0))


def _with_common(inward: np.ndarray, precision: np.ndarray,
                 shared: np.ndarray, doubt: float) -> tuple[np.ndarray, float]:
    """
    Lengthen the offset that all segments share.

    Grey levels learnt from each other give in to an offset of all sides at once, so
    that its linear step comes out short by what was learnt.
    """
    weight = np.minimum(precision, 4.0 * middle(precision))
    common = float(weight @ inward / weight.sum())
    lengthened = common * doubt * (float(weight @ shared / weight.sum()) - 1.0)
    return inward + lengthened, common + lengthened


def _sums(scan: Scan, share: np.ndarray, slope: np.ndarray) -> Sums:
    table = np.empty((8, share.shape[1]), np.float32)
    np.add.reduce(share, axis=0, out=table[0])
    np.einsum('ij,ij->j', share, share, out=table[1])
    np.einsum('ij,ij->j', share, scan.grey, out=table[2])
    np.add.reduce(slope, axis=0, out=table[3])
    np.einsum('ij,ij->j', slope, share, out=table[4])
    np.einsum('ij,ij->j', slope, slope, out=table[5])
    np.einsum('ij,ij->j', slope, scan.grey, out=table[6])
    table[7] = table[5] * scan.along
    total = np.add.reduceat(table, scan.layout.first_line, axis=1, dtype=np.float64)
    return Sums(scan.layout.lines * float(len(share)), scan.grey_sum, *total)


def _levels(sums: Sums, scan: Scan, step: np.ndarray, known: Known | None,
            memory: LevelMemory | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, Known]:
    """
    Fit the grey levels of each segment.

    Returns
    -------
    (2, s) array, (s,) array, (s,) array, Known
        Levels outside and inside, share of the offset's information that is left when
        they are unknown, mean squared deviation, and what to use in the next step.

    """
    levels = _two_levels(sums)
    # At the least squares solution the explained part is the product with the data.
    missed = scan.grey_square - levels[0] * (sums.grey - sums.share_grey) \
        - levels[1] * sums.share_grey
    residual = np.maximum(missed, 0.01) / (sums.one - 2.0)
    if known is None:
        known = _learn_levels(sums, scan, step, levels, middle(residual), memory)
    sums = _with_pixels(sums, known)
    return _two_levels(sums), _kept(sums), residual, known


def _learn_levels(sums: Sums, scan: Scan, step: np.ndarray, levels: np.ndarray,
                  noise: float, memory: LevelMemory | None) -> Known:
    """Let far pixels and other segments pin the levels down as far as they are alike."""
    rising = step.take(scan.layout.first_line) > 0.0
    far = np.empty_like(levels)
    far[1] = np.where(rising, scan.high_sum, scan.low_sum)
    far[0] = scan.high_sum + scan.low_sum - far[1]
    pixels = FAR_PX * scan.layout.lines
    far /= pixels
    near = np.stack([sums.one - sums.share, sums.share])
    counted = _alike(far, levels, near, pixels, noise)
    far *= counted
    sums = _with_pixels(sums, Known(counted, far, near, near, 1.0))
    shared, common = _common(_two_levels(sums), near + counted, noise)
    believed, doubt = common, 1.0
    if memory is not None:
        believed = memory.level + memory.gain * (common - memory.level)
        doubt = float(memory.gain.max())
    return Known(counted + shared, far + shared * believed, _kept(sums), common, doubt)


def _two_levels(sums: Sums) -> np.ndarray:
    """Solve for the levels (2, s): outside and inside."""
    one, share = sums.one, sums.share
    contrast = (one * sums.share_grey - share * sums.grey) / _determinant(sums)
    levels = np.empty((2, len(share)))
    np.divide(sums.grey - contrast * share, one, out=levels[0])
    np.add(levels[0], contrast, out=levels[1])
    return levels


def _determinant(sums: Sums) -> np.ndarray:
    return np.maximum(sums.one * sums.share_share - sums.share * sums.share, 1e-6)


def _kept(sums: Sums) -> np.ndarray:
    """Give the share of the offset's information that unknown levels leave."""
    slope, slope_share = sums.slope, sums.slope_share
    taken = slope * (sums.share_share * slope - 2.0 * sums.share * slope_share) \
        + sums.one * slope_share * slope_share
    return np.maximum(1.0 - taken / (_determinant(sums) * sums.slope_slope + 1e-9), 0.1)


def _with_pixels(sums: Sums, known: Known) -> Sums:
    """Add pixels of known grey level far outside and far inside."""
    (pixels_out, pixels_in), (grey_out, grey_in) = known.pixels, known.grey
    return Sums(sums.one + pixels_out + pixels_in, sums.grey + grey_out + grey_in,
                sums.share + pixels_in, sums.share_share + pixels_in,
                sums.share_grey + grey_in, *sums[5:])


def _alike(far: np.ndarray, levels: np.ndarray, near: np.ndarray, pixels: np.ndarray,
           noise: float) -> np.ndarray:
    """Give the pixels that the far ones count for, outside and inside (2, s)."""
    away = np.abs(far - levels)
    expected = noise / middle(pixels) + noise / middles(near)
    uneven = np.maximum((1.48 * middles(away)) ** 2 - expected, 0.0)
    alike = away < FAR_SIGMAS * np.sqrt(expected + uneven)
    return alike * noise / (noise / pixels + uneven)


def _common(levels: np.ndarray, pixels: np.ndarray,
            noise: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Let segments learn the grey levels from each other as far as they are alike.

    Returns
    -------
    (2, s) array, (2, 1) array
        How many pixels the common levels outside and inside stand for in each segment,
        and these levels.

    """
    common = middles(levels)
    away = np.abs(levels - common)
    spread = 1.48 * middles(away)
    scatter = np.maximum(spread * spread - noise / middles(pixels), 1e-3 * noise)
    alike = away < FAR_SIGMAS * spread + FLAT_GREY  # others have a level of their own
    return alike * np.minimum(noise / scatter, MOST_POOLED), common


def _straightened(step: np.ndarray, sigma_px: float) -> np.ndarray:
    """
    Undo the saturation of the linear step.

    An edge that is off by e gives a step of sqrt(pi) sigma erf(e / (2 sigma)); the
    inverse's series up to the seventh power is within 1 % up to e = 1.2 sigma.
    """
    limit = LINEAR_SHARE * math.sqrt(math.pi) * sigma_px
    step = np.minimum(np.maximum(step, -limit), limit)
    q = (step / sigma_px) ** 2
    return step * (1.0 + q * (1.0 / 12.0 + q * (7.0 / 480.0 + q * (127.0 / 40320.0))))


def _second(scan: Scan, back, share: np.ndarray, slope: np.ndarray, outside: np.ndarray,
            contrast: np.ndarray, noise: np.ndarray) -> SecondEdge:
    """Form the normal equations of the strips' widths and levels."""
    lines, grey = back.lines, scan.grey[:, back.lines]
    share, slope = share[:, lines], slope[:, lines]
    table = np.empty((9, len(lines)))
    for row, (a, b) in enumerate(((back.slope, slope), (back.slope, back.slope),
                                  (back.slope, grey), (back.slope, share),
                                  (back.strip, grey), (back.strip, share),
                                  (back.strip, back.strip))):
        table[row] = np.einsum('ij,ij->j', a, b)
    table[7], table[8] = back.slope.sum(axis=0), back.strip.sum(axis=0)
    mixed, own, slope_grey, slope_share, strip_grey, strip_share, strip2, slope_one, strip_one = \
        np.add.reduceat(table, back.first_line, axis=1)
    segment = back.segment
    low, high, noise = outside[segment], contrast[segment], noise[segment]
    gain = high * high / noise
    return SecondEdge(segment, -gain * mixed, gain * own,
                      (slope_grey - low * slope_one - high * slope_share) * high / noise,
                      strip_grey - low * strip_one - high * strip_share, strip2)


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
