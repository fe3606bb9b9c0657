"""How a servo run went, and what a suite of runs says in one row."""

from __future__ import annotations

from typing import Any, NamedTuple, Sequence

from homography_servo.geometry.rigid import pose_difference
import numpy as np

CONVERGED_M, CONVERGED_RAD = 0.005, np.radians(3.0)
JUMP_RAD = 0.5
TINY_M, TINY_RAD = 0.01, 0.05


class Outcome(NamedTuple):
    """One run. What does not apply is False or nan."""

    converged: bool
    left_image: bool = False
    limit_broken: bool = False
    jumped: bool = False
    vetoed: bool = False
    confirmed: bool = False  # an independent search found no way either
    path_over_straight: float = np.nan
    rotation_over_minimum: float = np.nan
    iterations: float = np.nan
    error_m: float = np.nan
    error_rad: float = np.nan
    why: str = ''


def lengths(poses: np.ndarray) -> tuple[float, float]:
    """
    Compare a way (K, 4, 4) with the shortest one.

    Returns
    -------
    float, float
        Length of the origin's way over the straight line, rotation over its minimum;
        nan where start and end are too near each other to compare.

    """
    steps = pose_difference(poses[1:], poses[:-1])
    whole = pose_difference(poses[-1], poses[0])
    way_m, way_rad = (np.linalg.norm(steps[:, part], axis=1).sum()
                      for part in (slice(0, 3), slice(3, 6)))
    line_m, line_rad = np.linalg.norm(whole[:3]), np.linalg.norm(whole[3:])
    return (float(way_m / line_m) if line_m > TINY_M else np.nan,
            float(way_rad / line_rad) if line_rad > TINY_RAD else np.nan)


def error_of(pose: np.ndarray, goal: np.ndarray) -> tuple[float, float]:
    """Give distance [m] and angle [rad] to the goal."""
    error = pose_difference(pose, goal)
    return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))


def row(method: str, case: str, outcomes: Sequence[Outcome], robot: bool) -> dict[str, Any]:
    """Sum runs up as a row of the benchmark's table."""
    def share(name: str) -> float:
        return float(np.mean([getattr(outcome, name) for outcome in outcomes]))

    def median(name: str) -> float:
        values = [getattr(outcome, name) for outcome in outcomes if outcome.converged]
        values = [value for value in values if np.isfinite(value)]
        return float(np.median(values)) if values else float('nan')

    result = {'method': method, 'case': case, 'runs': len(outcomes),
              'converged_share': share('converged'), 'left_image_share': share('left_image')}
    if robot:
        result.update(limit_broken_share=share('limit_broken'), jumped_share=share('jumped'))
    if method == 'homography_servo':
        vetoed = [outcome for outcome in outcomes if outcome.vetoed]
        result.update(
            vetoed_share=share('vetoed'), vetoed_confirmed=sum(o.confirmed for o in vetoed),
            vetoed_not_confirmed=sum(not o.confirmed for o in vetoed),
            failed=sum(not (o.converged or o.vetoed) for o in outcomes))
    result.update(
        path_over_straight_median=median('path_over_straight'),
        rotation_over_minimum_median=median('rotation_over_minimum'),
        iterations_median=median('iterations'),
        error_mm_median=1e3 * median('error_m'),
        error_deg_median=float(np.degrees(median('error_rad'))))
    return result
