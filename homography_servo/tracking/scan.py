"""
Read the raw pixels around the sides of a polygon.

Each side is crossed by scan lines, one per pixel column (flat sides) or row (steep
sides), so that every pixel near the side is used exactly once and nothing is
interpolated. Neighbouring lines form short segments, the unit of measurement.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from homography_servo.tracking.plane import Plane
import numpy as np

CORNER_REACH_PX = 1.5  # lines go on for this much beyond the corners
CORNER_ZONE_PX = 3.0  # lines this close to a corner see the next side too
FAR_PX = 8  # pixels beyond either end of a line, for the grey levels only


class Geometry(NamedTuple):
    """Sides of a polygon."""

    edge: np.ndarray  # (m, 2) from corner to corner
    length: np.ndarray  # (m,)
    normal_u: np.ndarray  # (m,) inwards where corners run clockwise on the screen
    normal_v: np.ndarray
    level: np.ndarray  # (m,) normal . corner


class Layout(NamedTuple):
    """Which line belongs where; depends on the numbers of lines only."""

    side: np.ndarray  # (n,)
    number: np.ndarray  # (n,) of the line on its side
    first_line: np.ndarray  # (s,) of each segment
    lines: np.ndarray  # (s,) in each segment
    segment_side: np.ndarray  # (s,)


class Scan(NamedTuple):
    """
    Pixels across the sides; n lines of k pixels each, in s segments.

    Points are in the plane of straight edges. The first n entries of ``side``, ``u``,
    ``v``, ``du``, ``dv`` are the lines; the other c repeat the lines close to a corner
    together with the side across that corner.
    """

    grey: np.ndarray  # (k, n) float32 grey levels
    low_sum: np.ndarray  # (s,) sum of the FAR_PX pixels before the first of each line
    high_sum: np.ndarray  # (s,) and after the last
    grey_sum: np.ndarray  # (s,) sum of the grey levels of each segment
    grey_square: np.ndarray  # (s,) and of their squares
    side: np.ndarray  # (n + c,) which side
    u: np.ndarray  # (n + c,) first pixel
    v: np.ndarray
    du: np.ndarray  # (n + c,) from pixel to pixel
    dv: np.ndarray
    along: np.ndarray  # (n,) place on the side, 0 at its first corner, 1 at its second
    near: np.ndarray  # (c,) lines close to a corner
    layout: Layout
    bent: bool  # whether the plane differs from the image


def side_geometry(corners: np.ndarray) -> Geometry:
    """Describe the sides of a polygon (m, 2)."""
    edge = corners.take(_next(len(corners)), axis=0) - corners
    length = np.sqrt(edge[:, 0] * edge[:, 0] + edge[:, 1] * edge[:, 1]) + 1e-12
    normal_u, normal_v = -edge[:, 1] / length, edge[:, 0] / length
    return Geometry(edge, length, normal_u, normal_v,
                    normal_u * corners[:, 0] + normal_v * corners[:, 1])


@lru_cache(maxsize=8)
def _next(count: int) -> np.ndarray:
    return np.arange(1, count + 1) % count


def read_scan(image: np.ndarray, corners: np.ndarray, plane: Plane, half: int, stride: int = 1,
              lines_per_segment: int = 6, spans: np.ndarray | None = None) -> Scan | None:
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
    spans : (m, 2) array or None
        Part of each side to use, 0 to 1; None is all and a little beyond the corners.

    Returns
    -------
    Scan or None
        Lines that would leave the image are left out; None when hardly any are left.

    """
    count, numbers = len(corners), np.arange(len(corners))
    shown, sag = _as_shown(corners, plane)
    edge = shown.take(_next(count), axis=0) - shown
    absolute = np.abs(edge)
    upright = absolute[:, 1] > absolute[:, 0]
    main_axis = upright.astype(np.intp)
    start_main, start_cross = shown[numbers, main_axis], shown[numbers, 1 - main_axis]
    edge_main, edge_cross = edge[numbers, main_axis], edge[numbers, 1 - main_axis]
    low, total = _extent(start_main, edge_main, spans, stride)
    layout = _layout(tuple(total.tolist()), lines_per_segment)
    side = layout.side
    main = low.take(side) + stride * layout.number
    along = (main - start_main.take(side)) * (1.0 / edge_main).take(side)
    cross = start_cross.take(side) + along * edge_cross.take(side)
    if plane.bent:
        cross += 4.0 * sag[numbers, 1 - main_axis].take(side) * along * (1.0 - along)
    base = np.rint(cross).astype(np.int64) - (half + FAR_PX)
    pixels = 2 * (half + FAR_PX) + 1
    if _leaves(shown, image.shape, half + FAR_PX + 3):
        keep = _inside(upright.take(side), main, base, pixels, image.shape)
        if keep.sum() < 3 * count:
            return None
        side, main, along, base = side[keep], main[keep], along[keep], base[keep]
        layout = _layout(tuple(np.bincount(side, minlength=count).tolist()), lines_per_segment)
    return _gather(image, plane, half, layout, upright.take(side), main, base, along,
                   _near_corners(side, along, absolute, half))


