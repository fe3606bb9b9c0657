"""Estimate the blur of the edges while tracking."""

from __future__ import annotations

from homography_servo.tracking.edges import measure_edges
from homography_servo.tracking.profile import edge_profile
from homography_servo.tracking.scan import Scan
import numpy as np

LADDER_PX = (0.3, 0.5, 0.8, 1.2, 1.8, 2.6, 3.8)
STEP = 1.2  # the blur is tried this much smaller and larger
GAIN = 0.3
GRID = 0.02  # blurs are rounded to this [px], so that few profiles are tabulated
SHARPEST_PX, SOFTEST_PX = 0.2, 5.0
SEGMENTS_NEEDED = 8


def refocus(scan: Scan, corners: np.ndarray, good: np.ndarray, blur_px: float) -> float:
    """
    Move the blur towards the one that explains the pixels best.

    Parameters
    ----------
    scan : Scan
        The pixels around the sides.
    corners : (m, 2) array
        Fitted corners.
    good : (s,) bool array
        Segments that show one clean edge.
    blur_px : float
        Blur in use.

    Returns
    -------
    float
        Blur to use next.

    """
    if np.count_nonzero(good) < SEGMENTS_NEEDED:
        return blur_px
    tried = _rounded(blur_px / STEP), _rounded(blur_px), _rounded(blur_px * STEP)
    cost = [float(measure_edges(scan, corners, edge_profile(blur)).residual[good].sum())
            for blur in tried]
    curvature = cost[0] - 2.0 * cost[1] + cost[2]
    shift = 0.5 * (cost[0] - cost[2]) / curvature if curvature > 0.0 else np.sign(
        cost[0] - cost[2])
    wanted = blur_px * STEP ** float(np.clip(shift, -1.0, 1.0))
    return float(np.clip(blur_px + GAIN * (wanted - blur_px), SHARPEST_PX, SOFTEST_PX))


def first_focus(scan: Scan, corners: np.ndarray) -> float:
    """Choose the blur that explains the pixels best, without a guess."""
    cost = [np.median(measure_edges(scan, corners, edge_profile(blur)).residual)
            for blur in LADDER_PX]
    best = min(max(int(np.argmin(cost)), 1), len(cost) - 2)
    curvature = cost[best - 1] - 2.0 * cost[best] + cost[best + 1]
    shift = 0.5 * (cost[best - 1] - cost[best + 1]) / curvature if curvature > 0.0 else 0.0
    step = LADDER_PX[best + 1] / LADDER_PX[best]
    return float(LADDER_PX[best] * step ** float(np.clip(shift, -1.0, 1.0)))


def _rounded(blur_px: float) -> float:
    return max(round(blur_px / GRID), 1) * GRID
