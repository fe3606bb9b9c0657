"""
What Gauss-Newton leaves out: the curvature of the projection itself.

Where errors are large, as in the wrong one of two minima, Gauss-Newton creeps; with
these terms it becomes Newton's method and arrives. They cost as much as the rest of a
step, so `pose_refine` adds them only to poses that are slow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from homography_servo.geometry.pose_refine import Views


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
    turned = rotation @ views.points_m
    camera_m = turned + translation_m[:, :, None]
    depth = camera_m[:, 2:]
    pull = _unwhitened(views, residual.reshape(len(turned), 2, -1))
    # Force on every point: the gradient of half of chi squared by its position.
    along = -(pull * camera_m[:, :2]).sum(axis=1, keepdims=True) / depth
    force = np.concatenate([pull, along], axis=1) / depth
    axis = np.zeros_like(force)
    axis[:, 2] = 1.0
    # Position enters through 1 / Z: second derivative -(force axis' + axis force') / Z.
    mixed = _wrench(turned, force / depth) @ _wrench(turned, axis).swapaxes(-1, -2)
    second = -mixed - mixed.swapaxes(-1, -2)
    # A rotation vector moves a point on an arc: second derivative of the arc times force.
    arc = force @ turned.swapaxes(-1, -2)
    second[:, 3:, 3:] += 0.5 * (arc + arc.swapaxes(-1, -2))
    second[:, 3:, 3:] -= np.trace(arc, axis1=1, axis2=2)[:, None, None] * np.eye(3)
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
    x, y, z = (arm[:, i] for i in range(3))
    fx, fy, fz = (force[:, i] for i in range(3))
    moment = np.stack([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx], axis=1)
    return np.concatenate([force, moment], axis=1)
