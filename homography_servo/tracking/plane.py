"""The plane in which straight edges of the object are straight lines."""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
from homography_servo.result import required
import numpy as np

NEAREST_M = 1e-6  # depth of what can be projected


class Plane:
    """
    Pixels as an ideal camera with the same matrix would see them.

    Without a lens that bends, plane and image are the same.

    Parameters
    ----------
    camera : Camera or None
        None stands for an ideal one that nobody has calibrated.

    """

    def __init__(self, camera: Camera | None) -> None:
        self.camera = camera
        self.bent = camera is not None and camera.bends
        if camera is not None:
            self.focal = np.array([camera.fx, camera.fy])
            self.mean_focal = 0.5 * (camera.fx + camera.fy)
            self._centre = np.array([camera.cx, camera.cy])
        self._map: np.ndarray | None = None

    @property
    def lens(self) -> Camera:
        """Give the camera; ValueError where nobody has calibrated one."""
        return required(self.camera, 'calibrated camera')

    def fits(self, shape: tuple[int, ...]) -> bool:
        """Tell whether an image of this shape is one of the camera's."""
        return self.camera is None or (self.camera.height, self.camera.width) == tuple(shape)

    def from_image(self, points_px: np.ndarray) -> np.ndarray:
        """Straighten pixels (..., 2)."""
        if not self.bent:
            return points_px
        return self.lens.rays(points_px) * self.focal + self._centre

    def to_image(self, points: np.ndarray) -> np.ndarray:
        """Bend points (..., 2) of the plane to where the camera shows them."""
        if not self.bent:
            return points
        return self.lens.project_rays(self.rays(points))

    def rays(self, points: np.ndarray) -> np.ndarray:
        """Turn points (..., 2) of the plane into normalised coordinates."""
        return (points - self._centre) / self.focal

    def from_rays(self, rays: np.ndarray) -> np.ndarray:
        """Turn normalised coordinates (..., 2) into points of the plane."""
        return rays * self.focal + self._centre

    def rays_in_space(self, points: np.ndarray) -> np.ndarray:
        """Give the rays (..., 3) to points (..., 2) of the plane; their depth is 1."""
        return np.concatenate([self.rays(points), np.ones((*points.shape[:-1], 1))], axis=-1)

    def from_space(self, points_m: np.ndarray) -> np.ndarray:
        """Project points (..., 3) of the camera's frame; those behind it come out far away."""
        return self.from_rays(points_m[..., :2] / np.maximum(points_m[..., 2:], NEAREST_M))

    def rms_px(self, miss: np.ndarray) -> np.ndarray:
        """Give the RMS (...) of what coordinates (..., N, 2) of rays miss [px]."""
        square = np.einsum('...ij,...ij', miss, miss) / (2 * miss.shape[-2])
        return self.mean_focal * np.sqrt(square)

    def show(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bend a few points (N, 2) as `to_image`; differentiate them by those (N, 2, 2)."""
        pixels, slopes = self.lens.show(self.rays(points))
        slopes /= self.focal
        return pixels, slopes

    def to_image_with_covariance(self, points: np.ndarray, covariance: np.ndarray
                                 ) -> tuple[np.ndarray, np.ndarray]:
        """Bend a few points (N, 2) as `to_image`, and carry their covariance (2N, 2N) along."""
        if not self.bent:
            return points, covariance
        pixels, slopes = self.show(points)
        for _ in range(2):  # rows, then columns
            covariance = np.matmul(slopes, covariance.T.reshape(len(points), 2, -1)) \
                .reshape(covariance.shape)
        return pixels, covariance

    @property
    def map(self) -> np.ndarray:
        """Give the plane's point (H W, 2) of every pixel of the image; made on first use."""
        if self._map is None:
            grid = np.stack(np.meshgrid(np.arange(self.lens.width),
                                        np.arange(self.lens.height)), axis=-1)
            straight = self.from_image(grid.reshape(-1, 2).astype(float))
            # No ray reaches some pixels of a bad calibration: far away is harmless.
            self._map = np.where(np.isfinite(straight), straight, 1e6)
        return self._map
