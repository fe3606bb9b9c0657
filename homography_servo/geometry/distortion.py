"""
Lens distortion as sensor_msgs/CameraInfo names it, with derivatives.

Every model is a function ``model(x, y, k) -> (u, v), (u_x, u_y, v_y)`` of ideal normalised
image coordinates, plain floats or arrays alike. No lens here turns a picture about a point,
so that v_x = u_y. One Newton iteration, `undistort`, inverts them all. For plumb_bob see
Brown, Decentering Distortion of Lenses (1966); for equidistant Kannala and Brandt, IEEE
TPAMI 28(8), 2006, DOI 10.1109/TPAMI.2006.153.
"""

from __future__ import annotations

import math
from typing import Any
from typing import Callable
from typing import NamedTuple
from typing import Sequence
from typing import TypeVar

import numpy as np

_NEWTON_STEPS = 30
_TOLERANCE = 1e-7  # of a step, in normalised image units; the error after it is its square
_TINY = 1e-30  # of a squared radius: the axis itself has no direction
_WIDEST = 10.0  # rays further out (84 deg off the axis) are not looked at


Number = TypeVar('Number', float, np.ndarray)
Coordinates = tuple[Number, Number]
Slopes = tuple[Number, Number, Number]


class Model(NamedTuple):
    """A distortion model and how many coefficients it takes."""

    lengths: tuple[int, ...]
    distort: Callable[..., Any]


def _plumb_bob(x: Number, y: Number, k: Sequence[float]) -> tuple[Coordinates, Slopes]:
    k1, k2, p1, p2, k3 = (*k, 0.0)[:5]
    s = x * x + y * y
    gain = 1.0 + s * (k1 + s * (k2 + s * k3))
    slope = k1 + s * (2.0 * k2 + s * (3.0 * k3))
    return _bent(x, y, s, gain, slope, p1, p2)


def _rational_polynomial(x: Number, y: Number,
                         k: Sequence[float]) -> tuple[Coordinates, Slopes]:
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    s = x * x + y * y
    above, below = 1.0 + s * (k1 + s * (k2 + s * k3)), 1.0 + s * (k4 + s * (k5 + s * k6))
    gain = above / below
    slope = (k1 + s * (2.0 * k2 + 3.0 * s * k3)
             - gain * (k4 + s * (2.0 * k5 + 3.0 * s * k6))) / below
    return _bent(x, y, s, gain, slope, p1, p2)


def _bent(x: Number, y: Number, s: Number, gain: Number, slope: Number, p1: float,
          p2: float) -> tuple[Coordinates, Slopes]:
    """Apply a radial gain, whose derivative by the squared radius s is slope, and decentring."""
    xx, xy, yy = x * x, x * y, y * y
    return ((x * gain + 2.0 * p1 * xy + p2 * (s + 2.0 * xx),
             y * gain + p1 * (s + 2.0 * yy) + 2.0 * p2 * xy),
            (gain + 2.0 * (xx * slope + p1 * y + 3.0 * p2 * x),
             2.0 * (xy * slope + p1 * x + p2 * y),
             gain + 2.0 * (yy * slope + 3.0 * p1 * y + p2 * x)))


def _equidistant(x: Number, y: Number, k: Sequence[float]) -> tuple[Coordinates, Slopes]:
    k1, k2, k3, k4 = k
    square = x * x + y * y + _TINY
    radius = square ** 0.5
    theta = np.arctan(radius)
    s = theta * theta
    gain = theta * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))) / radius
    bent_slope = 1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
    slope = (bent_slope / (1.0 + square) - gain) / square
    return (x * gain, y * gain), (gain + slope * x * x, slope * x * y, gain + slope * y * y)


MODELS: dict[str, Model] = {
    'plumb_bob': Model((0, 4, 5), _plumb_bob),
    'rational_polynomial': Model((0, 8), _rational_polynomial),
    'equidistant': Model((4,), _equidistant),
}


def undistort(model: Model, distorted: np.ndarray, k: Sequence[float]) -> np.ndarray:
    """
    Find the ideal rays that a lens bends onto given ones.

    Parameters
    ----------
    model : Model
        An entry of `MODELS`.
    distorted : (..., 2) array
        Distorted normalised coordinates.
    k : (K,) sequence
        The coefficients.

    Returns
    -------
    (..., 2) array
        Ideal normalised coordinates; ``inf`` where the lens has no such ray.

    """
    (u, v), (x, y) = np.moveaxis(distorted, -1, 0), np.moveaxis(
        _first_guess(model, distorted), -1, 0)
    with np.errstate(all='ignore'):
        for _ in range(_NEWTON_STEPS):
            (bent_u, bent_v), (u_x, u_y, v_y) = model.distort(x, y, k)
            miss_u, miss_v, scale = u - bent_u, v - bent_v, 1.0 / (u_x * v_y - u_y * u_y)
            step = np.array([(v_y * miss_u - u_y * miss_v) * scale,
                             (u_x * miss_v - u_y * miss_u) * scale])
            x, y = x + step[0], y + step[1]
            if not np.any(np.abs(step) > _TOLERANCE):
                break
        arrived = (np.abs(step) <= _TOLERANCE).all(axis=0)
    return np.stack([np.where(arrived, x, np.inf), np.where(arrived, y, np.inf)], axis=-1)


def reach(model: Model, k: Sequence[float]) -> float:
    """
    Find how far from the axis a lens model holds.

    Beyond some radius the polynomials fold back into the image: there they describe no
    lens, and a point far outside the view would seem to be inside.

    Parameters
    ----------
    model : Model
        An entry of `MODELS`.
    k : (K,) sequence
        The coefficients.

    Returns
    -------
    float
        Largest radius of ideal rays; ``inf`` if there is no fold.

    """
    radius = np.linspace(0.0, _WIDEST, 4001)
    with np.errstate(all='ignore'):
        (bent, _), (slope, _, _) = model.distort(radius, np.zeros_like(radius), k)
        rising = (slope[1:] > 0.0) & (np.diff(bent) > 0.0)
    return math.inf if rising.all() else float(radius[np.argmin(rising)])


def _first_guess(model: Model, distorted: np.ndarray) -> np.ndarray:
    if model.distort is not _equidistant:
        return distorted
    angle = np.hypot(distorted[..., 0], distorted[..., 1])[..., None]
    safe = np.clip(angle, 1e-9, 1.5)
    return distorted * np.where(angle < 1e-9, 1.0, np.tan(safe) / np.maximum(angle, 1e-9))
