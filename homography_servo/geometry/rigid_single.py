"""
Exponential and logarithm of one motion in plain floats.

For a single matrix what numpy costs is the number of calls: some twenty, a microsecond
each. `rigid` uses these where there is no stack.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

HALF_TURN = -0.99  # cosine of the angle from which scipy finds the axis
SMALL_RAD = 0.1  # below it the series is more exact than the closed form


def exp_one(twist: list[float]) -> np.ndarray:
    """Do as `exp_twist` for a single one, where what costs is the number of calls."""
    vx, vy, vz, x, y, z = twist
    squared = x * x + y * y + z * z
    angle_rad = math.sqrt(squared)
    half_sinc = math.sin(0.5 * angle_rad) / (0.5 * angle_rad) if angle_rad > 1e-100 else 1.0
    b = 0.5 * half_sinc * half_sinc
    if angle_rad < SMALL_RAD:
        c = cubic_series(squared)
    else:
        c = (angle_rad - math.sin(angle_rad)) / (angle_rad * squared)
    a = 1.0 - squared * c
    # w x v, w (w . v), and with them exp(w) v = v + b (w x v) + c (w x (w x v)).
    along = x * vx + y * vy + z * vz
    shift = [v + b * cross + c * (w * along - squared * v) for v, w, cross in (
        (vx, x, y * vz - z * vy), (vy, y, z * vx - x * vz), (vz, z, x * vy - y * vx))]
    return np.array([
        [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y, shift[0]],
        [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x, shift[1]],
        [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y), shift[2]],
        [0.0, 0.0, 0.0, 1.0]])


def log_one(rows: list[list[float]]) -> np.ndarray | None:
    """Do as `rotation_log` for a single one; None near half a turn."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows
    x, y, z = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)
    cosine = 0.5 * (xx + yy + zz - 1.0)
    if cosine < HALF_TURN:
        return None
    sine = math.sqrt(x * x + y * y + z * z)
    gain = 1.0 if sine < 1e-12 else math.atan2(sine, cosine) / sine
    return np.array([gain * x, gain * y, gain * z])


def cubic_series(squared: Any) -> Any:
    """Evaluate (x - sin x) / x^3 near zero, given x^2: a number or an array."""
    return 1 / 6 - squared / 120 * (1 - squared / 42 * (1 - squared / 72))
