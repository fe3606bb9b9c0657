"""The blurred profile of a straight edge, tabulated once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtr

PIXEL_SIGMA_PX = 12.0 ** -0.5  # a square pixel blurs an edge of any direction by this much
STEPS_PER_PX = 128
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
        self._slope = np.exp(-0.5 * z * z).astype(np.float32) \
            / np.float32(self.sigma_px * np.sqrt(2.0 * np.pi))

    def places(self, distance_px: np.ndarray, count: int) -> np.ndarray:
        """
        Find the places in the tables of equally spaced signed distances.

        Parameters
        ----------
        distance_px : (2, n) float32 array
            Distance of the first pixel of each line, positive inside, and its change
            from pixel to pixel [px].
        count : int
            Pixels per line.

        Returns
        -------
        (count, n) integer array

        """
        place = _along_tables(count) @ distance_px
        place += np.float32(STEPS_PER_PX * REACH_PX + 0.5)
        return place.astype(np.intp)

    def share_and_slope(self, place: np.ndarray, both: np.ndarray | None = None) -> np.ndarray:
        """Look up both (2, ...), float32, into a given array if there is one."""
        if both is None:
            both = np.empty((2, *place.shape), np.float32)
        self._share.take(place, mode='clip', out=both[0])
        self._slope.take(place, mode='clip', out=both[1])
        return both

    def share(self, place: np.ndarray) -> np.ndarray:
        """Look up the share of the pixel inside the edge."""
        return self._share.take(place, mode='clip')

    def slope(self, place: np.ndarray) -> np.ndarray:
        """Look up its derivative with respect to the distance [1/px]."""
        return self._slope.take(place, mode='clip')


@lru_cache(maxsize=64)
def along_line(count: int) -> np.ndarray:
    """Turn values at the first pixels and their changes (2, n) into those of all: (count, 2)."""
    pixel = np.arange(count, dtype=np.float32)
    return np.stack((np.ones_like(pixel), pixel), axis=1)


@lru_cache(maxsize=64)
def _along_tables(count: int) -> np.ndarray:
    return np.float32(STEPS_PER_PX) * along_line(count)


@lru_cache(maxsize=64)
def edge_profile(blur_px: float) -> EdgeProfile:
    """Give the profile of a blur; each is tabulated once."""
    return EdgeProfile(blur_px)
