"""
Lens distortion as sensor_msgs/CameraInfo names it, with derivatives.

Every model is a function ``model(rays, k) -> (distorted, jacobian)`` on ideal
normalised image coordinates (..., 2); the Jacobian is (..., 2, 2). One Newton
iteration, `undistort`, inverts them all. For plumb_bob see Brown, Decentering
Distortion of Lenses (1966); for equidistant Kannala and Brandt, IEEE TPAMI 28(8),
2006, DOI 10.1109/TPAMI.2006.153.
"""

from __future__ import annotations

import math
from typing import Callable
from typing import NamedTuple

import numpy as np

_NEWTON_STEPS = 30
_TOLERANCE = 1e-7  # of a step, in normalised image units; the error after it is its square
_WIDEST = 10.0  # rays further out (84 deg off the axis) are not looked at


class Model(NamedTuple):
    """A distortion model and how many coefficients it takes."""

    lengths: tuple[int, ...]
    distort: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def _plumb_bob(rays: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, p1, p2, k3 = (*k.tolist(), 0.0)[:5]
    square = rays * rays
    s = square[..., 0] + square[..., 1]
    gain = 1.0 + s * (k1 + s * (k2 + s * k3))
    slope = k1 + s * (2.0 * k2 + s * (3.0 * k3))
    return _bent(rays, square, s, gain, slope, p1, p2)


def _rational_polynomial(rays: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, p1, p2, k3, k4, k5, k6 = k.tolist()
    square = rays * rays
    s = square[..., 0] + square[..., 1]
    above, below = 1 + s * (k1 + s * (k2 + s * k3)), 1 + s * (k4 + s * (k5 + s * k6))
    gain = above / below
    slope = (k1 + s * (2 * k2 + 3 * s * k3) - gain * (k4 + s * (2 * k5 + 3 * s * k6))) / below
    return _bent(rays, square, s, gain, slope, p1, p2)


def _bent(rays: np.ndarray, square: np.ndarray, s: np.ndarray, gain: np.ndarray,
          slope: np.ndarray, p1: float, p2: float) -> tuple[np.ndarray, np.ndarray]:
    """Apply a radial gain, whose derivative by the squared radius s is slope, and decentring."""
    x, y = rays[..., 0], rays[..., 1]
    cross = x * y
    distorted = np.empty_like(rays)
    distorted[..., 0] = x * gain + 2 * p1 * cross + p2 * (s + 2 * square[..., 0])
    distorted[..., 1] = y * gain + p1 * (s + 2 * square[..., 1]) + 2 * p2 * cross
    jacobian = np.empty((*rays.shape, 2))
    jacobian[..., 0, 1] = jacobian[..., 1, 0] = 2 * (cross * slope + p1 * x + p2 * y)
    jacobian[..., 0, 0] = gain + 2 * (square[..., 0] * slope + p1 * y + 3 * p2 * x)
    jacobian[..., 1, 1] = gain + 2 * (square[..., 1] * slope + 3 * p1 * y + p2 * x)
    return distorted, jacobian


def _equidistant(rays: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k1, k2, k3, k4 = k
    radius = np.hypot(rays[..., 0], rays[..., 1])
    theta = np.arctan(radius)
    s = theta * theta
    bent = theta * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    bent_slope = 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))
    tiny = radius < 1e-8
    safe = np.where(tiny, 1.0, radius)
    gain = np.where(tiny, 1.0, bent / safe)
    slope = np.where(tiny, 0.0, (bent_slope / (1 + radius * radius) - gain) / safe**2)
    outer = rays[..., :, None] * rays[..., None, :]
    jacobian = gain[..., None, None] * np.eye(2) + slope[..., None, None] * outer
    return rays * gain[..., None], jacobian


MODELS: dict[str, Model] = {
    'plumb_bob': Model((0, 4, 5), _plumb_bob),
    'rational_polynomial': Model((0, 8), _rational_polynomial),
    'equidistant': Model((4,), _equidistant),
}


def undistort(model: Model, distorted: np.ndarray, k: np.ndarray) -> np.ndarray:
    """
    Find the ideal rays that a lens bends onto given ones.

    Parameters
    ----------
    model : Model
        An entry of `MODELS`.
    distorted : (..., 2) array
        Distorted normalised coordinates.
    k : (K,) array
        The coefficients.

    Returns
    -------
    (..., 2) array
        Ideal normalised coordinates; ``inf`` where the lens has no such ray.

    """
    rays = _first_guess(model, distorted)
    with np.errstate(all='ignore'):
        for _ in range(_NEWTON_STEPS):
            bent, jacobian = model.distort(rays, k)
            step = _solve_2x2(jacobian, distorted - bent)
            rays = rays + step
            if not np.any(np.abs(step) > _TOLERANCE):
                break
        arrived = (np.abs(step) <= _TOLERANCE).all(axis=-1, keepdims=True)
    return np.where(arrived, rays, np.inf)


def reach(model: Model, k: np.ndarray) -> float:
    """
    Find how far from the axis a lens model holds.

    Beyond some radius the polynomials fold back into the image: there they describe no
    lens, and a point far outside the view would seem to be inside.

    Parameters
    ----------
    model : Model
        An entry of `MODELS`.
    k : (K,) array
        The coefficients.

    Returns
    -------
    float
        Largest radius of ideal rays; ``inf`` if there is no fold.

    """
    radius = np.linspace(0.0, _WIDEST, 4001)
    with np.errstate(all='ignore'):
        bent, jacobian = model.distort(np.column_stack([radius, np.zeros_like(radius)]), k)
        rising = (jacobian[1:, 0, 0] > 0.0) & (np.diff(bent[:, 0]) > 0.0)
    return math.inf if rising.all() else float(radius[np.argmin(rising)])


def _first_guess(model: Model, distorted: np.ndarray) -> np.ndarray:
    if model.distort is not _equidistant:
        return distorted
    angle = np.hypot(distorted[..., 0], distorted[..., 1])[..., None]
    safe = np.clip(angle, 1e-9, 1.5)
    return distorted * np.where(angle < 1e-9, 1.0, np.tan(safe) / np.maximum(angle, 1e-9))


def _solve_2x2(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    a, b, c, d = (matrix[..., i, j] for i in (0, 1) for j in (0, 1))
    x, y, scale = right[..., 0], right[..., 1], 1.0 / (a * d - b * c)
    solution = np.empty_like(right)
    solution[..., 0] = (d * x - b * y) * scale
    solution[..., 1] = (a * y - c * x) * scale
    return solution
