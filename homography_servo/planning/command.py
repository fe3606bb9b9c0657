"""What the servo tells the arm to do."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field

import numpy as np


@dataclass(frozen=True, eq=False)
class Command:
    """
    Points to pass and when, the last one at rest; no points mean: stop now.

    Parameters
    ----------
    points_rad, velocities_rad_s : (K, n) array
        Joints and their velocities at each point.
    times_s : (K,) array
        From now, strictly increasing.

    """

    points_rad: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    times_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    velocities_rad_s: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @staticmethod
    def to(joints_rad: np.ndarray, time_s: float) -> Command:
        """Go to joints and rest there."""
        points = np.array(joints_rad, dtype=float)[None]
        return Command(points, np.array([time_s]), np.zeros_like(points))

    @property
    def joints_rad(self) -> np.ndarray | None:
        """Where the arm comes to rest, None for a stop."""
        return self.points_rad[-1] if len(self.points_rad) else None

    @property
    def time_s(self) -> float:
        """When it rests there."""
        return float(self.times_s[-1]) if len(self.times_s) else 0.0
