"""Move the corners of a polygon to where its edges were measured, robustly."""

from __future__ import annotations

from functools import lru_cache
from itertools import compress
import math
from typing import NamedTuple

import cv2
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.tracking.edges import Edges
from homography_servo.tracking.edges import SecondEdge
from homography_servo.tracking.lines import Layout
from homography_servo.tracking.quality import noise_of
from homography_servo.tracking.quality import Quality
from homography_servo.tracking.scan import Scan
from homography_servo.tracking.strips import Strips
import numpy as np

MODEL_ERROR_PX = 0.005  # straightness of a printed or cut edge, over one segment
ROBUST_SIGMAS = 4.0  # where Tukey's weight ends
ODD_SIGMAS = 3.0  # a residual this far above its mean is more than noise


class Prior(NamedTuple):
    """Where the corners are expected, and how sure that is."""

    corners: np.ndarray  # (m, 2) [px]
    information: np.ndarray  # (2m, 2m) [1/px^2]
    free: np.ndarray | None = None  # (2m, 4) orthonormal columns that are left free
    pull: np.ndarray | None = None  # (2m,) [1/px] what draws away from these corners


class Look(NamedTuple):
    """One way of looking for the edges."""

    blur_px: float  # expected blur
    half: int  # pixels on either side of the edge
    stride: int = 1  # distance of the scan lines [px]
    lines: int = 6  # scan lines per segment
    iterations: int = 5  # linear steps at most
    done_sigmas: float = 15.0  # a step smaller than so many corner sigmas is the last one
    sure_px: float = 0.15  # scatter between segments that is not surprising
    first_sure_px: float = 0.6  # the same in the first round
    least: int = 8  # segments that must show an edge
    round_px: int = 1  # lines of a side cover a multiple of this: their arrangement rests


class SnakeFit(NamedTuple):
    """Corners, how sure they are, and why."""

    corners: np.ndarray  # (m, 2) [px]
    covariance: np.ndarray  # (2m, 2m) [px^2]
    information: np.ndarray  # (2m, 2m) [1/px^2], its inverse
    edges: Edges
    weight: np.ndarray  # (s,) 0 outlier .. 1 inlier
    miss: np.ndarray  # (s,) distance of the segments from the shape [px]
    step: np.ndarray  # (2m,) last move of the corners
    moved_px: float  # its largest component
    quality: Quality | None = None
    scan: Scan | None = None  # the pixels it was fitted to
    strips: Strips | None = None  # the sides of the box that were expected
    by_print: bool = False  # whether the print on the face was needed
    shape: Prior | None = None  # the part of the prior that is the same for every picture

    @property
    def judged(self) -> Quality:
        """Give the quality, which every fit has that `fit_snake` gives."""
        return required(self.quality, 'quality of the fit')

    @property
    def told_by_pictures(self) -> np.ndarray:
        """Give the covariance (2m, 2m) [px^2] without the shape, which every fit may use once."""
        if self.shape is None:
            return self.covariance
        determined, covariance = cv2.invert(self.information - self.shape.information,
                                            flags=cv2.DECOMP_CHOLESKY)
        return covariance if determined else self.covariance


def fit_polygon(edges: Edges, corners: np.ndarray, usable: np.ndarray, prior: Prior | None,
                look: Look, first: bool = True,
                strips: Strips | None = None) -> SnakeFit | Rejected:
    """
    Move the corners to where most segments agree.

    Parameters
    ----------
    edges : Edges
        Measured around `corners`.
    corners : (m, 2) array
        Where the corners were expected.
    usable : (s,) bool array
        Segments that may take part.
    prior : Prior or None
        Holds what no segment measures.
    look : Look
        Says what scatter is no surprise.
    first : bool
        Whether nothing has been fitted in this picture yet.
    strips : Strips or None
        Sides of a box; their widths were measured too.

    Returns
    -------
    SnakeFit or Rejected

    """
    rows, inward = polygon_rows(edges, len(corners)), edges.inward
    beyond: float | np.ndarray = MODEL_ERROR_PX ** 2
    if edges.second is not None and strips is not None:
        beyond = beyond + strips.doubt(edges.side, edges.along)
    held, pull = _held(prior, corners)
    miss = inward
    if first:  # the mean of a side would follow outliers
        miss = inward - _side_middles(inward, edges.layout, usable)
    for sure_px in (look.first_sure_px, look.sure_px) if first else (look.sure_px,):
        variance = _variance(edges, miss) + beyond
        weight = 1.0 - miss * miss / (ROBUST_SIGMAS ** 2 * (variance + sure_px * sure_px))
        np.maximum(weight, 0.0, out=weight)
        weight *= weight * usable
        precision = weight / variance
        weighted = rows * precision
        information, target = weighted @ rows.T + held, weighted @ inward + pull
        if edges.second is not None and strips is not None:
            _add_widths(information, target, edges, edges.second, strips, rows,
                        precision * edges.variance)
        determined, covariance = cv2.invert(information, flags=cv2.DECOMP_CHOLESKY)
        if not determined:
            return Rejected('the edges do not determine the corners')
        shift = covariance @ target
        before, miss = miss, inward - shift @ rows
        if float(np.maximum.reduce(np.maximum(np.abs(before), np.abs(miss)))) < look.sure_px:
            break  # weights would hardly change
    return SnakeFit(corners + shift.reshape(corners.shape), covariance, information, edges,
                    weight, miss, shift, max(map(abs, shift.tolist())))


