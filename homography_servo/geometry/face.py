"""The tracked face of the object."""

from __future__ import annotations

import numpy as np


def face_corners(width_m: float, height_m: float) -> np.ndarray:
    """
    Give the corners of the face in the object frame.

    Parameters
    ----------
    width_m, height_m : float
        Size along x and y.

    Returns
    -------
    (4, 3) array
        Seen at the home pose: top left, top right, bottom right, bottom left.

    """
    if not (0.0 < width_m < np.inf and 0.0 < height_m < np.inf):
        raise ValueError(f'the face must have a size > 0 m, got {width_m} x {height_m}')
    signs = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return signs * (0.5 * width_m, 0.5 * height_m, 0.0)
