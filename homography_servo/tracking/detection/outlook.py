"""
Look whether surfaces end at the edges of many quadrilaterals, at once.

From inside to outside the grey level must stay that of the surface until the edge and
leave it there. Where it stays, something of the same level lies behind and hides the
edge; where it has left before, something is wrong.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
from homography_servo.tracking.plane import Plane
import numpy as np

UNLIKE_GREY = 20.0  # levels inside of the sides of a face in uneven light
LEVEL_SAMPLES = 2  # innermost ones, which tell the level
LONGEST, PACE = 7, 0.25  # pixels of a transition; its slope over the steepest before
START = 2.0  # beginning of a transition, over the difference that noise cannot explain
NOISE_ROWS, DIFFERENCE_MEDIAN = 16, 0.954  # median difference of two pixels over the noise
SMOOTHED, STRONGLY_SMOOTHED = (3, 0.375), (5, 0.273)  # kernel; share of the noise it leaves
NOISY_GREY = 5.0
MOST_ROWS = 30_000  # of a picture that OpenCV makes: it must have less than 32,767
NOISE_SIGMAS, LEAST_GREY = 5.0, 5.0  # differences that are none of the noise's, nor the light's
BEFORE, AFTER = [3, 0, 1, 2], [1, 2, 3, 0]  # neighbours of the corners


class Picture(NamedTuple):
    """A picture to look at."""

    grey: np.ndarray  # (H, W) uint8
    smooth: np.ndarray  # (H, W) uint8
    other_grey: float  # a difference in the smooth one that noise cannot explain


class Rows(NamedTuple):
    """Places on edges, k on each; mostly (n, 4) of them, those of quadrilaterals."""

    share: np.ndarray  # (k,) where on the edge, 0 to 1
    place: np.ndarray  # (n, 4, k, 2) in the plane
    inward: np.ndarray  # (n, 4, k, 2) way inwards; one pixel away from the edge

    def and_those(self, other: Rows) -> Rows:
        """List all edges (e, k, 2) of these and others."""
        return Rows(self.share, *(np.concatenate([part.reshape(-1, *part.shape[-2:])
                                                  for part in parts])
                                  for parts in zip(self[1:], other[1:])))


class Outlook(NamedTuple):
    """What is seen across the edges."""

    share: np.ndarray  # (k,) where on the edge
    level: np.ndarray  # (n, 4) inside
    inward_px: np.ndarray  # (n, 4, k) where the level changes, inwards of the edge
    shown: np.ndarray  # (n, 4, k) whether it changes within reach

    def chosen(self, which: np.ndarray | slice) -> Outlook:
        """Select some."""
        return Outlook(self.share, *(part[which] for part in self[1:]))

    def grouped(self, count: int) -> Outlook:
        """Arrange a list of edges by so many in a row."""
        return Outlook(self.share, *(part.reshape(-1, count, *part.shape[1:])
                                     for part in self[1:]))

    def closeness(self, reach_px: float) -> np.ndarray:
        """Rate how near the edges the level changes (n, 4), 0 to 1."""
        near = np.maximum(1.0 - (self.inward_px / reach_px) ** 2, 0.0)
        return (self.shown * near).mean(axis=2)

    def broken(self, near_px: float) -> np.ndarray:
        """Give the share of each edge (n, 4) where the level changes far inside."""
        return (self.shown & (self.inward_px >= near_px)).mean(axis=2)

    @property
    def even(self) -> np.ndarray:
        """Tell whether there is one level inside of all four edges (n,)."""
        return np.abs(self.level - median(self.level)[:, None]).max(axis=1) < UNLIKE_GREY


def smoothed(image: np.ndarray) -> Picture:
    """Smooth a picture, and tell by how much its pixels differ that noise cannot explain."""
    part = image[::NOISE_ROWS]
    noise = _median_grey(cv2.absdiff(part[:, 1:], part[:, :-1])) / DIFFERENCE_MEDIAN \
        if image.shape[1] > 1 else 0.0
    size, left = STRONGLY_SMOOTHED if noise > NOISY_GREY else SMOOTHED
    return Picture(image, cv2.GaussianBlur(image, (size, size), 0),
                   max(NOISE_SIGMAS * left * noise, LEAST_GREY))


def look_across(picture: Picture, rows: Rows, plane: Plane, first_px: float | np.ndarray,
                last_px: float, count: int,
                uneven_grey: float | np.ndarray = 0.0) -> Outlook:
    """
    Follow the grey level from inside to outside.

    Parameters
    ----------
    picture : Picture
        What is looked at.
    rows : Rows
        Where to cross the edges.
    plane : Plane
        Straightens the lens.
    first_px : float or (n, 4) array
        How far inside of each edge to begin.
    last_px : float
        And where to end; negative outside.
    count : int
        Pixels to read on the way.
    uneven_grey : float or (n, 4) array
        How much the level may differ along each edge, if that is more than noise explains.

    Returns
    -------
    Outlook

    """
    first_px, uneven_grey = np.asarray(first_px)[..., None], np.asarray(uneven_grey)[..., None]
    step_px = (first_px - last_px) / (count - 1)
    begin, end = rows.place + first_px[..., None] * rows.inward, rows.place + last_px * rows.inward
    grey, inside = _read(picture.smooth, _finite(plane.to_image(np.stack([begin, end]))), count)
    own = np.add.reduce(grey[..., :LEVEL_SAMPLES], axis=-1) / np.float32(LEVEL_SAMPLES)
    level = median(own)
    other_grey = picture.other_grey
    other = np.abs(grey - own[..., None]) > other_grey
    uneven = np.abs(own - level[..., None]) > np.maximum(uneven_grey, other_grey)
    change = np.argmax(other, axis=-1)
    start = np.arange(0, grey.size, count).reshape(change.shape)
    shown = (other & inside).ravel().take(start + change)
    middle = _middle(grey, start, change, own, START * other_grey)
    inward = np.where(uneven, first_px, first_px - step_px * (change - 0.5 + middle))
    return Outlook(rows.share, level, inward, shown | uneven)


def _finite(places: np.ndarray) -> np.ndarray:
    """Put places that no lens shows outside the picture; float32."""
    return np.where(np.isfinite(places), places, -1.0).astype(np.float32)


def _middle(grey: np.ndarray, start: np.ndarray, change: np.ndarray,
            own: np.ndarray, start_grey: float) -> np.ndarray:
    """
    Give the middle of the transition that begins at a change, in pixels read.

    It lasts as long as the level goes on changing the same way at a similar pace, so
    that a sliver of something else beside the edge does not shift it.
    """
    last = grey.shape[-1] - 1
    along = np.arange(-1, LONGEST).reshape(-1, *[1] * change.ndim)
    read = grey.ravel().take(start + np.minimum(np.maximum(change + along, 0), last))
    step = np.where(read[1] > own, np.float32(1.0), np.float32(-1.0)) * (read[1:] - read[:-1])
    rise = np.maximum(step, 0.0)
    steepest, total = np.maximum.accumulate(rise), np.add.accumulate(rise)
    lasting = (step[1:] > PACE * steepest[:-1]) | (total[:-1] < start_grey)
    rise[1:] *= np.logical_and.accumulate(lasting)
    return (along[1:].astype(np.float32) * rise).sum(axis=0) / np.maximum(rise.sum(axis=0), 1e-6)


def rows_across(corners: np.ndarray, share: np.ndarray) -> Rows:
    """
    Cross the sides of quadrilaterals (n, 4, 2), clockwise on the screen.

    The way inwards leans like the neighbouring sides, so that it does not cross them.
    """
    edge, normal = edges_and_normals(corners)
    share_2d = share[:, None]
    begin, end = -edge[:, BEFORE, None], edge[:, AFTER, None]
    way = begin + share_2d * (end - begin)
    deep = way @ normal[..., None]
    return Rows(share, corners[:, :, None] + share_2d * edge[:, :, None],
                way / np.maximum(deep, 1e-6))


def edges_and_normals(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Give the sides (n, 4, 2) of quadrilaterals and their unit vectors inwards."""
    edge = corners[:, AFTER] - corners
    return edge, inward_normals(edge)


