"""Things that pass in front of the box, by the clock of the scene."""

from __future__ import annotations

import math

from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np

_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)


def in_window(time_s: float, start_s: float, duration_s: float, period_s: float = 0.0) -> bool:
    """Tell whether a time is inside a window that may come back every period."""
    since_s = time_s - start_s
    if start_s < 0.0 or since_s < 0.0:
        return False
    return (math.fmod(since_s, period_s) if period_s > 0.0 else since_s) < duration_s


def box_present(settings: SceneSettings, time_s: float) -> bool:
    """Tell whether the box is in the scene at this time."""
    return settings.box_visible and not in_window(
        time_s, settings.vanish_start_s, settings.vanish_duration_s)


def occluder_polygon(settings: SceneSettings, corners_px: np.ndarray, image_width: int,
                     time_s: float) -> np.ndarray | None:
    """
    Give the outline of what is in front of the box now.

    Parameters
    ----------
    settings : SceneSettings
        Which occluder, how large and when.
    corners_px : (4, 2) array
        Where the corners of the face are.
    image_width : int
        Width of the picture [px].
    time_s : float
        Time of the scene.

    Returns
    -------
    (N, 2) array or None

    """
    if settings.occluder == 'none' or not in_window(
            time_s, settings.occluder_start_s, settings.occluder_duration_s,
            settings.occluder_period_s):
        return None
    sides_px = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
    radius_px = max(2.0, settings.occluder_size * float(sides_px.min()))
    return _SHAPES[settings.occluder](settings, corners_px, radius_px, image_width, time_s)


def _corner(settings, corners_px, radius_px, image_width, time_s) -> np.ndarray:
    centre = corners_px[settings.occluder_index]
    return centre + radius_px * np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])


def _side(settings, corners_px, radius_px, image_width, time_s) -> np.ndarray:
    """Cover one side from just inside its first corner to just inside its second."""
    first = corners_px[settings.occluder_index]
    along = corners_px[(settings.occluder_index + 1) % 4] - first
    across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
    inner, outer = first + 0.06 * along, first + 0.94 * along
    return np.array([inner - radius_px * across, outer - radius_px * across,
                     outer + radius_px * across, inner + radius_px * across])


def _sweep(settings, corners_px, radius_px, image_width, time_s) -> np.ndarray:
    """Move an upright bar over the image once per occlusion."""
    period_s = settings.occluder_period_s
    since_s = time_s - settings.occluder_start_s
    since_s = math.fmod(since_s, period_s) if period_s > 0.0 else since_s
    centre = image_width * since_s / max(settings.occluder_duration_s, 1e-9)
    return np.array([[centre - radius_px, -1e3], [centre + radius_px, -1e3],
                     [centre + radius_px, 1e4], [centre - radius_px, 1e4]])


_SHAPES = {'corner': _corner, 'side': _side, 'sweep': _sweep}
