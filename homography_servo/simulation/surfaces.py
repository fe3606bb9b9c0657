"""What is fixed in the world: background with clutter, print, light, a store of noise."""

from __future__ import annotations

import cv2
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np

PRINT_TEXELS_PER_M = 4000.0
_NOISE_STORE = 1 << 22
_CLUTTER_THINGS = 60
_SCALE_BITS = 4  # sub-pixel bits of OpenCV's drawing functions


def background(width: int, height: int, settings: SceneSettings,
               rng: np.random.Generator) -> np.ndarray:
    """
    Paint what is behind the box, before lens blur.

    Returns
    -------
    (height, width) float32 array
        Grey levels.

    """
    image = np.full((height, width), settings.background_level, np.float32)
    if settings.texture_grey > 0.0:
        image += settings.texture_grey * _slow_variation(width, height, rng)
    for _ in range(round(settings.clutter * _CLUTTER_THINGS)):
        _draw_thing(image, rng)
    return np.clip(image, 0.0, 255.0)


def _slow_variation(width: int, height: int, rng: np.random.Generator) -> np.ndarray:
    coarse = rng.standard_normal((height // 16 + 2, width // 16 + 2)).astype(np.float32)
    fine = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return (fine - fine.mean()) / fine.std()


def _draw_thing(image: np.ndarray, rng: np.random.Generator) -> None:
    """Draw one thing: a bright quadrilateral, a disc, a stick or a broken line."""
    height, width = image.shape
    centre = rng.uniform((0.0, 0.0), (width, height))
    size = rng.uniform(8.0, 60.0)
    level = float(rng.uniform(20.0, 230.0))
    kind = rng.integers(4)
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 4)) if kind else _right_angles(rng)
    points = centre + size * np.column_stack([np.cos(angles), np.sin(angles)])
    fixed = np.rint(points * 2 ** _SCALE_BITS).astype(np.int32)
    if kind <= 1:
        cv2.fillPoly(image, [fixed], level, cv2.LINE_8, _SCALE_BITS)
    elif kind == 2:
        cv2.circle(image, [int(x) for x in centre], int(0.5 * size), level, -1)
    else:
        cv2.polylines(image, [fixed], False, level, int(rng.integers(1, 5)), cv2.LINE_8,
                      _SCALE_BITS)


def _right_angles(rng: np.random.Generator) -> np.ndarray:
    turn, half = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.4, 1.1)
    return turn + np.array([-half, half, np.pi - half, np.pi + half])


def print_texture(face_size_m: tuple[float, float], settings: SceneSettings,
                  rng: np.random.Generator) -> list[np.ndarray]:
    """
    Draw the print of the face: blocks and lines of text inside a margin.

    Returns
    -------
    list of float32 arrays
        Grey levels in face coordinates, each half the size of the one before, so that a
        face seen from afar can be sampled without aliasing.

    """
    width, height = (max(8, round(side * PRINT_TEXELS_PER_M)) for side in face_size_m)
    sheet = np.full((height, width), settings.face_level, np.float32)
    size, margin = np.array([width, height]), 0.08 * min(width, height)
    for _ in range(14):
        corner = rng.uniform(margin, 0.75 * size)
        extent = np.minimum(rng.uniform(0.04, 0.35, 2) * size * (1.0, 0.6), size - margin - corner)
        level = settings.face_level - settings.print_contrast * rng.uniform(0.4, 1.0)
        low, high = corner.astype(int), (corner + extent).astype(int)
        sheet[low[1]:high[1], low[0]:high[0]] = max(level, 0.0)
    return _pyramid(sheet)


def _pyramid(sheet: np.ndarray) -> list[np.ndarray]:
    levels = [sheet]
    while min(levels[-1].shape) >= 16:
        size = (max(1, levels[-1].shape[1] // 2), max(1, levels[-1].shape[0] // 2))
        levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA))
    return levels


def light_field(width: int, height: int, settings: SceneSettings) -> np.ndarray | None:
    """Give the relative light of every pixel, 1 in the middle; None when it is even."""
    if settings.gradient == 0.0:
        return None
    direction = settings.gradient_direction_rad
    u = (np.arange(width) - 0.5 * (width - 1)) / width * np.cos(direction)
    v = (np.arange(height) - 0.5 * (height - 1)) / width * np.sin(direction)
    return (1.0 + settings.gradient * (u[None, :] + v[:, None])).astype(np.float32)


class NoiseStore:
    """
    Unit Gaussian noise fast enough for video.

    Four million samples are drawn once; a frame takes a run of them that begins at a
    random place, so two frames share no noise at the same pixel in practice.

    """

    def __init__(self, width: int, height: int, rng: np.random.Generator) -> None:
        self._shape = (height, width)
        size = max(_NOISE_STORE, 4 * width * height)
        self._samples = rng.standard_normal(size, dtype=np.float32)

    def frame(self, rng: np.random.Generator) -> np.ndarray:
        """Take one frame of noise (height, width), a view that must not be changed."""
        count = self._shape[0] * self._shape[1]
        first = int(rng.integers(len(self._samples) - count))
        return self._samples[first:first + count].reshape(self._shape)