def inward_normals(edge: np.ndarray) -> np.ndarray:
    """Give unit vectors to the inside of edges (..., 2) that run clockwise on the screen."""
    normal = np.empty_like(edge)
    np.negative(edge[..., 1], out=normal[..., 0])
    normal[..., 1] = edge[..., 0]
    normal /= np.maximum(np.hypot(edge[..., 0], edge[..., 1]), 1e-9)[..., None]
    return normal


def median(values: np.ndarray) -> np.ndarray:
    """Give the upper median along the last axis, quickly."""
    half = values.shape[-1] // 2
    return np.partition(values, half, axis=-1)[..., half]


def _median_grey(grey: np.ndarray) -> float:
    """Give the median of many grey levels: counting them is quicker than sorting."""
    up_to = np.add.accumulate(np.bincount(grey.ravel()))
    return 0.5 * float(up_to.searchsorted([(grey.size - 1) // 2, grey.size // 2], 'right').sum())


def _read(image: np.ndarray, ends: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Interpolate so many grey levels along lines.

    Parameters
    ----------
    image : (H, W) uint8 array
        Grey image.
    ends : (2, ..., 2) float32 array
        Where the lines begin and end.
    count : int
        Grey levels on each.

    Returns
    -------
    (..., count) float32 array, (..., count) bool array
        The levels, and which of their places are inside the image.

    """
    begin, end = ends
    along, way = _steps(count), end - begin
    u, v = (begin[..., axis, None] + along * way[..., axis, None] for axis in (0, 1))
    height, width = image.shape
    inside = (u >= 0.0) & (u <= width - 1.0) & (v >= 0.0) & (v <= height - 1.0)
    if not u.size:
        return np.zeros(u.shape, np.float32), inside
    rows_u, rows_v = u.reshape(-1, count), v.reshape(-1, count)
    grey = [cv2.remap(image, rows_u[row:row + MOST_ROWS], rows_v[row:row + MOST_ROWS],
                      cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for row in range(0, len(rows_u), MOST_ROWS)]
    return np.concatenate(grey).reshape(u.shape).astype(np.float32), inside


@lru_cache(maxsize=8)
def _steps(count: int) -> np.ndarray:
    return np.linspace(0.0, 1.0, count, dtype=np.float32)
