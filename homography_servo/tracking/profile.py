"""The blurred profile of a straight edge, tabulated once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtr

PIXEL_SIGMA_PX = 12.0 ** -0.5  # a square pixel blurs an edge of any direction by this much
STEPS_PER_PX = 64
REACH_PX = 24.0


class EdgeProfile:
    """
    Share of a pixel that lies inside an edge, as a function of signed distance.

    The pixel's own square is taken as a Gaussian of equal variance, which is the same
    for every direction of the edge.

    Parameters
    ----------
    blur_px : float
        Standard deviation of the lens blur [px].

    """

    def __init__(self, blur_px: float) -> None:
        self.blur_px = blur_px
        self.sigma_px = float(np.hypot(blur_px, PIXEL_SIGMA_PX))
        distance = np.arange(-REACH_PX, REACH_PX + 0.5 / STEPS_PER_PX, 1.0 / STEPS_PER_PX)
        z = distance / self.sigma_px
        self._share = ndtr(z).astype(np.float32)
        self._slope = (np.exp(-0.5 * z * z) / (self.sigma_px * np.sqrt(2.0 * np.pi)))
        self._slope = self._slope.astype(np.float32)
        self._last = len(distance) - 1

    def index(self, distance_px: np.ndarray) -> np.ndarray:
        """Turn signed distances [px], positive inside, into places of the tables."""
        place = distance_px * np.float32(STEPS_PER_PX)
        place += np.float32(REACH_PX * STEPS_PER_PX + 0.5)
        np.clip(place, 0.0, self._last, out=place)
        return place.astype(np.int32)

    def share(self, index: np.ndarray) -> np.ndarray:
        """Look up the inside share."""
        return self._share.take(index)

    def slope(self, index: np.ndarray) -> np.ndarray:
        """Look up its derivative with respect to the distance [1/px]."""
        return self._slope.take(index)


@lru_cache(maxsize=256)
def edge_profile(blur_px: float) -> EdgeProfile:
    """Give the profile of a blur; each is tabulated once."""
    return EdgeProfile(blur_px)
