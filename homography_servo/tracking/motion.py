"""Where the corners will be in the next picture."""

from __future__ import annotations

from homography_servo.tracking.snake import Prior
import numpy as np

FREE_SIGMA_PX = 1e3  # common shift, turn and scale are left to the picture
LARGEST_PAUSE_S = 1.0
FIRST_SURPRISE_PX, LEAST_SURPRISE_PX = 0.5, 0.1  # RMS change of shape beyond the prediction
FORGET = 0.1
SURPRISES = 3.0  # standard deviation of the prior over the usual surprise


class Motion:
    """
    Constant velocity of every corner.

    The prior it gives leaves the common shift, turn and scale of the face to the
    measurement and holds the rest of its shape softly, so that a corner or a side
    that is hidden follows the visible ones.
    """

    def __init__(self) -> None:
        self.corners: np.ndarray | None = None
        self._velocity: np.ndarray | None = None
        self._stamp_s = 0.0
        self._period_s = 1.0 / 30.0
        self._expected: np.ndarray | None = None
        self._surprise_px = FIRST_SURPRISE_PX

    def period(self, stamp_s: float) -> float:
        """Give the time since the last measurement [s]; the usual one after a clock jump."""
        elapsed_s = stamp_s - self._stamp_s
        return elapsed_s if 0.0 < elapsed_s < LARGEST_PAUSE_S else self._period_s

    def measured(self, corners: np.ndarray, stamp_s: float) -> None:
        """Take in a trusted measurement."""
        if self._expected is not None:
            self._learn(corners)
        if self.corners is not None:
            self._period_s = self.period(stamp_s)
            self._velocity = (corners - self.corners) / self._period_s
        self.corners, self._stamp_s = corners, stamp_s

    def predict(self, stamp_s: float) -> Prior:
        """Give the corners expected at a time, and their prior."""
        if self.corners is None:
            raise ValueError('nothing has been measured yet')
        moved = np.zeros_like(self.corners)
        if self._velocity is not None:
            moved = self._velocity * self.period(stamp_s)
        self._expected = self.corners + moved
        return shape_prior(self._expected, SURPRISES * self._surprise_px)

    def _learn(self, corners: np.ndarray) -> None:
        """Learn how well the shape is predicted; large surprises count at once."""
        miss = (corners - self._expected).ravel()
        free = similarity_basis(self._expected)
        bend_px = float(np.sqrt(np.mean((miss - free @ (free.T @ miss)) ** 2)))
        share = 1.0 if bend_px > self._surprise_px else FORGET
        self._surprise_px = max(self._surprise_px + share * (bend_px - self._surprise_px),
                                LEAST_SURPRISE_PX)
        self._expected = None


def shape_prior(corners: np.ndarray, shape_sigma_px: float) -> Prior:
    """Hold the shape of a polygon but not its place, direction and size."""
    free = similarity_basis(corners)
    # The inverse of shape_sigma^2 I + FREE_SIGMA^2 free free^T, free being orthonormal.
    ratio = FREE_SIGMA_PX ** 2 / (FREE_SIGMA_PX ** 2 + shape_sigma_px ** 2)
    return Prior(corners, (np.eye(corners.size) - ratio * (free @ free.T)) / shape_sigma_px ** 2)


def both(first: Prior, second: Prior) -> Prior:
    """Combine two priors that are independent of each other."""
    information = first.information + second.information
    pull = first.information @ first.corners.ravel() \
        + second.information @ second.corners.ravel()
    return Prior(np.linalg.solve(information, pull).reshape(first.corners.shape), information)


def similarity_basis(corners: np.ndarray) -> np.ndarray:
    """Give orthonormal columns (2m, 4) of common shift, turn and scale."""
    count = len(corners)
    away = corners - corners.sum(axis=0) / count
    flat = away.ravel()
    away = away / (flat @ flat) ** 0.5
    basis = np.zeros((count, 2, 4))
    basis[:, 0, 0] = basis[:, 1, 1] = count ** -0.5
    basis[:, :, 2] = away
    basis[:, 0, 3], basis[:, 1, 3] = -away[:, 1], away[:, 0]
    return basis.reshape(corners.size, 4)
