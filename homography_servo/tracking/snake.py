"""Fit the shape of the object to edge measurements: robust weighted least squares."""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.result import Rejected
from homography_servo.tracking.edges import EdgeMeasurement
from homography_servo.tracking.edges import measure_edges
from homography_servo.tracking.edges import scan_lines
from homography_servo.tracking.edges import side_geometry
from homography_servo.tracking.profile import EdgeProfile
import numpy as np

MODEL_ERROR_PX = 0.02  # straightness of a printed or cut edge
NOISE_FLOOR = 0.3  # mean squared grey level; rounding alone gives 1/12
ROBUST_SIGMAS = 4.0  # where Tukey's weight ends


class Prior(NamedTuple):
    """Where the corners are expected, and how sure that is."""

    corners: np.ndarray  # (m, 2) [px]
    information: np.ndarray  # (2m, 2m) [1/px^2]


class Quality(NamedTuple):
    """How well the edges support a shape."""

    inlier_share: float  # of all lines
    side_share: np.ndarray  # (m,) of the lines of each side
    contrast: float  # median of inside minus outside over the inliers, grey levels
    residual: float  # RMS distance of the inliers from the shape [px]
    noise: float  # pixel noise found, grey levels
    inside: float  # median grey level inside


class SnakeFit(NamedTuple):
    """Corners, how sure they are, and why."""

    corners: np.ndarray  # (m, 2) [px]
    covariance: np.ndarray  # (2m, 2m) [px^2]
    quality: Quality
    edges: EdgeMeasurement
    weight: np.ndarray  # (n,) 0 outlier .. 1 inlier


def polygon_rows(edges: EdgeMeasurement, corner_count: int) -> np.ndarray:
    """
    Say how the inward offset of each line follows from moves of the corners.

    Returns
    -------
    (n, 2 corner_count) array

    """
    rows = np.zeros((len(edges.side), corner_count, 2))
    number = np.arange(len(edges.side))
    rows[number, edges.side] = edges.normal * (1.0 - edges.along)[:, None]
    rows[number, (edges.side + 1) % corner_count] += edges.normal * edges.along[:, None]
    return rows.reshape(len(number), -1)


