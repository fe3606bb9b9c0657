"""
Pose from four corners: accuracy against the Cramer-Rao bound, wrong minima, speed.

Random poses of a 0.10 x 0.06 m face seen with f = 800 px: tilt to 60 deg, any gamma,
depth 0.7 to 1.3 m, all corners in the image; Gaussian corner noise. A result counts as
the wrong minimum when its orientation is nearer to the mirror image of the truth about
the line of sight than to the truth, and noise about the truth does not explain it: it
lies outside the 99.9 % region of the Cramer-Rao bound. (Seen nearly face on, truth and
mirror image are one minimum; there is no wrong one to choose.) Errors over the bound
leave wrong minima out: root mean square error over the root mean trace of the inverse
Fisher information at the truth.
"""

from __future__ import annotations

import time
from typing import Any

import cv2
from homography_servo.experiments.benchmarks.pose_methods import HOME_DEPTH_M
from homography_servo.experiments.benchmarks.pose_methods import Method
from homography_servo.experiments.benchmarks.pose_methods import methods
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.decomposition import compose
from homography_servo.geometry.decomposition import decompose
from homography_servo.geometry.decomposition import parameters_from_pose
from homography_servo.geometry.face import face_corners
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.pose import Prior
from homography_servo.geometry.pose_batch import estimate_poses
from homography_servo.geometry.pose_residuals import linearise
from homography_servo.geometry.pose_start import mirrored_rotation
from homography_servo.geometry.pose_start import shape_of
from homography_servo.geometry.pose_views import views_of
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import pose_difference
from homography_servo.geometry.rigid import rotation_angle
from homography_servo.geometry.rigid import transform
from homography_servo.geometry.rigid import transform_points
import numpy as np
from scipy.spatial.transform import Rotation

OURS = 'homography_servo'
CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
FACE_M = face_corners(0.10, 0.06)
NOISE_PX = (0.1, 0.3, 1.0)
PRIOR_OFF_DEG, PRIOR_OFF_M = 5.0, 0.01
_CHI2_3_999 = 16.27  # 99.9 % of chi squared with three degrees of freedom


def run(quick: bool, seed: int) -> list[dict[str, Any]]:
    """Measure all methods in the same run, on the same corners."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(seed)
    truth, tilt_deg = random_poses(rng, 300 if quick else 10_000)
    rows: list[dict[str, Any]] = []
    for noise_px in NOISE_PX:
        rows += _rows_at(rng, truth, tilt_deg, noise_px)
    return rows + _speed_rows(rng)


def random_poses(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw poses (M, 4, 4) with all corners in the image, and their tilts [deg]."""
    kept, tilts = [], []
    while sum(map(len, kept)) < count:
        poses, tilt_deg = _draw(rng, count)
        inside = CAMERA.contains(_corners(poses), 10.0).all(axis=1)
        kept.append(poses[inside])
        tilts.append(tilt_deg[inside])
    return np.concatenate(kept)[:count], np.concatenate(tilts)[:count]


