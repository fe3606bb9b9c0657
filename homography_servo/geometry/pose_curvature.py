"""
What Gauss-Newton leaves out: the curvature of the projection itself.

Where errors are large, as in the wrong one of two minima, Gauss-Newton creeps; with
these terms it becomes Newton's method and arrives. They cost as much as the rest of a
step, so `pose_refine` adds them only to poses that are slow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from homography_servo.geometry.stacks import images
from homography_servo.geometry.stacks import product
from homography_servo.geometry.stacks import zeros
import numpy as np

if TYPE_CHECKING:
    from homography_servo.geometry.pose_residuals import Views


def curvature(views: Views, rotation: np.ndarray, translation_m: np.ndarray,
              residual: np.ndarray) -> np.ndarray:
    """
    Give the second derivatives of half of chi squared beyond the Gauss-Newton matrix.

    Parameters
    ----------
    views : Views
        One view, or B.
    rotation, translation_m : (B, 3, 3) and (B, 3) array
        The object in the camera.
    residual : (B, 2N) array
        The whitened errors there.

    Returns
    -------
    (B, 6, 6) array
        By translation and rotation vector along the camera's axes.

    """
    turned = images(rotation, views.points_m)
    camera_m = turned + translation_m[:, :, None]
    depth = camera_m[:, 2:]
    pull = _unwhitened(views, residual.reshape(len(turned), 2, -1))
    # Force on every point: the gradient of half of chi squared by its position.
    along = -(pull * camera_m[:, :2]).sum(axis=1, keepdims=True) / depth
    force = np.concatenate([pull, along], axis=1) / depth
    # Position enters through 1 / Z: second derivative -(force axis' + axis force') / Z.
    mixed = product(_wrench(turned, force / depth), _axial_wrench(turned).swapaxes(-1, -2))
    second = -mixed - mixed.swapaxes(-1, -2)
    # A rotation vector moves a point on an arc: second derivative of the arc times force.
    arc = product(force, turned.swapaxes(-1, -2))
    second[:, 3:, 3:] += 0.5 * (arc + arc.swapaxes(-1, -2))
    second[:, 3:, 3:] -= np.einsum('bii->b', arc)[:, None, None] * _EYE
    return second


def _unwhitened(views: Views, residual: np.ndarray) -> np.ndarray:
    """Apply the transposed whitening: the derivative by rays, (B, 2, N)."""
    if views.mixer is not None:
        flat = residual.reshape(len(residual), -1) @ views.mixer
        residual = flat.reshape(residual.shape)
    if views.whitener.ndim == 2:
        return residual * views.whitener
    return (views.whitener * residual[:, :, None]).sum(axis=1)


def _wrench(arm: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Give force and moment (B, 6, N) of forces (B, 3, N) that act at arms (B, 3, N)."""
    wrench = zeros(len(arm), 6, arm.shape[2])
    wrench[:, :3] = force
    wrench[:, 3:] = arm[:, _YZX] * force[:, _ZXY] - arm[:, _ZXY] * force[:, _YZX]
    return wrench


def _axial_wrench(arm: np.ndarray) -> np.ndarray:
    """Do as `_wrench` for forces of one along the optical axis."""
    wrench = zeros(len(arm), 6, arm.shape[2])
    wrench[:, 2] = 1.0
    wrench[:, 3] = arm[:, 1]
    np.negative(arm[:, 0], out=wrench[:, 4])
    return wrench


_EYE = np.eye(3)
_YZX, _ZXY = np.array([1, 2, 0]), np.array([2, 0, 1])
