"""How well the edges support a shape that was fitted to them."""

from __future__ import annotations

from functools import cached_property
import math

from homography_servo.tracking.edges import Edges
from homography_servo.tracking.levels import middle
import numpy as np

INLIER_WEIGHT = 0.1
SEEN_SIDE, SIDES_NEEDED = 0.3, 3  # share of its lines that makes a side seen
CLEAR_SIDE = 0.9  # share of its lines that makes a side clear: nothing hides it
NOISE_FLOOR = 0.3  # mean squared grey level; rounding alone gives 1/12
QUIET_SHARE, QUIET_SIGMAS = 0.25, 0.674  # the lower quartile, and how far below the mean it is


class Quality:
    """
    Support of a fit; what only people want to know is worked out when they ask.

    Parameters
    ----------
    edges : Edges
        What the segments said.
    weight : (s,) array
        What each counted for, 0 outlier to 1 inlier.
    miss : (s,) array
        Distance of the segments from the shape [px].

    Attributes
    ----------
    inlier_share : float
        Share of all lines that agree with the shape.
    contrast : float
        Median of inside minus outside over the inliers [grey levels].

    """

    def __init__(self, edges: Edges, weight: np.ndarray, miss: np.ndarray) -> None:
        inlier = weight > INLIER_WEIGHT
        self._edges, self._miss = edges, miss
        self._inlier: np.ndarray | slice = slice(None)
        total: list[int] = edges.layout.side_lines
        supported: list[float] | list[int] = total
        if np.count_nonzero(inlier) < len(inlier):
            self._inlier = inlier
            supported = np.bincount(edges.layout.segment_side, edges.layout.lines * inlier,
                                    len(total)).tolist()
        self._side_share = [part / max(whole, 1) for part, whole in zip(supported, total)]
        self.inlier_share = sum(supported) / sum(total)
        self.contrast = middle(edges.contrast[self._inlier]) if self.inlier_share else 0.0

    @property
    def enough_sides(self) -> bool:
        """Tell whether so many sides are seen that the others follow from them."""
        return sum([share > SEEN_SIDE for share in self._side_share]) >= SIDES_NEEDED

    @property
    def least_side_share(self) -> float:
        """Give the share of the side whose lines agree the least."""
        return min(self._side_share)

    @property
    def clear(self) -> bool:
        """Tell whether nothing hides a part of the edges."""
        return self.least_side_share > CLEAR_SIDE

    @cached_property
    def side_share(self) -> np.ndarray:
        """Give the share (m,) of each side's lines that agree with the shape."""
        return np.array(self._side_share)

    @cached_property
    def residual(self) -> float:
        """Give the RMS distance of the inliers from the shape [px]."""
        miss = self._miss[self._inlier]
        return math.sqrt(float(miss @ miss) / len(miss)) if len(miss) else math.inf

    @cached_property
    def noise(self) -> float:
        """Give the pixel noise that was found [grey levels]."""
        return math.sqrt(noise_of(self._edges.residual, self._edges.pixels))

    @cached_property
    def inside(self) -> float:
        """Give the median grey level inside of the inliers."""
        level = (self._edges.outside + self._edges.contrast)[self._inlier]
        return middle(level) if len(level) else 0.0


def noise_of(residual: np.ndarray, pixels: np.ndarray) -> float:
    """Estimate the variance of the pixel noise from the quieter segments."""
    count, ordered = len(residual), residual.copy()
    quiet, typical = int(QUIET_SHARE * count), float(pixels[count // 2])
    ordered.partition(quiet)
    usual = 1.0 - QUIET_SIGMAS * math.sqrt(2.0 / typical)  # of the noise, in so few pixels
    return max(float(ordered[quiet]) / usual, NOISE_FLOOR)
