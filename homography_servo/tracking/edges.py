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

from functools import lru_cache
import math
from typing import NamedTuple

from homography_servo.tracking.level_memory import Known
from homography_servo.tracking.level_memory import LevelMemory
from homography_servo.tracking.levels import fit_levels
from homography_servo.tracking.levels import left_alone
from homography_servo.tracking.levels import Levels
from homography_servo.tracking.levels import middle
from homography_servo.tracking.levels import Sums
from homography_servo.tracking.lines import Layout
from homography_servo.tracking.profile import EdgeProfile
from homography_servo.tracking.scan import Geometry
from homography_servo.tracking.scan import Scan
from homography_servo.tracking.scan import side_geometry
from homography_servo.tracking.strips import Back
from homography_servo.tracking.strips import Strips
from homography_servo.tracking.wedge import cut_corners
import numpy as np

SMALL_PX = 0.02  # a doubtful offset that levels learnt from each other shorten by little
LINEAR_SHARE = 0.85  # of the largest offset that the linear step can show


class Edges(NamedTuple):
    """What the segments say about the sides; arrays with one entry per segment."""

    side: np.ndarray
    along: np.ndarray  # where on the side, 0 to 1
    normal: np.ndarray  # (2, s) unit vectors towards the inside
    inward: np.ndarray  # how far the edge lies inside of where it was expected
    variance: np.ndarray  # of inward, by the noise found in this segment
    contrast: np.ndarray  # grey levels inside minus outside
    outside: np.ndarray  # grey level
    residual: np.ndarray  # mean squared deviation of the pixels from the model
    pixels: np.ndarray  # in the segment
    known: Known
    second: SecondEdge | None
    layout: Layout  # of the lines that they were measured on

    @property
    def common(self) -> float:
        """Give the offset that all segments share."""
        return _mean(self.inward, _weights(self.variance))

    @property
    def single(self) -> np.ndarray:
        """Tell which segments show one edge only."""
        single = np.ones(len(self.side), bool)
        if self.second is not None:
            single[self.second.segment] = False
        return single


class SecondEdge(NamedTuple):
    """Normal equations of the strips' widths; one entry per segment with a strip."""

    segment: np.ndarray
    mixed: np.ndarray  # information between inward offset and width
    own: np.ndarray  # information about the width
    pull: np.ndarray  # right-hand side of the width
    level_pull: np.ndarray  # the strip's grey level: right-hand side
    level_own: np.ndarray  # and information, both times the noise variance

    def in_plane(self, scale: np.ndarray) -> SecondEdge:
        """Count widths in units of the plane; scale is in image pixels per unit (s,)."""
        square = scale * scale
        return self._replace(mixed=square * self.mixed, own=square * self.own,
                             pull=scale * self.pull)


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
    geometry, layout = side_geometry(corners), scan.layout
    distance, scale = line_distances(scan, geometry)
    place = profile.places(distance, len(scan.grey))
    table = np.empty((3, *place.shape), np.float32)
    edge = profile.share_and_slope(place, table[:2])
    cut_corners(scan, geometry, profile, distance, edge)
    edge, table = edge[:, :, :layout.total], table[:, :, :layout.total]
    back = None if strips is None else strips.mix_in(scan, profile, place, scale, edge)
    table[2] = scan.grey
    sums = _sums(scan, table)
    slope_share, slope_slope, slope_grey, slope_along = sums.by_slope
    levels = fit_levels(sums, scan, known, memory)
    contrast, residual, known = levels.contrast, levels.residual, levels.known
    response = slope_grey - levels.outside * sums.plain[1] - contrast * slope_share
    precision = contrast * contrast * levels.slope_left + 1e-9
    offset = _straightened(contrast * response / precision, profile.sigma_px)
    variance = residual / precision
    if scale is not None:
        pixel = 1.0 / scale.take(layout.first_line)
        offset, variance = pixel * offset, pixel * pixel * variance
    inward = _lengthened(-offset, variance, sums, levels)
    side = layout.segment_side
    second = None
    if back is not None:
        second = _second(scan, back, edge, levels.outside, contrast,
                         residual * slope_slope / levels.slope_left)
        if scale is not None:
            second = second.in_plane(scale.take(layout.first_line.take(second.segment)))
    return Edges(side, slope_along / np.maximum(slope_slope, 1e-9),
                 geometry.normal.take(side, axis=1), inward, variance, contrast,
                 levels.outside, residual, sums.one, known, second, layout)


