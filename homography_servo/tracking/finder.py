"""
Find the face in a picture without being told where it is.

Bright and dark regions at several thresholds, and regions that edges enclose, whose
outline is close to a convex quadrilateral are candidates. Each is fitted like in
tracking and must look like the projection of a rectangle of the known proportions.

A rectangle looks the same after half a turn. Which corner comes first is decided by
the expected corners where they are given, else by taking the turn whose top side
points most to the right (gamma closest to 0).
"""

from __future__ import annotations

from typing import Iterator, NamedTuple

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.face import face_corners
from homography_servo.result import Rejected
from homography_servo.tracking.face_pose import pose_of_face
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.snake import Look
from homography_servo.tracking.snake import quality_of
from homography_servo.tracking.snake import SnakeFit
import numpy as np

MIN_SIDE_PX = 8.0
SHRUNK_BY_PX = 1.5  # a region between edges is smaller than the face by this
WIDE = Look(2.0, 8, 3, 3, 2, 0.25, 0.5, 1.0)
ENOUGH_CANDIDATES = 24
FIELD_GUESS = 1.2  # focal length over image width of a camera nobody calibrated


class Found(NamedTuple):
    """A face that was found."""

    fit: SnakeFit
    score: float  # 0..1
    shape_miss_px: float  # RMS of the corners about the nearest rectangle's projection


def find_face(image: np.ndarray, face_size_m: tuple[float, float], plane: Plane,
              blur_px: float, expected: np.ndarray | None = None,
              polarity: int = 0) -> Found | Rejected:
    """
    Find the quadrilateral that looks most like the face.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    face_size_m : (float, float)
        Width and height of the face.
    plane : Plane
        Its camera makes the check of the proportions sharp; without one a typical lens
        is assumed.
    blur_px : float
        Blur of the edges.
    expected : (4, 2) array or None
        Corners in the plane; decides the order of the corners.
    polarity : int
        1 bright face, -1 dark face, 0 unknown.

    Returns
    -------
    Found or Rejected

    """
    if plane.camera is None:
        plane = _typical_plane(image.shape)
    best, reason = None, 'no quadrilateral in the image'
    for candidate in candidates(image):
        found = examine(image, plane.from_image(candidate), face_size_m, plane, blur_px,
                        expected, polarity)
        if isinstance(found, Rejected):
            reason = found.reason
        elif best is None or found.score > best.score:
            best = found
    return Rejected(reason) if best is None else best


def candidates(image: np.ndarray) -> list[np.ndarray]:
    """List distinct convex quadrilaterals (4, 2), clockwise on the screen, largest first."""
    kept: list[np.ndarray] = []
    for quad in _quadrilaterals(image):
        centre, size = quad.mean(axis=0), np.sqrt(cv2.contourArea(quad.astype(np.float32)))
        if not any(np.abs(quad.mean(axis=0) - other.mean(axis=0)).max() < 3.0
                   and abs(size / np.sqrt(cv2.contourArea(other.astype(np.float32))) - 1.0) < 0.1
                   for other in kept) and np.isfinite(centre).all():
            kept.append(quad)
    kept.sort(key=lambda quad: -cv2.contourArea(quad.astype(np.float32)))
    return kept[:ENOUGH_CANDIDATES]


def _quadrilaterals(image: np.ndarray) -> Iterator[np.ndarray]:
    smooth = cv2.GaussianBlur(image, (5, 5), 0)
    edges = cv2.Canny(smooth, 40, 80)
    closed = cv2.bitwise_not(cv2.dilate(edges, np.ones((3, 3), np.uint8)))
    yield from _from_regions(closed, SHRUNK_BY_PX)
    low, high = np.percentile(smooth[::4, ::4], (2.0, 98.0))
    for level in np.linspace(low, high, 9)[1:-1]:
        yield from _from_regions((smooth > level).astype(np.uint8), 0.0)


def _from_regions(mask: np.ndarray, grow_px: float) -> Iterator[np.ndarray]:
    """List the quadrilaterals among the outlines of a mask."""
    outlines = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)[-2]
    limit = 0.6 * mask.size
    for outline in outlines:
        if len(outline) < 4:
            continue
        area = cv2.contourArea(outline)
        if not MIN_SIDE_PX ** 2 < area < limit:
            continue
        quad = _four_corners(outline, area)
        if quad is not None:
            yield _grown(quad, grow_px)


