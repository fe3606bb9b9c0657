"""
Find the straight edges of a picture that may have the face on their right hand.

Edge pixels whose gradients point the same way form regions (Burns, Hanson and Riseman,
"Extracting straight lines", PAMI 1986): neighbours are joined where their gradients fall
into the same of eight sectors, once more with the sectors turned by half of one, and
each pixel counts for the larger of its two regions. Here the grey level inside must be
alike too, so that an edge ends where the face ends. A line is fitted to every region.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
from homography_servo.tracking.plane import Plane
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

SMALLER_BY = 2  # the picture is searched at this fraction of its size
CANNY_GREY = (12, 30)  # noise of 3 grey levels gives gradients of 3 at this size
SECTORS = 8  # a power of two
INSIDE_PX = 2.5  # from the edge to where the level inside is read
EVEN_GREY = 8.0  # neighbouring levels that are alike in the small smooth picture
LEAST_PIXELS = 4  # of a region
LEAST_OWN = 0.5  # share of a region's pixels that have no larger one
MOST_SCATTER_PX = 0.6  # of the pixels about the line


class Pieces(NamedTuple):
    """Straight edges with the inside to the right of their direction on the screen."""

    start: np.ndarray  # (N, 2) [px]
    direction: np.ndarray  # (N, 2)
    length: np.ndarray  # (N,) [px]
    level: np.ndarray  # (N,) mean grey level inside

    def chosen(self, which: np.ndarray | slice) -> Pieces:
        """Select some."""
        return Pieces(*(part[which] for part in self))


NO_PIECES = Pieces(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))


class _Pixels(NamedTuple):
    """Edge pixels (n,) of a picture."""

    place: np.ndarray  # (2, n)
    inward: np.ndarray  # (2, n) unit vectors
    level: np.ndarray  # grey level inside


def shrunk(image: np.ndarray) -> np.ndarray:
    """Make the small smooth picture (H / 2, W / 2) in which edges are looked for."""
    height, width = image.shape
    small = cv2.resize(image, (width // SMALLER_BY, height // SMALLER_BY),
                       interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small, (3, 3), 0)


def straightened(pieces: Pieces, plane: Plane) -> Pieces:
    """Carry pieces of the small picture into the plane of the large one."""
    end = pieces.start + pieces.length[:, None] * pieces.direction
    # Pixel centres of the small picture lie between those of the large one.
    start, end = (plane.from_image(point * SMALLER_BY + 0.5 * (SMALLER_BY - 1))
                  for point in (pieces.start, end))
    way = end - start
    length = np.linalg.norm(way, axis=1)
    return Pieces(start, way / np.maximum(length[:, None], 1e-9), length, pieces.level)


def find_pieces(smooth: np.ndarray, polarity: int, news: np.ndarray | None = None) -> Pieces:
    """
    Find straight edges.

    Parameters
    ----------
    smooth : (H, W) uint8 array
        Small smooth picture.
    polarity : int
        1 when the inside is brighter, -1 when darker, 0 for both, each edge twice.
    news : (H, W) uint8 array or None
        Where to look, if not everywhere: pixels that are not 0.

    Returns
    -------
    Pieces
        In its pixels, to within about a quarter of one.

    """
    slope_u, slope_v = cv2.spatialGradient(smooth)
    edges = cv2.Canny(slope_u, slope_v, *CANNY_GREY)
    edges[[0, -1]] = edges[:, [0, -1]] = 0
    if news is not None:
        edges &= news
    index = cv2.findNonZero(edges)
    if index is None:
        return NO_PIECES
    place = index.reshape(-1, 2).T
    index = place[1] * edges.shape[1] + place[0]
    slope = np.stack([slope_u.ravel()[index], slope_v.ravel()[index]]).astype(np.float32)
    slope /= np.sqrt(slope[0] * slope[0] + slope[1] * slope[1]) + 1e-6
    hands = [hand for hand in (1, -1) if polarity != -hand]
    pixels = _with_inside(smooth, np.tile(place, len(hands)),
                          np.concatenate([hand * slope for hand in hands], axis=1))
    region = _regions(pixels, slope, *_neighbours(index, edges.shape))
    pieces, straight, aside_px = _fitted(region, pixels)
    # Two edges close to each other with the fitted line between them.
    bent = (region >= 0) & ~straight
    again = _fitted(np.where(bent, 2 * region + (aside_px > 0.0), -1), pixels)[0]
    return Pieces(*(np.concatenate(part) for part in zip(pieces, again)))


def _neighbours(index: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Pair edge pixels that touch: their numbers, twice (l,), in the order of the former."""
    width, count = shape[1], len(index)
    node = np.full(shape[0] * width, -1, np.int32)
    node[index] = np.arange(count, dtype=np.int32)
    others = node.take(np.add.outer(index, (1, width - 1, width, width + 1))).ravel()
    pairs = np.flatnonzero(others >= 0)
    return pairs >> 2, others.take(pairs)


