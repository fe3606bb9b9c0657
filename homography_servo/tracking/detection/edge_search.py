"""
Find the face by its straight edges and the box behind it.

Views of the face that straight edges allow are ranked by the grey levels along their
sides and on the sides of the box behind; the best are fitted like in tracking and
weighed again. What is not surely the face may be a side of its box: the face beside it is
looked for as well.
"""

from __future__ import annotations

import math

from homography_servo.result import Rejected
from homography_servo.tracking.detection.beside import find_beside
from homography_servo.tracking.detection.candidates import Effort
from homography_servo.tracking.detection.candidates import find_candidates
from homography_servo.tracking.detection.candidates import find_sides
from homography_servo.tracking.detection.candidates import rough_views
from homography_servo.tracking.detection.outlook import smoothed
from homography_servo.tracking.detection.view_check import check_view
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.target import Found
from homography_servo.tracking.target import Target
import numpy as np

APART_ODDS = 0.4  # by which the logarithm must be better than that of the next best one
# Logarithms: 150 to 1 for the face, which it is; 30 to 1, which a face needs of which one
# side does not show at all, as three sides are found in many things; 4 to 1, better than nothing.
SURE_ODDS, BELIEVED_ODDS, LEAST_ODDS = 5.0, 3.5, 1.5
QUICK = Effort(150, 12, 6, 3, 2.5, 7.0)  # mostly suffices
THOROUGH = Effort(1000, 200, 100, 6, 2.5, 3.0)
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
        self._sides = find_sides(self._picture, target, plane)
        self._checked: dict[bytes, Found | Rejected] = {}
        self._beside: dict[bytes, Found | Rejected] = {}

    def best(self, effort: Effort) -> Found | Rejected:
        """Find the view of the face for which most speaks; its merit is a logarithm of odds."""
        sides = self._sides.chosen(slice(effort.sides))
        rough = rough_views(self._picture, sides, self._target, self._plane)
        candidates = find_candidates(self._picture, rough, self._target, self._plane, effort)
        checked = [self._check(corners) for corners in candidates.views.corners]
        found = [one for one in checked if not isinstance(one, Rejected)]
        best = self._unrivalled(_best(found))
        if not isinstance(best, Rejected) and best.merit > SURE_ODDS:
            return best
        for side in found:
            beside = self._find_beside(side.fit.corners)
            if not isinstance(beside, Rejected):
                return beside._replace(merit=SURE_ODDS)  # face and side agree
        return best

    def odds(self, corners: np.ndarray) -> float:
        """Give the logarithm of the odds that corners (4, 2) found otherwise are the face's."""
        checked = self._check(corners)
        return -math.inf if isinstance(checked, Rejected) else checked.merit

    def odds_elsewhere(self, corners: np.ndarray) -> float:
        """Give those of the likeliest thing found so far that is elsewhere."""
        return max((one.merit for one in self._checked.values()
                    if not isinstance(one, Rejected)
                    and _apart(one.fit.corners, corners) > ELSEWHERE_PX), default=-math.inf)

    def _unrivalled(self, best: Found | Rejected) -> Found | Rejected:
        """Doubt the best one if another thing looks like the face as well."""
        if not isinstance(best, Rejected) \
                and self.odds_elsewhere(best.fit.corners) > best.merit - APART_ODDS:
            return Rejected('two quadrilaterals look like the face')
        return best

    def _check(self, corners: np.ndarray) -> Found | Rejected:
        """Check a candidate, once."""
        key = corners.tobytes()
        if key not in self._checked:
            checked = check_view(self._picture, corners, self._target, self._plane)
            if not isinstance(checked, Rejected) and self._target.strange(checked.fit.corners):
                checked = checked._replace(merit=-math.inf)  # but maybe a side of its box
            self._checked[key] = checked
        return self._checked[key]

    def _find_beside(self, corners: np.ndarray) -> Found | Rejected:
        """Look for the face of which something else is a side of the box, once."""
        key = corners.tobytes()
        if key not in self._beside:
            self._beside[key] = find_beside(self._picture.grey, corners, self._target,
                                            self._plane)
        return self._beside[key]


def _best(found: list[Found]) -> Found | Rejected:
    """Choose the one for which most speaks, if that is enough."""
    if not found:
        return Rejected('the edges do not support any view of the face')
    best = max(found, key=lambda one: one.merit)
    all_show = min(best.fit.judged.side_share.tolist()) > 0.0
    if best.merit < (LEAST_ODDS if all_show else BELIEVED_ODDS):
        return Rejected('the best quadrilateral does not look like the face and its box')
    return best


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Give the distance of the middles of corners (4, 2) [px]."""
    return float(np.linalg.norm((one - other).mean(axis=0)))
