"""Estimate the blur of the edges while tracking."""

from __future__ import annotations

from functools import lru_cache
from statistics import median

from homography_servo.tracking.edges import line_distances
from homography_servo.tracking.edges import sum_pixels
from homography_servo.tracking.profile import along_line
from homography_servo.tracking.profile import edge_profile
from homography_servo.tracking.profile import EdgeProfile
from homography_servo.tracking.profile import PIXEL_SIGMA_PX
from homography_servo.tracking.scan import Geometry
from homography_servo.tracking.scan import Scan
from homography_servo.tracking.scan import side_geometry
from homography_servo.tracking.wedge import cut_corners
import numpy as np

LADDER_PX = (0.3, 0.5, 0.8, 1.2, 1.8, 2.6, 3.8)
STEP = 1.2  # the blur changes by this much at most
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
    layout = scan.layout
    between = layout.first_line >= layout.near  # close to a corner the next side is in them
    good = good[between]
    if np.count_nonzero(good) < SEGMENTS_NEEDED:
        return blur_px
    profile = edge_profile(max(round(blur_px / GRID), 1) * GRID)
    response, energy = _sharpness(scan, corners, profile, between)
    sigma_px = profile.sigma_px
    wanted = sigma_px + float(response @ good) / max(float(energy @ good), 1e-9)
    wanted = min(max(wanted, sigma_px / STEP), sigma_px * STEP)
    variance = sigma_px ** 2 + GAIN * (wanted ** 2 - sigma_px ** 2) - PIXEL_SIGMA_PX ** 2
    return min(max(variance, SHARPEST_PX ** 2) ** 0.5, SOFTEST_PX)


def _sharpness(scan: Scan, corners: np.ndarray, profile: EdgeProfile,
               between: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Ask the segments between the corners for the width of their edge.

    Their grey levels are unknown.

    Returns
    -------
    (r,) array, (r,) array
        Right-hand side and coefficient of the linear equation for the change of the
        profile's sigma [px].

    """
    layout, count = scan.layout, len(scan.grey)
    distance = line_distances(scan, side_geometry(corners))[0][:, layout.near:layout.total]
    parts = np.empty((3, count, distance.shape[1]), np.float32)
    profile.share_and_slope(profile.places(distance, count), parts[:2])
    parts[1] *= along_line(count) @ distance  # change of the share, times -sigma
    parts[2] = scan.grey[:, layout.near:]
    table = np.empty((9, distance.shape[1]), np.float32)
    sum_pixels(parts, table)
    share, widened, grey, share2, _, share_grey, widened_share, widened2, widened_grey = \
        np.add.reduceat(table, layout.first_line[between] - layout.near, axis=1, dtype=float)
    one = count * layout.lines[between]
    inverse = 1.0 / np.maximum(one * share2 - share * share, 1e-6)
    contrast = (one * share_grey - share * grey) * inverse
    outside = (grey - contrast * share) / one
    taken = inverse * (share2 * widened ** 2 - 2.0 * share * widened * widened_share
                       + one * widened_share ** 2)
    gain = contrast / profile.sigma_px
    return (-gain * (widened_grey - outside * widened - contrast * widened_share),
            gain * gain * np.maximum(widened2 - taken, 0.0))


def first_focus(scan: Scan, corners: np.ndarray) -> float:
    """Choose the blur that explains the pixels best, without a guess."""
    @lru_cache(maxsize=None)
    def cost(number: int) -> float:
        return median(_unexplained(scan, geometry, distance, place,
                                   edge_profile(LADDER_PX[number])).tolist())

    geometry = side_geometry(corners)
    distance = line_distances(scan, geometry)[0]
    place = edge_profile(LADDER_PX[0]).places(distance, len(scan.grey))  # the same for all
    best = 1
    while best < len(LADDER_PX) - 2 and cost(best + 1) < cost(best):
        best += 1
    curvature = cost(best - 1) - 2.0 * cost(best) + cost(best + 1)
    shift = 0.5 * (cost(best - 1) - cost(best + 1)) / curvature if curvature > 0.0 else 0.0
    step = LADDER_PX[best + 1] / LADDER_PX[best]
    return float(LADDER_PX[best] * step ** float(np.clip(shift, -1.0, 1.0)))


def _unexplained(scan: Scan, geometry: Geometry, distance: np.ndarray, place: np.ndarray,
                 profile: EdgeProfile) -> np.ndarray:
    """
    Give the mean square that an edge of two free levels leaves in each segment (s,).

    Places of the pixels and the distance of the lines from the sides are as in `measure_edges`.
    """
    layout, count = scan.layout, len(scan.grey)
    edge = profile.share_and_slope(place)
    cut_corners(scan, geometry, profile, distance, edge)
    share = edge[0, :, :layout.total]
    table = np.empty((5, layout.total), np.float32)
    np.add.reduce(share, axis=0, out=table[0])
    np.add.reduce(scan.grey, axis=0, out=table[1])
    np.einsum('kn,kn->n', share, share, out=table[2])
    np.einsum('kn,kn->n', share, scan.grey, out=table[3])
    table[4] = scan.line_sums[2]
    total_share, total_grey, share2, mixed, grey2 = np.add.reduceat(
        table, layout.first_line, axis=1, dtype=float)
    pixels = count * layout.lines
    mixed -= total_share * total_grey / pixels
    share2 -= total_share * total_share / pixels
    left = grey2 - total_grey * total_grey / pixels - mixed * mixed / np.maximum(share2, 1e-8)
    return np.maximum(left, 0.01) / (pixels - 2.0)
