"""The last gate before the wire: whole targets, inside the limits, not too far apart."""

from __future__ import annotations

import numpy as np


class StepRoom:
    """
    How far each servo may go from one target to the next, by the times between them.

    A joint that makes less than one unit in the shortest of these times takes one when it
    has stood long enough for it: it would never move otherwise.

    Parameters
    ----------
    speed_units_s : (n,) array
        Largest speed of each servo.
    shortest_s : float
        Usual shortest time between two targets.
    now_s : float
        When the servos were last told something.

    """

    def __init__(self, speed_units_s: np.ndarray, shortest_s: float, now_s: float) -> None:
        self._speed = speed_units_s
        self._crawls = speed_units_s * shortest_s < 1.0
        self.start(now_s)

    def start(self, now_s: float) -> None:
        """Count from now."""
        self._last_s = float(now_s)
        self._changed_s = np.full(len(self._speed), float(now_s))

    def at(self, now_s: float) -> np.ndarray:
        """Give the largest steps (n,) from the last target to one that goes out now."""
        room = self._speed * max(now_s - self._last_s, 0.0)
        due = self._crawls & (self._speed * (now_s - self._changed_s) >= 1.0)
        return np.where(due, np.maximum(room, 1.0), room)

    def took(self, way: np.ndarray, now_s: float) -> None:
        """Take note of a target that went out, so many units (n,) from the last one."""
        self._last_s = float(now_s)
        self._changed_s[way != 0] = now_s


class Governor:
    """
    Let out only targets that the limits allow, whatever came before this point.

    Parameters
    ----------
    low, high : (n,) array of int
        Servo positions allowed.
    speed_units_s : (n,) array
        Largest distance of two targets per second between them.
    shortest_s : float
        Usual shortest time between two targets.

    """

    def __init__(self, low: np.ndarray, high: np.ndarray, speed_units_s: np.ndarray,
                 shortest_s: float) -> None:
        self._low = low
        self._high = high
        self._room = StepRoom(speed_units_s, shortest_s, 0.0)
        self._last: np.ndarray | None = None
        self.held_back = 0  # targets that had to be moved nearer
        self.refused = 0  # targets that must never have come here

    @property
    def last(self) -> np.ndarray | None:
        """Last target let out, or where the arm stood."""
        return self._last

    def start(self, units: np.ndarray, now_s: float) -> None:
        """Begin at where the arm stands."""
        self._last = np.array(units)
        self._room.start(now_s)

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
        room = self._room.at(now_s)
        share = float(np.min(np.where(way == 0, np.inf, room / np.maximum(np.abs(way), 1))))
        if share < 1.0:
            self.held_back += 1
            way = np.trunc(share * way).astype(int)
            if not way.any():
                return None
        self._room.took(way, now_s)
        self._last = self._last + way
        return self._last
