"""Draw what the tracker sees, for people."""

from __future__ import annotations

import cv2
from homography_servo.tracking.tracker import Track
import numpy as np

_COLOURS = {'TRACKING': (60, 200, 60), 'COASTING': (0, 190, 255), 'SEARCHING': (255, 160, 0),
            'LOST': (40, 40, 230)}
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


def _fixed(points_px: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(points_px, -4e3, 4e4) * 2 ** _BITS).astype(np.int32)
