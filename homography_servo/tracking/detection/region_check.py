"""
Tell whether a quadrilateral is the face.

It is fitted like in tracking, must be the projection of a rectangle of the known size
within reach, and is rated by how well edges, evenness, pose and the sides of the box
behind it agree.
"""

from __future__ import annotations

from homography_servo.geometry.face import face_corners
from homography_servo.result import Rejected
from homography_servo.tracking.box import BoxSides
from homography_servo.tracking.box import Outline
from homography_servo.tracking.detection.region_quads import grey_at
from homography_servo.tracking.detection.side_fit import fit_with_sides
from homography_servo.tracking.face_pose import FacePose
from homography_servo.tracking.face_pose import pose_of_face
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.quality import INLIER_WEIGHT
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.target import Found
from homography_servo.tracking.target import rolled
from homography_servo.tracking.target import STEEPEST
from homography_servo.tracking.target import Target
import numpy as np

LEAST_SCORE = 0.5
LIKELY_MISS = 0.6  # of the miss of the proportions that is allowed
FULL_GREY = 50.0  # contrast from which on more is not better
NO_SIDES_SEEN = 0.65  # evidence where no side of the box can be in view
CLEAR_GREY = 10.0  # contrast that is no noise
EVEN_GREY = 12.0  # differences that a face of one colour may show
AWAY_PX = 4.0  # distance from a side at which grey levels are compared
STRIP_SAMPLES = np.linspace(0.15, 0.85, 7)
NARROW_HALF = 5
SLIVER_PX = 0.1  # a miss that a narrow side of the box may cause
WIDE = Look(1.5, 7, 3, 3, 3, 6.0, 0.5, 1.5)


def examine(image: np.ndarray, quad: np.ndarray, target: Target,
            plane: Plane) -> Found | Rejected:
    """Fit a candidate and check that it can be the face."""
    fit = fit_snake(image, quad, WIDE, plane, None, target.polarity)
    if isinstance(fit, Rejected):
        return fit
    if _best_pose(fit.corners, target.face_size_m, plane)[1] > 2.0 + 0.03 * _size(fit.corners):
        return Rejected('the proportions are not those of the face')
    narrow = Look(target.blur_px, NARROW_HALF, iterations=3)
    fit = fit_snake(image, fit.corners, narrow, plane, None, target.polarity)
    if isinstance(fit, Rejected):
        return fit
    pose, miss_px, turn = _best_pose(fit.corners, target.face_size_m, plane)
    allowed_px = 0.4 + (0.03 if target.guessed_lens else 0.01) * _size(fit.corners)
    if SLIVER_PX < miss_px < allowed_px and target.box_height_m > 0.0 \
            and not target.guessed_lens:
        fit = fit_with_sides(image, rolled(fit, turn), _box(target, plane), narrow, target, plane,
                             lambda rigid: None)
        pose, miss_px, turn = _best_pose(fit.corners, target.face_size_m, plane)
    quality = fit.judged
    if quality.inlier_share < 0.55 or quality.side_share.min() < 0.15:
        return Rejected('the edges do not support the quadrilateral')
    if pose is None or miss_px > allowed_px:
        return Rejected('the proportions are not those of the face')
    cosine = abs(float(pose.rotation[:, 2] @ pose.translation)) \
        / float(np.linalg.norm(pose.translation))
    if not target.nearest_m < pose.translation[2] < target.farthest_m or cosine < STEEPEST:
        return Rejected('the face would be out of reach')
    score = quality.inlier_share * quality.side_share.min() ** 0.25 \
        * float(np.exp(-miss_px / (LIKELY_MISS * allowed_px))) * _evenness(fit) \
        * min(abs(quality.contrast) / FULL_GREY, 1.0) ** 0.5
    if score < LEAST_SCORE:  # looking at the sides of the box takes time
        return Rejected('the edges, the evenness and the proportions are not those of the face')
    strange = target.strange(fit.corners)
    if strange:
        return Rejected(strange)
    score *= _box_evidence(image, fit.corners, turn, target, plane)
    return Found(rolled(fit, turn), float(score))


