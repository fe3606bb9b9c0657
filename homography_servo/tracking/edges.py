"""
Measure where the sides of a polygon run: a blurred step fitted to raw pixels.

A pixel at signed distance d inside a side is expected to have the grey level
outside + contrast * share(d), where share is the profile of a blurred edge. Both
levels are fitted per segment of a few scan lines; the segment's offset is the linear
least squares step of that model, its variance that of the same step.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.profile import EdgeProfile
from homography_servo.tracking.scan import FAR_PX
from homography_servo.tracking.scan import Geometry
from homography_servo.tracking.scan import Scan
from homography_servo.tracking.scan import side_geometry
import numpy as np

FAR_SIGMAS = 3.0  # far pixels that differ by more than this have another grey level
FLAT_GREY = 1.0  # and uneven lighting makes them differ by this much


class Edges(NamedTuple):
    """What the segments say about the sides; arrays with one entry per segment."""

    side: np.ndarray
    along: np.ndarray  # where on the side, 0 to 1
    normal: np.ndarray  # (s, 2) unit vector towards the inside
    inward: np.ndarray  # how far the edge lies inside of where it was expected [px]
    variance: np.ndarray  # of inward, by the noise found in this segment [px^2]
    contrast: np.ndarray  # grey levels inside minus outside
    outside: np.ndarray  # grey level
    residual: np.ndarray  # mean squared deviation of the pixels from the model
    lines: np.ndarray  # scan lines in the segment


class Sums(NamedTuple):
    """Sums over the pixels of each segment."""

    one: np.ndarray
    grey: np.ndarray
    share: np.ndarray
    share_share: np.ndarray
    share_grey: np.ndarray
    slope: np.ndarray
    slope_share: np.ndarray
    slope_slope: np.ndarray
    slope_grey: np.ndarray
    slope_along: np.ndarray


def measure_edges(scan: Scan, corners: np.ndarray, profile: EdgeProfile) -> Edges:
    """
    Fit the edge profile in every segment.

    Parameters
    ----------
    scan : Scan
        Pixels, read around some polygon close to this one.
    corners : (m, 2) array
        Where the corners are thought to be now, in the plane of the scan.
    profile : EdgeProfile
        The blurred edge.

    Returns
    -------
    Edges

    """
    geometry = side_geometry(corners)
    first, step, scale = line_distances(scan, geometry)
    place = profile.places(first, step, len(scan.grey))
    share, slope = profile.share(place), profile.slope(place)
    _cut_corners(scan, geometry, profile, share, slope, scale)
    sums = _sums(scan, share, slope)
    outside, contrast, kept, residual = _levels(sums, scan, step)
    response = sums.slope_grey - outside * sums.slope - contrast * sums.slope_share
    energy = np.maximum(sums.slope_slope * kept, 1e-9)
    safe = np.where(np.abs(contrast) < 1e-3, 1e-3, contrast)
    length = 1.0 if scale is None else 1.0 / scale.take(scan.first_line)
    return Edges(scan.segment_side, sums.slope_along / np.maximum(sums.slope_slope, 1e-9),
                 geometry.normal[scan.segment_side], -length * response / (safe * energy),
                 length * length * residual / (safe * safe * energy), contrast, outside,
                 residual, scan.lines)


def line_distances(scan: Scan, geometry: Geometry) -> tuple[np.ndarray, ...]:
    """
    Give each line's first signed distance, its step, and image pixels per plane unit.

    Distances are in pixels of the image; the scale is None where the plane is the image.
    """
    normal_u, normal_v = (column.take(scan.side) for column in geometry.normal.T)
    first = normal_u * scan.u + normal_v * scan.v - geometry.level.take(scan.side)
    step = normal_u * scan.du + normal_v * scan.dv
    if not scan.bent:
        return first, step, None
    scale = 1.0 / np.sqrt(scan.du * scan.du + scan.dv * scan.dv)
    return first * scale, step * scale, scale


def _cut_corners(scan: Scan, geometry: Geometry, profile: EdgeProfile, share: np.ndarray,
                 slope: np.ndarray, scale: np.ndarray | None) -> None:
    """Multiply in the share of the next side on the lines close to a corner."""
    near, other = scan.near, scan.neighbour
    normal_u, normal_v = (column.take(other) for column in geometry.normal.T)
    first = normal_u * scan.u.take(near) + normal_v * scan.v.take(near) \
        - geometry.level.take(other)
    step = normal_u * scan.du.take(near) + normal_v * scan.dv.take(near)
    if scale is not None:
        first, step = first * scale.take(near), step * scale.take(near)
    beyond = profile.share(profile.places(first, step, len(share)))
    share[:, near] *= beyond
    slope[:, near] *= beyond


def _sums(scan: Scan, share: np.ndarray, slope: np.ndarray) -> Sums:
    table = np.empty((8, share.shape[1]), np.float32)
    np.add.reduce(share, axis=0, out=table[0])
    np.einsum('ij,ij->j', share, share, out=table[1])
    np.einsum('ij,ij->j', share, scan.grey, out=table[2])
    np.add.reduce(slope, axis=0, out=table[3])
    np.einsum('ij,ij->j', slope, share, out=table[4])
    np.einsum('ij,ij->j', slope, slope, out=table[5])
    np.einsum('ij,ij->j', slope, scan.grey, out=table[6])
    np.multiply(table[5], scan.along, out=table[7], casting='unsafe')
    total = np.add.reduceat(table, scan.first_line, axis=1, dtype=np.float64)
    return Sums(scan.lines * float(len(share)), scan.grey_sum, *total)


def _levels(sums: Sums, scan: Scan, step: np.ndarray) -> tuple[np.ndarray, ...]:
    """
    Fit the grey levels of each segment.

    Returns
    -------
    four (s,) arrays
        Level outside, contrast, share of the offset's information that is left when
        the levels are unknown, and mean squared deviation.

    """
    outside, contrast, _ = _two_levels(sums)
    # At the least squares solution the explained part is the product with the data.
    missed = scan.grey_square - outside * sums.grey - contrast * sums.share_grey
    residual = np.maximum(missed, 0.0) / (sums.one - 2.0)
    # Far pixels pin the levels down where they have the same level as the near ones.
    rising = step.take(scan.first_line) > 0.0
    far_in, far_out = (np.where(rising, scan.high_sum, scan.low_sum),
                       np.where(rising, scan.low_sum, scan.high_sum))
    pixels = FAR_PX * scan.lines
    allowed = FAR_SIGMAS * np.sqrt(2.0 * middle(residual) / pixels) + FLAT_GREY
    use_in = pixels * (np.abs(far_in / pixels - outside - contrast) < allowed)
    use_out = pixels * (np.abs(far_out / pixels - outside) < allowed)
    grey_in = np.where(use_in, far_in, 0.0)
    wider = sums._replace(one=sums.one + use_in + use_out, share=sums.share + use_in,
                          share_share=sums.share_share + use_in,
                          grey=sums.grey + grey_in + np.where(use_out, far_out, 0.0),
                          share_grey=sums.share_grey + grey_in)
    outside, contrast, kept = _two_levels(wider)
    return outside, contrast, kept, residual


def _two_levels(sums: Sums) -> tuple[np.ndarray, ...]:
    determinant = np.maximum(sums.one * sums.share_share - sums.share * sums.share, 1e-6)
    contrast = (sums.one * sums.share_grey - sums.share * sums.grey) / determinant
    taken = (sums.share_share * sums.slope * sums.slope
             - 2.0 * sums.share * sums.slope * sums.slope_share
             + sums.one * sums.slope_share * sums.slope_share) / determinant
    kept = np.maximum(1.0 - taken / np.maximum(sums.slope_slope, 1e-9), 0.1)
    return (sums.grey - contrast * sums.share) / sums.one, contrast, kept


def middle(values: np.ndarray) -> float:
    """Give the median of a short array, quickly."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])
