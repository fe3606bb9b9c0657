"""
Pose of a known object from its points in one image.

A homography starts it, `pose_start` gives both poses that a plane suggests, and
`pose_refine` takes each to its minimum of the reprojection error, weighted by the
measurement's covariance. Both minima are returned: a small face seen from afar has
two that explain it almost equally well, and only other knowledge can tell them apart.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Sequence

from homography_servo.geometry.camera_model import Camera
from homography_servo.geometry.pose_refine import refine
from homography_servo.geometry.pose_refine import same_minimum
from homography_servo.geometry.pose_residuals import Fit
from homography_servo.geometry.pose_residuals import Views
from homography_servo.geometry.pose_start import FAULTS
from homography_servo.geometry.pose_start import mirrored_rotation
from homography_servo.geometry.pose_start import planar_starts
from homography_servo.geometry.pose_start import Shape
from homography_servo.geometry.pose_start import shape_of
from homography_servo.geometry.pose_views import views_of
from homography_servo.geometry.rigid import pose_difference
from homography_servo.result import Rejected
import numpy as np
from scipy.linalg import lapack


@dataclass(frozen=True)
class Prior:
    """A pose believed before looking, and its covariance (6, 6) in the order of ROS."""

    home_from_object: np.ndarray
    covariance: np.ndarray

    def __post_init__(self) -> None:
        for name, shape in (('home_from_object', (4, 4)), ('covariance', (6, 6))):
            value = np.asarray(getattr(self, name), float)
            if value.shape != shape:
                raise ValueError(f'{name} of a prior must have shape {shape}, got {value.shape}')
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class PoseCandidate:
    """One minimum of the reprojection error."""

    home_from_object: np.ndarray  # (4, 4)
    covariance: np.ndarray  # (6, 6): x, y, z, rotation vector, along the axes of home
    chi2: float  # squared error in units of the measurement's covariance
    residual_px: float  # root mean square over the points


@dataclass(frozen=True)
class PoseEstimate:
    """The chosen minimum, the other one if there is one, and how near a toss-up it was."""

    candidates: tuple[PoseCandidate, ...]  # the chosen one first
    ambiguity: float  # likelihood of the second over the first: 0 certain, 1 toss-up

    @property
    def home_from_object(self) -> np.ndarray:
        """Give the chosen pose (4, 4)."""
        return self.candidates[0].home_from_object

    @property
    def covariance(self) -> np.ndarray:
        """Give the uncertainty of the chosen pose, (6, 6)."""
        return self.candidates[0].covariance


def estimate_pose(object_points_m: np.ndarray, image_points_px: np.ndarray, camera: Camera,
                  home_depth_m: float = 1.0, covariance_px2: float | np.ndarray | None = None,
                  prior: Prior | None = None, near: Sequence[PoseCandidate] = ()
                  ) -> PoseEstimate | Rejected:
    """
    Estimate where an object is from its points in an image.

    Parameters
    ----------
    object_points_m : (N, 3) array
        Points of the object, N >= 4, flat or not.
    image_points_px : (N, 2) array
        Where they are seen, in the distorted image.
    camera : Camera
        The camera.
    home_depth_m : float
        cZh, the depth of the home frame.
    covariance_px2 : float, (N, 2, 2) or (2N, 2N) array, optional
        Covariance of the image points; the large one is ordered u_0, v_0, u_1, ...
        The default stands for 1 px, independent.
    prior : Prior, optional
        Decides between the minima. It does not pull the estimate.
    near : sequence of PoseCandidate, optional
        All minima of a view just before. Where they lead to as many minima of this one,
        and one of those explains the points, no others are searched for: that takes a
        third of the time.

    Returns
    -------
    PoseEstimate or Rejected
        Both minima, or why there is none.

    """
    points, image = checked_points(object_points_m, image_points_px, home_depth_m)
    prepared = _prepare(points, image, camera, covariance_px2, prior)
    if isinstance(prepared, Rejected):
        return prepared
    shape, views, px_per_ray = prepared
    if near:
        fit = refine(views, *_starts_near(near, home_depth_m))
        candidates = _candidates(fit, views, px_per_ray, home_depth_m)
        if len(candidates) == len(near) and candidates[0].chi2 < _explained(len(points)):
            return _chosen(candidates, prior)
    starts = _starts(shape, views)
    if isinstance(starts, Rejected):
        return starts
    fit = refine(views, *starts)
    candidates = _candidates(fit, views, px_per_ray, home_depth_m)
    if not candidates:
        return Rejected('no pose before the camera explains the points')
    return _chosen(candidates, prior)


def _explained(points: int) -> float:
    """Give a chi squared that noise exceeds in one view of 400; more rarely with many points."""
    freedom = 2 * points - 6
    return freedom + 5.0 * math.sqrt(2.0 * freedom)


def _starts_near(near: Sequence[PoseCandidate], home_depth_m: float
                 ) -> tuple[np.ndarray, np.ndarray]:
    poses = np.array([candidate.home_from_object for candidate in near])
    return np.ascontiguousarray(poses[:, :3, :3]), poses[:, :3, 3] + (0.0, 0.0, home_depth_m)


def checked_points(object_points_m: np.ndarray, image_points_px: np.ndarray,
                   home_depth_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Check the shapes that every estimate of a pose shares."""
    points = np.ascontiguousarray(object_points_m, float)
    image = np.asarray(image_points_px, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f'object_points_m must have shape (N, 3), got {points.shape}')
    if image.shape[-2:] != (len(points), 2) or image.ndim > 3:
        raise ValueError(f'image_points_px must have shape ({len(points)}, 2) to match the '
                         f'object, got {image.shape}')
    if not 0.0 < home_depth_m < math.inf:
        raise ValueError(f'home_depth_m must be > 0 and finite, got {home_depth_m}')
    return points, image


