"""
Find the face in a picture without being told where it is.

Two searches take turns, the surest and quickest one first:

1. Straight edges are put together to views of the face and compared with the picture,
   the sides of the box behind included (`edge_search`), quickly and, if need be, once
   more thoroughly. It knows best among other things, and finds a face of which a side is
   hidden. Where it finds nothing, a print on the face or noise may mislead it.
2. Then regions of like grey level are looked through (`region_search`): a print on the
   face and noise matter little to it. It is believed where it is convinced; else the
   edges along what it shows are asked as well.
3. What the quick look found is taken where nothing else is found.

A rectangle looks the same after half a turn. Which corner comes first is decided by
the expected corners where they are given, else by taking the turn whose top side
points most to the right (gamma closest to 0).
"""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
from homography_servo.result import Rejected
from homography_servo.tracking.detection.edge_search import BELIEVED_ODDS
from homography_servo.tracking.detection.edge_search import EdgeSearch
from homography_servo.tracking.detection.edge_search import LEAST_ODDS
from homography_servo.tracking.detection.edge_search import QUICK
from homography_servo.tracking.detection.edge_search import SURE_ODDS
from homography_servo.tracking.detection.edge_search import THOROUGH
from homography_servo.tracking.detection.region_check import LEAST_SCORE
from homography_servo.tracking.detection.region_search import CONVINCING
from homography_servo.tracking.detection.region_search import find_by_regions
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.target import Found
from homography_servo.tracking.target import Target
from homography_servo.tracking.target import turned
import numpy as np

LENS_GUESS = 1.2  # focal length over image width of a camera nobody calibrated
SLACK = 1.5  # for distances measured with it


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
    found = _search(image, target, plane)
    if isinstance(found, Rejected):
        return found
    return found._replace(fit=turned(found.fit, target.turns, expected))


def _search(image: np.ndarray, target: Target, plane: Plane) -> Found | Rejected:
    edges = EdgeSearch(image, target, plane)
    quickly = edges.best(QUICK)
    if not isinstance(quickly, Rejected) and quickly.merit > BELIEVED_ODDS:
        return quickly
    # The thorough search lists other candidates first, and may lose what the quick one found.
    return edges.best(THOROUGH) or _by_regions(image, edges, target, plane, quickly)


def _by_regions(image: np.ndarray, edges: EdgeSearch, target: Target, plane: Plane,
                otherwise: Found | Rejected) -> Found | Rejected:
    """Look through the regions where edges are not sure."""
    found = find_by_regions(image, target, plane)
    if isinstance(found, Rejected):
        return otherwise or found
    if found.merit > CONVINCING:
        return found
    # From nothing to what ends a search; the edges' odds are something else that speaks for it.
    told = SURE_ODDS * (found.merit - LEAST_SCORE) / (CONVINCING - LEAST_SCORE)
    together = told + edges.odds(found.fit.corners)
    if together < max(LEAST_ODDS, edges.odds_elsewhere(found.fit.corners)):
        return otherwise or Rejected('neither regions nor edges show what surely is the face')
    return found


def _typical_plane(shape: tuple[int, ...]) -> Plane:
    height, width = shape
    focal = LENS_GUESS * max(width, height)
    return Plane(Camera(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height))
