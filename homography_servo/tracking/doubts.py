"""Doubt a fit that cannot be the face."""

from __future__ import annotations

import math

from homography_servo.geometry.face import face_corners
from homography_servo.result import Rejected
from homography_servo.tracking.face_pose import FacePose
from homography_servo.tracking.face_pose import next_pose
from homography_servo.tracking.face_pose import pose_of_face
from homography_servo.tracking.motion import similarity_basis
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.quality import SEEN_SIDE
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

OTHER_SIZE = 0.25  # relative change of size from one picture to the next
FARTHEST_SIGMAS = 6.0  # from where it was expected to where a side may be that no edge shows
SETTLED_PX = 0.5  # largest last step of a fit that has found its place


def weak_support(fit: SnakeFit, settings: TrackerSettings) -> str:
    """Give the reason why the edges do not support a fit, or nothing."""
    quality = fit.judged
    if abs(quality.contrast) < settings.min_contrast:
        return f'the contrast of the edges is {quality.contrast:.0f} grey levels'
    if quality.inlier_share < settings.min_inlier_share:
        return f'only {quality.inlier_share:.0%} of the lines agree'
    if not quality.enough_sides:
        return 'fewer than three sides are visible'
    if fit.moved_px > SETTLED_PX:
        return f'the fit has not settled: it moves by {fit.moved_px:.1f} px'
    return ''


def vagueness(fit: SnakeFit, settings: TrackerSettings) -> str:
    """Say of a fit that may be right how uncertain it is, if it is too much so."""
    sigma_px = corner_sigma_px(fit)
    return f'a corner is uncertain by {sigma_px:.2f} px' \
        if sigma_px > settings.max_corner_sigma_px else ''


def corner_sigma_px(fit: SnakeFit) -> float:
    """Give the standard deviation of the least certain corner [px]."""
    return max(fit.covariance.diagonal().tolist()) ** 0.5


def surprise(fit: SnakeFit, prior: Prior, settings: TrackerSettings, following: bool) -> str:
    """
    Compare a fit with what was expected.

    Parameters
    ----------
    fit : SnakeFit
        What came out.
    prior : Prior
        What was expected.
    settings : TrackerSettings
        What may happen.
    following : bool
        Whether the prior comes from the motion, so that place and size are known too.

    Returns
    -------
    str
        Why it cannot be, or nothing.

    """
    move = (fit.corners - prior.corners).ravel()
    free = similarity_basis(prior.corners) if prior.free is None else prior.free
    common = move @ free
    bend_px = max(np.abs(move - free @ common).tolist())
    if bend_px > settings.max_jump_px:
        return f'the shape changed by {bend_px:.1f} px at once'
    if not following:
        return ''
    if fit.judged.least_side_share <= SEEN_SIDE and _too_far(move, prior.information):
        return 'a side that is not seen would be far from where it was expected'
    right, down, larger, _ = common.tolist()
    if abs(larger) > OTHER_SIZE * abs(float(free[:, 2] @ prior.corners.ravel())):
        return 'the size changed at once'
    if max(abs(right), abs(down)) > 2.0 * settings.search_px:
        return 'the face jumped'
    return ''


def contradicts(fit: SnakeFit, vague: SnakeFit) -> bool:
    """Tell whether a fit is where another, that is too uncertain to be told, cannot be."""
    return _too_far((fit.corners - vague.corners).ravel(), vague.information)


def _too_far(move: np.ndarray, information: np.ndarray) -> bool:
    return bool(move @ information @ move > FARTHEST_SIGMAS ** 2)


class FaceCheck:
    """
    Checks that corners are the projection of the rectangle.

    Parameters
    ----------
    face_size_m : (float, float)
        Width and height of the face.
    plane : Plane
        Without a camera every quadrilateral may be the face.

    """

    def __init__(self, face_size_m: tuple[float, float], plane: Plane) -> None:
        self._points_m, self._plane = face_corners(*face_size_m), plane
        self._pose: FacePose | None = None

    def doubt(self, corners: np.ndarray, settings: TrackerSettings) -> str:
        """Give the reason why corners (4, 2) are no view of the face, or nothing."""
        if self._plane.camera is None:
            return ''
        rays, near = self._plane.rays(corners), self._pose
        pose = pose_of_face(self._points_m, rays) if near is None \
            else next_pose(self._points_m, rays, near)
        if near is not None and self._miss_px(pose) > settings.max_shape_miss_px:
            pose = pose_of_face(self._points_m, rays)  # it may have turned too far for one step
        self._pose = None
        if isinstance(pose, Rejected):
            return pose.reason
        miss_px = self._miss_px(pose)
        if miss_px > settings.max_shape_miss_px:
            return f'the corners miss a view of the face by {miss_px:.1f} px'
        self._pose = pose
        return ''

    def _miss_px(self, pose: FacePose | Rejected) -> float:
        return math.inf if isinstance(pose, Rejected) else float(self._plane.rms_px(pose.miss))
