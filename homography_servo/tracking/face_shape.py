"""
How far the corners are from a view of the rectangle, and how far they usually are.

The camera sees four corners of a parallelogram in directions m_i. Their depths are
proportional to the areas d_i of the triangles that the other three form in the
picture, so d_i m_i are the corners in space but for scale, and tell the angle and the
ratio of the sides. A face keeps both: what its size and the lens are wrong by is
learnt, and every picture need measure little more than a pose.
"""

from __future__ import annotations

import math

from homography_servo.result import Rejected
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
import numpy as np

FIRST_SIGMA_PX = 0.3  # of the corners about a view of the face: lens, size, flatness
LEAST_SIGMA_PX = 0.03  # how much of that may change with the place in the picture
MEAN_GAIN, SPREAD_GAIN = 0.1, 0.05  # of a picture among earlier ones
MOST_SURPRISED = 9.0  # squared surprise that counts, over the usual: 3 sigmas
LEAST_TOLD = 0.1  # share of the prior's variance that a picture must remove to teach
LEAST_AREA = 1e-9  # of a triangle of corners, normalised coordinates


def angle_and_ratio(rays: np.ndarray
                    ) -> tuple[float, float, list[float], list[float]] | Rejected:
    """
    Find the angle and the ratio of the sides of a parallelogram from its view.

    In plain floats: for so few numbers what numpy costs is the number of calls.

    Parameters
    ----------
    rays : (4, 2) array
        Normalised coordinates of the corners, clockwise on the screen.

    Returns
    -------
    float, float, list of float, list of float
        Cosine of the angle between the sides 0-1 and 0-3, log of the ratio of their
        lengths, and the slopes of the one and the other by the eight coordinates.

    """
    points = (x0, y0), (x1, y1), (x2, y2), (x3, y3) = rays.tolist()
    # Twice the areas of the triangles that corners 0, 1 and 3 are left out of.
    areas = d0, d1, d3 = ((x2 - x1) * (y3 - y1) - (y2 - y1) * (x3 - x1),
                          (x2 - x0) * (y3 - y0) - (y2 - y0) * (x3 - x0),
                          (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0))
    if min(d0, d1, d3, d1 + d3 - d0) < LEAST_AREA:
        return Rejected('the corners lie on a line')
    a = ax, ay, az = d1 * x1 - d0 * x0, d1 * y1 - d0 * y0, d1 - d0
    b = bx, by, bz = d3 * x3 - d0 * x0, d3 * y3 - d0 * y0, d3 - d0
    aa, bb = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
    both = 1.0 / math.sqrt(aa * bb)
    cosine = both * (ax * bx + ay * by + az * bz)
    by_a, by_b = cosine / aa, cosine / bb
    return (cosine, 0.5 * math.log(aa / bb),
            _by_corners(points, areas, [both * v - by_a * u for u, v in zip(a, b)],
                        [both * u - by_b * v for u, v in zip(a, b)]),
            _by_corners(points, areas, [u / aa for u in a], [-v / bb for v in b]))


def _by_corners(points: list[list[float]], areas: tuple[float, float, float],
                by_a: list[float], by_b: list[float]) -> list[float]:
    """Turn slopes by the sides a = d1 m1 - d0 m0 and b = d3 m3 - d0 m0 into those by corners."""
    ((x0, y0), (x1, y1), (x2, y2), (x3, y3)), (d0, d1, d3) = points, areas
    (ux, uy, uz), (vx, vy, vz) = by_a, by_b
    wx, wy = ux + vx, uy + vy
    by_d0, by_d1, by_d3 = (-wx * x0 - wy * y0 - uz - vz, ux * x1 + uy * y1 + uz,
                           vx * x3 + vy * y3 + vz)
    return [by_d1 * (y2 - y3) + by_d3 * (y1 - y2) - d0 * wx,
            by_d1 * (x3 - x2) + by_d3 * (x2 - x1) - d0 * wy,
            by_d0 * (y2 - y3) + by_d3 * (y2 - y0) + d1 * ux,
            by_d0 * (x3 - x2) + by_d3 * (x0 - x2) + d1 * uy,
            by_d0 * (y3 - y1) + by_d1 * (y3 - y0) + by_d3 * (y0 - y1),
            by_d0 * (x1 - x3) + by_d1 * (x0 - x3) + by_d3 * (x1 - x0),
            by_d0 * (y1 - y2) + by_d1 * (y0 - y2) + d3 * vx,
            by_d0 * (x2 - x1) + by_d1 * (x2 - x0) + d3 * vy]


