"""Where the corners will be in the next picture."""

from __future__ import annotations

from functools import lru_cache
import math
from typing import NamedTuple

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
DOUBTFUL = 0.5  # variance of a corner, over that of the prior, from which on it is remembered


class Spread(NamedTuple):
    """Covariance of corners [px] and their velocities [px/s]; n numbers of each."""

    corners: np.ndarray  # (n, n)
    cross: np.ndarray  # (n, n) of corners (rows) with velocities
    velocity: np.ndarray  # (n, n)

    def ahead(self, period_s: float, change: np.ndarray) -> Spread:
        """
        Predict by constant velocity.

        Parameters
        ----------
        period_s : float
            How far ahead.
        change : (n, n) array
            Covariance [px^2] of what a change of velocity shifts the corners by until then.

        Returns
        -------
        Spread

        """
        cross = self.cross + period_s * self.velocity
        return Spread(self.corners + period_s * (cross + self.cross.T) + change,
                      cross + change / period_s, self.velocity + change / period_s ** 2)

    def told(self, corners: np.ndarray) -> tuple[Spread, np.ndarray]:
        """
        Let a picture that tells of the corners tell of their velocities as well.

        Parameters
        ----------
        corners : (n, n) array
            Covariance of the corners after the picture; this one is that before.

        Returns
        -------
        Spread, (n, n) array
            After the picture, and the gain [1/s] by which velocities follow the corners.

        """
        gain = np.linalg.solve(self.corners, self.cross).T
        return Spread(corners, corners @ gain.T,
                      self.velocity - gain @ (self.corners - corners) @ gain.T), gain


class Motion:
    """
    Constant velocity of every corner, and as much of its change as has come true before.

    The prior it gives leaves the common shift, turn and scale of the face to the
    measurement and holds the rest of its shape softly, so that a corner or a side
    that is hidden follows the visible ones. Where a picture does not tell it anew, it is
    remembered how well the shape and its change are known (a Kalman filter).
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
        self._spread: Spread | None = None  # of the last corners, if one is doubtful
        self._ahead: tuple[Spread, np.ndarray] | None = None  # of the prior, and its velocity

    def period(self, stamp_s: float) -> float:
        """Give the time since the last measurement [s]; the usual one after a clock jump."""
        elapsed_s = stamp_s - self._stamp_s
        return elapsed_s if 0.0 < elapsed_s < LARGEST_PAUSE_S else self._period_s

    def measured(self, corners: np.ndarray, covariance: np.ndarray, stamp_s: float) -> None:
        """Take in trusted corners (m, 2) and their covariance (2 m, 2 m)."""
        doubtful = max(covariance.diagonal().tolist()) \
            > DOUBTFUL * (SURPRISES * self._surprise_px) ** 2
        if self._prior is not None and not doubtful:
            self._learn(corners, self._prior)
        spread: Spread | None = None
        if self.corners is not None:
            period_s = self._period_s = self.period(stamp_s)
            if self._ahead is not None and self._prior is not None:
                (ahead, velocity), moved = self._ahead, corners - self._prior.corners
                spread, gain = ahead.told(covariance)
                velocity = velocity + (gain @ moved.ravel()).reshape(corners.shape)
            else:  # all of the shift is news
                velocity = (corners - self.corners) / period_s
                if doubtful:
                    spread = Spread(covariance, covariance / period_s, covariance / period_s ** 2)
            self._change = None if self._velocity is None else velocity - self._velocity
            self._velocity = velocity
        self._spread = spread if doubtful else None
        self._prior = self._ahead = None
        self.corners, self._stamp_s = corners, stamp_s

    def predict(self, stamp_s: float) -> Prior:
        """Give the corners expected at a time, and their prior."""
        if self.corners is None:
            raise ValueError('nothing has been measured yet')
        expected, period_s = self.corners, self.period(stamp_s)
        if self._velocity is not None:
            expected = self._steady = expected + self._velocity * period_s
        change = self._likely_change(period_s)
        if self._spread is not None:
            self._prior = self._remembering(self._spread, expected, change, period_s)
            return self._prior
        self._ahead = None
        if change is not None:
            expected = expected + change
        self._prior = shape_prior(expected, SURPRISES * self._surprise_px)
        return self._prior

    def _likely_change(self, period_s: float) -> np.ndarray | None:
        """Give how far the velocity's last change shifts the corners if it comes again."""
        if self._change is None or self._changed <= 0.0:
            return None
        change = period_s * self._change
        # A jump is a change that nobody has seen before: it will not come again.
        usual = USUAL_CHANGES * math.sqrt(
            self._changed / max(float(np.vdot(change, change)), 1e-12))
        share = min(max(self._repeated / self._changed, LEAST_REPEATED), 1.0)
        return share * min(usual, 1.0) * change

    def _remembering(self, spread: Spread, steady: np.ndarray, change: np.ndarray | None,
                     period_s: float) -> Prior:
        """Hold the shape by what it usually changes and by how well it has been known."""
        free = similarity_basis(steady)
        velocity, expected = required(self._velocity, 'velocity'), steady
        if change is not None:  # what pictures have told of it
            common = (free @ (free.T @ change.ravel())).reshape(steady.shape)
            velocity, expected = velocity + common / period_s, expected + common
        ahead = spread.ahead(period_s, self._surprise_px ** 2 * _unit(steady.size)
                             + FREE_SIGMA_PX ** 2 * (free @ free.T))
        self._ahead = ahead, velocity
        return Prior(expected, np.linalg.inv(ahead.corners), free)

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
