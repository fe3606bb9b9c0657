"""
Find a face again that has moved further than its edges can be followed.

The face and a margin around it are sampled on a coarse grid that is fixed to the
expected corners, and compared with what was seen there before.
"""

from __future__ import annotations

import cv2
import numpy as np

GRID_PX = 3.0  # distance of the samples
MARGIN_PX = 9.0  # of the surroundings that belong to the view
LEAST_SIDE = 4  # samples
LIKE = 0.6  # correlation of the right place
NEARBY_PX, APART_PX = 12.0, 4.0  # search for the face beside edges that may not be its own


class Locator:
    """Remembers how the face looks, coarsely."""

    def __init__(self) -> None:
        self._view: np.ndarray | None = None
        self._grid = (0, 0)

    def remember(self, image: np.ndarray, corners: np.ndarray) -> None:
        """Take in how the face with these corners [px] looks."""
        across, down = _axes(corners)
        columns, rows = (max(LEAST_SIDE, int(np.ceil(
            (np.linalg.norm(axis) + 2.0 * MARGIN_PX) / GRID_PX))) for axis in (across, down))
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
        if self._view is None:
            return None
        extra = int(np.ceil(search_px / GRID_PX))
        scene = _sample(image, corners, self._grid, extra)
        match = cv2.matchTemplate(scene, self._view, cv2.TM_CCOEFF_NORMED)
        _, best, _, (column, row) = cv2.minMaxLoc(match)
        if not best > LIKE:
            return None
        across, down = _axes(corners)
        shift = (column - extra) * GRID_PX * across / np.linalg.norm(across) \
            + (row - extra) * GRID_PX * down / np.linalg.norm(down)
        return corners + shift

    def beside(self, image: np.ndarray, corners: np.ndarray) -> bool:
        """Tell whether the face looks to be near by rather than at these corners [px]."""
        found = self.locate(image, corners, NEARBY_PX)
        return found is not None and not np.abs(found - corners).max() < APART_PX


def _axes(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (0.5 * (corners[1] - corners[0] + corners[2] - corners[3]),
            0.5 * (corners[3] - corners[0] + corners[2] - corners[1]))


def _sample(image: np.ndarray, corners: np.ndarray, grid: tuple[int, int],
            extra: int) -> np.ndarray:
    """Sample a grid of the given size, and more around it, along the axes of the face."""
    across, down = (axis / np.linalg.norm(axis) * GRID_PX for axis in _axes(corners))
    columns, rows = grid[0] + 2 * extra, grid[1] + 2 * extra
    first = corners.mean(axis=0) - 0.5 * ((columns - 1) * across + (rows - 1) * down)
    matrix = np.array([[across[0], down[0], first[0]], [across[1], down[1], first[1]]])
    soft = cv2.warpAffine(image, matrix, (columns, rows), None,
                          cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE)
    return cv2.GaussianBlur(soft, (3, 3), 0)
