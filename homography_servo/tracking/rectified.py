"""Look straight at the face."""

from __future__ import annotations

import cv2
import numpy as np


def spread_inside(count: int) -> np.ndarray:
    """Give the shares (count count, 4) of four corners in places spread between them."""
    share = (np.arange(count) + 1.0) / (count + 1.0)
    s, t = (part.ravel() for part in np.meshgrid(share, share))
    return np.column_stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])


def rectified_view(image: np.ndarray, corners_px: np.ndarray, size: tuple[int, int],
                   inset: float) -> np.ndarray:
    """
    Sample what is between four corners on an even grid.

    Parameters
    ----------
    image : (H, W) uint8 array
        The picture.
    corners_px : (4, 2) array
        Of what is looked at.
    size : (int, int)
        Columns c and rows r of the grid.
    inset : float
        Share of width and height that is left out at each edge; negative to see more.

    Returns
    -------
    (r, c) float32 array
        Grey levels, a little smoothed.

    """
    right, bottom = size[0] - 1.0, size[1] - 1.0
    margin_u, margin_v = (inset * last / (1.0 - 2.0 * inset) for last in (right, bottom))
    frame = np.array([[-margin_u, -margin_v], [right + margin_u, -margin_v],
                      [right + margin_u, bottom + margin_v], [-margin_u, bottom + margin_v]])
    image_from_view = cv2.getPerspectiveTransform(frame.astype(np.float32),
                                                  corners_px.astype(np.float32))
    view = cv2.warpPerspective(image, image_from_view, size, None,
                               cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE)
    return cv2.GaussianBlur(view, (3, 3), 0).astype(np.float32)
