"""
Read the raw pixels around the sides of a polygon.

Each side is crossed by scan lines, one per pixel column (flat sides) or row (steep
sides), so that every pixel near the side is used exactly once and nothing is
interpolated. Neighbouring lines form short segments, the unit of measurement.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.plane import Plane
import numpy as np

CORNER_REACH_PX = 1.5  # lines go on for this much beyond the corners
CORNER_ZONE_PX = 3.0  # lines this close to a corner see the next side too
FAR_PX = 6  # pixels beyond either end of a line, for the grey levels only


class Geometry(NamedTuple):
    """Sides of a polygon."""

    start: np.ndarray  # (m, 2)
    edge: np.ndarray  # (m, 2)
    length: np.ndarray  # (m,)
    normal: np.ndarray  # (m, 2) inwards where corners run clockwise on the screen
    level: np.ndarray  # (m,) normal . start


class Scan(NamedTuple):
    """
    Pixels across the sides; n lines of k pixels each, in s segments.

    Points are in the plane of straight edges.
    """

    grey: np.ndarray  # (k, n) float32 grey levels
    low_sum: np.ndarray  # (s,) sum of the FAR_PX pixels before the first of each line
    high_sum: np.ndarray  # (s,) and after the last
    grey_sum: np.ndarray  # (s,) sum of the grey levels of each segment
    grey_square: np.ndarray  # (s,) and of their squares
    side: np.ndarray  # (n,) which side
    u: np.ndarray  # (n,) first pixel
    v: np.ndarray
    du: np.ndarray  # (n,) from pixel to pixel
    dv: np.ndarray
    along: np.ndarray  # (n,) place on the side, 0 at its first corner, 1 at its second
    first_line: np.ndarray  # (s,) first line of each segment
    lines: np.ndarray  # (s,) lines in each segment
    segment_side: np.ndarray  # (s,)
    near: np.ndarray  # (c,) lines close to a corner
    neighbour: np.ndarray  # (c,) the side across that corner
    bent: bool  # whether the plane differs from the image


def side_geometry(corners: np.ndarray) -> Geometry:
    """Describe the sides of a polygon (m, 2)."""
    edge = corners[_next(len(corners))] - corners
    length = np.maximum(np.sqrt(edge[:, 0] ** 2 + edge[:, 1] ** 2), 1e-9)
    normal = np.empty_like(edge)
    np.divide(edge[:, 1], -length, out=normal[:, 0])
    np.divide(edge[:, 0], length, out=normal[:, 1])
    return Geometry(corners, edge, length, normal, (normal * corners).sum(axis=1))


def _next(count: int) -> np.ndarray:
    return np.arange(1, count + 1) % count


def read_scan(image: np.ndarray, corners: np.ndarray, plane: Plane, half: int, stride: int = 1,
              lines_per_segment: int = 6) -> Scan | None:
    """
    Read the pixels around the sides of a polygon.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    corners : (m, 2) array
        Where the polygon is expected in the plane, clockwise on the screen.
    plane : Plane
        Straightens the lens.
    half : int
        Pixels on either side of the expected edge.
    stride : int
        Distance of the lines [px]; 1 uses every pixel.
    lines_per_segment : int
        How many lines share their grey levels.

    Returns
    -------
    Scan or None
        Lines that would leave the image are left out; None when hardly any are left.

    """
    count = len(corners)
    shown, sag = _as_shown(corners, plane)
    edge = shown[_next(count)] - shown
    upright = np.abs(edge[:, 1]) > np.abs(edge[:, 0])
    main_axis = upright.astype(np.intp)
    sides = np.arange(count)
    start_main, start_cross = shown[sides, main_axis], shown[sides, 1 - main_axis]
    edge_main, edge_cross = edge[sides, main_axis], edge[sides, 1 - main_axis]
    side, main = _places(start_main, edge_main, stride)
    along = (main - start_main.take(side)) / edge_main.take(side)
    cross = start_cross.take(side) + along * edge_cross.take(side)
    if plane.bent:
        cross += 4.0 * sag[sides, 1 - main_axis].take(side) * along * (1.0 - along)
    base = np.rint(cross).astype(np.int64) - (half + FAR_PX)
    height, width = image.shape
    pixels = 2 * (half + FAR_PX) + 1
    cross_size = np.where(upright, width, height).take(side)
    main_size = np.where(upright, height, width).take(side)
    keep = (base >= 0) & (base + pixels <= cross_size) & (main >= 0) & (main < main_size)
    if not keep.all():
        if keep.sum() < 3 * count:
            return None
        side, main, along, base = side[keep], main[keep], along[keep], base[keep]
    steep = upright.take(side)
    step = np.where(steep, 1, width)
    first = np.where(steep, main * width + base, base * width + main)
    grey = image.reshape(-1).take(first + step * np.arange(pixels)[:, None])
    segments = _segments(side, count, lines_per_segment)
    near = grey[FAR_PX:-FAR_PX].astype(np.float32)
    return Scan(near, *_segment_sums(grey, near, segments[0]), side,
                *_in_plane(plane, steep, main, base + FAR_PX, first + FAR_PX * step, step, half),
                along, *segments, *_near_corners(side, along, edge, half),
                plane.bent)


def _as_shown(corners: np.ndarray, plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """Give the corners in the image, and how far each side's middle bends away."""
    if not plane.bent:
        return corners, np.zeros_like(corners)
    middle = 0.5 * (corners + corners[_next(len(corners))])
    shown = plane.to_image(np.concatenate([corners, middle]))
    shown, middle = shown[:len(corners)], shown[len(corners):]
    return shown, middle - 0.5 * (shown + shown[_next(len(corners))])


