"""
Find the face by its straight edges and the box behind it.

Views of the face that straight edges allow are ranked by the grey levels along their
sides and on the sides of the box behind; the best are fitted like in tracking and
weighed again.
"""

from __future__ import annotations

from homography_servo.result import Rejected
from homography_servo.tracking.detection.candidates import Effort
from homography_servo.tracking.detection.candidates import find_candidates
from homography_servo.tracking.detection.candidates import rough_views
from homography_servo.tracking.detection.outlook import smoothed
from homography_servo.tracking.detection.view_check import check_view
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.target import Found
from homography_servo.tracking.target import Target
import numpy as np

APART_ODDS = 0.4  # by which the logarithm must be better than that of the next best one
BELIEVED_ODDS = 3.0  # logarithm: 20 to 1 for the face
QUICK = Effort(20, 8, 4, 1.5, BELIEVED_ODDS)  # mostly suffices
THOROUGH = Effort(32, 14, 6, 1.5, BELIEVED_ODDS)
ELSEWHERE_PX = 10.0  # from the middle of the best one to that of another thing


class EdgeSearch:
    """
    Searches one picture.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.

    """

    def __init__(self, image: np.ndarray, target: Target, plane: Plane) -> None:
        self._target, self._plane = target, plane
        self._picture = smoothed(image)
        self._rough = rough_views(self._picture, target, plane)

    def best(self, effort: Effort) -> Found | Rejected:
        """Find the view of the face for which most speaks."""
        candidates = find_candidates(self._picture, self._rough, self._target, self._plane,
                                     effort)
        checked = [check_view(self._picture, corners, self._target, self._plane)
                   for corners in candidates.views.corners]
        return _best([found for found in checked if not isinstance(found, Rejected)], effort)


def _best(found: list[Found], effort: Effort) -> Found | Rejected:
    """Choose the one for which most speaks; nothing else may look like the face as well."""
    if not found:
        return Rejected('the edges do not support any view of the face')
    best = max(found, key=lambda one: one.merit)
    if best.merit < effort.least_odds:
        return Rejected('the best quadrilateral does not look like the face and its box')
    if any(one.merit > best.merit - APART_ODDS and _apart(one, best) > ELSEWHERE_PX
           for one in found):
        return Rejected('two quadrilaterals look like the face')
    return best


def _apart(one: Found, other: Found) -> float:
    """Give the distance of two middles [px]."""
    return float(np.linalg.norm((one.fit.corners - other.fit.corners).mean(axis=0)))
