"""
A pinhole camera with the lens models of sensor_msgs/CameraInfo.

Pixels are (u, v); the centre of the top left pixel is (0, 0). Normalised
coordinates are (X / Z, Y / Z) in the camera's optical frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Sequence

from homography_servo.geometry.distortion import Model
from homography_servo.geometry.distortion import MODELS
from homography_servo.geometry.distortion import reach
from homography_servo.geometry.distortion import undistort
from homography_servo.result import Rejected
import numpy as np


@dataclass(frozen=True)
class Camera:
    """Focal lengths and principal point [px], image size [px] and lens distortion."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion_model: str = 'plumb_bob'
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, 'distortion', tuple(float(k) for k in self.distortion))
        problem = _problem(self)
        if problem:
            raise ValueError(problem)
        if not self.bends:
            object.__setattr__(self, 'distortion', ())  # zeros and none are the same lens

    @cached_property
    def matrix(self) -> np.ndarray:
        """Give the intrinsic matrix K (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def bends(self) -> bool:
        """Tell whether the lens distorts at all."""
        return any(self.distortion) or self.distortion_model == 'equidistant'

    def project(self, points_camera_m: np.ndarray) -> np.ndarray:
        """
        Project points of the optical frame.

        Parameters
        ----------
        points_camera_m : (..., 3) array
            Points in the camera's optical frame.

        Returns
        -------
        (..., 2) array
            Pixels; ``inf`` for points at or behind the focal plane.

        """
        points = _last_axis(points_camera_m, 3, 'points_camera_m')
        depth = points[..., 2:]
        ahead = depth > 0.0
        rays = np.where(ahead, points[..., :2] / np.where(ahead, depth, 1.0), np.nan)
        pixels = self.project_rays(rays)
        return np.where(ahead, pixels, np.inf)

    def project_rays(self, rays: np.ndarray) -> np.ndarray:
        """Turn ideal rays (..., 2) into pixels (..., 2); ``inf`` beyond where the lens holds."""
        rays = _last_axis(rays, 2, 'rays')
        if not self.bends:
            return rays * self._focal + self._centre
        bent, _ = self._model.distort(rays[..., 0], rays[..., 1], self._coefficients)
        return self._within(rays, np.stack(bent, axis=-1) * self._focal + self._centre)

    def show(self, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Turn a few ideal rays into pixels, and differentiate these.

        In plain floats: for so few numbers what numpy costs is the number of calls.

        Parameters
        ----------
        rays : (N, 2) array
            Ideal normalised coordinates.

        Returns
        -------
        (N, 2) array, (N, 2, 2) array
            Pixels, ``inf`` beyond where the lens holds; their derivatives by the rays.

        """
        distort, k, reach_squared = self._model.distort, self._coefficients, self._reach ** 2
        pixels, slopes = [], []
        for x, y in rays.tolist():
            (u, v), (u_x, u_y, v_y) = distort(x, y, k)
            if x * x + y * y > reach_squared:
                u = v = math.inf
            pixels.append((self.fx * u + self.cx, self.fy * v + self.cy))
            slopes.append((self.fx * u_x, self.fx * u_y, self.fy * u_y, self.fy * v_y))
        return np.array(pixels), np.array(slopes).reshape(-1, 2, 2)

    def rays(self, points_px: np.ndarray) -> np.ndarray:
        """
        Turn pixels into ideal normalised coordinates.

        Parameters
        ----------
        points_px : (..., 2) array
            Pixels as measured, distorted.

        Returns
        -------
        (..., 2) array
            (X / Z, Y / Z); ``inf`` for pixels that no ray reaches through this lens.

        """
        bent = (_last_axis(points_px, 2, 'points_px') - self._centre) / self._focal
        if not self.bends:
            return bent
        rays = undistort(self._model, bent, self._coefficients)
        return self._within(rays, rays)

    def jacobian(self, rays: np.ndarray) -> np.ndarray:
        """Differentiate pixels by ideal normalised coordinates (..., 2): (..., 2, 2)."""
        rays = _last_axis(rays, 2, 'rays')
        if not self.bends:
            return np.broadcast_to(np.diag(self._focal), (*rays.shape, 2))
        _, (u_x, u_y, v_y) = self._model.distort(rays[..., 0], rays[..., 1], self._coefficients)
        slope = np.stack([u_x, u_y, u_y, v_y], axis=-1).reshape(*rays.shape, 2)
        return self._focal[:, None] * slope

    def contains(self, points_px: np.ndarray, margin_px: float = 0.0) -> np.ndarray:
        """Tell which pixels (..., 2) lie inside the image, ``margin_px`` from its edge."""
        points = _last_axis(points_px, 2, 'points_px')
        last = np.array([self.width - 1.0, self.height - 1.0])
        return np.all((points >= margin_px) & (points <= last - margin_px), axis=-1)

    def _within(self, rays: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Keep values whose rays the lens model holds for."""
        squared = (rays * rays).sum(axis=-1, keepdims=True)
        return np.where(squared <= self._reach**2, values, np.inf)

    @cached_property
    def _reach(self) -> float:
        return reach(self._model, self._coefficients)

    @cached_property
    def _model(self) -> Model:
        return MODELS[self.distortion_model]

    @cached_property
    def _coefficients(self) -> tuple[float, ...]:
        return self.distortion or (0.0,) * self._model.lengths[-1]

    @cached_property
    def _focal(self) -> np.ndarray:
        return np.array([self.fx, self.fy])

    @cached_property
    def _centre(self) -> np.ndarray:
        return np.array([self.cx, self.cy])


def camera_from_calibration(width: int, height: int, k: Sequence[float], d: Sequence[float] = (),
                            model: str = 'plumb_bob') -> Camera | Rejected:
    """
    Build a camera from the fields of a CameraInfo message.

    Parameters
    ----------
    width, height : int
        Image size [px].
    k : (9,) sequence
        Intrinsic matrix by rows; k[0] = 0 means uncalibrated in ROS.
    d : sequence
        Distortion coefficients; empty for none.
    model : str
        `plumb_bob`, `rational_polynomial` or `equidistant`; may be empty without ``d``.

    Returns
    -------
    Camera or Rejected
        The reason is a sentence for people.

    """
    k = [float(number) for number in np.ravel(k)]
    if len(k) != 9:
        raise ValueError(f'k must have 9 numbers, got {len(k)}')
    if k[0] == 0.0:
        return Rejected('the camera is not calibrated: k[0] (the focal length) is 0 in its '
                        'camera_info; calibrate it and publish the result')
    if abs(k[1]) > 1e-6 * abs(k[0]):
        return Rejected(f'k[1] (skew) must be 0, got {k[1]:g}')
    if not model and not any(d):
        model = 'plumb_bob'
    try:
        return Camera(k[0], k[4], k[2], k[5], int(width), int(height), model, tuple(d))
    except ValueError as error:
        return Rejected(str(error))


def _problem(camera: Camera) -> str | None:
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    if not np.isfinite(numbers).all():
        return f'camera parameters must be finite, got {numbers}'
    if not (camera.fx > 0.0 and camera.fy > 0.0):
        return f'focal lengths must be > 0 px, got fx={camera.fx}, fy={camera.fy}'
    if camera.width < 1 or camera.height < 1:
        return f'the image must have a size, got {camera.width} x {camera.height} px'
    if camera.distortion_model not in MODELS:
        return (f'distortion_model must be one of {", ".join(MODELS)}, '
                f'got {camera.distortion_model!r}')
    lengths = MODELS[camera.distortion_model].lengths
    if len(camera.distortion) not in lengths:
        return (f'{camera.distortion_model} takes {" or ".join(map(str, lengths))} '
                f'coefficients, got {len(camera.distortion)}')
    return None


def _last_axis(points: np.ndarray, size: int, name: str) -> np.ndarray:
    points = np.asarray(points, float)
    if points.shape[-1:] != (size,):
        raise ValueError(f'{name} must have shape (..., {size}), got {points.shape}')
    return points
