"""
Fit a view of the face to the picture, and weigh what speaks for it.

The corners are fitted like in tracking, but held to what a rectangle of the known size
can look like, so that a side that is hidden follows from the others; narrow sides of
the box are taken into account. Then the picture is compared once more with the view
that came out, and it is tried whether the corners stay a view of the face when nothing
holds them: those of another thing hardly do.
"""

from __future__ import annotations

import math

from homography_servo.result import Rejected
from homography_servo.tracking.box import BoxSides
from homography_servo.tracking.box import RIGID_SIGMA_PX
from homography_servo.tracking.detection.box_fit import held_by_box
from homography_servo.tracking.detection.box_views import box_points
from homography_servo.tracking.detection.box_views import look_at
from homography_servo.tracking.detection.box_views import odds
from homography_servo.tracking.detection.outlook import Picture
from homography_servo.tracking.detection.side_fit import fit_with_sides
from homography_servo.tracking.detection.views import Views
from homography_servo.tracking.doubts import corner_sigma_px
from homography_servo.tracking.motion import both
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.snake import let_go
from homography_servo.tracking.target import Found
from homography_servo.tracking.target import Target
import numpy as np

GUESSED_SIGMA = 0.01  # of the corners about a view through a guessed lens, by the size
CLOSEST_PX = 2.5  # from an edge to the farthest change that supports it
HALF, STEPS = 5, 3
CLEAR_ODDS = 3.5  # logarithm from which on there is no need for another fit
FREE_PX = 1.0  # standard deviation of a corner that a side without an edge leaves free
LEAST_INLIERS = 0.5
# RMS of what a view misses of free corners: of the face, and how much more of other things.
OWN_MISS_PX, OTHER_MISS_PX = 0.1, 0.35
MOST_AGAINST = 3.0  # a miss that is no accident: something hides a part of a side


def check_view(picture: Picture, corners: np.ndarray, target: Target,
               plane: Plane) -> Found | Rejected:
    """
    Fit a candidate and weigh it.

    Parameters
    ----------
    picture : Picture
        What is seen.
    corners : (4, 2) array
        To within a pixel or so, in the plane; the first is the face's first, or third.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.

    Returns
    -------
    Found or Rejected
        Its merit is the logarithm of how much likelier it is the face than not.

    """
    found = _weighed(picture, corners, target, plane)
    if not isinstance(found, Rejected) and found.merit > CLEAR_ODDS \
            and corner_sigma_px(found.fit) < FREE_PX:
        return found
    points_m = box_points(target.face_size_m, target.box_height_m)
    told = None if target.guessed_lens else held_by_box(picture, corners, points_m, plane)
    held = Rejected('no box holds it') if told is None \
        else _weighed(picture, corners, target, plane, told)
    if isinstance(held, Rejected) or isinstance(found, Rejected):
        return held or found
    return held if held.merit > found.merit else found


def _weighed(picture: Picture, corners: np.ndarray, target: Target, plane: Plane,
             told: Prior | None = None) -> Found | Rejected:
    """Fit a candidate, held by what the edges of the box tell, and weigh it."""
    box = BoxSides(target.face_size_m, target.box_height_m, plane)
    fit = _held_fit(picture.grey, corners, box, target, plane, told)
    if isinstance(fit, Rejected):
        return fit
    quality = fit.judged
    if quality.inlier_share < LEAST_INLIERS or not quality.enough_sides:
        return Rejected('the edges do not support the quadrilateral')
    outline = box.outline(fit.corners)
    if isinstance(outline, Rejected):
        return outline
    view = Views(fit.corners[None], outline.pose.rotation[None],
                 outline.pose.translation[None], np.zeros(1))
    seen = look_at(picture, view, box_points(target.face_size_m, target.box_height_m), plane)
    return Found(fit, float(odds(seen, CLOSEST_PX)[0])
                 + _shape_odds(fit, box, target, plane))


def _held_fit(image: np.ndarray, corners: np.ndarray, box: BoxSides, target: Target,
              plane: Plane, told: Prior | None) -> SnakeFit | Rejected:
    """Fit a view of the face, and again with the sides of the box."""
    def held(rigid: Prior) -> Prior:
        softer = _softer(rigid, target)
        return softer if told is None else both(softer, told)

    outline = box.outline(corners)
    if isinstance(outline, Rejected):
        return outline
    look = _look(target)
    fit = fit_snake(image, corners, look, plane, held(outline.rigid), target.polarity)
    if isinstance(fit, Rejected):
        return fit
    return fit_with_sides(image, fit, box, look, target, plane, held)


def _look(target: Target) -> Look:
    return Look(target.blur_px, HALF, iterations=STEPS)


def _softer(rigid: Prior, target: Target) -> Prior:
    """Hold corners to a view of the face as firmly as the lens is known."""
    if not target.guessed_lens:
        return rigid
    softer = RIGID_SIGMA_PX / (GUESSED_SIGMA * _size_px(rigid.corners))
    return rigid._replace(information=rigid.information * softer ** 2)


def _size_px(corners: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(corners, axis=0)))


def _shape_odds(fit: SnakeFit, box: BoxSides, target: Target, plane: Plane) -> float:
    """
    Let the corners go, and tell how much speaks for the face in where they stay.

    Their miss of the nearest view has two degrees of freedom of eight: it is compared
    with what noise and lens allow, and with that of other quadrilaterals of about these
    proportions.
    """
    free = let_go(fit, _look(target), target.polarity)
    if isinstance(free, Rejected):
        return 0.0
    outline = box.outline(free.corners)
    if isinstance(outline, Rejected):
        return -MOST_AGAINST
    square = float(plane.rms_px(outline.pose.miss)) ** 2
    own = OWN_MISS_PX ** 2 + float(np.trace(free.covariance)) / 32.0
    if target.guessed_lens:
        own += (GUESSED_SIGMA * _size_px(fit.corners)) ** 2
    other = own + OTHER_MISS_PX ** 2
    told = math.log(other / own) - 0.5 * square * (1.0 / own - 1.0 / other)
    return max(told, -MOST_AGAINST)
