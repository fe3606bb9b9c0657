"""
Reprojection errors of poses, and how they change: what a refinement works on.

Points run along the last axis, so that every operation is on rows of numbers. The six
unknowns are a small translation of the object's origin and a small rotation vector, both
along the camera's axes.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.stacks import crosses
from homography_servo.geometry.stacks import images
from homography_servo.geometry.stacks import laid_out
from homography_servo.geometry.stacks import product
from homography_servo.geometry.stacks import zeros
import numpy as np


class Views(NamedTuple):
    """
    What is to be explained: one object, and its measured points in M views.

    `whitener` turns ray errors into errors of unit variance: (2, 1) where it is the
    same scale for all points, or (1 or M, 2, 2, N) with rows, columns, points. `mixer`
    (2N, 2N) or None acts after it, where the errors of different points are correlated;
    it is ordered u_0 .. u_N, v_0 .. v_N.
    """

    points_m: np.ndarray  # (3, N)
    rays: np.ndarray  # (M, 2, N); one view serves any number of poses
    whitener: np.ndarray
    mixer: np.ndarray | None

    def take(self, index: np.ndarray) -> Views:
        """Select or repeat views."""
        shared = self.whitener.ndim == 2 or len(self.whitener) == 1
        whitener = self.whitener if shared else self.whitener[index]
        return self._replace(rays=laid_out(self.rays[index]), whitener=whitener)


class Fit(NamedTuple):
    """Poses (B, ...) of the object in the camera, with what was learnt at them."""

    rotation: np.ndarray  # (B, 3, 3)
    translation_m: np.ndarray  # (B, 3)
    chi2: np.ndarray  # (B,)
    normal: np.ndarray  # (B, 6, 6) inverse of the covariance
    gradient: np.ndarray  # (B, 6)
    residual: np.ndarray  # (B, 2N) whitened

    def take(self, index: np.ndarray) -> Fit:
        """Select poses."""
        return Fit(*(laid_out(value[index]) for value in self))


def linearise(views: Views, rotation: np.ndarray, translation_m: np.ndarray) -> Fit:
    """Evaluate chi squared, its gradient and the Gauss-Newton matrix at poses."""
    rows = residuals(views, rotation, translation_m)
    products = product(rows, rows.swapaxes(-1, -2))
    return Fit(rotation, translation_m, products[:, 6, 6], products[:, :6, :6],
               products[:, :6, 6], rows[:, 6])


def residuals(views: Views, rotation: np.ndarray, translation_m: np.ndarray) -> np.ndarray:
    """
    Give the whitened errors of reprojection and their derivatives.

    Parameters
    ----------
    views : Views
        One view, or B.
    rotation, translation_m : (B, 3, 3) and (B, 3) array
        The object in the camera.

    Returns
    -------
    (B, 7, 2N) array
        Rows 0 to 5: derivatives by translation and rotation vector along the camera's
        axes, the interaction matrix of visual servoing. Row 6: the errors, not finite
        where a point is not before the camera.

    """
    camera_m = images(rotation, views.points_m) + translation_m[:, :, None]
    inverse = 1.0 / np.maximum(camera_m[:, 2:], 0.0)
    image = camera_m[:, :2] * inverse
    square = image * image + 1.0
    rows = zeros(len(camera_m), 7, 2, camera_m.shape[2])
    rows[:, 0, 0] = rows[:, 1, 1] = inverse[:, 0]
    np.multiply(image, -inverse, out=rows[:, 2])
    u, v = image[:, 0], image[:, 1]
    np.multiply(u, v, out=rows[:, 4, 1])
    np.negative(rows[:, 4, 1], out=rows[:, 3, 0])
    np.negative(square[:, 1], out=rows[:, 3, 1])
    rows[:, 4, 0] = square[:, 0]
    np.negative(v, out=rows[:, 5, 0])
    rows[:, 5, 1] = u
    np.subtract(image, views.rays, out=rows[:, 6])
    rows = _whitened(views, rows).reshape(len(camera_m), 7, -1)
    # So far it turns about the camera; let it turn about the object's origin.
    rows[:, 3:6] -= product(crosses(translation_m), rows[:, :3])
    return rows


def _whitened(views: Views, rows: np.ndarray) -> np.ndarray:
    if views.whitener.ndim == 2:
        rows = rows * views.whitener
    else:
        by_u, by_v = views.whitener[:, None, :, 0], views.whitener[:, None, :, 1]
        rows = by_u * rows[:, :, :1] + by_v * rows[:, :, 1:]
    if views.mixer is None:
        return rows
    return rows.reshape(len(rows), 7, -1) @ views.mixer.T
