"""
List the views of the face that a picture may show, best first.

Straight edges are put together to quadrilaterals, these become views of a rectangle of
the known size, and the grey levels along their sides and on the sides of the box tell
how well they fit. All of it runs over all of them at once.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
from homography_servo.tracking.box_views import box_points
from homography_servo.tracking.box_views import face_merit
from homography_servo.tracking.box_views import look_at
from homography_servo.tracking.box_views import nearer
from homography_servo.tracking.box_views import odds
from homography_servo.tracking.examine import Target
from homography_servo.tracking.outlook import look_across
from homography_servo.tracking.outlook import rows_across
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.quads import find_quads
from homography_servo.tracking.segments import find_pieces
from homography_servo.tracking.segments import shrunk
from homography_servo.tracking.segments import straightened
from homography_servo.tracking.sides import join_pieces
from homography_servo.tracking.views import Views
from homography_servo.tracking.views import views_of_face
from homography_servo.tracking.views import with_mirrored
import numpy as np
from scipy.special import expit

LEAST_IMAGE_PX = 16
STEEPEST = 0.35  # cosine of the largest tilt
ROUGH_MISS_PX, ROUGH_MISS = 3.0, 0.03  # of rough corners from a view, and by its size
ROUGH_SHARES, ROUGH_PX, ROUGH_READ = np.linspace(0.12, 0.88, 4), 9.0, 7
MOST = (32, 14, 6)  # views that are moved closer, in turn
CLOSE_PX, CLOSEST_PX = 4.0, 2.5  # from an edge to the farthest change that supports it
ROUGH_SAME_PX, SAME_PX = 7.0, 4.0
NOISE_ROWS, DIFFERENCE_MEDIAN = 16, 0.954  # median difference of two pixels over the noise
SMOOTHED, STRONGLY_SMOOTHED = (3, 0.375), (5, 0.273)  # kernel; share of the noise it leaves
NOISY_GREY = 5.0
NOISE_SIGMAS, LEAST_GREY = 5.0, 5.0  # differences that are none of the noise's, nor the light's


class Candidates(NamedTuple):
    """Views that may be the face, best first."""

    views: Views
    odds: np.ndarray  # (n,) logarithm of how much likelier each is the face than not


def find_candidates(image: np.ndarray, target: Target, plane: Plane) -> Candidates:
    """
    List what may be the face.

    Parameters
    ----------
    image : (H, W) uint8 array
        Grey image.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.

    Returns
    -------
    Candidates

    """
    if min(image.shape) < LEAST_IMAGE_PX:
        return Candidates(views_of_face(np.zeros((0, 4, 2)), target.face_size_m, plane),
                          np.zeros(0))
    smooth, other_grey = _smoothed(image)
    points_m = box_points(target.face_size_m, target.box_height_m)
    views = _rough_views(image, target, plane)
    rough = look_across(smooth, rows_across(views.corners, ROUGH_SHARES), plane, ROUGH_PX,
                        -ROUGH_PX, ROUGH_READ, other_grey)
    views = views.chosen(_distinct(views, face_merit(rough, ROUGH_PX), MOST[0], ROUGH_SAME_PX))
    seen = look_at(smooth, views, points_m[:4], plane, other_grey, ROUGH_PX)
    views = nearer(views, seen, points_m[:4], plane)
    seen = look_at(smooth, views, points_m[:4], plane, other_grey)
    chosen = _distinct(views, face_merit(seen.face, CLOSE_PX), MOST[1])
    views = with_mirrored(views.chosen(chosen))
    views = nearer(views, look_at(smooth, views, points_m, plane, other_grey), points_m, plane)
    seen = look_at(smooth, views, points_m, plane, other_grey)
    chosen = _distinct(views, expit(odds(seen, CLOSE_PX)), MOST[2])
    views, seen = views.chosen(chosen), seen.chosen(chosen)
    views = nearer(views, seen, points_m, plane)
    told = odds(look_at(smooth, views, points_m, plane, other_grey), CLOSEST_PX)
    told = np.where(in_reach(views, target), told, -np.inf)
    best = _distinct(views, expit(told), MOST[2])
    return Candidates(views.chosen(best), told[best])


def _smoothed(image: np.ndarray) -> tuple[np.ndarray, float]:
    """Smooth a picture, and tell by how much its pixels differ that noise cannot explain."""
    part = image[::NOISE_ROWS].astype(np.int16)
    noise = float(np.median(np.abs(part[:, 1:] - part[:, :-1]))) / DIFFERENCE_MEDIAN
    size, left = STRONGLY_SMOOTHED if noise > NOISY_GREY else SMOOTHED
    return (cv2.GaussianBlur(image, (size, size), 0),
            max(NOISE_SIGMAS * left * noise, LEAST_GREY))


def _rough_views(image: np.ndarray, target: Target, plane: Plane) -> Views:
    """Give the views of the face that straight edges allow."""
    pieces = straightened(find_pieces(shrunk(image), target.polarity), plane)
    quads = find_quads(join_pieces(pieces), target.face_size_m, plane)
    views = views_of_face(quads, target.face_size_m, plane)
    size = np.linalg.norm(np.ptp(views.corners, axis=1), axis=1)
    return views.chosen((views.miss_px < ROUGH_MISS_PX + ROUGH_MISS * size)
                        & in_reach(views, target))


def in_reach(views: Views, target: Target) -> np.ndarray:
    """Tell which views are where the face can be (n,)."""
    depth = views.translation[:, 2]
    return (depth > target.nearest_m) & (depth < target.farthest_m) & (views.facing > STEEPEST)


def _distinct(views: Views, merit: np.ndarray, most: int,
              same_px: float = SAME_PX) -> np.ndarray:
    """Choose the best ones with some merit, the first of those that are alike."""
    order = np.argsort(-merit, kind='stable')
    order = order[merit[order] > 0.0][:4 * most]
    low, high = views.corners[order].min(axis=1), views.corners[order].max(axis=1)
    marks = np.concatenate([low, high], axis=1)
    alike = (np.abs(marks[:, None] - marks) < same_px).all(axis=2)
    kept: list[int] = []
    free = np.ones(len(order), bool)
    for index in range(len(order)):
        if free[index]:
            kept.append(index)
            free &= ~alike[index]
        if len(kept) == most:
            break
    return order[kept]
