"""Where the corners will be in the next picture."""

from __future__ import annotations

from functools import lru_cache
import math

from homography_servo.result import required
from homography_servo.tracking.polygon_fit import Prior
import numpy as np

FREE_SIGMA_PX = 1e3  # common shift, turn and scale are left to the picture
LARGEST_PAUSE_S = 1.0
FIRST_SURPRISE_PX, LEAST_SURPRISE_PX = 0.5, 0.02  # RMS change of shape beyond the prediction
FORGET = 0.1
USUAL_CHANGES = 3.0  # a change is expected to be at most so many times the earlier ones
LEAST_REPEATED = -0.5  # of a change that is noise, this much is undone
SURPRISES = 2.0  # standard deviation of the prior over the usual surprise


class Motion:
    """
    Constant velocity of every corner, and as much of its change as has come true before.

    The prior it gives leaves the common shift, turn and scale of the face to the
    measurement and holds the rest of its shape softly, so that a corner or a side
    that is hidden follows the visible ones.
    """

    def __init__(self) -> None:
        self.corners: np.ndarray | None = None
        self._velocity: np.ndarray | None = None
        self._change: np.ndarray | None = None  # of the velocity, from picture to picture
        self._repeated = self._changed = 0.0  # how much of it came again, and of how much
        self._stamp_s = 0.0
        self._period_s = 1.0 / 30.0
        self._steady: np.ndarray | None = None  # where constant velocity leads
        self._prior: Prior | None = None
        self._surprise_px = FIRST_SURPRISE_PX

    def period(self, stamp_s: float) -> float:
        """Give the time since the last measurement [s]; the usual one after a clock jump."""
        elapsed_s = stamp_s - self._stamp_s
        return elapsed_s if 0.0 < elapsed_s < LARGEST_PAUSE_S else self._period_s

    def measured(self, corners: np.ndarray, stamp_s: float) -> None:
        """Take in a trusted measurement."""
        if self._prior is not None:
            self._learn(corners, self._prior)
        if self.corners is not None:
            self._period_s = self.period(stamp_s)
            velocity = (corners - self.corners) / self._period_s
            self._change = None if self._velocity is None else velocity - self._velocity
            self._velocity = velocity
        self.corners, self._stamp_s = corners, stamp_s

    def predict(self, stamp_s: float) -> Prior:
        """Give the corners expected at a time, and their prior."""
        if self.corners is None:
            raise ValueError('nothing has been measured yet')
        expected = self.corners
        if self._velocity is not None:
            expected = self._steady = expected + self._velocity * self.period(stamp_s)
        if self._change is not None and self._changed > 0.0:
            change = self.period(stamp_s) * self._change
            # A jump is a change that nobody has seen before: it will not come again.
            usual = USUAL_CHANGES * math.sqrt(
                self._changed / max(float(np.vdot(change, change)), 1e-12))
            share = min(max(self._repeated / self._changed, LEAST_REPEATED), 1.0)
            expected = expected + share * min(usual, 1.0) * change
        self._prior = shape_prior(expected, SURPRISES * self._surprise_px)
        return self._prior

    def _learn(self, corners: np.ndarray, prior: Prior) -> None:
        """Learn how well the shape is predicted; large surprises count at once."""
        miss = (corners - prior.corners).ravel()
        free = required(prior.free, 'free motion in the prior')
        bend = miss - free @ (free.T @ miss)
        bend_px = (float(bend @ bend) / len(bend)) ** 0.5
        share = 1.0 if bend_px > self._surprise_px else FORGET
        self._surprise_px = max(self._surprise_px + share * (bend_px - self._surprise_px),
                                LEAST_SURPRISE_PX)
        if self._change is not None:
            expected = (self._change * self._period_s).ravel()
            new = (corners - self._steady).ravel()
            self._repeated += FORGET * (float(expected @ new) - self._repeated)
            self._changed += FORGET * (float(expected @ expected) - self._changed)
        self._prior = None


def shape_prior(corners: np.ndarray, shape_sigma_px: float) -> Prior:
    """Hold the shape of a polygon but not its place, direction and size."""
    free = similarity_basis(corners)
    # The inverse of shape_sigma^2 I + FREE_SIGMA^2 free free^T, free being orthonormal.
    weight = 1.0 / (shape_sigma_px * shape_sigma_px)
    ratio = FREE_SIGMA_PX ** 2 / (FREE_SIGMA_PX ** 2 + shape_sigma_px ** 2)
    return Prior(corners, weight * (_unit(corners.size) - ratio * (free @ free.T)), free)


@lru_cache(maxsize=8)
def _unit(size: int) -> np.ndarray:
    return np.eye(size)


def both(first: Prior, second: Prior) -> Prior:
    """Combine two priors that are independent of each other."""
    away = (second.corners - first.corners).ravel()
    pull = second.information @ away
    return Prior(first.corners, first.information + second.information, first.free,
                 pull if first.pull is None else first.pull + pull)


def similarity_basis(corners: np.ndarray) -> np.ndarray:
    """
    Give orthonormal columns (2m, 4) of common shift, turn and scale.

    In plain floats: for so few numbers what numpy costs is the number of calls.
    """
    points = corners.tolist()
    count = len(points)
    centre_u = sum([u for u, _ in points]) / count
    centre_v = sum([v for _, v in points]) / count
    away = [(u - centre_u, v - centre_v) for u, v in points]
    shift = count ** -0.5
    size = max(math.hypot(*[math.hypot(u, v) for u, v in away]), 1e-12)
    rows = [row for u, v in away for row in ((shift, 0.0, u / size, -v / size),
                                             (0.0, shift, v / size, u / size))]
    return np.array(rows)
