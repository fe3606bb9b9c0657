"""
Fit a view of the face to the picture.

The corners are fitted like in tracking, but held to what a rectangle of the known size
can look like, so that a side that is hidden follows from the others.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.result import Rejected
from homography_servo.tracking.box import BoxSides
from homography_servo.tracking.box import RIGID_SIGMA_PX
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import Quality
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.snake import fit_snake
import numpy as np

GUESSED_SIGMA = 0.01  # of the corners about a view through a guessed lens, by the size
HALF, STEPS = 5, 3
LEAST_INLIERS = 0.5
SEEN_SIDE, SIDES_NEEDED = 0.3, 3
SQUARE = 0.02  # difference of the sides of a square


class Target(NamedTuple):
    """What is looked for."""

    face_size_m: tuple[float, float]
    box_height_m: float
    nearest_m: float
    farthest_m: float
    polarity: int  # 1 bright face, -1 dark face, 0 unknown
    blur_px: float
    guessed_lens: bool = False


class Found(NamedTuple):
    """A face that was found."""

    fit: SnakeFit
    quality: Quality
    odds: float  # logarithm of how much likelier it is the face than not


def examine(image: np.ndarray, corners: np.ndarray, odds: float, target: Target, plane: Plane,
            expected: np.ndarray | None = None) -> Found | Rejected:
    """
    Fit a candidate.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    corners : (4, 2) array
        To within a pixel or so, in the plane; the first is the face's first, or third.
    odds : float
        Logarithm of how much likelier the candidate is the face than not.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.
    expected : (4, 2) array or None
        Decides the order of the corners that come out.

    Returns
    -------
    Found or Rejected

    """
    outline = BoxSides(target.face_size_m, target.box_height_m, plane).outline(corners)
    if isinstance(outline, Rejected):
        return outline
    fit = fit_snake(image, corners, Look(target.blur_px, HALF, iterations=STEPS), plane,
                    _held(outline.rigid, target), target.polarity)
    if isinstance(fit, Rejected):
        return fit
    quality = fit.judged
    if quality.inlier_share < LEAST_INLIERS \
            or np.count_nonzero(quality.side_share > SEEN_SIDE) < SIDES_NEEDED:
        return Rejected('the edges do not support the quadrilateral')
    turn = _best_turn(fit.corners, target, expected)
    return Found(turned_fit(fit, turn), quality, odds)


def _held(rigid: Prior, target: Target) -> Prior:
    """Hold corners to a view of the face as firmly as the lens is known."""
    if not target.guessed_lens:
        return rigid
    sigma_px = GUESSED_SIGMA * float(np.linalg.norm(np.ptp(rigid.corners, axis=0)))
    return rigid._replace(information=rigid.information * (RIGID_SIGMA_PX / sigma_px) ** 2)


def _best_turn(corners: np.ndarray, target: Target, expected: np.ndarray | None) -> int:
    """Say which corner comes first, of those that the proportions allow."""
    width, height = target.face_size_m
    turns = (0, 1, 2, 3) if abs(width / height - 1.0) < SQUARE else (0, 2)
    return min(turns, key=lambda turn: _turn_cost(np.roll(corners, -turn, axis=0), expected))


def _turn_cost(corners: np.ndarray, expected: np.ndarray | None) -> float:
    if expected is not None:
        away = (corners - corners.mean(axis=0)) - (expected - expected.mean(axis=0))
        return float(np.abs(away).sum())
    top = corners[1] - corners[0] + corners[2] - corners[3]
    return abs(float(np.arctan2(top[1], top[0])))


def turned_fit(fit: SnakeFit, turn: int) -> SnakeFit:
    """Begin the corners of a fit with another one."""
    if turn == 0:
        return fit
    order = np.roll(np.arange(4), -turn)
    both = (2 * order[:, None] + np.arange(2)).ravel()
    edges = fit.edges._replace(side=(fit.edges.side - turn) % 4)
    return fit._replace(corners=fit.corners[order], covariance=fit.covariance[np.ix_(both, both)],
                        edges=edges)
