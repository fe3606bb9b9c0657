"""Where the arm is now, from positions that a device told a moment ago."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from homography_servo.robot.trajectory import State
import numpy as np

WINDOW = 4  # samples for the velocity; more is smoother and later
LONGEST_AHEAD_S = 0.1
LONGEST_GAP_S = 1.0  # between samples of one motion


class _Sample(NamedTuple):
    time_s: float
    joints_rad: np.ndarray


class ArmEstimate:
    """
    Commanded, interpolated position between two answers of the device.

    Two equal samples in a row mean that the arm stands.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque(maxlen=WINDOW)

    def clear(self) -> None:
        """Forget everything: the link is gone."""
        self._samples.clear()

    def add(self, time_s: float, joints_rad: np.ndarray) -> None:
        """Take a position and when it held."""
        if self._samples and time_s - self._samples[-1].time_s > LONGEST_GAP_S:
            self._samples.clear()
        if not self._samples or time_s > self._samples[-1].time_s:
            self._samples.append(_Sample(time_s, joints_rad))

    @property
    def known(self) -> bool:
        """Tell whether a position has been heard."""
        return bool(self._samples)

    @property
    def last(self) -> np.ndarray:
        """Position (n,) heard last; ValueError when nothing is known."""
        return self._newest().joints_rad

    def at(self, now_s: float) -> State:
        """Give position and velocity now; ValueError when nothing is known."""
        last = self._newest()
        velocity = self._velocity()
        ahead_s = min(max(now_s - last.time_s, 0.0), LONGEST_AHEAD_S)
        return State(last.joints_rad + ahead_s * velocity, velocity)

    def age_s(self, now_s: float) -> float:
        """Give the time since the last position."""
        return now_s - self._samples[-1].time_s if self._samples else float('inf')

    def _newest(self) -> _Sample:
        if not self._samples:
            raise ValueError('no position has been heard yet')
        return self._samples[-1]

    def _velocity(self) -> np.ndarray:
        last = self._samples[-1]
        moving = np.zeros_like(last.joints_rad)
        if len(self._samples) < 2:
            return moving
        previous = self._samples[-2]
        step = last.joints_rad - previous.joints_rad
        if not step.any():
            return moving
        first = self._samples[0]
        slope = (last.joints_rad - first.joints_rad) / (last.time_s - first.time_s)
        return np.where(step == 0.0, 0.0, slope)
