"""
Align the print on the face with how it looked before.

Where the edges of a face are too weak to follow, its print can carry it: the view of
the face in a key picture is compared with the present one by Gauss-Newton steps of
the four corners, brightness and contrast left free.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.rectified import rectified_view
import numpy as np

SAMPLE_PX = 2.5  # distance of the samples in the key picture
INSET = 0.03  # of the face's width and height that is left out at its edges
LEAST_SAMPLES, MOST_SAMPLES = 8, 64  # per direction
LIVELY_GREY = 8.0  # standard deviation of a view with print on it
STEPS = 8
DONE_PX = 0.02
LIKE = 0.85  # correlation with the key picture
REDUNDANCY = 4.0  # neighbouring samples share their noise
KEY_SIGMA_PX = 0.5  # corners of the key picture


class Key(NamedTuple):
    """How the face looked once."""

    view: np.ndarray  # (r, c) float32, zero mean, unit deviation
    weights: np.ndarray  # (r, c, 4) share of each corner in the place of a sample
    size: tuple[int, int]  # c, r

    def rows(self, view: np.ndarray, corners: np.ndarray) -> np.ndarray:
        """Differentiate the samples by the corners (r c, 8)."""
        down, across = np.gradient(0.5 * (view + self.view))
        place = self.weights @ corners
        place_down, place_across = (np.gradient(place, axis=axis) for axis in (0, 1))
        determinant = place_across[..., 0] * place_down[..., 1] \
            - place_across[..., 1] * place_down[..., 0]
        slope_u = (across * place_down[..., 1] - down * place_across[..., 1]) / determinant
        slope_v = (down * place_across[..., 0] - across * place_down[..., 0]) / determinant
        slope = np.stack([slope_u, slope_v], axis=-1)
        rows = self.weights[..., :, None] * slope[..., None, :]
        return rows.reshape(-1, 8)


class FaceTexture:
    """Remembers the print of a face and finds it again near by."""

    def __init__(self) -> None:
        self._key: Key | None = None

    @property
    def known(self) -> bool:
        """Tell whether there is print to align with."""
        return self._key is not None

    def forget(self) -> None:
        """Drop the key picture."""
        self._key = None

    def remember(self, image: np.ndarray, corners_px: np.ndarray) -> None:
        """Take a picture as key if the face with these corners has print on it."""
        points = corners_px.tolist()
        sides = list(map(math.dist, points, points[1:] + points[:1]))
        across, down = (min(max(int(max(pair) / SAMPLE_PX), LEAST_SAMPLES), MOST_SAMPLES)
                        for pair in (sides[::2], sides[1::2]))
        size = (across, down)
        view = rectified_view(image, corners_px, size, INSET)
        if cv2.meanStdDev(view)[1][0, 0] < LIVELY_GREY:
            self._key = None
            return
        s, t = np.meshgrid(*(np.linspace(INSET, 1.0 - INSET, count) for count in size))
        weights = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1)
        self._key = Key((view - view.mean()) / view.std(), weights, size)

    def align(self, image: np.ndarray, corners_px: np.ndarray) -> Prior | None:
        """
        Find the corners at which the face looks like in the key picture.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        corners_px : (4, 2) array
            Where the corners are expected.

        Returns
        -------
        Prior or None
            Corners and their information, None where the face does not look alike.

        """
        key = self._key
        if key is None:
            return None
        corners = corners_px
        for _ in range(STEPS):
            if not np.isfinite(corners).all():
                return None
            view = rectified_view(image, corners, key.size, INSET)
            spread = float(view.std())
            if spread < 0.25 * LIVELY_GREY:
                return None
            view = (view - view.mean()) / spread
            rows = key.rows(view, corners)
            miss = (key.view - view).ravel()
            normal = rows.T @ rows + 1e-6 * np.eye(8)
            step = np.linalg.solve(normal, rows.T @ miss)
            corners = corners + step.reshape(4, 2)
            if np.abs(step).max() < DONE_PX:
                break
        if float(np.mean(view * key.view)) < LIKE or not np.isfinite(corners).all():
            return None
        noise = REDUNDANCY * float(np.mean(miss * miss))
        covariance = noise * np.linalg.inv(normal) + KEY_SIGMA_PX ** 2 * np.eye(8)
        return Prior(corners, np.linalg.inv(covariance))