def _box(target: Target, plane: Plane) -> BoxSides:
    return BoxSides(target.face_size_m, target.box_height_m, plane)


def _best_pose(quad: np.ndarray, face_size_m: tuple[float, float],
               plane: Plane) -> tuple[FacePose | None, float, int]:
    """
    Fit the pose of the face to a quadrilateral in either turn.

    Returns
    -------
    FacePose or None, float, int
        The better one, the RMS of what its projection misses of the corners [px], and
        by how many places the corners must be rolled.

    """
    points_m, rays = face_corners(*face_size_m), plane.rays(quad)
    rough = [pose_of_face(points_m, np.roll(rays, -turn, axis=0), None, 0) for turn in (0, 1)]
    better = int(_miss_px(rough[1], plane) < _miss_px(rough[0], plane))
    pose = rough[better]
    if not isinstance(pose, Rejected):
        pose = pose_of_face(points_m, np.roll(rays, -better, axis=0), pose)
    return (None if isinstance(pose, Rejected) else pose), _miss_px(pose, plane), better


def _miss_px(pose: FacePose | Rejected, plane: Plane) -> float:
    return np.inf if isinstance(pose, Rejected) else float(plane.rms_px(pose.miss))


def _size(quad: np.ndarray) -> float:
    across, down = quad[1] - quad[0], quad[3] - quad[0]
    return float(np.sqrt(np.abs(across[0] * down[1] - across[1] * down[0])))


def _evenness(fit: SnakeFit) -> float:
    """Rate how alike the sides look from inside, 0 to 1."""
    edges, good = fit.edges, fit.weight > INLIER_WEIGHT
    inside = edges.outside + edges.contrast
    levels = [np.median(inside[good & (edges.side == side)])
              for side in range(4) if (good & (edges.side == side)).any()]
    scale = np.abs(edges.contrast[good]).mean() + CLEAR_GREY
    return float(np.exp(-np.std(levels) / scale))


def _box_evidence(image: np.ndarray, corners: np.ndarray, turn: int, target: Target,
                  plane: Plane) -> float:
    """Rate whether the sides of the box show where they must, 0.4 to 1."""
    if target.box_height_m <= 0.0:
        return 1.0
    outline = _box(target, plane).outline(np.roll(corners, -turn, axis=0))
    if isinstance(outline, Rejected):
        return 0.4
    seen = [_strip_shows(image, np.roll(corners, -turn, axis=0), outline, side, plane)
            for side in range(4) if outline.width[side].mean() > 4.0]
    return 0.4 + 0.6 * float(np.mean(seen)) if seen else NO_SIDES_SEEN


def _strip_shows(image: np.ndarray, corners: np.ndarray, outline: Outline, side: int,
                 plane: Plane) -> float:
    """Compare the grey levels of a strip with those of the face and of what is behind."""
    first, second = corners[side], corners[(side + 1) % 4]
    along = second - first
    outward = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    share = STRIP_SAMPLES[:, None]
    reach = outline.reach[side, 0] + share * (outline.reach[side, 1] - outline.reach[side, 0])
    width = outline.width[side, 0] + share * (outline.width[side, 1] - outline.width[side, 0])
    at = first + reach * along
    face, strip, near, behind = (
        grey_at(image, plane.to_image(at + away * outward))
        for away in (-AWAY_PX, 0.5 * width, width - 2.0, width + 3.0))
    common = np.median(np.concatenate([strip, near]))
    even = (np.abs(np.concatenate([strip, near]) - common) < EVEN_GREY).mean()
    ends = np.minimum(np.abs(behind - common) / CLEAR_GREY, 1.0).mean()
    apart = (np.abs(face - strip) > CLEAR_GREY).mean()
    return float(even ** 2 * ends * apart)
