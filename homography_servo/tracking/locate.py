"""
Find a face again that has moved further than its edges can be followed.

The face and a margin around it are sampled on a coarse grid that is fixed to the
expected corners, and compared with what was seen there before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

GRID_PX = 3.0  # distance of the samples
MARGIN_PX = 9.0  # of the surroundings that belong to the view
LEAST_SIDE = 4  # samples
LIKE = 0.6  # correlation of the right place
NEARBY_PX, APART_PX = 12.0, 4.0  # search for the face beside edges that may not be its own
CLEARLY = 2.0  # times as much must be unlike the view here as there


class _Best(NamedTuple):
    """Where a view looks most alike."""

    shift: np.ndarray  # (2,) [px]
    like: float  # correlation there
    like_here: float  # and without a shift


class Locator:
    """Remembers how the face looks, coarsely."""

    def __init__(self) -> None:
        self._view: np.ndarray | None = None
        self._grid = (0, 0)

    def remember(self, image: np.ndarray, corners: np.ndarray) -> None:
        """Take in how the face with these corners [px] looks."""
        columns, rows = (max(LEAST_SIDE, math.ceil((length + 2.0 * MARGIN_PX) / GRID_PX))
                         for length, _, _ in _axes(corners.tolist()))
        self._grid = (columns, rows)
        self._view = _sample(image, corners, self._grid, 0)

    def locate(self, image: np.ndarray, corners: np.ndarray,
               search_px: float) -> np.ndarray | None:
        """
        Look for the face around expected corners.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        corners : (4, 2) array
            Where the corners are expected [px].
        search_px : float
            How far from there to look.

        Returns
        -------
        (4, 2) array or None
            The corners shifted to the best place, None where nothing looks alike.

        """
        best = self._best(image, corners, search_px)
        return None if best is None or not best.like > LIKE else corners + best.shift

    def beside(self, image: np.ndarray, corners: np.ndarray) -> bool:
        """Tell whether the face looks to be near by rather than at these corners [px]."""
        best = self._best(image, corners, NEARBY_PX)
        return best is not None and best.like > LIKE \
            and 1.0 - best.like_here > CLEARLY * (1.0 - best.like) \
            and not np.abs(best.shift).max() < APART_PX

    def _best(self, image: np.ndarray, corners: np.ndarray, search_px: float) -> _Best | None:
        """Compare with the view at all shifts that are no farther than to be searched."""
        if self._view is None:
            return None
        extra = math.ceil(search_px / GRID_PX)
        scene = _sample(image, corners, self._grid, extra)
        match = cv2.matchTemplate(scene, self._view, cv2.TM_CCOEFF_NORMED)
        _, best, _, (column, row) = cv2.minMaxLoc(match)
        (_, *across), (_, *down) = _axes(corners.tolist())
        shift = (column - extra) * GRID_PX * np.array(across) \
            + (row - extra) * GRID_PX * np.array(down)
        return _Best(shift, best, float(match[extra, extra]))


def _axes(corners: list[list[float]]) -> list[tuple[float, float, float]]:
    """Give the mean length and direction (u, v) of the sides across and of those down."""
    (u0, v0), (u1, v1), (u2, v2), (u3, v3) = corners
    axes = []
    for u, v in ((u1 - u0 + u2 - u3, v1 - v0 + v2 - v3), (u3 - u0 + u2 - u1, v3 - v0 + v2 - v1)):
        length = math.hypot(u, v) or 1e-12
        axes.append((0.5 * length, u / length, v / length))
    return axes


def _sample(image: np.ndarray, corners: np.ndarray, grid: tuple[int, int],
            extra: int) -> np.ndarray:
    """Sample a grid of the given size, and more around it, along the axes of the face."""
    points = corners.tolist()
    (_, right_u, right_v), (_, down_u, down_v) = _axes(points)
    columns, rows = grid[0] + 2 * extra, grid[1] + 2 * extra
    right, down = 0.5 * (columns - 1) * GRID_PX, 0.5 * (rows - 1) * GRID_PX
    centre_u, centre_v = (0.25 * sum(values) for values in zip(*points))
    matrix = np.array(((GRID_PX * right_u, GRID_PX * down_u,
                        centre_u - right * right_u - down * down_u),
                       (GRID_PX * right_v, GRID_PX * down_v,
                        centre_v - right * right_v - down * down_v)))
    soft = cv2.warpAffine(image, matrix, (columns, rows), None,
                          cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE)
    return cv2.GaussianBlur(soft, (3, 3), 0)