def fit_polygon(edges: EdgeMeasurement, corners: np.ndarray, usable: np.ndarray,
                prior: Prior | None, sure_px: float, rounds: int = 2
                ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Move the corners to where most lines agree.

    Parameters
    ----------
    edges : EdgeMeasurement
        Measured around `corners`.
    corners : (m, 2) array
        Where the sides were expected [px].
    usable : (n,) bool array
        Lines that may take part.
    prior : Prior or None
        Holds what no line measures.
    sure_px : float
        Scatter that is not surprising, added to each line's own [px].
    rounds : int
        Reweightings.

    Returns
    -------
    (m, 2) array, (2m, 2m) array, (n,) array
        Corners, their covariance, and the weight 0..1 of each line.

    """
    rows = polygon_rows(edges, len(corners))
    noise = noise_of(edges)
    variance = edges.variance_px2 * np.maximum(noise / edges.residual, 1.0) \
        + MODEL_ERROR_PX ** 2
    scale = 1.0 / (ROBUST_SIGMAS * np.sqrt(variance + sure_px * sure_px))
    weight = usable.astype(float)
    shift = np.zeros(corners.size) if prior is None else (prior.corners - corners).ravel()
    miss = edges.inward_px - rows @ shift
    if rounds > 1:  # start from the middle of each side's votes, not from their mean
        miss = miss - _side_medians(miss, edges.side, usable, len(corners))
    for _ in range(rounds):
        weight = np.where(usable, np.maximum(1.0 - (miss * scale) ** 2, 0.0) ** 2, 0.0)
        weighted = rows * (weight / variance)[:, None]
        information, target = weighted.T @ rows, weighted.T @ edges.inward_px
        if prior is not None:
            information = information + prior.information
            target = target + prior.information @ (prior.corners - corners).ravel()
        information[np.diag_indices_from(information)] += 1e-9
        covariance = np.linalg.inv(information)
        shift = covariance @ target
        miss = edges.inward_px - rows @ shift
    return corners + shift.reshape(corners.shape), covariance, weight


def _side_medians(miss: np.ndarray, side: np.ndarray, usable: np.ndarray,
                  count: int) -> np.ndarray:
    medians = np.zeros(count)
    for number in range(count):
        votes = miss[(side == number) & usable]
        if len(votes):
            medians[number] = np.median(votes)
    return medians[side]


def noise_of(edges: EdgeMeasurement) -> float:
    """Estimate the variance of the pixel noise from the quieter lines."""
    return max(float(np.median(edges.residual)), NOISE_FLOOR)


def fit_snake(image: np.ndarray, start: np.ndarray, profile: EdgeProfile, half: int,
              stride: int = 1, iterations: int = 3, prior: Prior | None = None,
              sure_px: float = 0.3, polarity: int = 0) -> SnakeFit | Rejected:
    """
    Find the polygon's corners near where they are expected.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    start : (m, 2) array
        Corners to begin with, clockwise on the screen [px].
    profile : EdgeProfile
        Expected blur of the edges.
    half, stride : int
        Band and spacing of the scan lines [px].
    iterations : int
        Linear steps.
    prior : Prior or None
        What is known before looking.
    sure_px : float
        Scatter between lines that is not surprising [px].
    polarity : int
        1 when the face is brighter than what surrounds it, -1 when darker, 0 unknown.

    Returns
    -------
    SnakeFit or Rejected

    """
    corners, read_at = start, None
    for iteration in range(iterations):
        if read_at is None or np.abs(corners - read_at).max() > 0.5 * half:
            lines, read_at = scan_lines(image, corners, half, stride), corners
            if len(lines.side) < 3 * len(start):
                return Rejected(f'only {len(lines.side)} scan lines inside the image')
        edges = measure_edges(lines, corners, profile)
        usable = usable_lines(edges, profile, polarity)
        if usable.sum() < 2 * len(start):
            return Rejected(f'only {int(usable.sum())} lines show an edge')
        reach = np.clip(edges.inward_px, -2.0 * profile.sigma_px, 2.0 * profile.sigma_px)
        edges = edges._replace(inward_px=reach)
        rounds = 3 if iteration == 0 else 1
        corners, covariance, weight = fit_polygon(edges, corners, usable, prior, sure_px, rounds)
        if not _sound(corners):
            return Rejected('the polygon folded')
    return SnakeFit(corners, covariance, quality_of(edges, weight, len(start)), edges, weight)


def usable_lines(edges: EdgeMeasurement, profile: EdgeProfile, polarity: int) -> np.ndarray:
    """Choose lines whose edge stands out of the noise, with the right sign."""
    clear = edges.variance_px2 < (0.75 * profile.sigma_px) ** 2
    if polarity:
        clear &= edges.contrast * polarity > 0.0
    return clear


def quality_of(edges: EdgeMeasurement, weight: np.ndarray, count: int) -> Quality:
    """Summarise the support of a fit."""
    inlier = weight > 0.1
    lines = np.maximum(np.bincount(edges.side, minlength=count), 1)
    side_share = np.bincount(edges.side, inlier, minlength=count) / lines
    if not inlier.any():
        return Quality(0.0, side_share, 0.0, np.inf, np.sqrt(noise_of(edges)), 0.0)
    residual = float(np.sqrt(np.mean(edges.inward_px[inlier] ** 2)))
    return Quality(float(inlier.mean()), side_share, float(np.median(edges.contrast[inlier])),
                   residual, float(np.sqrt(noise_of(edges))),
                   float(np.median(edges.inside[inlier])))


def _sound(corners: np.ndarray) -> bool:
    """Tell whether the polygon is convex, clockwise on the screen and finite."""
    geometry = side_geometry(corners)
    edge, following = geometry.edge, np.roll(geometry.edge, -1, axis=0)
    cross = edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]
    return bool(np.isfinite(corners).all() and (cross > 0.0).all()
                and geometry.length.min() > 4.0)