def _variance(edges: Edges, miss: np.ndarray) -> np.ndarray:
    """
    Give the variances of the offsets of segments that miss the shape by so much.

    A lucky residual does not make a segment surer; one that noise cannot explain has
    something else in it. Squares that the model leaves unexplained may have shifted the
    edge by as much as if all of them had been its own (Cauchy and Schwarz).
    """
    pixels = edges.pixels
    per_square = edges.residual / (edges.variance * pixels)  # of an offset
    left = np.maximum(edges.residual - per_square * edges.inward ** 2, 0.1 * edges.residual)
    noise = noise_of(left, pixels)
    usual = noise * (1.0 + ODD_SIGMAS * math.sqrt(2.0 / float(pixels[len(pixels) // 2])))
    odd = np.maximum(left + per_square * miss ** 2 - usual, 0.0)
    return (np.maximum(left, noise) / pixels + odd) / per_square


def polygon_rows(edges: Edges, corner_count: int) -> np.ndarray:
    """Say how each segment's inward offset follows from moves of the corners: (2 m, s)."""
    own, change = _shares(edges.layout, corner_count)
    share = change * edges.along  # of each corner in a segment's place
    share += own
    return (share[:, None] * edges.normal).reshape(2 * corner_count, -1)


@lru_cache(maxsize=64)
def _shares(layout: Layout, corner_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Give the shares of the corners at the start of a segment's side, and their change."""
    start, change = _ends(corner_count)
    return start.take(layout.segment_side, axis=1), change.take(layout.segment_side, axis=1)


@lru_cache(maxsize=8)
def _ends(corner_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Give the share of each corner in the start of each side, and its change to the end."""
    start = np.eye(corner_count)
    return start, np.roll(start, 1, axis=0) - start


def _add_widths(information: np.ndarray, target: np.ndarray, edges: Edges,
                second: SecondEdge, strips: Strips, rows: np.ndarray,
                weight: np.ndarray) -> None:
    """Add what the strips' widths say about the corners to the normal equations."""
    own = strips.rows_at(edges.side[second.segment], edges.along[second.segment])
    weight = weight[second.segment]
    mixed = rows[:, second.segment] @ (own * (weight * second.mixed)[:, None])
    information += mixed + mixed.T + own.T @ (own * (weight * second.own)[:, None])
    target += own.T @ (weight * second.pull)


def _held(prior: Prior | None, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if prior is None:
        return 1e-9 * np.eye(corners.size), np.zeros(corners.size)
    pull = prior.information @ (prior.corners - corners).ravel()
    return prior.information, pull if prior.pull is None else pull + prior.pull


def _side_middles(votes: np.ndarray, layout: Layout, usable: np.ndarray) -> np.ndarray:
    """Give each segment the median of its side's usable ones."""
    all_votes, middles = votes.tolist(), []
    used = None if np.count_nonzero(usable) == len(usable) else usable.tolist()
    for ends, between in layout.parts:  # so few are sorted faster as plain floats
        own = all_votes[ends] + all_votes[between]
        if used is not None:
            own = list(compress(own, used[ends] + used[between]))
        own.sort()
        middles.append(own[len(own) // 2] if own else 0.0)
    return np.array(middles).take(layout.segment_side)
