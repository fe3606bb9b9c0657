"""The pixels close to a corner, where two sides blur into each other."""

from __future__ import annotations

from functools import lru_cache

from homography_servo.tracking.lines import Layout
from homography_servo.tracking.profile import EdgeProfile
from homography_servo.tracking.scan import Geometry
from homography_servo.tracking.scan import Scan
import numpy as np

SQUARE = 0.08  # cosine of a corner that may be taken for a right angle


def cut_corners(scan: Scan, geometry: Geometry, profile: EdgeProfile, first: np.ndarray,
                step: np.ndarray, edge: np.ndarray) -> None:
    """
    Let the next side cut off the lines close to a corner.

    The share of a blurred wedge is that of two correlated normal variables, by its
    series in the correlation (which is 0 at a right angle).

    Parameters
    ----------
    scan : Scan
        Tells which lines are close to which corner.
    geometry : Geometry
        The sides.
    profile : EdgeProfile
        The blurred edge.
    first, step : (n + c,) float32 array
        Distance of each line's first pixel from its side, and its change [px].
    edge : (2, k, n + c) array
        Share and slope of every pixel for its side alone; those of the first n lines
        are changed in place.

    """
    layout, total = scan.layout, scan.layout.total
    near, alike = layout.near, geometry.normal.T @ geometry.normal
    skew = -alike.take(_pairs(layout, len(alike))).astype(np.float32)
    own, (cut_share, cut_slope) = edge.take(near, axis=2), edge[:, :, total:]
    if np.maximum.reduce(np.abs(skew), initial=0.0) < SQUARE:
        edge[:, :, near] = own * cut_share
        return
    count = np.arange(len(scan.grey), dtype=np.float32)[:, None]
    away = count * step.take(near)
    away += first.take(near)
    beyond = count * step[total:]
    beyond += first[total:]
    variance = np.float32(profile.sigma_px ** 2)
    twist = skew * cut_slope
    half = beyond
    half *= twist
    half *= np.float32(0.5) * skew
    share, slope = own
    share *= cut_share
    share += slope * (half * away - variance * twist)
    half *= away * away / variance - np.float32(1.0)
    twist *= away
    twist += cut_share
    twist -= half
    slope *= twist
    edge[:, :, near] = own


@lru_cache(maxsize=64)
def _pairs(layout: Layout, corner_count: int) -> np.ndarray:
    """Give each repeated line (c,) one number for its own side and the one across."""
    return layout.own[layout.total:] * corner_count + layout.side[layout.total:]
