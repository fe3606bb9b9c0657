"""How much of every pixel a polygon covers: exact areas, no sampling."""

from __future__ import annotations

from typing import NamedTuple

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
    low = np.floor(points_px.min(axis=0)).astype(int) - margin_px
    high = np.ceil(points_px.max(axis=0)).astype(int) + margin_px + 1
    low = np.clip(low, 0, (width, height))
    high = np.clip(high, low, (width, height))
    return Region(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def polygon_coverage(polygon_px: np.ndarray, region: Region) -> np.ndarray:
    """
    Compute the share of each pixel's square that lies inside a simple polygon.

    Every edge is cut where it crosses the pixel grid. A piece inside one pixel hides a
    trapezoid of that pixel to its right and the whole row behind it; the running sum
    along the row of these signed areas is the covered area, as in font rasterisers.

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
    start = np.asarray(polygon_px, float) - (region.left - 0.5, region.top - 0.5)
    step = np.concatenate([start[1:], start[:1]]) - start
    edge, t_first, t_last = _cut_at_grid(start, step)
    middle = start[edge] + step[edge] * (0.5 * (t_first + t_last))[:, None]
    rise = step[edge, 1] * (t_last - t_first)
    column, row = np.floor(middle).astype(int).T
    inside = np.where(column < 0, 0.0, middle[:, 0] - column)
    keep = (row >= 0) & (row < region.height) & (column < region.width)
    return _running_sum(row[keep], np.maximum(column, 0)[keep], rise[keep], inside[keep], region)


def _running_sum(row: np.ndarray, column: np.ndarray, rise: np.ndarray, inside: np.ndarray,
                 region: Region) -> np.ndarray:
    stride = region.width + 1
    cell = row * stride + column
    areas = np.bincount(np.concatenate([cell, cell + 1]),
                        np.concatenate([rise * (1.0 - inside), rise * inside]),
                        region.height * stride)
    # Without any cell, bincount counts in whole numbers.
    share = areas.astype(float, copy=False).reshape(region.height, stride)
    share = share.cumsum(axis=1)[:, :-1]
    return np.minimum(np.abs(share, out=share), 1.0, out=share)


def _cut_at_grid(start: np.ndarray, step: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut edges at all grid lines; give each piece's edge and its interval of t."""
    cuts = [_crossings(start[:, axis], step[:, axis]) for axis in (0, 1)]
    edge = np.concatenate([np.arange(len(start)), cuts[0][0], cuts[1][0]])
    t_first = np.concatenate([np.zeros(len(start)), cuts[0][1], cuts[1][1]])
    order = np.lexsort((t_first, edge))
    edge, t_first = edge[order], t_first[order]
    t_last = np.append(t_first[1:], 1.0)
    t_last[np.append(edge[1:] != edge[:-1], True)] = 1.0
    return edge, t_first, t_last


def _crossings(start: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """List the parameters 0 < t < 1 at which coordinates pass whole numbers."""
    low = np.floor(np.minimum(start, start + step)).astype(int)
    count = np.ceil(np.maximum(start, start + step)).astype(int) - low - 1
    count = np.maximum(count, 0)
    edge = np.repeat(np.arange(len(start)), count)
    first = np.repeat(np.cumsum(count) - count, count)
    line = low[edge] + 1 + np.arange(len(edge)) - first
    return edge, np.clip((line - start[edge]) / step[edge], 0.0, 1.0)
