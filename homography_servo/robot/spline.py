"""Joint splines: pieces of polynomials of degree five at most, joined at knots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

_SAMPLES = np.linspace(0.0, 1.0, 33)
# Position, velocity, acceleration: factor times time to the power.
_FACTORS = np.array([[1, 1, 1, 1, 1, 1], [0, 1, 2, 3, 4, 5], [0, 0, 2, 6, 12, 20]], dtype=float)
_POWERS = np.array([[0, 1, 2, 3, 4, 5], [0, 0, 1, 2, 3, 4], [0, 0, 0, 1, 2, 3]], dtype=float)
_DENSE = np.moveaxis(_FACTORS * _SAMPLES[:, None, None] ** _POWERS, 1, 0)  # (3, 33, 6)


class Sample(NamedTuple):
    """State of all joints at one time (or many: one row each)."""

    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray


@dataclass(frozen=True, eq=False)
class Knots:
    """
    What a spline passes through.

    Parameters
    ----------
    times_s : (K,) array
        Strictly increasing.
    positions : (K, n) array
    velocities : (K, n) array or None
        None makes the pieces straight lines.
    accelerations : (K, n) array or None
        None makes the pieces cubic.

    """

    times_s: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray | None = None
    accelerations: np.ndarray | None = None


class Spline:
    """Passes through knots; before the first and after the last it stands."""

    def __init__(self, knots: Knots) -> None:
        self.knots = knots
        self.times_s = np.asarray(knots.times_s, dtype=float)
        spans = np.diff(self.times_s)
        if len(self.times_s) < 2 or not np.all(spans > 0.0):
            raise ValueError(f'times_s must be 2 or more and increase, got {self.times_s}')
        self._spans = spans
        self._pieces = _pieces(knots, spans[:, None])

    @property
    def duration_s(self) -> float:
        """Time of the last knot."""
        return float(self.times_s[-1])

    def sample(self, time_s: float | np.ndarray) -> Sample:
        """Give the state at a time, or one row for each of many times."""
        time_s = np.asarray(time_s, dtype=float)
        inside = np.minimum(np.maximum(time_s, self.times_s[0]), self.times_s[-1])
        piece = np.searchsorted(self.times_s[1:-1], inside, side='right')
        state = self._evaluate(piece, inside - self.times_s[piece])
        stands = (time_s < self.times_s[0]) | (time_s >= self.times_s[-1])
        if not stands.any():
            return state
        moving = np.where(stands, 0.0, 1.0)[..., None]
        # Exactly the last knot, not what a polynomial rounds it to: it may be a limit.
        ended = (time_s >= self.times_s[-1])[..., None]
        positions = np.where(ended, self.knots.positions[-1], state.positions)
        return Sample(positions, state.velocities * moving, state.accelerations * moving)

    def _evaluate(self, piece: np.ndarray, since_s: np.ndarray) -> Sample:
        weights = _FACTORS * np.asarray(since_s)[..., None, None] ** _POWERS
        state = weights @ self._pieces[piece]
        return Sample(state[..., 0, :], state[..., 1, :], state[..., 2, :])

    def dense(self) -> Sample:
        """Sample every piece at both ends and between; each field is (K - 1, 33, n)."""
        span = self._spans[:, None, None]
        whole = self._pieces * span ** _POWERS[0][:, None]
        return Sample(_DENSE[0] @ whole, _DENSE[1] @ whole / span, _DENSE[2] @ whole / span ** 2)


def _pieces(knots: Knots, span: np.ndarray) -> np.ndarray:
    """Fit the pieces to their ends; (K - 1, 6, n), power by power."""
    position = np.asarray(knots.positions, dtype=float)
    pieces = np.zeros((len(span), 6, position.shape[1]))
    pieces[:, 0] = position[:-1]
    step = np.diff(position, axis=0)
    if knots.velocities is None:
        pieces[:, 1] = step / span
        return pieces
    velocity = np.asarray(knots.velocities, dtype=float)
    v0, v1 = velocity[:-1], velocity[1:]
    pieces[:, 1] = v0
    if knots.accelerations is None:
        pieces[:, 2] = (3.0 * step / span - 2.0 * v0 - v1) / span
        pieces[:, 3] = (v0 + v1 - 2.0 * step / span) / span**2
        return pieces
    acceleration = np.asarray(knots.accelerations, dtype=float)
    a0, a1 = acceleration[:-1], acceleration[1:]
    rest = step - span * (v0 + 0.5 * span * a0)
    slope = (v1 - v0 - span * a0) * span
    bend = (a1 - a0) * span**2
    pieces[:, 2] = 0.5 * a0
    pieces[:, 3] = (10.0 * rest - 4.0 * slope + 0.5 * bend) / span**3
    pieces[:, 4] = (-15.0 * rest + 7.0 * slope - bend) / span**4
    pieces[:, 5] = (6.0 * rest - 3.0 * slope + 0.5 * bend) / span**5
    return pieces


def monotone_velocities(times_s: np.ndarray, positions: np.ndarray, first: np.ndarray,
                        last: np.ndarray) -> np.ndarray:
    """
    Choose velocities at knots so that cubic pieces never leave the range of their ends.

    Inside, the harmonic mean of the slopes on both sides, 0 where the direction turns
    (Fritsch and Butland, 1984, doi:10.1137/0905021). At the ends, what is given.

    Parameters
    ----------
    times_s : (K,) array
        Strictly increasing.
    positions : (K, n) array
        Knots.
    first, last : (n,) array
        Velocities at the ends.

    Returns
    -------
    (K, n) array
        Velocities.

    """
    spans = np.diff(times_s)[:, None]
    slopes = np.diff(positions, axis=0) / spans
    velocities = np.empty_like(positions)
    velocities[0], velocities[-1] = first, last
    before, after = slopes[:-1], slopes[1:]
    w1, w2 = 2.0 * spans[1:] + spans[:-1], spans[1:] + 2.0 * spans[:-1]
    same = before * after > 0.0
    weaker = np.abs(before) < np.abs(after)
    small, large = np.where(weaker, before, after), np.where(weaker, after, before)
    w_small, w_large = np.where(weaker, w1, w2), np.where(weaker, w2, w1)
    # Not the mean of inverse slopes: the inverse of a slope of almost nothing overflows.
    share = np.divide(small, large, out=np.zeros_like(small), where=same)
    velocities[1:-1] = np.where(same, small * (w1 + w2) / (w_small + w_large * share), 0.0)
    return velocities