class FaceShape:
    """
    Expects the angle and the ratio of the sides that the face has shown so far.

    Parameters
    ----------
    face_size_m : (float, float)
        Width and height of the face.
    plane : Plane
        Without a camera every quadrilateral may be the face.

    """

    def __init__(self, face_size_m: tuple[float, float], plane: Plane) -> None:
        self._plane, self._ratio = plane, math.log(face_size_m[0] / face_size_m[1])
        if plane.camera is not None:
            self._per_px = np.tile(1.0 / plane.focal, 4)
        self.forget()

    def forget(self) -> None:
        """Begin anew with what the size of the face says."""
        self._mean = [0.0, self._ratio]
        self._variance, self._learnt = FIRST_SIGMA_PX ** 2, 0  # [px^2]
        self._asked: tuple[Prior, np.ndarray] | None = None

    def prior(self, corners: np.ndarray) -> Prior | None:
        """Hold corners (4, 2) to a view of the face; None where they cannot be one."""
        self._asked = None
        if self._plane.camera is None:
            return None
        found = angle_and_ratio(self._plane.rays(corners))
        if isinstance(found, Rejected):
            return None
        cosine, ratio, *slopes_of_both = found
        slopes = self._per_px * slopes_of_both  # (2, 8) [1/px]
        (one, both), (_, two) = (slopes @ slopes.T).tolist()
        # Corners are held along the slopes, by a deviation that is the same in all directions.
        weight = 1.0 / (self._variance * (one * two - both * both))
        stiff = weight * np.array(((two, -both), (-both, one))) @ slopes
        away = np.array((self._mean[0] - cosine, self._mean[1] - ratio))
        move = self._variance * (away @ stiff)
        prior = Prior(corners + move.reshape(4, 2), slopes.T @ stiff)
        self._asked = prior, slopes
        return prior

    def miss_px(self, corners: np.ndarray) -> float:
        """
        Give the RMS by which corners (4, 2) miss the shape that was asked for last.

        To first order it is that by which they miss a view of a face of this shape.
        """
        if self._asked is None:
            return math.inf
        prior, _ = self._asked
        missed = (corners - prior.corners).ravel()
        return math.sqrt(self._variance * max(float(missed @ prior.information @ missed), 0.0)
                         / len(missed))

    def learn(self, fit: SnakeFit) -> None:
        """Compare a trusted fit with the prior that it used."""
        if self._asked is None:
            return
        (prior, slopes), self._asked = self._asked, None
        share = 1.0 - 0.5 * float(np.vdot(prior.information, fit.covariance))
        if share < LEAST_TOLD:  # of the variance that the picture took away
            return
        missed = (fit.corners - prior.corners).ravel()
        # The fit gives in to the prior: it shows this share of what the picture says.
        surprise = 0.5 * float(missed @ prior.information @ missed) / share
        gain = max(MEAN_GAIN, 1.0 / (self._learnt + 1.0)) \
            * min(1.0, math.sqrt(MOST_SURPRISED / max(surprise, 1e-12)))
        self._learnt += 1
        angle, ratio = (slopes @ missed).tolist()
        self._mean = [self._mean[0] + gain * angle, self._mean[1] + gain * ratio]
        grown = SPREAD_GAIN / share * (min(surprise, MOST_SURPRISED) - 1.0)
        self._variance = max(self._variance * (1.0 + grown), LEAST_SIGMA_PX ** 2)
