"""List the convex quadrilaterals in a picture, quickly and generously."""

from __future__ import annotations

from itertools import combinations
from typing import Iterator

import cv2
import numpy as np

SMALLER_BY = 2  # the picture is searched at this fraction of its size
LEAST_IMAGE_PX = 16
THRESHOLDS = 9
CANNY_GREY = (15, 40)
SAME_PX = 4.0
STRAIGHT_PX = 1.5  # how far an outline may leave a straight side
LONGEST_SIDES = 7  # of an outline that may be sides of the face
SUPPORTED = 0.3  # share of a side that must be seen
FOURS = {count: np.array(list(combinations(range(count), 4)))
         for count in range(4, LONGEST_SIDES + 1)}
RARE_KERNEL = np.array([1, 2, 3, 2, 1])
MERGED_SINE, MERGED_PX = 0.06, 2.0  # pieces this much in line are parts of one side
SIDE_SAMPLES = np.array([0.15, 0.3, 0.5, 0.7, 0.85])


def list_quads(image: np.ndarray, least_area_px2: float) -> np.ndarray:
    """
    Find outlines of regions that are close to convex quadrilaterals.

    Regions are what lies above or below several grey levels, and what edges enclose.

    Parameters
    ----------
    image : (H, W) uint8 array
        Grey image.
    least_area_px2 : float
        Smaller ones are left out.

    Returns
    -------
    (N, 4, 2) array
        Corners clockwise on the screen, to within a few pixels; each once.

    """
    height, width = image.shape
    if min(height, width) < LEAST_IMAGE_PX:
        return np.zeros((0, 4, 2))
    small = cv2.resize(image, (width // SMALLER_BY, height // SMALLER_BY),
                       interpolation=cv2.INTER_AREA)
    least = max(least_area_px2 / SMALLER_BY ** 2, 30.0)
    pieces = [piece for mask, grow in _masks(small) for piece in _pieces(mask, least, grow)]
    if not pieces:
        return np.zeros((0, 4, 2))
    start, direction, length, grow = (np.concatenate(part) for part in zip(*pieces))
    quads = _intersected(start, direction, length, grow, least)
    # Pixel centres of the small picture lie between those of the large one.
    return _first_of_each(quads * SMALLER_BY + 0.5 * (SMALLER_BY - 1))


def _masks(small: np.ndarray) -> Iterator[tuple[np.ndarray, float]]:
    """Give binary pictures, and by how many pixels their regions are too small."""
    smooth = cv2.GaussianBlur(small, (3, 3), 0)
    edges = cv2.Canny(smooth, *CANNY_GREY)
    yield cv2.bitwise_not(edges), 0.5
    yield cv2.bitwise_not(cv2.dilate(edges, np.ones((3, 3), np.uint8))), 1.5
    levels = _rare_levels(smooth)
    for level in levels[1::2]:
        yield cv2.threshold(smooth, level, 255, cv2.THRESH_BINARY)[1], 0.0
    for low, high in zip(levels, [*levels[1:], 255]):  # between darker and brighter things
        yield cv2.inRange(smooth, low + 1, high), 0.0


def _rare_levels(smooth: np.ndarray) -> list[int]:
    """
    Spread thresholds over the grey levels, each where few pixels are near it.

    Noise would fringe the outlines at a level that a whole surface has.
    """
    low, high = np.percentile(smooth[::3, ::3], (1.0, 99.0))
    count = np.convolve(np.bincount(smooth[::2, ::2].ravel(), minlength=256), RARE_KERNEL, 'same')
    cuts = np.linspace(low, high, THRESHOLDS + 1).astype(int).tolist()
    return [first + int(np.argmin(count[first:last]))
            for first, last in zip(cuts, cuts[1:]) if last > first]


def _pieces(mask: np.ndarray, least: float, grow: float) -> Iterator[tuple[np.ndarray, ...]]:
    """
    Choose fours of straight pieces of each outline that may be sides of a quadrilateral.

    An outline that is a quadrilateral gives that one; one that has grown together with
    something else gives all that its longest pieces allow.

    Yields
    ------
    (N, 4, 2) array, (N, 4, 2) array, (N, 4) array, (N,) array
        Start, direction and length of the pieces, and how much to grow the result.

    """
    outlines = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)[-2]
    most = 0.7 * mask.size
    for outline in outlines:
        if len(outline) < 4 or not least < cv2.contourArea(outline) < most:
            continue
        simple = cv2.approxPolyDP(outline, STRAIGHT_PX, True)[:, 0, :].astype(float)
        if len(simple) < 4:
            continue
        after = simple[np.arange(1, len(simple) + 1) % len(simple)]
        hole = (simple[:, 0] * after[:, 1] - simple[:, 1] * after[:, 0]).sum() > 0.0
        if not hole:  # OpenCV goes round these the other way
            simple, after = after[::-1], simple[::-1]
        edge = after - simple
        length = np.sqrt(edge[:, 0] ** 2 + edge[:, 1] ** 2)
        direction = edge / length[:, None]
        chosen = np.argsort(-length)[:LONGEST_SIDES]
        if len(simple) > 4:
            simple, length, chosen = _joined(simple, direction, length, chosen)
        if len(chosen) < 4:
            continue
        four = np.sort(chosen)[FOURS[len(chosen)]]
        # Outlines run through the centres of a region's own pixels.
        yield (simple[four], direction[four], length[four],
               np.full(len(four), -0.5 if hole else grow + 0.5))


