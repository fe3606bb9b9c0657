"""Single unit quaternions (x, y, z, w), as messages hold them; by plain floats, for speed."""

from __future__ import annotations

import math

import numpy as np


def quaternion_of(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """
    Give the unit quaternion of a rotation matrix.

    Divides by the largest of the four components, so every angle is safe (Shepperd,
    Journal of Guidance and Control 1, 1978).

    Parameters
    ----------
    rotation : (3, 3) array
        A rotation.

    Returns
    -------
    (float, float, float, float)
        x, y, z, w, with w at least 0 up to half a turn.

    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    trace = a + e + i
    largest = max(trace, a, e, i)
    if largest == trace:
        raw = h - f, c - g, d - b, 1.0 + trace
    elif largest == a:
        raw = 1.0 + a - e - i, b + d, c + g, h - f
    elif largest == e:
        raw = b + d, 1.0 + e - i - a, f + h, c - g
    else:
        raw = c + g, f + h, 1.0 + i - a - e, d - b
    scale = math.copysign(1.0 / math.hypot(*raw), raw[3])
    x, y, z, w = (scale * value for value in raw)
    return x, y, z, w


def rotation_of(x: float, y: float, z: float, w: float) -> np.ndarray:
    """
    Give the rotation matrix (3, 3) of a quaternion of any length but zero.

    Raises
    ------
    ValueError
        Where the quaternion has no direction.

    """
    square = x * x + y * y + z * z + w * w
    if not 0.0 < square < math.inf:
        raise ValueError(f'a quaternion needs a finite length above 0, got {x}, {y}, {z}, {w}')
    s = 2.0 / square
    return np.array([[1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
                     [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)],
                     [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)]])
