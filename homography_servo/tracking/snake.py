"""Fit the shape of the object to edge measurements: robust weighted least squares."""

from __future__ import annotations

import math

from homography_servo.result import Rejected
from homography_servo.tracking.edges import Edges
from homography_servo.tracking.edges import measure_edges
from homography_servo.tracking.level_memory import LevelMemory
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import fit_polygon
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.profile import edge_profile
from homography_servo.tracking.quality import Quality
from homography_servo.tracking.scan import read_scan
from homography_servo.tracking.scan import Scan
from homography_servo.tracking.strips import Strips
import numpy as np

MOST_DONE_PX, MOST_STEADY_PX = 0.3, 0.3  # largest last step; step that leaves levels as they are
SAME_LEVELS_PX = 0.03  # all sides in or out by less: grey levels need no second look
IMAGE_PLANE = Plane(None)


def fit_snake(image: np.ndarray, start: np.ndarray, look: Look, plane: Plane = IMAGE_PLANE,
              prior: Prior | None = None, polarity: int = 0,
              strips: Strips | None = None,
              memory: LevelMemory | None = None) -> SnakeFit | Rejected:
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
    strips : Strips or None
        Sides of a box that show beside the face.
    memory : LevelMemory or None
        Grey levels of earlier pictures.

    Returns
    -------
    SnakeFit or Rejected

    """
    profile, corners, far_px = edge_profile(look.blur_px), start, np.inf
    spans = None if strips is None else strips.spans
    scan: Scan | None = None
    for iteration in range(look.iterations):
        if scan is None or far_px > 0.4 * look.half:
            scan, far_px = read_scan(image, corners, plane, look.half, look.stride, look.lines,
                                     spans, look.round_px), 0.0
            known = None
            if scan is None:
                return Rejected('the face is not inside the image')
        edges = measure_edges(scan, corners, profile, strips, known, memory)
        usable = _usable(edges, profile.sigma_px, polarity)
        if np.count_nonzero(usable) < look.least:
            return Rejected(f'only {np.count_nonzero(usable)} segments show an edge')
        moved = fit_polygon(edges, corners, usable, prior, look, iteration == 0, strips)
        if isinstance(moved, Rejected):
            return moved
        fit = moved
        if not sound(fit.corners):
            return Rejected('the polygon folded')
        corners, far_px = fit.corners, far_px + fit.moved_px
        sigma_px = math.sqrt(sum(fit.covariance.diagonal().tolist()) / corners.size)
        if fit.moved_px < min(look.done_sigmas * sigma_px, MOST_DONE_PX):
            break
        steady = abs(edges.common) < SAME_LEVELS_PX and fit.moved_px < MOST_STEADY_PX
        known = edges.known if steady else None
        if strips is not None:
            strips = strips._replace(width=strips.width + strips.rows @ fit.step)
    return fit._replace(quality=Quality(fit.edges, fit.weight, fit.miss), scan=scan, strips=strips)


def let_go(fit: SnakeFit, look: Look, polarity: int) -> SnakeFit | Rejected:
    """
    Fit the corners to what a fit has measured, held by nothing.

    One linear step from where it has measured: corners do not run to other edges.

    Parameters
    ----------
    fit : SnakeFit
        With a prior.
    look : Look
        How it has looked for the edges.
    polarity : int
        What it knew of the face.

    Returns
    -------
    SnakeFit or Rejected

    """
    usable = _usable(fit.edges, edge_profile(look.blur_px).sigma_px, polarity)
    measured_around = fit.corners - fit.step.reshape(fit.corners.shape)
    return fit_polygon(fit.edges, measured_around, usable, None, look, True, fit.strips)


def _usable(edges: Edges, sigma_px: float, polarity: int) -> np.ndarray:
    """Choose segments whose edge stands out of the noise, with the right sign."""
    clear = edges.variance < (0.5 * sigma_px) ** 2
    return clear & (edges.contrast * polarity > 0.0) if polarity else clear


def sound(corners: np.ndarray) -> bool:
    """Tell whether the polygon is convex, clockwise on the screen and finite."""
    points = corners.tolist()
    for (u0, v0), (u1, v1), (u2, v2) in zip(points, points[1:] + points[:1],
                                            points[2:] + points[:2]):
        if not (u1 - u0) * (v2 - v1) - (v1 - v0) * (u2 - u1) > 16.0:
            return False
    return True
