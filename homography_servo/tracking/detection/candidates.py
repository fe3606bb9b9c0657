"""
List the views of the face that a picture may show, best first.

Straight edges are put together to quadrilaterals, these become views of a rectangle of
the known size, and the grey levels along their sides and on the sides of the box tell
how well they fit. All of it runs over all of them at once.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.detection.box_fit import nearer
from homography_servo.tracking.detection.box_views import box_points
from homography_servo.tracking.detection.box_views import face_merit
from homography_servo.tracking.detection.box_views import look_at
from homography_servo.tracking.detection.box_views import odds
from homography_servo.tracking.detection.box_views import only_face
from homography_servo.tracking.detection.outlook import look_across
from homography_servo.tracking.detection.outlook import Outlook
from homography_servo.tracking.detection.outlook import Picture
from homography_servo.tracking.detection.outlook import rows_across
from homography_servo.tracking.detection.segments import find_pieces
from homography_servo.tracking.detection.segments import NO_PIECES
from homography_servo.tracking.detection.segments import shrunk
from homography_servo.tracking.detection.segments import straightened
from homography_servo.tracking.detection.side_quads import find_quads
from homography_servo.tracking.detection.sides import join_pieces
from homography_servo.tracking.detection.sides import Sides
from homography_servo.tracking.detection.views import Views
from homography_servo.tracking.detection.views import views_of_face
from homography_servo.tracking.detection.views import with_mirrored
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.target import STEEPEST
from homography_servo.tracking.target import Target
import numpy as np
from scipy.special import expit

LEAST_IMAGE_PX = 16
ROUGH_MISS_PX, ROUGH_MISS = 3.0, 0.03  # of rough corners from a view, and by its size
ROUGH_SHARES, ROUGH_PX, ROUGH_READ = np.linspace(0.12, 0.88, 4), 9.0, 7
CLOSE_PX = 4.0  # from an edge to the farthest change that supports it
SAME_PX = 4.0


class Effort(NamedTuple):
    """How many views are looked at, at most, each time more closely."""

    sides: int
    rough: int
    near: int
    fitted: int
    clear_odds: float  # those whose logarithm is lower by this than the best are left out
    same_px: float  # of views whose outlines differ by less, at first, the best is enough


class Candidates(NamedTuple):
    """Views that may be the face, best first."""

    views: Views
    odds: np.ndarray  # (n,) logarithm of how much likelier each is the face than not


class RoughViews(NamedTuple):
    """Views of the face that straight edges allow."""

    views: Views
    seen: Outlook  # across their sides
    merit: np.ndarray  # (n,) how well the sides of the face show, 0 to 1


def find_sides(picture: Picture, target: Target, plane: Plane) -> Sides:
    """List straight edges that may be sides of the face, longest first."""
    if min(picture.grey.shape) < LEAST_IMAGE_PX:
        return join_pieces(NO_PIECES)
    pieces = find_pieces(shrunk(picture.grey), target.polarity, target.news)
    return join_pieces(straightened(pieces, plane))


def rough_views(picture: Picture, sides: Sides, target: Target, plane: Plane) -> RoughViews:
    """
    List views of the face by their sides alone.

    Parameters
    ----------
    picture : Picture
        Where to look.
    sides : Sides
        Of these.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.

    Returns
    -------
    RoughViews

    """
    quads = find_quads(sides, target.face_size_m, plane)
    views = views_of_face(quads, target.face_size_m, plane,
                          (target.nearest_m, target.farthest_m))
    views = views.chosen(roughly_fits(views) & in_reach(views, target))
    seen = look_across(picture, rows_across(views.corners, ROUGH_SHARES), plane, ROUGH_PX,
                       -ROUGH_PX, ROUGH_READ)
    return RoughViews(views, seen, face_merit(seen, ROUGH_PX))


def find_candidates(picture: Picture, rough: RoughViews, target: Target, plane: Plane,
                    effort: Effort) -> Candidates:
    """
    Move the best views closer, and rank them with the sides of the box.

    Parameters
    ----------
    picture : Picture
        Where to look.
    rough : RoughViews
        To begin with.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.
    effort : Effort
        How many to consider.

    Returns
    -------
    Candidates

    """
    points_m = box_points(target.face_size_m, target.box_height_m)
    chosen = _distinct(rough.views, rough.merit, effort.rough, effort.same_px)
    views = nearer(rough.views.chosen(chosen), only_face(rough.seen.chosen(chosen)), points_m[:4],
                   plane)
    face = look_at(picture, views, points_m[:4], plane).face
    chosen = _distinct(views, face_merit(face, CLOSE_PX), effort.near)
    views, face = with_mirrored(views.chosen(chosen)), face.chosen(np.tile(chosen, 2))
    views = nearer(views, look_at(picture, views, points_m, plane, face), points_m, plane)
    seen = look_at(picture, views, points_m, plane)
    told = np.where(in_reach(views, target), odds(seen, CLOSE_PX), -np.inf)
    best = _distinct(views, expit(told), effort.fitted)
    if len(best):
        best = best[told[best] >= told[best[0]] - effort.clear_odds]
    return Candidates(nearer(views.chosen(best), seen.chosen(best), points_m, plane), told[best])


def roughly_fits(views: Views) -> np.ndarray:
    """Tell which views miss rough corners by no more than is usual (n,)."""
    size_px = np.linalg.norm(np.ptp(views.corners, axis=1), axis=1)
    return views.miss_px < ROUGH_MISS_PX + ROUGH_MISS * size_px


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
