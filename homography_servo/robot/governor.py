"""The last gate before the wire: whole targets, inside the limits, not too far apart."""

from __future__ import annotations

import numpy as np


class Governor:
    """
    Let out only targets that the limits allow, whatever came before this point.

    Parameters
    ----------
    low, high : (n,) array of int
        Servo positions allowed.
    speed_units_s : (n,) array
        Largest distance of two targets per second between them.

    """

    def __init__(self, low: np.ndarray, high: np.ndarray, speed_units_s: np.ndarray) -> None:
        self._low = low
        self._high = high
        self._speed = speed_units_s
        self._last: np.ndarray | None = None
        self._last_s = 0.0
        self.held_back = 0  # targets that had to be moved nearer
        self.refused = 0  # targets that must never have come here

    @property
    def last(self) -> np.ndarray | None:
        """Last target let out, or where the arm stood."""
        return self._last

    def start(self, units: np.ndarray, now_s: float) -> None:
        """Begin at where the arm stands."""
        self._last = np.array(units)
        self._last_s = now_s

    def forget(self) -> None:
        """Forget the last target: something else has moved the arm."""
        self._last = None

    def whole(self, units: np.ndarray) -> np.ndarray | None:
        """Pass a target of a move whose speed the device limits; None when it is outside."""
        if np.any(units < self._low) or np.any(units > self._high):
            self.refused += 1
            return None
        return units

    def step(self, units: np.ndarray, now_s: float) -> np.ndarray | None:
        """
        Pass a target of a stream.

        All joints are held back by one factor where the step since the last target is
        longer than the limits allow. None when there is nothing to send: outside, or not
        different from the last target.
        """
        if self._last is None or self.whole(units) is None:
            return None
        way = units - self._last
        if not way.any():
            return None
        room = self._speed * max(now_s - self._last_s, 0.0)
        share = float(np.min(np.where(way == 0, np.inf, room / np.maximum(np.abs(way), 1))))
        if share < 1.0:
            self.held_back += 1
            way = np.trunc(share * way).astype(int)
            if not way.any():
                return None
        target = self._last + way
        self._last, self._last_s = target, now_s
        return target
