"""Poses of one object in many images at once, for simulations and statistics."""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.camera_model import Camera
from homography_servo.geometry.pose import checked_points
from homography_servo.geometry.pose import solid_starts
from homography_servo.geometry.pose_refine import refine
from homography_servo.geometry.pose_refine import SAME_MINIMUM
from homography_servo.geometry.pose_residuals import Fit
from homography_servo.geometry.pose_residuals import Views
from homography_servo.geometry.pose_start import planar_starts
from homography_servo.geometry.pose_start import Shape
from homography_servo.geometry.pose_start import shape_of
from homography_servo.geometry.pose_views import views_of
from homography_servo.geometry.rigid import transform
from homography_servo.geometry.stacks import inverse_positive
from homography_servo.result import Rejected
import numpy as np


class PoseStack(NamedTuple):
    """
    Poses in M images, both minima of each, the smaller error first.

    Where ``minima`` is 1 both of a pair are the same; where it is 0 no pose was found
    and the numbers of that image are ``nan``.
    """

    home_from_object: np.ndarray  # (M, 2, 4, 4)
    covariance: np.ndarray  # (M, 2, 6, 6)
    chi2: np.ndarray  # (M, 2)
    minima: np.ndarray  # (M,) 0, 1 or 2
    ambiguity: np.ndarray  # (M,) as in `PoseEstimate`, without a prior


def estimate_poses(object_points_m: np.ndarray, image_points_px: np.ndarray, camera: Camera,
                   home_depth_m: float = 1.0,
                   covariance_px2: float | np.ndarray | None = None) -> PoseStack | Rejected:
    """
    Estimate the pose of one object in many images.

    Parameters
    ----------
    object_points_m : (N, 3) array
        Points of the object, N >= 4.
    image_points_px : (M, N, 2) array
        Where they are seen.
    camera, home_depth_m, covariance_px2
        As for `estimate_pose`; the covariance is that of every image.

    Returns
    -------
    PoseStack or Rejected
        Rejected when the object or the covariance cannot be used for any image.

    """
    points, image = checked_points(object_points_m, image_points_px, home_depth_m)
    if image.ndim != 3:
        raise ValueError(f'image_points_px must have shape (M, N, 2), got {image.shape}')
    if len(points) < 4:
        return Rejected(f'need 4 points, have {len(points)}')
    shape = shape_of(points)
    if isinstance(shape, Rejected):
        return shape
    seen = views_of(points, image, camera, covariance_px2)
    if isinstance(seen, Rejected):
        return seen
    views, _ = seen
    good = np.flatnonzero(np.isfinite(views.rays).all(axis=(1, 2)))
    with np.errstate(all='ignore'):
        good, rotation, translation_m = _starts(shape, views.take(good), good)
    if len(good) == 0:
        return _empty(len(image))
    both = np.concatenate([good, good])
    fit = refine(views.take(both), rotation, translation_m)
    return _stack(fit, good, len(image), home_depth_m)


def _starts(shape: Shape, views: Views, index: np.ndarray
            ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give the images that have starts, then all first starts followed by all second ones."""
    if not shape.flat:
        found = [(i, start) for i, rays in zip(index, views.rays)
                 if not isinstance(start := solid_starts(shape, views.points_m, rays), Rejected)]
        good = np.array([i for i, _ in found], int)
        pairs = [np.array([start[k] for _, start in found]) for k in (0, 1)]
        rotation = pairs[0].reshape(-1, 2, 3, 3).swapaxes(0, 1)
        return good, rotation.reshape(-1, 3, 3), pairs[1].reshape(-1, 2, 3).swapaxes(0, 1).reshape(
            -1, 3)
    rotation, centre_m, fault = planar_starts(shape, views.rays)
    well = (fault == 0) & np.isfinite(rotation).all(axis=(0, 2, 3))
    rotation = rotation[:, well]
    translation_m = centre_m[well] - rotation @ shape.centre_m
    return index[well], rotation.reshape(-1, 3, 3), translation_m.reshape(-1, 3)


def _stack(fit: Fit, good: np.ndarray, count: int, home_depth_m: float) -> PoseStack:
    half = len(good)
    swap = fit.chi2[half:] < fit.chi2[:half]
    first = np.arange(half) + half * swap
    second = np.arange(half) + half * ~swap
    exists = np.isfinite(fit.chi2[first])
    distinct = exists & np.isfinite(fit.chi2[second]) & ~_same(fit, first, second)
    stack = _empty(count)
    with np.errstate(all='ignore'):
        covariance = inverse_positive(fit.normal)
    pose = transform(fit.rotation, fit.translation_m - (0.0, 0.0, home_depth_m))
    found = good[exists]
    for column, index in ((0, first), (1, np.where(distinct, second, first))):
        stack.home_from_object[found, column] = pose[index[exists]]
        stack.covariance[found, column] = covariance[index[exists]]
        stack.chi2[found, column] = fit.chi2[index[exists]]
    stack.minima[found] = 1 + distinct[exists]
    likelihood_ratio = np.exp(-0.5 * (stack.chi2[found, 1] - stack.chi2[found, 0]))
    stack.ambiguity[found] = np.where(distinct[exists], likelihood_ratio, 0.0)
    return stack


def _empty(count: int) -> PoseStack:
    pose, covariance, chi2 = (np.full((count, *size), np.nan)
                              for size in ((2, 4, 4), (2, 6, 6), (2,)))
    return PoseStack(pose, covariance, chi2, np.zeros(count, int), np.full(count, np.nan))


def _same(fit: Fit, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Tell which pairs of fits are one minimum, by the rule of `same_minimum`."""
    turn = fit.rotation[first] @ fit.rotation[second].swapaxes(-1, -2)
    axial = turn - turn.swapaxes(-1, -2)
    difference = np.concatenate([
        fit.translation_m[first] - fit.translation_m[second],
        0.5 * np.stack([axial[:, 2, 1], axial[:, 0, 2], axial[:, 1, 0]], axis=1)], axis=1)
    distance2 = np.einsum('bi,bij,bj->b', difference, fit.normal[first], difference)
    return (np.trace(turn, axis1=1, axis2=2) > 1.0) & (distance2 < SAME_MINIMUM)