def _with_inside(smooth: np.ndarray, place: np.ndarray, inward: np.ndarray) -> _Pixels:
    """Read the level where unit vectors (2, n) point."""
    height, width = smooth.shape
    u, v = np.rint(place + INSIDE_PX * inward).astype(np.int32)
    index = np.minimum(np.maximum(v, 0), height - 1) * width \
        + np.minimum(np.maximum(u, 0), width - 1)
    return _Pixels(place.astype(np.float32), inward,
                   smooth.reshape(-1).take(index).astype(np.float32))


def _regions(pixels: _Pixels, slope: np.ndarray, first: np.ndarray,
             second: np.ndarray) -> np.ndarray:
    """
    Join edge pixels to regions.

    Parameters
    ----------
    pixels : _Pixels
        With each hand once, one hand after the other.
    slope : (2, m) array
        Unit vectors along the gradients.
    first, second : (l,) integer array, (l,) integer array
        Which of the m touch, in the order of the former.

    Returns
    -------
    (n,) array
        Number of each pixel's region; -1 where it has none.

    """
    count, level = len(pixels.level), pixels.level.reshape(-1, slope.shape[1])
    angle = np.arctan2(slope[1], slope[0]) * (SECTORS / (2.0 * np.pi))
    # Opposite gradients are alike where these are: both hands have the same sectors.
    alike = []
    for turn in (0.0, 0.5):
        sector = np.floor(angle + turn).astype(np.int8) & (SECTORS - 1)
        alike.append(sector.take(first) == sector.take(second))
    even = np.abs(level.take(first, axis=1) - level.take(second, axis=1)) < EVEN_GREY
    # The graph's nodes are all pixels, once for each way to cut the sectors.
    linked = [np.flatnonzero(one & hand) for one in alike for hand in even]
    begin, end = (np.concatenate([touching.take(pairs) + block * slope.shape[1]
                                  for block, pairs in enumerate(linked)])
                  for touching in (first, second))
    ahead = np.bincount(begin, minlength=2 * count).cumsum(dtype=np.int32)
    graph = csr_array((np.ones(len(end)), end.astype(np.int32), np.append(np.int32(0), ahead)),
                      shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    sizes = np.bincount(label).take(label).reshape(2, count)
    second_wins = sizes[1] > sizes[0]
    region = np.where(second_wins, label[count:], label[:count])
    own = np.bincount(region).take(region)
    size = np.where(second_wins, sizes[1], sizes[0])
    return np.where((own >= LEAST_PIXELS) & (own > LEAST_OWN * size), region, -1)


def _fitted(region: np.ndarray, pixels: _Pixels) -> tuple[Pieces, np.ndarray, np.ndarray]:
    """
    Fit a line to each region by the moments of its pixels.

    Returns
    -------
    Pieces, (n,) bool array, (n,) array
        The straight regions; which pixels belong to one; signed distance of each pixel
        from the line of its region.

    """
    chosen = np.flatnonzero(region >= 0)
    straight_pixel, aside_px = np.zeros(len(region), bool), np.zeros(len(region), np.float32)
    if not len(chosen):
        return NO_PIECES, straight_pixel, aside_px
    number = region.take(chosen)
    number = number.astype(np.min_scalar_type(number.max()))  # the shorter, the faster sorted
    order = np.argsort(number, kind='stable')
    chosen, number = chosen.take(order), number.take(order)
    first = np.flatnonzero(np.append(True, number[1:] != number[:-1]))
    counts = np.diff(first, append=len(chosen))
    own = np.repeat(np.arange(len(first)), counts)
    table = np.vstack([pixels.place, pixels.inward, pixels.level]).take(chosen, axis=1)
    centre_u, centre_v, in_u, in_v, level = np.add.reduceat(table, first, axis=1) / counts
    du, dv = table[0] - centre_u.take(own), table[1] - centre_v.take(own)
    uu, uv, vv = np.add.reduceat(np.stack([du * du, du * dv, dv * dv]), first, axis=1) / counts
    turn = 0.5 * np.arctan2(2.0 * uv, uu - vv)
    along = np.stack([np.cos(turn), np.sin(turn)])
    along *= np.where(along[0] * in_v > along[1] * in_u, 1.0, -1.0)
    along_u, along_v = along.take(own, axis=1)
    ahead = du * along_u + dv * along_v
    low, high = np.minimum.reduceat(ahead, first), np.maximum.reduceat(ahead, first)
    scatter = 0.5 * (uu + vv) - np.hypot(0.5 * (uu - vv), uv)
    straight = (scatter < MOST_SCATTER_PX ** 2) & (counts >= LEAST_PIXELS)
    straight_pixel[chosen] = straight.take(own)
    aside_px[chosen] = dv * along_u - du * along_v
    start = np.stack([centre_u, centre_v]) + low * along
    return (Pieces(start.T, along.T, high - low, level).chosen(straight), straight_pixel,
            aside_px)
