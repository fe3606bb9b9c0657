"""
Measure where the sides of a polygon run, from the raw pixels around them.

Each side is crossed by scan lines, one per pixel column (flat sides) or row (steep
sides), so that every pixel near the side is used exactly once and nothing is
interpolated. A pixel at signed distance d from the side is expected to have the grey
level outside + contrast * share(d), where share is the blurred profile of an edge;
the offset of the side at that line is the linear least squares step of that model.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.profile import EdgeProfile
import numpy as np

CORNER_REACH_PX = 1.5  # lines go on for this much beyond the corners
CORNER_ZONE_PX = 3.5  # lines this close to a corner see the next side too


class ScanLines(NamedTuple):
    """Pixels across the sides of a polygon; n lines of 2 half + 1 pixels each."""

    side: np.ndarray  # (n,) which side
    along: np.ndarray  # (n,) place on it, 0 at its first corner, 1 at its second
    normal: np.ndarray  # (n, 2) unit vector towards the inside
    first: np.ndarray  # (n,) signed distance of the first pixel, inside positive [px]
    step: np.ndarray  # (n,) change of that distance per pixel
    grey: np.ndarray  # (n, 2 half + 1) float32 grey levels
    pixel: np.ndarray  # (n, 2) first pixel (u, v)
    advance: np.ndarray  # (n, 2) from pixel to pixel: (0, 1) or (1, 0)


class EdgeMeasurement(NamedTuple):
    """What the lines say about the sides; arrays (n,) with one entry per line."""

    side: np.ndarray
    along: np.ndarray
    normal: np.ndarray
    inward_px: np.ndarray  # how far the edge lies inside of where it was expected
    variance_px2: np.ndarray  # of inward_px, from the noise found on this line
    contrast: np.ndarray  # grey levels inside minus outside
    inside: np.ndarray  # grey level inside
    residual: np.ndarray  # mean squared deviation of the pixels from the model


class Geometry(NamedTuple):
    """Sides of a polygon."""

    start: np.ndarray  # (m, 2)
    edge: np.ndarray  # (m, 2)
    length: np.ndarray  # (m,)
    normal: np.ndarray  # (m, 2) inwards where corners run clockwise on the screen


def side_geometry(corners: np.ndarray) -> Geometry:
    """Describe the sides of a polygon (m, 2)."""
    edge = np.roll(corners, -1, axis=0) - corners
    length = np.maximum(np.hypot(edge[:, 0], edge[:, 1]), 1e-9)
    normal = np.column_stack([-edge[:, 1], edge[:, 0]]) / length[:, None]
    return Geometry(corners, edge, length, normal)


def scan_lines(image: np.ndarray, corners_px: np.ndarray, half: int,
               stride: int = 1) -> ScanLines:
    """
    Read the pixels around the sides of a polygon.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    corners_px : (m, 2) array
        Where the polygon is expected, clockwise on the screen.
    half : int
        Pixels on either side of the expected edge.
    stride : int
        Distance of the lines [px]; 1 uses every pixel.

    Returns
    -------
    ScanLines
        Lines that would leave the image are left out.

    """
    geometry = side_geometry(corners_px)
    side, main, upright = _line_places(geometry, stride)
    start, edge = geometry.start[side], geometry.edge[side]
    rows = np.arange(len(side))
    main_axis = upright.astype(int)
    along = (main - start[rows, main_axis]) / edge[rows, main_axis]
    cross = start[rows, 1 - main_axis] + along * edge[rows, 1 - main_axis]
    base = np.rint(cross).astype(np.int64) - half
    height, width = image.shape
    main_size, cross_size = np.where(upright, height, width), np.where(upright, width, height)
    keep = (base >= 0) & (base + 2 * half < cross_size) & (main >= 0) & (main < main_size)
    if not keep.all():
        side, main, upright, along, base = (a[keep] for a in (side, main, upright, along, base))
        start = start[keep]
    pixel = np.where(upright[:, None], np.column_stack([base, main]),
                     np.column_stack([main, base]))
    advance = np.where(upright[:, None], (1, 0), (0, 1))
    normal = geometry.normal[side]
    offset = pixel - start
    return ScanLines(side, along, normal, (normal * offset).sum(axis=1),
                     (normal * advance).sum(axis=1), _read(image, pixel, upright, half),
                     pixel, advance)


def _line_places(geometry: Geometry, stride: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give each line's side, its column or row, and whether its side is steep."""
    upright = np.abs(geometry.edge[:, 1]) > np.abs(geometry.edge[:, 0])
    main_axis = upright.astype(int)
    sides = np.arange(len(upright))
    from_main = geometry.start[sides, main_axis]
    to_main = from_main + geometry.edge[sides, main_axis]
    low = np.ceil(np.minimum(from_main, to_main) - CORNER_REACH_PX).astype(np.int64)
    high = np.floor(np.maximum(from_main, to_main) + CORNER_REACH_PX).astype(np.int64)
    count = (high - low) // stride + 1
    side = np.repeat(sides, count)
    number = np.arange(len(side)) - np.repeat(np.cumsum(count) - count, count)
    return side, low[side] + stride * number, upright[side]


def _read(image: np.ndarray, pixel: np.ndarray, upright: np.ndarray, half: int) -> np.ndarray:
    width = image.shape[1]
    place = (pixel[:, 1] * width + pixel[:, 0])[:, None] \
        + np.where(upright, 1, width)[:, None] * np.arange(2 * half + 1)
    return image.reshape(-1).take(place).astype(np.float32)


