"""Fit a face that was found with the sides of the box, whose slivers shift its edges."""

from __future__ import annotations

from typing import Callable

from homography_servo.result import Rejected
from homography_servo.tracking.box import BoxSides
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.target import Target
import numpy as np

ROUNDS = 2  # the levels of the sides and the corners depend on each other
STEADY_PX = 0.03  # a round that moves them by less is the last: the next hardly does


def fit_with_sides(image: np.ndarray, fit: SnakeFit, box: BoxSides, look: Look, target: Target,
                   plane: Plane, held: Callable[[Prior], Prior | None]) -> SnakeFit:
    """
    Fit again with the sides of the box as far as they are known.

    Parameters
    ----------
    image : (H, W) uint8 array
        Grey image.
    fit : SnakeFit
        Without the sides; the first corner is the face's first, or third.
    box : BoxSides
        Learns the grey levels of its sides.
    look : Look
        How to look for the edges.
    target : Target
        What is looked for.
    plane : Plane
        With a camera.
    held : function
        Says what holds the corners, given that they are a view of the face.

    Returns
    -------
    SnakeFit
        The last one that the edges support.

    """
    for _ in range(ROUNDS if target.box_height_m > 0.0 else 0):
        box.learn(fit.edges, fit.weight, fit.strips, look.half)
        strips, rigid = box.strips(fit.corners)
        if rigid is None:
            break
        again = fit_snake(image, fit.corners, look, plane, held(rigid), target.polarity, strips)
        if isinstance(again, Rejected):
            break
        before, fit = fit, again
        if float(np.abs(fit.corners - before.corners).max()) < STEADY_PX:
            break
    return fit