def _prepare(points: np.ndarray, image: np.ndarray, camera: Camera,
             covariance_px2: float | np.ndarray | None, prior: Prior | None
             ) -> tuple[Shape, Views, np.ndarray] | Rejected:
    if image.ndim != 2:
        raise ValueError(f'image_points_px must have shape (N, 2), got {image.shape}')
    if len(points) < 4:
        return Rejected(f'need 4 points, have {len(points)}')
    if not np.isfinite(image).all():
        return Rejected('a point in the image is not finite')
    if prior is not None and not (np.isfinite(prior.home_from_object).all()
                                  and np.isfinite(prior.covariance).all()):
        return Rejected('the prior is not finite')
    shape = shape_of(points)
    if isinstance(shape, Rejected):
        return shape
    views = views_of(points, image[None], camera, covariance_px2)
    if isinstance(views, Rejected):
        return views
    if camera.bends and not np.isfinite(views[0].rays).all():
        return Rejected('a point lies where the lens of the camera shows nothing')
    return shape, *views


def _starts(shape: Shape, views: Views) -> tuple[np.ndarray, np.ndarray] | Rejected:
    """Give two starts: rotations (2, 3, 3) and translations (2, 3) of the object's origin."""
    if shape.flat:
        rotation, centre_m, fault = planar_starts(shape, views.rays)
        if fault[0]:
            return Rejected(FAULTS[int(fault[0])])
        rotation = rotation[:, 0]
        return rotation, centre_m - rotation @ shape.centre_m
    return solid_starts(shape, views.points_m, views.rays[0])


def solid_starts(shape: Shape, points_m: np.ndarray, rays: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray] | Rejected:
    """Start an object (3, N) that is not flat by SQPNP, and by the mirror image of that."""
    import cv2  # only solid objects need it

    try:
        found, turn, shift = cv2.solvePnP(np.ascontiguousarray(points_m.T),
                                          np.ascontiguousarray(rays.T), np.eye(3), None,
                                          flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        found = False
    if not found or not (np.isfinite(turn).all() and np.isfinite(shift).all()):
        return Rejected('the points in the image do not fix a pose of the object')
    first = cv2.Rodrigues(turn)[0]
    centre_m = first @ shape.centre_m + shift[:, 0]
    second = mirrored_rotation(first[None], centre_m[None], shape)[0]
    rotation = np.stack([first, second])
    return rotation, centre_m - rotation @ shape.centre_m


def _candidates(fit: Fit, views: Views, px_per_ray: np.ndarray, home_depth_m: float
                ) -> list[PoseCandidate]:
    """Collect the different minima, the smaller error first."""
    chi2 = fit.chi2.tolist()
    order = sorted((i for i in range(len(chi2)) if math.isfinite(chi2[i])), key=chi2.__getitem__)
    if len(order) == 2 and same_minimum(fit, *order):
        order.pop()
    residuals_px = _residuals_px(fit, views, px_per_ray)
    poses = np.zeros((len(chi2), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = fit.rotation, fit.translation_m, 1.0
    poses[:, 2, 3] -= home_depth_m
    found = []
    for i in order:
        covariance, open_direction = lapack.dpotri(lapack.dpotrf(fit.normal[i])[0])
        if open_direction == 0 and math.isfinite(covariance.sum() + residuals_px[i]):
            full = np.where(_UPPER, covariance, covariance.T)
            found.append(PoseCandidate(poses[i], full, chi2[i], residuals_px[i]))
    return found


def _residuals_px(fit: Fit, views: Views, px_per_ray: np.ndarray) -> list[float]:
    camera_m = fit.rotation @ views.points_m + fit.translation_m[:, :, None]
    error = camera_m[:, :2] / camera_m[:, 2:] - views.rays
    if px_per_ray.ndim == 2:
        error_px = px_per_ray * error
    else:
        error_px = (px_per_ray[0] * error[:, None]).sum(axis=2)
    return np.sqrt((error_px * error_px).sum(axis=(1, 2)) / error.shape[2]).tolist()


def _chosen(candidates: list[PoseCandidate], prior: Prior | None) -> PoseEstimate | Rejected:
    """Order the candidates by error, and by distance from the prior if there is one."""
    if len(candidates) == 1:
        return PoseEstimate(tuple(candidates), 0.0)
    cost = [candidate.chi2 for candidate in candidates]
    if prior is not None:
        try:
            cost = [c + d for c, d in zip(cost, _distances2(candidates, prior))]
        except np.linalg.LinAlgError:
            return Rejected('the covariance of the prior is not positive definite')
    if cost[1] < cost[0]:
        candidates = candidates[::-1]
    return PoseEstimate(tuple(candidates), math.exp(-0.5 * abs(cost[1] - cost[0])))


def _distances2(candidates: list[PoseCandidate], prior: Prior) -> list[float]:
    """Measure how far candidates are from the prior, in units of both covariances."""
    poses = np.array([candidate.home_from_object for candidate in candidates])
    spread = prior.covariance + np.array([candidate.covariance for candidate in candidates])
    difference = pose_difference(poses, prior.home_from_object)[..., None]
    whitened = np.linalg.solve(np.linalg.cholesky(spread), difference)
    return (whitened * whitened).sum(axis=(1, 2)).tolist()


_UPPER = np.triu(np.ones((6, 6), bool))
