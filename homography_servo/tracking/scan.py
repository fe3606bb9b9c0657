"""
Read the raw pixels around the sides of a polygon.

Each side is crossed by scan lines, one per pixel column (flat sides) or row (steep
sides), so that every pixel near the side is used exactly once and nothing is
interpolated. Neighbouring lines form short segments, the unit of measurement.
"""

from __future__ import annotations

from functools import lru_cache
import math
from typing import NamedTuple

from homography_servo.tracking.lines import FAR_PX
from homography_servo.tracking.lines import Layout
from homography_servo.tracking.lines import Lines
from homography_servo.tracking.lines import lines_within
from homography_servo.tracking.lines import place_lines
from homography_servo.tracking.plane import Plane
import numpy as np

FAR_STEP = 2  # every so manieth of them is read
FAR_READ = FAR_PX // FAR_STEP
FARTHEST_PX = 1e4  # corners further outside of the image are no place to look


class Geometry(NamedTuple):
    """Sides of a polygon."""

    edge: np.ndarray  # (m, 2) from corner to corner
    length: np.ndarray  # (m,)
    normal: np.ndarray  # (2, m) inwards where corners run clockwise on the screen
    level: np.ndarray  # (m,) normal . corner
    line: np.ndarray  # (3, m) normal and level


class Scan(NamedTuple):
    """
    Pixels across the sides; n lines of k pixels each, in s segments.

    Points are in the plane of straight edges. The arrays of n + c entries repeat the
    lines close to a corner, to be seen from the side across that corner.
    """

    grey: np.ndarray  # (k, n) float32 grey levels
    line_sums: np.ndarray  # (3, n) of pixels further away, outside and inside; of squares
    place: np.ndarray  # (2, 2, n + c) first pixel, and step from pixel to pixel
    along: np.ndarray  # (n,) place on the side, 0 at its first corner, 1 at its second
    layout: Layout
    bent: bool  # whether the plane differs from the image


def side_geometry(corners: np.ndarray) -> Geometry:
    """Describe the sides of a polygon (m, 2); in plain floats, for there are so few."""
    points, rows = corners.tolist(), []
    for (u, v), (next_u, next_v) in zip(points, points[1:] + points[:1]):
        along_u, along_v = next_u - u, next_v - v
        length = math.sqrt(along_u * along_u + along_v * along_v) + 1e-12
        normal_u, normal_v = -along_v / length, along_u / length
        rows.append((along_u, along_v, length, normal_u, normal_v, normal_u * u + normal_v * v))
    table = np.array(rows).T.copy()
    return Geometry(table[:2].T, table[2], table[3:5], table[5], table[3:])


@lru_cache(maxsize=8)
def _next(count: int) -> np.ndarray:
    return np.arange(1, count + 1) % count


def read_scan(image: np.ndarray, corners: np.ndarray, plane: Plane, half: int, stride: int = 1,
              lines_per_segment: int = 6, spans: np.ndarray | None = None,
              round_px: int = 1) -> Scan | None:
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
    round_px : int
        The lines of a side cover a multiple of this, so that their number rests.

    Returns
    -------
    Scan or None
        Lines that would leave the image are left out; None when hardly any are left.

    """
    shown, sag = _as_shown(corners, plane)
    outside_px = _outside(shown, image.shape)
    if not outside_px < FARTHEST_PX:
        return None
    lines = place_lines(shown, sag, half, stride, lines_per_segment, spans, round_px)
    if outside_px + half + FAR_PX + 3 > 0.0:
        lines = lines_within(lines, half, image.shape, lines_per_segment)
        if lines.layout.total < 3 * len(corners):
            return None
    return _gather(image, plane, half, lines)


def _as_shown(corners: np.ndarray,
              plane: Plane) -> tuple[np.ndarray, np.ndarray | None]:
    """Give the corners in the image, and how far each side's middle bends away."""
    if not plane.bent:
        return corners, None
    after, (shown, slopes) = _next(len(corners)), plane.show(corners)
    along = corners.take(after, axis=0) - corners
    turn = slopes.take(after, axis=0) - slopes
    # So far from its chord is the middle of a cubic with these directions at its ends.
    return shown, -0.125 * np.matmul(turn, along[:, :, None])[:, :, 0]


def _outside(shown: np.ndarray, shape: tuple[int, ...]) -> float:
    """Tell how far a polygon reaches out of the image [px]; negative where it stays inside."""
    across, down = shown.T.tolist()
    left, top, right, bottom = min(across), min(down), max(across), max(down)
    if not math.isfinite(sum(across) + sum(down)):
        return math.inf
    return max(-left, -top, right - shape[1] + 1.0, bottom - shape[0] + 1.0)


@lru_cache(maxsize=32)
def _read(half: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Go to the pixels of a line that are read from first and step, and sum them up.

    The sums are those of the far pixels before and after, and of the squares of the
    close ones, which follow after all pixels.
    """
    length = 2 * half + 1
    low = np.arange(-FAR_PX, 0, FAR_STEP)
    pixels = np.concatenate([low, np.arange(length), length - 1 - low[::-1]])
    part = np.repeat([0, 3, 1, 2], [FAR_READ, length, FAR_READ, length])
    return (np.stack((np.ones(len(pixels)), pixels), axis=1),
            np.equal.outer([0, 1, 2], part).astype(np.float32))


def _gather(image: np.ndarray, plane: Plane, half: int, lines: Lines) -> Scan:
    layout, total = lines.layout, lines.layout.total
    pixels, parts = _read(half)
    memory = np.array((1.0, image.shape[1])) @ lines.place  # where first pixels are, and steps
    table = np.empty((parts.shape[1], total), np.float32)
    table[:len(pixels)] = image.reshape(-1).take((pixels @ memory[:, :total]).astype(np.intp))
    close = table[FAR_READ:len(pixels) - FAR_READ]
    np.multiply(close, close, out=table[len(pixels):])
    place = _in_plane(plane, memory.astype(np.intp), half) if plane.bent else lines.place
    return Scan(close, parts @ table, place, lines.along, layout, plane.bent)


def _in_plane(plane: Plane, memory: np.ndarray, half: int) -> np.ndarray:
    """Give first pixels and steps (2, 2, n) of lines in the plane of a lens that bends."""
    memory[1] *= 2 * half
    memory[1] += memory[0]
    place = plane.map.take(memory, axis=0)  # of first and last pixels
    place[1] -= place[0]
    place[1] *= 0.5 / half
    return place.transpose(0, 2, 1).copy()
