"""Render the scene: exact edges, then lens blur, light and noise."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.simulation import surfaces
from homography_servo.simulation.box import BoxView
from homography_servo.simulation.box import FACE
from homography_servo.simulation.box import Outline
from homography_servo.simulation.coverage import bounding_region
from homography_servo.simulation.coverage import polygon_coverage
from homography_servo.simulation.coverage import Region
from homography_servo.simulation.face_print import FacePrint
from homography_servo.simulation.occluders import box_present
from homography_servo.simulation.occluders import occluder_polygon
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np


class Frame(NamedTuple):
    """One picture and its truth; corners and pose are None while the box is away."""

    image_grey: np.ndarray  # (H, W) uint8
    true_corners_px: np.ndarray | None  # (4, 2)
    true_camera_from_object: np.ndarray | None  # (4, 4)


class Layers(NamedTuple):
    """Outlines of everything that moves, nearest last."""

    shadow_px: np.ndarray | None
    faces: list[Outline]
    occluder_px: np.ndarray | None

    @property
    def points_px(self) -> np.ndarray:
        """Stack all vertices, to find where the picture changes."""
        parts = [outline.polygon_px for outline in self.faces]
        parts += [part for part in (self.shadow_px, self.occluder_px) if part is not None]
        return np.vstack(parts) if parts else np.zeros((0, 2))


class Scene:
    """
    The world in front of the fixed camera.

    The share of every pixel that each surface covers is computed exactly and mixed
    linearly, so the corners of `Frame` are the corners of the picture. Lens blur is a
    symmetric kernel over the mixed picture. Only the region of the box is rendered per
    frame; the background waits, blurred and lit, in a cache.

    Parameters
    ----------
    camera : Camera
        Lens and picture size.
    face_size_m : (float, float)
        Width and height of the face.
    box_height_m : float
        How far the box reaches behind the face; 0 is a plate.
    settings : SceneSettings
        Appearance.
    seed : int
        Decides clutter, print and noise.
    noise : NoiseStore, optional
        Noise shared with other scenes of the same size; saves its making.

    """

    def __init__(self, camera: Camera, face_size_m: tuple[float, float], box_height_m: float = 0.0,
                 settings: SceneSettings = SceneSettings(), seed: int = 0,
                 noise: surfaces.NoiseStore | None = None) -> None:
        self.camera = camera
        self.settings = settings
        self.box = BoxView(camera, face_size_m, box_height_m)
        self._seed = seed
        rngs = [np.random.default_rng([seed, part]) for part in range(3)]
        self._raw = surfaces.background(camera.width, camera.height, settings, rngs[0])
        self._light = surfaces.light_field(camera.width, camera.height, settings)
        self._still = self._lit(self._blurred(self._raw), self._whole)
        self._print = FacePrint(camera, face_size_m, settings, rngs[1]) \
            if settings.print_contrast > 0.0 else None
        self._noise = noise  # drawn when it is first needed: that takes a while
        self._noise_rng = rngs[2]

    @property
    def _whole(self) -> Region:
        return Region(0, 0, self.camera.width, self.camera.height)

    def render(self, camera_from_object: np.ndarray | None, time_s: float = 0.0,
               index: int = 0) -> Frame:
        """
        Take one picture.

        Parameters
        ----------
        camera_from_object : (4, 4) array or None
            Pose of the box; None shows the background alone.
        time_s : float
            Time of the scene, for flicker and for what comes and goes.
        index : int
            Number of the picture; picture and noise repeat with the same seed and index.

        Returns
        -------
        Frame

        """
        present = camera_from_object is not None and box_present(self.settings, time_s)
        pose = camera_from_object if present else None
        clean = self.clean(pose, time_s)
        if self._noise is None:
            self._noise = surfaces.NoiseStore(self.camera.width, self.camera.height,
                                              self._noise_rng)
        noise = self._noise.frame(np.random.default_rng([self._seed, 3, index]))
        image = cv2.addWeighted(clean, 1.0, noise, self.settings.noise_grey, 0.0,
                                dtype=cv2.CV_8U)
        return Frame(image, None if pose is None else self.corners(pose), pose)

    def corners(self, camera_from_object: np.ndarray) -> np.ndarray:
        """Project the corners of the face (4, 2), wherever they are."""
        return self.box.corners(camera_from_object)

    def clean(self, camera_from_object: np.ndarray | None, time_s: float = 0.0) -> np.ndarray:
        """Render without noise and rounding: (H, W) float32 grey levels."""
        canvas = self._still.copy()
        if camera_from_object is not None:
            layers = self.layers(camera_from_object, time_s)
            region = self.region(layers.points_px)
            if not region.empty:
                canvas[region.slices] = self.patch(layers, camera_from_object, region)
        gain = self.flicker(time_s)
        return canvas if gain == 1.0 else canvas * np.float32(gain)

    def layers(self, camera_from_object: np.ndarray, time_s: float = 0.0) -> Layers:
        """Find the outlines of shadow, visible faces and occluder."""
        settings, shadow_px = self.settings, None
        if settings.shadow > 0.0:
            slope = (settings.shadow_slope_x, settings.shadow_slope_y)
            shadow_px = self.box.shadow(camera_from_object, slope, settings.shadow_gap_m)
        occluder_px = None
        if settings.occluder != 'none':
            occluder_px = occluder_polygon(settings, self.corners(camera_from_object),
                                           self.camera.width, time_s)
        return Layers(shadow_px, self.box.outlines(camera_from_object), occluder_px)

    def region(self, points_px: np.ndarray) -> Region:
        """Enclose what the points can change, soft edges included."""
        if not len(points_px):
            return Region(0, 0, 0, 0)
        soft_px = self.settings.blur_px + (self.settings.shadow_softness_px
                                           if self.settings.shadow > 0.0 else 0.0)
        return bounding_region(points_px, self.camera.width, self.camera.height,
                               2 + math.ceil(4.0 * soft_px))

    def patch(self, layers: Layers, camera_from_object: np.ndarray, region: Region) -> np.ndarray:
        """Mix, blur and light one region; noise and flicker are left out."""
        pad = 1 + math.ceil(4.0 * self.settings.blur_px)
        wide = _grown(region, pad, self._whole)
        mixed = self._blurred(self._mixed(layers, camera_from_object, wide))
        top, left = region.top - wide.top, region.left - wide.left
        inner = mixed[top:top + region.height, left:left + region.width]
        return self._lit(inner, region)

    def _mixed(self, layers: Layers, camera_from_object: np.ndarray, region: Region) -> np.ndarray:
        behind = self._raw[region.slices].astype(np.float64)
        if layers.shadow_px is not None:
            behind *= 1.0 - self.settings.shadow * self._shadow_share(layers.shadow_px, region)
        mixed, free = np.zeros_like(behind), np.ones_like(behind)
        for outline in layers.faces:
            share = polygon_coverage(outline.polygon_px, region)
            free -= share
            mixed += share * self._level(outline.face, camera_from_object, region)
        mixed += np.maximum(free, 0.0) * behind
        if layers.occluder_px is not None:
            share = polygon_coverage(layers.occluder_px, region)
            mixed += share * (self.settings.occluder_level - mixed)
        return mixed.astype(np.float32)

    def _shadow_share(self, shadow_px: np.ndarray, region: Region) -> np.ndarray:
        share = polygon_coverage(shadow_px, region)
        soft_px = self.settings.shadow_softness_px
        return cv2.GaussianBlur(share, (0, 0), soft_px) if soft_px > 0.05 else share

    def _level(self, face: int, camera_from_object: np.ndarray,
               region: Region) -> float | np.ndarray:
        if face == FACE and self._print is not None:
            return self._print.levels(camera_from_object, region)
        settings = self.settings
        return (settings.face_level, *settings.side_levels, settings.back_level)[face]

    def _blurred(self, image: np.ndarray) -> np.ndarray:
        sigma = self.settings.blur_px
        if sigma < 0.05:
            return image
        size = 1 + 2 * math.ceil(4.0 * sigma)
        return cv2.GaussianBlur(image, (size, size), sigma)

    def _lit(self, image: np.ndarray, region: Region) -> np.ndarray:
        return image if self._light is None else image * self._light[region.slices]

    def flicker(self, time_s: float) -> float:
        """Give the relative strength of the light at a time."""
        settings = self.settings
        return 1.0 + settings.flicker * math.sin(2.0 * math.pi * settings.flicker_hz * time_s)


def _grown(region: Region, pad: int, limits: Region) -> Region:
    left, top = max(region.left - pad, 0), max(region.top - pad, 0)
    right = min(region.left + region.width + pad, limits.width)
    bottom = min(region.top + region.height + pad, limits.height)
    return Region(left, top, right - left, bottom - top)