def _as_shown(corners: np.ndarray, plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """Give the corners in the image, and how far each side's middle bends away."""
    if not plane.bent:
        return corners, corners
    after = _next(len(corners))
    middle = 0.5 * (corners + corners[after])
    shown = plane.to_image(np.concatenate([corners, middle]))
    shown, middle = shown[:len(corners)], shown[len(corners):]
    return shown, middle - 0.5 * (shown + shown[after])


def _extent(start: np.ndarray, edge: np.ndarray, spans: np.ndarray | None,
            stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Give each side's first column or row, and its number of lines."""
    reach = CORNER_REACH_PX
    if spans is not None:
        start, edge = start + spans[:, 0] * edge, (spans[:, 1] - spans[:, 0]) * edge
        reach = np.where((spans[:, 0] > 0.0) | (spans[:, 1] < 1.0), 0.0, reach)
    end = start + edge
    low = np.ceil(np.minimum(start, end) - reach)
    total = np.maximum(np.floor(np.maximum(start, end) + reach) - low, -1.0)
    return low.astype(np.int64), total.astype(np.int64) // stride + 1


@lru_cache(maxsize=4096)
def _layout(total: tuple[int, ...], per_segment: int) -> Layout:
    side = np.repeat(np.arange(len(total)), total)
    number = np.concatenate([np.arange(lines) for lines in total])
    cuts, owners, before = [], [], 0
    for owner, lines in enumerate(total):
        parts = max(1, round(lines / per_segment)) if lines else 0
        cuts += [before + part * lines // parts for part in range(parts)]
        owners += [owner] * parts
        before += lines
    return Layout(side, number, np.array(cuts, dtype=np.intp),
                  np.diff(np.array([*cuts, before])), np.array(owners, dtype=np.intp))


def _leaves(shown: np.ndarray, shape: tuple[int, ...], margin: int) -> bool:
    (left, top), (right, bottom) = shown.min(axis=0).tolist(), shown.max(axis=0).tolist()
    return not (left >= margin and top >= margin and right <= shape[1] - 1 - margin
                and bottom <= shape[0] - 1 - margin)


def _inside(steep: np.ndarray, main: np.ndarray, base: np.ndarray, pixels: int,
            shape: tuple[int, ...]) -> np.ndarray:
    height, width = shape
    return (base >= 0) & (base + pixels <= np.where(steep, width, height)) \
        & (main >= 0) & (main < np.where(steep, height, width))


def _near_corners(side: np.ndarray, along: np.ndarray, edge: np.ndarray,
                  half: int) -> tuple[np.ndarray, np.ndarray]:
    """List the lines whose pixels may lie beyond the next side, and that side."""
    length = np.sqrt(edge[:, 0] ** 2 + edge[:, 1] ** 2) + 1e-12
    slant = edge.min(axis=1) / length  # pixels drift along the side by this
    zone = ((CORNER_ZONE_PX + half * slant) / length).take(side)
    near = np.flatnonzero(np.abs(along - 0.5) > 0.5 - zone)
    return near, (side.take(near) + np.where(along.take(near) < 0.5, -1, 1)) % len(edge)


def _gather(image: np.ndarray, plane: Plane, half: int, layout: Layout, steep: np.ndarray,
            main: np.ndarray, base: np.ndarray, along: np.ndarray,
            near: tuple[np.ndarray, np.ndarray]) -> Scan:
    width = image.shape[1]
    step = np.where(steep, 1, width)
    first = np.where(steep, main * width + base, base * width + main)
    offsets = np.multiply.outer(np.arange(2 * (half + FAR_PX) + 1), step)
    grey = image.reshape(-1).take(offsets + first)
    close = grey[FAR_PX:-FAR_PX].astype(np.float32)
    table = np.empty((4, len(first)))
    np.add.reduce(grey[:FAR_PX], axis=0, dtype=float, out=table[0])
    np.add.reduce(grey[-FAR_PX:], axis=0, dtype=float, out=table[1])
    table[2] = np.add.reduce(close, axis=0)
    table[3] = np.einsum('ij,ij->j', close, close)
    again = np.concatenate([np.arange(len(first)), near[0]])
    places = (part.take(again) for part in _in_plane(plane, steep, main, base + FAR_PX,
                                                     first + FAR_PX * step, step, half))
    return Scan(close, *np.add.reduceat(table, layout.first_line, axis=1),
                np.concatenate([layout.side, near[1]]), *places, along, near[0], layout,
                plane.bent)


def _in_plane(plane: Plane, steep: np.ndarray, main: np.ndarray, base: np.ndarray,
              first: np.ndarray, step: np.ndarray, half: int) -> tuple[np.ndarray, ...]:
    """Give each line's first pixel and its advance in the plane: u, v, du, dv."""
    if not plane.bent:
        return (np.where(steep, base, main), np.where(steep, main, base),
                steep.astype(float), (~steep).astype(float))
    u_map, v_map = plane.maps
    last = first + 2 * half * step
    u, v = u_map.take(first), v_map.take(first)
    return u, v, (u_map.take(last) - u) / (2 * half), (v_map.take(last) - v) / (2 * half)
