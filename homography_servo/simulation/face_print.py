"""The print on the face, looked up through the lens."""

from __future__ import annotations

import math

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.simulation.coverage import Region
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.simulation.surfaces import PRINT_TEXELS_PER_M
from homography_servo.simulation.surfaces import print_texture
import numpy as np


class FacePrint:
    """Samples the printed sheet at the pixels of a region."""

    def __init__(self, camera: Camera, face_size_m: tuple[float, float], settings: SceneSettings,
                 rng: np.random.Generator) -> None:
        self._size_m = np.array(face_size_m)
        self._levels = print_texture(face_size_m, settings, rng)
        self._focal_px = camera.fx
        grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
        self._rays = camera.rays(grid.reshape(-1, 2).astype(float)).reshape(grid.shape)

    def levels(self, camera_from_object: np.ndarray, region: Region) -> np.ndarray:
        """Give the grey level of the face's plane at each pixel of a region."""
        plane = camera_from_object[:, [0, 1, 3]][:3]
        rays = self._rays[region.slices]
        mapped = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1) \
            @ np.linalg.inv(plane).T
        on_face_m = mapped[..., :2] / np.where(np.abs(mapped[..., 2:]) < 1e-9, 1e-9,
                                               mapped[..., 2:])
        sheet = self._sheet(camera_from_object[2, 3])
        texels = (on_face_m / self._size_m + 0.5) * sheet.shape[::-1] - 0.5
        texels = np.clip(texels, -1.0, np.array(sheet.shape[::-1]) + 1.0).astype(np.float32)
        return cv2.remap(sheet, texels[..., 0], texels[..., 1], cv2.INTER_LINEAR,
                         borderMode=cv2.BORDER_REPLICATE)

    def _sheet(self, depth_m: float) -> np.ndarray:
        """Choose the copy whose texels are about as large as the pixels."""
        texels_per_px = PRINT_TEXELS_PER_M * depth_m / self._focal_px
        level = round(math.log2(max(texels_per_px, 1.0)))
        return self._levels[min(max(level, 0), len(self._levels) - 1)]
