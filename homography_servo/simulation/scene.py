"""Render the scene: exact edges, then lens blur, light and noise."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.simulation import lens
from homography_servo.simulation import surfaces
from homography_servo.simulation.box import BoxView
from homography_servo.simulation.box import FACE
from homography_servo.simulation.box import Outline
from homography_servo.simulation.coverage import bounding_region
from homography_servo.simulation.coverage import polygon_coverages
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
        self._fineness = lens.fineness(settings.blur_px)
        still = self._blurred(lens.enlarged(self._raw, self._fineness))
        self._still = self._lit(still, self._whole)
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
        if self._noise is None:
            self._noise = surfaces.NoiseStore(self.camera.width, self.camera.height,
                                              self._noise_rng)
        noise = self._noise.frame(np.random.default_rng([self._seed, 3, index]))
        image = self._exposed(self._still, noise, time_s)
        drawn = self._drawn(pose, time_s)
        if drawn is not None:
            region, patch = drawn
            image[region.slices] = self._exposed(patch, noise[region.slices], time_s)
        return Frame(image, None if pose is None else self.corners(pose), pose)

    def _exposed(self, clean: np.ndarray, noise: np.ndarray, time_s: float) -> np.ndarray:
        return cv2.addWeighted(clean, self.flicker(time_s), noise, self.settings.noise_grey, 0.0,
                               dtype=cv2.CV_8U)

    def corners(self, camera_from_object: np.ndarray) -> np.ndarray:
        """Project the corners of the face (4, 2), wherever they are."""
        return self.box.corners(camera_from_object)

    def clean(self, camera_from_object: np.ndarray | None, time_s: float = 0.0) -> np.ndarray:
        """Render without noise and rounding: (H, W) float32 grey levels."""
        canvas = self._still.copy()
        drawn = self._drawn(camera_from_object, time_s)
        if drawn is not None:
            region, patch = drawn
            canvas[region.slices] = patch
        gain = self.flicker(time_s)
        return canvas if gain == 1.0 else canvas * np.float32(gain)

    def _drawn(self, camera_from_object: np.ndarray | None,
               time_s: float) -> tuple[Region, np.ndarray] | None:
        """Render the region that the box changes; None where it changes nothing."""
        if camera_from_object is None:
            return None
        layers = self.layers(camera_from_object, time_s)
        region = self.region(layers.points_px)
        return None if region.empty else (region, self.patch(layers, camera_from_object, region))

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
        """Mix the surfaces of a region on the fine grid."""
        fine, settings = region.divided(self._fineness), self.settings
        mixed = lens.enlarged(self._raw[region.slices], self._fineness)
        if layers.shadow_px is not None:
            mixed *= 1.0 - settings.shadow * self._shadow_share(layers.shadow_px, fine)
        changes = np.zeros_like(mixed)
        shares = self._shares([outline.polygon_px for outline in layers.faces], fine)
        for outline, (part, share) in zip(layers.faces, shares):
            behind = mixed[part]
            changes[part] += share * (self._level(outline.face, camera_from_object, region, part)
                                      - behind)
        mixed += changes
        if layers.occluder_px is not None:
            (part, share), = self._shares([layers.occluder_px], fine)
            mixed[part] += share * (settings.occluder_level - mixed[part])
        return mixed

    def _shares(self, polygons_px: list[np.ndarray],
                fine: Region) -> list[tuple[tuple[slice, slice], np.ndarray]]:
        """Give the parts of the fine grid that polygons reach, and their shares of them."""
        polygons = [(polygon_px + 0.5) * self._fineness - 0.5 for polygon_px in polygons_px]
        inner = [bounding_region(polygon - (fine.left, fine.top), fine.width, fine.height, 1)
                 for polygon in polygons]
        wholes = [part._replace(left=part.left + fine.left, top=part.top + fine.top)
                  for part in inner]
        return [(part.slices, share.astype(np.float32))
                for part, share in zip(inner, polygon_coverages(polygons, wholes))]

    def _shadow_share(self, shadow_px: np.ndarray, fine: Region) -> np.ndarray:
        share = np.zeros((fine.height, fine.width), np.float32)
        (part, inner), = self._shares([shadow_px], fine)
        share[part] = inner
        soft = self.settings.shadow_softness_px * self._fineness
        return cv2.GaussianBlur(share, (0, 0), soft) if soft > 0.05 else share

    def _level(self, face: int, camera_from_object: np.ndarray, region: Region,
               part: tuple[slice, slice]) -> float | np.ndarray:
        if face == FACE and self._print is not None:
            levels = self._print.levels(camera_from_object, region)
            return lens.enlarged(levels, self._fineness)[part]
        settings = self.settings
        return (settings.face_level, *settings.side_levels, settings.back_level)[face]

    def _blurred(self, fine: np.ndarray) -> np.ndarray:
        return lens.blurred(fine, self.settings.blur_px, self._fineness)

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
