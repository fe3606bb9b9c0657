"""Draw what the tracker sees, for people."""

from __future__ import annotations

import cv2
from homography_servo.tracking.tracker import Track
import numpy as np

_COLOURS = {'TRACKING': (60, 200, 60), 'COASTING': (0, 190, 255), 'SEARCHING': (255, 160, 0),
            'LOST': (40, 40, 230)}
_PATH, _TARGET = (255, 170, 90), (0, 220, 255)
_BITS = 4


def draw_track(image_bgr: np.ndarray, track: Track) -> np.ndarray:
    """
    Draw curve, corners and state into an image.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8 array
        Drawn on in place.
    track : Track
        What the tracker said about this image.

    Returns
    -------
    (H, W, 3) uint8 array
        The same array.

    """
    colour = _COLOURS[track.state]
    if track.contour_px is not None:
        cv2.polylines(image_bgr, [_fixed(track.contour_px)], True, colour, 1, cv2.LINE_AA, _BITS)
    if track.corners_px is not None:
        for number, place in enumerate(_fixed(track.corners_px)):
            cv2.circle(image_bgr, tuple(int(v) for v in place), 4 << _BITS, colour, 1,
                       cv2.LINE_AA, _BITS)
            text_at = tuple(int(v) for v in (place >> _BITS) + 6)
            cv2.putText(image_bgr, str(number), text_at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, 1)
    line = track.state if not track.reason else f'{track.state}: {track.reason}'
    cv2.putText(image_bgr, line, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    return image_bgr


def draw_path(image_bgr: np.ndarray, path_px: np.ndarray | None, target: int | None
              ) -> np.ndarray:
    """
    Draw the planned path of the corners, its goal, and the pose aimed at, into an image.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8 array
        Drawn on in place.
    path_px : (N, M, 2) array or None
        Corners of every pose; poses that are not finite are left out.
    target : int or None
        Index of the pose that the servo is going to.

    Returns
    -------
    (H, W, 3) uint8 array
        The same array.

    """
    if path_px is None:
        return image_bgr
    finite = np.isfinite(path_px).all(axis=(1, 2))
    shown = path_px[finite]
    if not len(shown):
        return image_bgr
    for corner in range(shown.shape[1]):
        cv2.polylines(image_bgr, [_fixed(shown[:, corner])], False, _PATH, 1, cv2.LINE_AA, _BITS)
    cv2.polylines(image_bgr, [_fixed(shown[-1])], True, _PATH, 1, cv2.LINE_AA, _BITS)
    if target is not None and 0 <= target < len(path_px) and finite[target]:
        cv2.polylines(image_bgr, [_fixed(path_px[target])], True, _TARGET, 1, cv2.LINE_AA, _BITS)
    return image_bgr


def _fixed(points_px: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(points_px, -4e3, 4e4) * 2 ** _BITS).astype(np.int32)