def _places(start: np.ndarray, edge: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Give each line's side and its column or row."""
    end = start + edge
    low = np.ceil(np.minimum(start, end) - CORNER_REACH_PX).astype(np.int64)
    high = np.floor(np.maximum(start, end) + CORNER_REACH_PX).astype(np.int64)
    number = (high - low) // stride + 1
    side = np.repeat(np.arange(len(start)), number)
    before = np.cumsum(number) - number
    return side, stride * np.arange(len(side)) + (low - stride * before).take(side)


def _in_plane(plane: Plane, steep: np.ndarray, main: np.ndarray, base: np.ndarray,
              first: np.ndarray, step: np.ndarray, half: int) -> tuple[np.ndarray, ...]:
    """Give each line's first pixel and its advance in the plane: u, v, du, dv."""
    if not plane.bent:
        flat = ~steep
        return (np.where(steep, base, main).astype(float),
                np.where(steep, main, base).astype(float),
                steep.astype(float), flat.astype(float))
    u_map, v_map = plane.maps
    last = first + 2 * half * step
    u, v = u_map.take(first), v_map.take(first)
    return u, v, (u_map.take(last) - u) / (2 * half), (v_map.take(last) - v) / (2 * half)


def _segments(side: np.ndarray, count: int, per_segment: int) -> tuple[np.ndarray, ...]:
    """Cut the lines of each side into segments: first line, number of lines, side."""
    lines = np.bincount(side, minlength=count)
    cuts, owners, before = [], [], 0
    for number, total in enumerate(lines.tolist()):
        parts = max(1, round(total / per_segment)) if total else 0
        cuts += [before + part * total // parts for part in range(parts)]
        owners += [number] * parts
        before += total
    first = np.array(cuts)
    return first, np.diff(np.append(first, before)), np.array(owners)


def _near_corners(side: np.ndarray, along: np.ndarray, edge: np.ndarray,
                  half: int) -> tuple[np.ndarray, np.ndarray]:
    """List the lines whose pixels may lie beyond the next side, and that side."""
    length = np.maximum(np.sqrt((edge ** 2).sum(axis=1)), 1e-9)
    slant = np.abs(edge).min(axis=1) / length  # pixels drift along the side by this
    zone = ((CORNER_ZONE_PX + half * slant) / length).take(side)
    near_start = along < zone
    near = np.flatnonzero(near_start | (along > 1.0 - zone))
    return near, (side.take(near) + np.where(near_start.take(near), -1, 1)) % len(edge)


def _segment_sums(grey: np.ndarray, near: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, ...]:
    table = np.empty((4, grey.shape[1]))
    np.add.reduce(grey[:FAR_PX], axis=0, dtype=float, out=table[0])
    np.add.reduce(grey[-FAR_PX:], axis=0, dtype=float, out=table[1])
    np.add.reduce(near, axis=0, out=table[2])
    np.einsum('ij,ij->j', near, near, out=table[3])
    return tuple(np.add.reduceat(table, first, axis=1))
