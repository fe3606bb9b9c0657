"""The pixels close to a corner, where two sides blur into each other."""

from __future__ import annotations

from homography_servo.tracking.profile import along_line
from homography_servo.tracking.profile import EdgeProfile
from homography_servo.tracking.scan import Geometry
from homography_servo.tracking.scan import Scan
import numpy as np

SQUARE = 0.08  # cosine of a corner that may be taken for a right angle


def cut_corners(scan: Scan, geometry: Geometry, profile: EdgeProfile, distance: np.ndarray,
                edge: np.ndarray) -> None:
    """
    Let the next side cut off the lines close to a corner.

    The share of a blurred wedge is that of two correlated normal variables, by the first
    term of its series in the correlation r (which is 0 at a right angle). A right angle
    leaves out up to 0.16 r, this 0.03 r^2, which is less at corners of 50 to 130 degrees.

    Parameters
    ----------
    scan : Scan
        Tells which lines are close to which corner.
    geometry : Geometry
        The sides.
    profile : EdgeProfile
        The blurred edge.
    distance : (2, n + c) float32 array
        Distance of each line's first pixel from its side, and its change [px].
    edge : (2, k, n + c) array
        Share and slope of every pixel for its side alone; those of the lines close to a
        corner are changed in place, and those of the same lines at the end used up.

    """
    layout, total = scan.layout, scan.layout.total
    near, cosines = layout.near, _corner_cosines(geometry)
    own, (cut_share, cut_slope) = edge[:, :, :near], edge[:, :, total:]
    if max(map(abs, cosines)) < SQUARE:
        own *= cut_share
        return
    (share, slope), variance = own, profile.sigma_px ** 2
    cut_slope *= np.array([-variance * cosine for cosine in cosines],
                          np.float32).take(layout.corner)
    left = along_line(len(scan.grey)) @ (distance[:, :near] / np.float32(variance))
    left *= cut_slope
    left += cut_share
    cut_slope *= slope
    share *= cut_share
    share -= cut_slope
    slope *= left


def _corner_cosines(geometry: Geometry) -> list[float]:
    """Give the cosine of the angle between each side and the one before."""
    across, down = geometry.normal.tolist()
    return [u * before_u + v * before_v for u, before_u, v, before_v in zip(
        across, across[-1:] + across[:-1], down, down[-1:] + down[:-1])]