def _draw(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    tilt_deg, towards = rng.uniform(0.0, 60.0, count), rng.uniform(-np.pi, np.pi, count)
    axis = np.stack([np.cos(towards), np.sin(towards), np.zeros(count)], axis=1)
    gamma = np.stack([np.zeros(count), np.zeros(count), rng.uniform(-np.pi, np.pi, count)], 1)
    rotation = Rotation.from_rotvec(axis * np.radians(tilt_deg)[:, None]) \
        * Rotation.from_rotvec(gamma)
    depth_m = rng.uniform(0.7, 1.3, count)
    centre_px = rng.uniform((0.0, 0.0), (CAMERA.width, CAMERA.height), (count, 2))
    across_m = CAMERA.rays(centre_px) * depth_m[:, None]
    origin_m = np.column_stack([across_m, depth_m - HOME_DEPTH_M])
    return transform(rotation.as_matrix(), origin_m), tilt_deg


def _corners(poses: np.ndarray) -> np.ndarray:
    return CAMERA.project(transform_points(poses, FACE_M) + (0.0, 0.0, HOME_DEPTH_M))


def _rows_at(rng: np.random.Generator, truth: np.ndarray, tilt_deg: np.ndarray,
             noise_px: float) -> list[dict[str, Any]]:
    corners_px = _corners(truth)
    corners_px = corners_px + noise_px * rng.normal(size=corners_px.shape)
    off = rng.normal(size=(2, len(truth), 3))
    off /= np.linalg.norm(off, axis=2, keepdims=True)
    scale = np.repeat([PRIOR_OFF_M, np.radians(PRIOR_OFF_DEG)], 3)
    believed = displaced(truth, np.concatenate(list(off), axis=1) * scale)
    bound = crlb(truth, noise_px)
    # An offset of this length in a random direction has a third of its square on each axis.
    results = _results(corners_px, believed, np.diag(scale**2 / 3.0), noise_px)
    rows = []
    for case, chosen in ((f'noise {noise_px} px', tilt_deg >= 0.0),
                         (f'noise {noise_px} px, tilt 20-60 deg', tilt_deg >= 20.0)):
        rows += [_row(name, case, result, truth, bound, chosen) for name, result in
                 results.items()]
    return rows


def crlb(truth: np.ndarray, noise_px: float) -> np.ndarray:
    """Give the Cramer-Rao bounds (M, 6, 6): the inverse Fisher information at the truth."""
    views, _ = views_of(FACE_M, _corners(truth), CAMERA, noise_px**2)
    translation_m = truth[:, :3, 3] + (0.0, 0.0, HOME_DEPTH_M)
    return np.linalg.inv(linearise(views, truth[:, :3, :3], translation_m).normal)


class _Result:
    """What one method gave for all corners; nan where it gave nothing."""

    def __init__(self, count: int) -> None:
        self.poses = np.full((count, 4, 4), np.nan)
        self.covariance = np.full((count, 6, 6), np.nan)
        self.time_us = np.zeros(count)
        self.minima = np.zeros(count, int)


def _results(corners_px: np.ndarray, believed: np.ndarray, prior_covariance: np.ndarray,
             noise_px: float) -> dict[str, _Result]:
    peers = methods(FACE_M, CAMERA)
    with_prior = f'{OURS}, prior {PRIOR_OFF_DEG:g} deg off'
    results = {name: _Result(len(corners_px)) for name in (OURS, with_prior, *peers)}
    for i, corners in enumerate(corners_px):
        prior = Prior(believed[i], prior_covariance)
        _ours(results[OURS], i, corners, noise_px**2, None)
        _ours(results[with_prior], i, corners, noise_px**2, prior)
        for name, method in peers.items():
            _peer(results[name], i, corners, method)
    return results


def _ours(result: _Result, i: int, corners_px: np.ndarray, variance_px2: float,
          prior: Prior | None) -> None:
    began_s = time.perf_counter()
    estimate = estimate_pose(FACE_M, corners_px, CAMERA, HOME_DEPTH_M, variance_px2, prior)
    result.time_us[i] = 1e6 * (time.perf_counter() - began_s)
    if estimate:
        result.poses[i], result.covariance[i] = estimate.home_from_object, estimate.covariance
        result.minima[i] = len(estimate.candidates)


def _peer(result: _Result, i: int, corners_px: np.ndarray, method: Method) -> None:
    began_s = time.perf_counter()
    pose = method(corners_px)
    result.time_us[i] = 1e6 * (time.perf_counter() - began_s)
    if pose is not None:
        result.poses[i] = pose


def _row(name: str, case: str, result: _Result, truth: np.ndarray, bound: np.ndarray,
         chosen: np.ndarray) -> dict[str, Any]:
    found = chosen & np.isfinite(result.poses).all(axis=(1, 2))
    poses, truth, bound = result.poses[found], truth[found], bound[found]
    error = pose_difference(poses, truth)
    right = ~wrong_minimum(poses, truth, bound)
    rotation_deg = np.degrees(np.linalg.norm(error[:, 3:], axis=1))
    translation_mm = 1e3 * np.linalg.norm(error[:, :3], axis=1)
    row = {'method': name, 'case': case, 'poses': int(chosen.sum()),
           'failed_share': 1.0 - found.sum() / chosen.sum(),
           'rotation_error_deg_median': np.median(rotation_deg),
           'rotation_error_deg_p95': np.percentile(rotation_deg, 95),
           'translation_error_mm_median': np.median(translation_mm),
           'translation_error_mm_p95': np.percentile(translation_mm, 95),
           'wrong_minimum_share': 1.0 - right.mean(),
           'rms_over_bound_rotation': _over_bound(error[right, 3:], bound[right, 3:, 3:]),
           'rms_over_bound_translation': _over_bound(error[right, :3], bound[right, :3, :3]),
           'time_us_median': np.median(result.time_us[chosen])}
    covariance = result.covariance[found][right]
    if np.isfinite(covariance).all():
        whitened = np.linalg.solve(covariance, error[right][..., None])[..., 0]
        row['nees_mean'] = (whitened * error[right]).sum(axis=1).mean()
        row['both_minima_share'] = (result.minima[found] == 2).mean()
    return row


def wrong_minimum(poses: np.ndarray, truth: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Tell which poses are flips: nearer to the mirror image, and not by noise."""
    sight = truth[:, :3, 3] + (0.0, 0.0, HOME_DEPTH_M)
    mirror = mirrored_rotation(truth[:, :3, :3], sight, shape_of(FACE_M))
    back = poses[:, :3, :3].swapaxes(-1, -2)
    nearer = rotation_angle(mirror @ back) < rotation_angle(truth[:, :3, :3] @ back)
    turn = pose_difference(poses, truth)[:, 3:]
    distance2 = (np.linalg.solve(bound[:, 3:, 3:], turn[..., None])[..., 0] * turn).sum(axis=1)
    return nearer & (distance2 > _CHI2_3_999)


def _over_bound(error: np.ndarray, bound: np.ndarray) -> float:
    mean_square = (error**2).sum(axis=1).mean()
    return float(np.sqrt(mean_square / np.trace(bound, axis1=1, axis2=2).mean()))


def _speed_rows(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Time what the table above does not: a batch, and the parameters of a homography."""
    truth, _ = random_poses(rng, 1000)
    corners_px = _corners(truth)
    corners_px = corners_px + 0.3 * rng.normal(size=corners_px.shape)
    batch_us = [_elapsed_us(lambda: estimate_poses(
        FACE_M, corners_px, CAMERA, HOME_DEPTH_M, 0.09)) / len(truth) for _ in range(11)]
    homographies = [compose(parameters_from_pose(pose, HOME_DEPTH_M)) for pose in truth]
    single_us = [_elapsed_us(lambda: decompose(each)) for each in homographies]
    return [{'method': OURS, 'case': 'batch of 1000, each', 'poses': len(truth),
             'time_us_median': np.median(batch_us)},
            {'method': OURS, 'case': 'six parameters of a homography', 'poses': len(truth),
             'time_us_median': np.median(single_us)}]


def _elapsed_us(work) -> float:
    began_s = time.perf_counter()
    work()
    return 1e6 * (time.perf_counter() - began_s)
