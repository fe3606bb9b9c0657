"""
Servo a body that flies freely: displacements are carried out as commanded.

There are no joints that could tell the two mirror poses of a plane apart, but there
is the motion that was commanded: only the true one of two hypotheses keeps agreeing
with what is seen when the body has turned by a known displacement. So two filters
run side by side from the two minima of the first look, and the one with the larger
likelihood over all looks leads.
"""

from __future__ import annotations

from typing import Callable

from homography_servo.geometry.rigid import inverse
from homography_servo.planning.arm_model import FreeBody
from homography_servo.planning.control import displacement
from homography_servo.planning.look_filter import Look
from homography_servo.planning.look_filter import LookFilter
import numpy as np

CAUTION = 4.0  # the covariance at a minimum tells too little about a bent valley
OFF_PATH_M, OFF_PATH_RAD = 0.05, 0.25

# A new path from a pose to the goal, (N, 4, 4).
Replan = Callable[[np.ndarray], np.ndarray]


class MirrorFilters:
    """Two hypotheses about where a plane is, each averaging all looks; the likelier leads."""

    def __init__(self, points_m: np.ndarray, home_depth_m: float, drift: float = 0.002) -> None:
        self._make = lambda: LookFilter(FreeBody(), points_m, home_depth_m, drift=drift)
        self._filters: list[LookFilter] = []

    @property
    def leader(self) -> LookFilter:
        """Give the likelier filter."""
        return min(self._filters, key=lambda item: item.misfit)

    def begin(self, poses: np.ndarray, covariances: np.ndarray, setpoint: np.ndarray) -> None:
        """Start from the minima (K, 4, 4) of the first look and their covariances."""
        self._filters = [self._make() for _ in poses]
        for item, pose, covariance in zip(self._filters, poses, covariances):
            item.begin(FreeBody(pose @ inverse(setpoint)), setpoint, CAUTION * covariance)

    def update(self, look: Look, setpoint: np.ndarray) -> None:
        """Take in one look."""
        for item in self._filters:
            item.update(look, setpoint)


class FreeServo:
    """
    Look, then move to the next pose of the path; at the goal keep correcting.

    Parameters
    ----------
    filters : MirrorFilters
        Already begun.
    path : (N, 4, 4) array
        From the pose that the leader believes, to the goal.
    replan : callable
        Gives a new path when the leader turns out to be far from this one.

    """

    def __init__(self, filters: MirrorFilters, path: np.ndarray, replan: Replan) -> None:
        self._filters, self._path, self._replan = filters, path, replan
        self._index = 0

    @property
    def at_goal(self) -> bool:
        """Tell whether the last pose is what is aimed at."""
        return self._index == len(self._path) - 1

    def step(self, look: Look, setpoint: np.ndarray) -> np.ndarray:
        """Take in a look at a setpoint (4, 4) and give the next one."""
        self._filters.update(look, setpoint)
        leader = self._filters.leader
        away = displacement(leader.pose(setpoint), self._path[self._index])
        if np.linalg.norm(away[:3]) > OFF_PATH_M or np.linalg.norm(away[3:]) > OFF_PATH_RAD:
            self._path, self._index = self._replan(leader.pose(setpoint)), 0
        self._index = min(self._index + 1, len(self._path) - 1)
        return inverse(leader.model.left) @ self._path[self._index]
