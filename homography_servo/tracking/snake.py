"""Fit the shape of the object to edge measurements: robust weighted least squares."""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.result import Rejected
from homography_servo.tracking.edges import Edges
from homography_servo.tracking.edges import measure_edges
from homography_servo.tracking.edges import middle
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.profile import edge_profile
from homography_servo.tracking.scan import read_scan
import numpy as np

MODEL_ERROR_PX = 0.01  # straightness of a printed or cut edge, over one segment
NOISE_FLOOR = 0.3  # mean squared grey level; rounding alone gives 1/12
ROBUST_SIGMAS = 4.0  # where Tukey's weight ends
IMAGE_PLANE = Plane(None)


class Prior(NamedTuple):
    """Where the corners are expected, and how sure that is."""

    corners: np.ndarray  # (m, 2) [px]
    information: np.ndarray  # (2m, 2m) [1/px^2]


class Look(NamedTuple):
    """One way of looking for the edges."""

    blur_px: float  # expected blur
    half: int  # pixels on either side of the edge
    stride: int = 1  # distance of the scan lines [px]
    lines: int = 6  # scan lines per segment
    iterations: int = 2  # linear steps
    sure_px: float = 0.15  # scatter between segments that is not surprising


class Quality(NamedTuple):
    """How well the edges support a shape."""

    inlier_share: float  # of all segments
    side_share: np.ndarray  # (m,) of the segments of each side
    contrast: float  # median of inside minus outside over the inliers, grey levels
    residual: float  # RMS distance of the inliers from the shape [px]
    noise: float  # pixel noise found, grey levels
    inside: float  # median grey level inside


class SnakeFit(NamedTuple):
    """Corners, how sure they are, and why."""

    corners: np.ndarray  # (m, 2) [px]
    covariance: np.ndarray  # (2m, 2m) [px^2]
    edges: Edges
    weight: np.ndarray  # (s,) 0 outlier .. 1 inlier
    miss: np.ndarray  # (s,) distance of the segments from the shape [px]
    moved_px: float  # last step


def fit_snake(image: np.ndarray, start: np.ndarray, look: Look, plane: Plane = IMAGE_PLANE,
              prior: Prior | None = None, polarity: int = 0) -> SnakeFit | Rejected:
    """
    Find the polygon's corners near where they are expected.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    start : (m, 2) array
        Corners to begin with, clockwise on the screen, in the plane of straight edges.
    look : Look
        Where and how to look for the edges.
    plane : Plane
        Straightens the lens.
    prior : Prior or None
        What is known before looking.
    polarity : int
        1 when the face is brighter than what surrounds it, -1 when darker, 0 unknown.

    Returns
    -------
    SnakeFit or Rejected

    """
    profile, scan, corners = edge_profile(look.blur_px), None, start
    for iteration in range(look.iterations):
        if scan is None or np.abs(corners - read_at).max() > 0.4 * look.half:
            scan, read_at = read_scan(image, corners, plane, look.half, look.stride,
                                      look.lines), corners
            if scan is None:
                return Rejected('the face is not inside the image')
        edges = measure_edges(scan, corners, profile)
        usable = _usable(edges, profile.sigma_px, polarity)
        if usable.sum() < 2 * len(start):
            return Rejected(f'only {int(usable.sum())} segments show an edge')
        fit = fit_polygon(edges, corners, usable, prior, look.sure_px, 3 if iteration == 0 else 2,
                          2.0 * profile.sigma_px)
        if not sound(fit.corners):
            return Rejected('the polygon folded')
        corners = fit.corners
    return fit