def line_distances(scan: Scan, geometry: Geometry
                   ) -> tuple[np.ndarray, np.ndarray | None]:
    """
    Give each line's first signed distance and its step, and image pixels per plane unit.

    Distances (2, n + c) are in pixels of the image, float32; the scale is None where the
    plane is the image.
    """
    line = geometry.line.take(scan.layout.side, axis=1)
    distance = np.einsum('ijn,jn->in', scan.place, line[:2])
    distance[0] -= line[2]
    if not scan.bent:
        return distance.astype(np.float32), None
    step = scan.place[1]
    scale = 1.0 / np.sqrt(np.add.reduce(step * step, axis=0))
    distance *= scale
    return distance.astype(np.float32), scale


def _lengthened(inward: np.ndarray, variance: np.ndarray, sums: Sums,
                levels: Levels) -> np.ndarray:
    """
    Lengthen the offset that all segments share.

    Grey levels learnt from each other give in to an offset of all sides at once, so
    that its linear step comes out short by what was learnt.
    """
    doubt = levels.known.doubt
    if doubt * float(np.maximum.reduce(np.abs(inward))) < SMALL_PX:
        return inward
    weight = _weights(variance)
    doubtful = _mean(inward, weight) * doubt
    if abs(doubtful) < SMALL_PX:
        return inward
    learnt = _mean(levels.slope_left / left_alone(sums, levels.known), weight) - 1.0
    return inward + doubtful * learnt


def _weights(variance: np.ndarray) -> np.ndarray:
    """Weigh offsets; a lucky residual does not make one much surer."""
    return 1.0 / np.maximum(variance, 0.25 * middle(variance))


def _mean(values: np.ndarray, weight: np.ndarray) -> float:
    return float(weight @ values) / float(np.add.reduce(weight))


def _sums(scan: Scan, parts: np.ndarray) -> Sums:
    """Sum up share, slope and grey level of the pixels (3, k, n) and their products."""
    pixels, lines = scan.grey.shape
    table = np.empty((13, lines), np.float32)
    sum_pixels(parts, table)
    np.multiply(table[7], scan.along, out=table[9])
    table[10:] = scan.line_sums
    sums = np.empty((14, len(scan.layout.lines)))
    np.multiply(scan.layout.lines, float(pixels), out=sums[0])
    np.add.reduceat(table, scan.layout.first_line, axis=1, dtype=float, out=sums[1:])
    return Sums(sums)


def sum_pixels(parts: np.ndarray, table: np.ndarray) -> None:
    """Sum up (3, k, n) over k, and its products with the first two, into nine rows (.., n)."""
    np.matmul(_ones(parts.shape[1]), parts, out=table[:3, None])
    np.einsum('akn,bkn->abn', parts[:2], parts, out=table[3:9].reshape(2, *table[:3].shape))


@lru_cache(maxsize=32)
def _ones(count: int) -> np.ndarray:
    return np.ones((1, count), np.float32)


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


def _second(scan: Scan, back: Back, edge: np.ndarray, outside: np.ndarray,
            contrast: np.ndarray, noise: np.ndarray) -> SecondEdge:
    """Form the normal equations of the strips' widths and levels."""
    lines = back.lines
    edge, grey = edge.take(lines, axis=2), scan.grey.take(lines, axis=1)
    pixels, count = grey.shape
    table = np.empty((10, count), np.float32)
    np.matmul(_ones(pixels), back.parts, out=table[:2, None])
    np.einsum('akn,kn->an', back.parts, grey, out=table[2:4])
    np.einsum('akn,bkn->abn', back.parts, edge, out=table[4:8].reshape(2, 2, count))
    np.einsum('akn,akn->an', back.parts, back.parts, out=table[8:])
    (slope_one, strip_one, slope_grey, strip_grey, slope_share, mixed, strip_share, _, own,
     strip2) = np.add.reduceat(table, back.first_line, axis=1, dtype=float)
    segment = back.segment
    low, high, noise = outside[segment], contrast[segment], noise[segment]
    gain = high * high / noise
    return SecondEdge(segment, -gain * mixed, gain * own,
                      (slope_grey - low * slope_one - high * slope_share) * high / noise,
                      strip_grey - low * strip_one - high * strip_share, strip2)