def _joined(start: np.ndarray, direction: np.ndarray, length: np.ndarray,
            chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Join pieces of an outline that lie on one line, as when something hides a part of a side.

    Returns
    -------
    (N, 2) array, (N,) array, (c,) array
        Where the pieces start, their lengths, and the chosen ones that are left.

    """
    own, away = direction[chosen], start - start[chosen][:, None]
    sine = own[:, :1] * direction[:, 1] - own[:, 1:] * direction[:, 0]
    aside = own[:, :1] * away[..., 1] - own[:, 1:] * away[..., 0]
    ahead = own[:, :1] * away[..., 0] + own[:, 1:] * away[..., 1]
    alike = (np.abs(sine) < MERGED_SINE) & (np.abs(aside) < MERGED_PX) \
        & (own @ direction.T > 0.0)
    low = np.where(alike, ahead, np.inf).min(axis=1)
    high = np.where(alike, ahead + length, -np.inf).max(axis=1)
    start, length = start.copy(), length.copy()
    start[chosen] += low[:, None] * own
    length[chosen] = high - low
    taken = np.triu(alike[:, chosen], 1).any(axis=0)  # by a longer one
    return start, length, chosen[~taken]


def _intersected(start: np.ndarray, direction: np.ndarray, length: np.ndarray, grow: np.ndarray,
                 least: float) -> np.ndarray:
    """Intersect neighbouring lines (N, 4) and keep the sound quadrilaterals (M, 4, 2)."""
    start = start + grow[:, None, None] * direction[..., ::-1] * (1.0, -1.0)
    after, before = [1, 2, 3, 0], [3, 0, 1, 2]
    turn = direction[:, after]
    cross = direction[..., 0] * turn[..., 1] - direction[..., 1] * turn[..., 0]
    sharp = (cross > 0.2).all(axis=1)  # clockwise on the screen, no flat corner
    start, direction, length = start[sharp], direction[sharp], length[sharp]
    turn, cross = turn[sharp], cross[sharp]
    away = start[:, after] - start
    forward = (away[..., 0] * turn[..., 1] - away[..., 1] * turn[..., 0]) / cross
    corner = start + forward[..., None] * direction  # where each side meets the next
    begin = corner[:, before]
    run = ((corner - begin) * direction).sum(axis=2)
    first = ((start - begin) * direction).sum(axis=2)
    seen = np.minimum(first + length, run) - np.maximum(first, 0.0)
    across = begin[:, 2:] - begin[:, :2]
    area = 0.5 * np.abs(across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0])
    return begin[((run > 4.0) & (seen > SUPPORTED * run)).all(axis=1) & (area > least)]


def _first_of_each(quads: np.ndarray) -> np.ndarray:
    """Pick one of those that share all corners, in whatever turn."""
    start = np.argmin(quads.sum(axis=2), axis=1)
    order = (start[:, None] + np.arange(4)) % 4
    turned = np.take_along_axis(quads, order[:, :, None], axis=1).reshape(len(quads), 8)
    return quads[np.unique(np.rint(turned / SAME_PX), axis=0, return_index=True)[1]]


def side_contrast(image: np.ndarray, quads: np.ndarray, away_px: float) -> tuple[np.ndarray, ...]:
    """
    Compare the grey levels just inside and outside of quadrilaterals.

    Returns
    -------
    (N, 4, 5) array, (N, 4, 5) array
        Inside minus outside at five places of each side, and the level inside.

    """
    edge = np.roll(quads, -1, axis=1) - quads
    normal = np.stack([-edge[..., 1], edge[..., 0]], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    place = quads[:, :, None, :] + SIDE_SAMPLES[:, None] * edge[:, :, None, :]
    inside = grey_at(image, place + away_px * normal[:, :, None, :])
    return inside - grey_at(image, place - away_px * normal[:, :, None, :]), inside


def grey_at(image: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Read the pixels nearest to some places (..., 2), inside the image."""
    height, width = image.shape
    u = np.clip(np.rint(place[..., 0]).astype(int), 0, width - 1)
    v = np.clip(np.rint(place[..., 1]).astype(int), 0, height - 1)
    return image[v, u].astype(float)