def fit_polygon(edges: Edges, corners: np.ndarray, usable: np.ndarray, prior: Prior | None,
                sure_px: float, rounds: int, reach_px: float) -> SnakeFit:
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
    sure_px : float
        Scatter that is not surprising, added to each segment's own [px].
    rounds : int
        Reweightings.
    reach_px : float
        Offsets beyond this are no longer linear in the image and are cut.

    Returns
    -------
    SnakeFit

    """
    rows = polygon_rows(edges, len(corners))
    inward = np.minimum(np.maximum(edges.inward, -reach_px), reach_px)
    noise = noise_of(edges)
    variance = edges.variance * np.maximum(noise / edges.residual, 1.0) + MODEL_ERROR_PX ** 2
    narrow = 1.0 / (ROBUST_SIGMAS ** 2 * (variance + sure_px * sure_px))
    precision = usable / variance
    held, pull = _held(prior, corners)
    # Begin with the middle of each side's votes: a mean would follow the outliers.
    miss = inward - _side_middles(inward, edges.side, usable, len(corners))
    for _ in range(rounds):
        weight = np.maximum(1.0 - miss * miss * narrow, 0.0)
        weight *= weight
        weighted = (rows * (precision * weight)[:, None]).T
        information = weighted @ rows + held
        covariance = np.linalg.inv(information)
        shift = covariance @ (weighted @ inward + pull)
        miss = inward - rows @ shift
    return SnakeFit(corners + shift.reshape(corners.shape), covariance, edges, weight * usable,
                    miss, float(np.abs(shift).max()))


def polygon_rows(edges: Edges, corner_count: int) -> np.ndarray:
    """Say how each segment's inward offset follows from moves of the corners: (s, 2 m)."""
    rows = np.zeros((len(edges.side), 2 * corner_count))
    number = np.arange(len(edges.side))
    first, second = 2 * edges.side, 2 * ((edges.side + 1) % corner_count)
    later = edges.normal * edges.along[:, None]
    earlier = edges.normal - later
    rows[number, first], rows[number, first + 1] = earlier.T
    rows[number, second], rows[number, second + 1] = later.T
    return rows


def _held(prior: Prior | None, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if prior is None:
        return 1e-9 * np.eye(corners.size), np.zeros(corners.size)
    return prior.information, prior.information @ (prior.corners - corners).ravel()


def _side_middles(votes: np.ndarray, side: np.ndarray, usable: np.ndarray,
                  count: int) -> np.ndarray:
    middles = np.zeros(count)
    for number in range(count):
        own = votes[(side == number) & usable]
        if len(own):
            middles[number] = middle(own)
    return middles.take(side)


def noise_of(edges: Edges) -> float:
    """Estimate the variance of the pixel noise from the quieter segments."""
    return max(middle(edges.residual), NOISE_FLOOR)


def _usable(edges: Edges, sigma_px: float, polarity: int) -> np.ndarray:
    """Choose segments whose edge stands out of the noise, with the right sign."""
    clear = edges.variance < (0.5 * sigma_px) ** 2
    return clear & (edges.contrast * polarity > 0.0) if polarity else clear


def quality_of(fit: SnakeFit) -> Quality:
    """Summarise the support of a fit."""
    edges, count = fit.edges, len(fit.corners)
    inlier = fit.weight > 0.1
    lines = np.maximum(np.bincount(edges.side, edges.lines, count), 1.0)
    side_share = np.bincount(edges.side, edges.lines * inlier, count) / lines
    noise = float(np.sqrt(noise_of(edges)))
    if not inlier.any():
        return Quality(0.0, side_share, 0.0, np.inf, noise, 0.0)
    contrast = edges.contrast[inlier]
    return Quality(float(edges.lines[inlier].sum() / lines.sum()), side_share, middle(contrast),
                   float(np.sqrt(np.mean(fit.miss[inlier] ** 2))), noise,
                   middle(edges.outside[inlier] + contrast))


def sound(corners: np.ndarray) -> bool:
    """Tell whether the polygon is convex, clockwise on the screen and finite."""
    edge = np.roll(corners, -1, axis=0) - corners
    after = np.roll(edge, -1, axis=0)
    cross = edge[:, 0] * after[:, 1] - edge[:, 1] * after[:, 0]
    return bool(np.isfinite(corners).all() and cross.min() > 16.0)