def measure_edges(lines: ScanLines, corners_px: np.ndarray, profile: EdgeProfile,
                  window: int = 6) -> EdgeMeasurement:
    """
    Fit the edge profile on every line.

    Parameters
    ----------
    lines : ScanLines
        Pixels, read around some polygon close to this one.
    corners_px : (m, 2) array
        Where the sides are thought to be now.
    profile : EdgeProfile
        The blurred edge.
    window : int
        Lines on either side of a line that share its grey levels.

    Returns
    -------
    EdgeMeasurement

    """
    geometry = side_geometry(corners_px)
    along, first, step, normal = _relocate(lines, geometry)
    distance = first[:, None] + step[:, None] * np.arange(lines.grey.shape[1], dtype=np.float32)
    place = profile.index(distance)
    share, slope = profile.share(place), profile.slope(place)
    _cut_corners(lines, geometry, along, profile, share, slope)
    sums = _products(lines.grey, share, slope)
    outside, contrast, kept = _levels(sums, lines, window)
    pixels = lines.grey.shape[1]
    response = sums.slope_grey - outside * sums.slope - contrast * sums.slope_share
    energy = np.maximum(sums.slope_slope * kept, 1e-9)
    residual = _residual(sums, outside, contrast, pixels)
    safe = np.where(np.abs(contrast) < 1e-3, 1e-3, contrast)
    return EdgeMeasurement(lines.side, along, normal, -response / (safe * energy),
                           residual / (safe * safe * energy), contrast, outside + contrast,
                           residual)


def _relocate(lines: ScanLines, geometry: Geometry) -> tuple[np.ndarray, ...]:
    """Express the lines with respect to sides that have moved a little."""
    normal = geometry.normal[lines.side]
    offset = lines.pixel - geometry.start[lines.side]
    first = (normal * offset).sum(axis=1)
    step = (normal * lines.advance).sum(axis=1)
    # Where the line crosses the side, not where its first pixel projects to.
    crossing = offset - (first / step)[:, None] * lines.advance
    edge = geometry.edge[lines.side]
    along = (crossing * edge).sum(axis=1) / geometry.length[lines.side] ** 2
    return along, first.astype(np.float32), step.astype(np.float32), normal


def _cut_corners(lines: ScanLines, geometry: Geometry, along: np.ndarray, profile: EdgeProfile,
                 share: np.ndarray, slope: np.ndarray) -> None:
    """Multiply in the share of the adjacent side on the lines close to a corner."""
    length = geometry.length[lines.side]
    near_start = along * length < CORNER_ZONE_PX
    near_end = (1.0 - along) * length < CORNER_ZONE_PX
    rows = np.flatnonzero(near_start | near_end)
    count = len(geometry.length)
    neighbour = (lines.side[rows] + np.where(near_start[rows], -1, 1)) % count
    normal = geometry.normal[neighbour]
    first = (normal * (lines.pixel[rows] - geometry.start[neighbour])).sum(axis=1)
    step = (normal * lines.advance[rows]).sum(axis=1)
    pixels = np.arange(share.shape[1], dtype=np.float32)
    distance = first.astype(np.float32)[:, None] + step.astype(np.float32)[:, None] * pixels
    other = profile.share(profile.index(distance))
    share[rows] *= other
    slope[rows] *= other


class _Sums(NamedTuple):
    """Sums of products over the pixels of each line."""

    one: int
    grey: np.ndarray
    grey_grey: np.ndarray
    share: np.ndarray
    share_share: np.ndarray
    share_grey: np.ndarray
    slope: np.ndarray
    slope_share: np.ndarray
    slope_slope: np.ndarray
    slope_grey: np.ndarray


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum('ij,ij->i', a, b)


def _products(grey: np.ndarray, share: np.ndarray, slope: np.ndarray) -> _Sums:
    one = np.ones(grey.shape[1], np.float32)
    return _Sums(grey.shape[1], grey @ one, _dot(grey, grey), share @ one, _dot(share, share),
                 _dot(share, grey), slope @ one, _dot(slope, share), _dot(slope, slope),
                 _dot(slope, grey))


def _levels(sums: _Sums, lines: ScanLines, window: int) -> tuple[np.ndarray, ...]:
    """
    Fit grey level outside and contrast, each over a few lines of the same side.

    The third answer is the share of the offset's information that is left when the
    levels are unknown too: a shift of the side looks partly like a change of levels.
    """
    table = np.column_stack([np.full(len(sums.grey), float(sums.one)), sums.share,
                             sums.share_share, sums.grey, sums.share_grey,
                             sums.slope, sums.slope_share, sums.slope_slope])
    total = np.vstack([np.zeros((1, 8)), np.cumsum(table, axis=0)])
    number = np.arange(len(table))
    begin = np.searchsorted(lines.side, lines.side, side='left')
    end = np.searchsorted(lines.side, lines.side, side='right')
    low, high = np.maximum(number - window, begin), np.minimum(number + window + 1, end)
    one, share, share2, grey, share_grey, slope, slope_share, slope2 = (total[high] - total[low]).T
    determinant = np.maximum(one * share2 - share * share, 1e-6)
    contrast = (one * share_grey - share * grey) / determinant
    taken = (share2 * slope * slope - 2.0 * share * slope * slope_share
             + one * slope_share * slope_share) / determinant
    kept = np.clip(1.0 - taken / np.maximum(slope2, 1e-9), 0.1, 1.0)
    return (grey - contrast * share) / one, contrast, kept


def _residual(sums: _Sums, outside: np.ndarray, contrast: np.ndarray, pixels: int) -> np.ndarray:
    """Give the mean squared deviation of each line's pixels from the model."""
    total = sums.grey_grey - 2.0 * (outside * sums.grey + contrast * sums.share_grey) \
        + outside * outside * pixels + 2.0 * outside * contrast * sums.share \
        + contrast * contrast * sums.share_share
    return np.maximum(total / max(pixels - 2, 1), 1e-3)
