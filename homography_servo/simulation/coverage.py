"""How much of every pixel a polygon covers: exact areas, no sampling."""

from __future__ import annotations

import math
from typing import NamedTuple
from typing import Sequence

import cv2
import numpy as np


class Region(NamedTuple):
    """A rectangle of whole pixels: first column and row, and size."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index of this rectangle in an image."""
        return (slice(self.top, self.top + self.height),
                slice(self.left, self.left + self.width))

    def divided(self, times: int) -> Region:
        """Give the same rectangle on a grid of that many parts per pixel's side."""
        return Region(*(times * value for value in self))

    @property
    def empty(self) -> bool:
        """Tell whether there is no pixel in it."""
        return self.width <= 0 or self.height <= 0


def bounding_region(points_px: np.ndarray, width: int, height: int, margin_px: int) -> Region:
    """Enclose points in whole pixels plus a margin, clipped to the image."""
    spans = []
    for low, high, size in zip(points_px.min(axis=0).tolist(), points_px.max(axis=0).tolist(),
                               (width, height)):
        first = min(max(math.floor(low) - margin_px, 0), size)
        spans.append((first, min(max(math.ceil(high) + margin_px + 1, first), size) - first))
    (left, region_width), (top, region_height) = spans
    return Region(left, top, region_width, region_height)


def polygon_coverage(polygon_px: np.ndarray, region: Region) -> np.ndarray:
    """
    Compute the share of each pixel's square that lies inside a simple polygon.

    Parameters
    ----------
    polygon_px : (N, 2) array
        Vertices (u, v) in either sense of rotation; the first is not repeated.
    region : Region
        The pixels wanted; the polygon may reach beyond them.

    Returns
    -------
    (height, width) float array
        Covered share, 0 to 1, exact to rounding.

    """
    return polygon_coverages([polygon_px], [region])[0]


def polygon_coverages(polygons_px: Sequence[np.ndarray],
                      regions: Sequence[Region]) -> list[np.ndarray]:
    """
    Compute `polygon_coverage` of several polygons, each in a region of its own.

    Every edge is cut where it crosses the pixel grid. A piece inside one pixel hides a
    trapezoid of that pixel to its right and the whole row behind it; the running sum
    along the row of these signed areas is the covered area, as in font rasterisers. A row
    ends with one cell for what lies further right, where its sum returns to zero: so one
    running sum does for the rows of all regions.
    """
    if not polygons_px:
        return []
    starts = [np.asarray(polygon, float) - (region.left - 0.5, region.top - 0.5)
              for polygon, region in zip(polygons_px, regions)]
    start = np.concatenate(starts)
    step = np.concatenate([part for own in starts for part in (own[1:], own[:1])]) - start
    shapes = [(region.height, region.width + 1) for region in regions]
    ends = np.cumsum([height * stride for height, stride in shapes]).tolist()
    window = np.repeat([(*shape, end - shape[0] * shape[1]) for shape, end in zip(shapes, ends)],
                       [len(own) for own in starts], axis=0)

    edge, t_first, t_last = _cut_at_grid(start, step)
    middle = start[edge] + step[edge] * (0.5 * (t_first + t_last))[:, None]
    rise = step[edge, 1] * (t_last - t_first)
    column, row = np.floor(middle).astype(int).T
    height, stride, first = window[edge].T
    inside = np.where((column < 0) | (column >= stride - 1), 0.0, middle[:, 0] - column)
    cell = first + row * stride + np.minimum(np.maximum(column, 0), stride - 1)
    kept = (row >= 0) & (row < height)
    shares = _running_sum(cell[kept], rise[kept], inside[kept], ends[-1])
    return [part.reshape(shape)[:, :-1]
            for part, shape in zip(np.split(shares, ends[:-1]), shapes)]


def _running_sum(cell: np.ndarray, rise: np.ndarray, inside: np.ndarray,
                 cells: int) -> np.ndarray:
    """Sum up what the pieces hide in their own pixel, and from the next one on."""
    areas = np.bincount(np.concatenate([cell, cell + 1]),
                        np.concatenate([rise * (1.0 - inside), rise * inside]), cells + 1)
    # Without any cell, bincount counts in whole numbers.
    areas = areas.astype(float, copy=False)[:cells]
    share = cv2.integral(areas[None])[1, 1:]  # four times as fast as numpy's running sum
    return np.minimum(np.abs(share, out=share), 1.0, out=share)


def _cut_at_grid(start: np.ndarray, step: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut edges at all grid lines; give each piece's edge and its interval of t."""
    count = len(start)
    crossed, t_crossed = _crossings(start.T.ravel(), step.T.ravel())
    edge = np.concatenate([np.arange(count), crossed % count])
    t_first = np.concatenate([np.zeros(count), t_crossed])
    order = np.argsort(edge + 0.5 * t_first)  # by edge, then along it
    edge, t_first = edge[order], t_first[order]
    t_last = np.ones(len(edge))
    same = edge[1:] == edge[:-1]
    t_last[:-1][same] = t_first[1:][same]
    return edge, t_first, t_last


def _crossings(start: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """List the parameters 0 < t < 1 at which coordinates pass whole numbers."""
    end = start + step
    low = np.floor(np.minimum(start, end)).astype(int)
    count = np.maximum(np.ceil(np.maximum(start, end)).astype(int) - low - 1, 0)
    index = np.repeat(np.arange(len(start)), count)
    # Number of each crossing in the whole list, less that of the first on its edge.
    line = np.arange(1, len(index) + 1) + (low - np.cumsum(count) + count)[index]
    return index, np.clip((line - start[index]) / step[index], 0.0, 1.0)
