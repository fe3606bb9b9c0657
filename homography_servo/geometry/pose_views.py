"""What a camera measured, in the form that the refinement of a pose wants."""

from __future__ import annotations

from homography_servo.geometry.camera_model import Camera
from homography_servo.geometry.pose_residuals import Views
from homography_servo.result import Rejected
import numpy as np


def views_of(points_m: np.ndarray, image_px: np.ndarray, camera: Camera,
             covariance_px2: float | np.ndarray | None) -> tuple[Views, np.ndarray] | Rejected:
    """
    Turn measured pixels and their covariance into rays and whitening matrices.

    The lens is inverted once and the covariance goes through its derivative there. At
    the minimum ray and measurement are some pixels apart at most, over which the
    derivative of a lens does not change.

    Parameters
    ----------
    points_m : (N, 3) array
        The object.
    image_px : (M, N, 2) array
        Its points in M images.
    camera : Camera
        The camera.
    covariance_px2 : float, (N, 2, 2) or (2N, 2N) array, optional
        As for `estimate_pose`.

    Returns
    -------
    views : Views
        The measurements.
    px_per_ray : (2, 1) or (M, 2, 2, N) array
        Derivative of pixels by rays; the focal lengths where the lens does not bend.

    """
    rays = camera.rays(image_px)
    if camera.bends:
        with np.errstate(all='ignore'):  # of rays that do not exist; they are sorted out later
            slope = np.moveaxis(camera.jacobian(rays), 1, -1)
    else:
        slope = np.array([[camera.fx], [camera.fy]])
    noise = _noise(covariance_px2, len(points_m))
    if isinstance(noise, Rejected):
        return noise
    blocks, mixer = noise
    if blocks is None:
        whitener = slope
    elif blocks.ndim == 0:
        whitener = slope * blocks
    elif slope.ndim == 2:
        whitener = (blocks * slope[:, 0]).transpose(1, 2, 0)[None]
    else:
        whitener = np.einsum('kij,mjlk->milk', blocks, slope)
    return Views(points_m.T, rays.swapaxes(-1, -2), whitener, mixer), slope


def _noise(covariance_px2: float | np.ndarray | None, count: int
           ) -> tuple[np.ndarray | None, np.ndarray | None] | Rejected:
    """Give inverse Cholesky factors: a number, (N, 2, 2) or None, and (2N, 2N) or None."""
    if covariance_px2 is None:
        return None, None
    covariance = np.asarray(covariance_px2, float)
    if not np.isfinite(covariance).all():
        return Rejected('the covariance of the points is not finite')
    try:
        if covariance.shape == ():
            return (np.array(covariance ** -0.5), None) if covariance > 0.0 else _NOT_POSITIVE
        if covariance.shape == (count, 2, 2):
            return np.linalg.inv(np.linalg.cholesky(covariance)), None
        if covariance.shape == (2 * count, 2 * count):
            order = np.arange(2 * count).reshape(count, 2).T.ravel()
            factor = np.linalg.cholesky(covariance[np.ix_(order, order)])
            return None, np.linalg.inv(factor)
    except np.linalg.LinAlgError:
        return _NOT_POSITIVE
    raise ValueError(f'covariance_px2 must be a number or have shape ({count}, 2, 2) or '
                     f'({2 * count}, {2 * count}), got {covariance.shape}')


_NOT_POSITIVE = Rejected('the covariance of the points is not positive definite')
