"""
Find the face in a picture without being told where it is.

Views of the face that straight edges allow are ranked by the grey levels along their
sides and on the sides of the box behind; the best are fitted like in tracking and
ranked again.

A rectangle looks the same after half a turn. Which corner comes first is decided by
the expected corners where they are given, else by taking the turn whose top side
points most to the right (gamma closest to 0).
"""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
from homography_servo.result import Rejected
from homography_servo.tracking.candidates import find_candidates
from homography_servo.tracking.examine import examine
from homography_servo.tracking.examine import Found
from homography_servo.tracking.examine import Target
from homography_servo.tracking.plane import Plane
import numpy as np

LENS_GUESS = 1.2  # focal length over image width of a camera nobody calibrated
SLACK = 1.5  # for distances measured with it
# Logarithms of odds: that are enough; by which others are lower that need not be fitted;
# by which the best one must be better than the next.
LEAST_ODDS, CLEAR_ODDS, APART_ODDS = 0.35, 1.5, 0.4
ELSEWHERE_PX = 10.0  # from the middle of the best one to that of another thing


def find_face(image: np.ndarray, target: Target, plane: Plane,
              expected: np.ndarray | None = None) -> Found | Rejected:
    """
    Find the quadrilateral that looks most like the face.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    target : Target
        The face and where it may be.
    plane : Plane
        Its camera makes the checks sharp; without one a typical lens is assumed.
    expected : (4, 2) array or None
        Corners in the plane; decides the order of the corners.

    Returns
    -------
    Found or Rejected

    """
    if plane.camera is None:
        plane = _typical_plane(image.shape)
        target = target._replace(nearest_m=target.nearest_m / SLACK,
                                 farthest_m=target.farthest_m * SLACK, guessed_lens=True)
    views, odds = find_candidates(image, target, plane)
    found: list[Found] = []
    reason = 'no quadrilateral in the image can be the face'
    for corners, told in zip(views.corners, odds.tolist()):
        if found and found[0].odds > told + CLEAR_ODDS:
            break
        one = examine(image, corners, told, target, plane, expected)
        if isinstance(one, Rejected):
            reason = one.reason
        else:
            found = sorted([*found, one], key=lambda item: -item.odds)
    if not found:
        return Rejected(reason)
    if found[0].odds < LEAST_ODDS:
        return Rejected('the best quadrilateral does not look like the face and its box')
    if any(one.odds > found[0].odds - APART_ODDS and _apart(one, found[0]) > ELSEWHERE_PX
           for one in found[1:]):
        return Rejected('two quadrilaterals look like the face')
    return found[0]


def _apart(one: Found, other: Found) -> float:
    """Give the distance of two middles [px]."""
    return float(np.linalg.norm((one.fit.corners - other.fit.corners).mean(axis=0)))


def _typical_plane(shape: tuple[int, ...]) -> Plane:
    height, width = shape
    focal = LENS_GUESS * max(width, height)
    return Plane(Camera(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height))