def _four_corners(outline: np.ndarray, area: float) -> np.ndarray | None:
    """Simplify an outline to four corners, clockwise on the screen, or None."""
    length = cv2.arcLength(outline, True)
    for share in (0.02, 0.04, 0.07):
        simple = cv2.approxPolyDP(outline, share * length, True)[:, 0, :].astype(float)
        if len(simple) == 4:
            break
    else:
        return None
    edge = np.roll(simple, -1, axis=0) - simple
    after = np.roll(edge, -1, axis=0)
    cross = edge[:, 0] * after[:, 1] - edge[:, 1] * after[:, 0]
    if (cross < 0.0).all():
        simple, cross = simple[::-1], -cross
    sides = np.hypot(edge[:, 0], edge[:, 1])
    if not (cross > 0.0).all() or sides.min() < MIN_SIDE_PX:
        return None
    own = cv2.contourArea(simple.astype(np.float32))
    return simple if 0.85 < area / own < 1.15 else None


def _grown(quad: np.ndarray, by_px: float) -> np.ndarray:
    away = quad - quad.mean(axis=0)
    return quad + by_px * 1.4 * away / np.linalg.norm(away, axis=1, keepdims=True)


def _typical_plane(shape: tuple[int, ...]) -> Plane:
    height, width = shape
    focal = FIELD_GUESS * max(width, height)
    return Plane(Camera(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height))


def examine(image: np.ndarray, quad: np.ndarray, face_size_m: tuple[float, float],
            plane: Plane, blur_px: float, expected: np.ndarray | None,
            polarity: int) -> Found | Rejected:
    """Fit a candidate and check that it can be the face."""
    if shape_miss(quad, face_size_m, plane)[0] > 0.12 * _size(quad) + 3.0:
        return Rejected('the proportions are not those of the face')
    fit: SnakeFit | Rejected = Rejected('')
    for look in (WIDE, Look(blur_px, 6)):
        fit = fit_snake(image, quad, look, plane, None, polarity)
        if isinstance(fit, Rejected):
            return fit
        quad = fit.corners
    quality = quality_of(fit)
    if quality.inlier_share < 0.6 or quality.side_share.min() < 0.3:
        return Rejected('the edges do not support the quadrilateral')
    miss_px, turn = shape_miss(fit.corners, face_size_m, plane, expected)
    allowed_px = 0.02 * _size(fit.corners) + 0.5
    if miss_px > allowed_px:
        return Rejected('the proportions are not those of the face')
    score = quality.inlier_share * quality.side_share.min() \
        * (1.0 - 0.5 * miss_px / allowed_px)
    return Found(turned_fit(fit, turn), float(score), miss_px)


def shape_miss(quad: np.ndarray, face_size_m: tuple[float, float], plane: Plane,
               expected: np.ndarray | None = None) -> tuple[float, int]:
    """
    Measure how far a quadrilateral is from a view of the rectangle.

    Returns
    -------
    float, int
        RMS of the corners [px] in the best of the turns the proportions allow, and by
        how many places the corners must be rolled to come in the right order.

    """
    points_m = face_corners(*face_size_m)
    rays, focal = plane.rays(quad), 0.5 * (plane.camera.fx + plane.camera.fy)
    missed = []
    for turn in (0, 1):
        pose = pose_of_face(points_m, np.roll(rays, -turn, axis=0))
        missed.append(np.inf if isinstance(pose, Rejected)
                      else focal * float(np.sqrt(np.mean(pose.miss ** 2))))
    turns = [0, 2] if missed[0] <= missed[1] else [1, 3]
    if abs(face_size_m[0] / face_size_m[1] - 1.0) < 0.02:
        turns = [0, 1, 2, 3]
    return min(missed), min(turns, key=lambda turn: _turn_cost(quad, turn, expected))


def _turn_cost(quad: np.ndarray, turn: int, expected: np.ndarray | None) -> float:
    corners = np.roll(quad, -turn, axis=0)
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


def _size(quad: np.ndarray) -> float:
    return float(np.sqrt(cv2.contourArea(quad.astype(np.float32))))
