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
from typing import NamedTuple

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
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # points (x, y) @ TURN are (y, -x)


def _triangles() -> np.ndarray:
    """Give the differences of corners that are the slopes of d_j by corner k: (16, 4)."""
    slopes = np.zeros((4, 4, 4))
    for left_out in range(4):
        first, second, third = (corner for corner in range(4) if corner != left_out)
        for corner, plus, minus in ((first, second, third), (second, third, first),
                                    (third, first, second)):
            slopes[left_out, corner, plus], slopes[left_out, corner, minus] = 1.0, -1.0
    return slopes.reshape(16, 4)


TRIANGLES = _triangles()
AT_REST = (0.0, 0.0, 0.0)


class Bent(NamedTuple):
    """How four corners differ from a view of the rectangle, to first order."""

    value: tuple[float, float]  # cosine of the angle of its sides, log of their ratio
    axes: np.ndarray  # (2, 8) orthonormal moves of the corners that change it
    scale: tuple[float, float, float]  # value follows these: l11, l21, l22 [1/px]

    def moved(self, value: list[float]) -> np.ndarray:
        """Say how far along the axes the corners reach another value (2,) [px]."""
        first = (value[0] - self.value[0]) / self.scale[0]
        return np.array((first, (value[1] - self.value[1] - self.scale[1] * first)
                         / self.scale[2]))


def angle_and_ratio(rays: np.ndarray) -> tuple[float, float, np.ndarray] | Rejected:
    """
    Find the angle and the ratio of the sides of a parallelogram from its view.

    Parameters
    ----------
    rays : (4, 2) array
        Normalised coordinates of the corners, clockwise on the screen.

    Returns
    -------
    float, float, (2, 8) array
        Cosine of the angle between the sides 0-1 and 0-3, log of the ratio of their
        lengths, and the slopes of both by the rays.

    """
    slopes = (TRIANGLES @ (rays @ TURN)).reshape(4, 8)  # of the areas
    area = 0.5 * (slopes @ rays.ravel())
    areas, ends = area.tolist(), rays.tolist()
    if min(areas) < LEAST_AREA:
        return Rejected('the corners lie on a line')
    origin, right, _, down = ((x * d, y * d, d) for (x, y), d in zip(ends, areas))
    ax, ay, az = (end - start for end, start in zip(right, origin))
    bx, by, bz = (end - start for end, start in zip(down, origin))
    aa, bb = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz
    both = 1.0 / math.sqrt(aa * bb)
    cosine = both * (ax * bx + ay * by + az * bz)
    p, q, r, s, t = both, cosine / aa, cosine / bb, 1.0 / aa, -1.0 / bb
    by_right = ((p * bx - q * ax, p * by - q * ay, p * bz - q * az), (s * ax, s * ay, s * az))
    by_down = ((p * ax - r * bx, p * ay - r * by, p * az - r * bz), (t * bx, t * by, t * bz))
    by_corner = np.array([((-ux - vx, -uy - vy, -uz - vz), (ux, uy, uz), AT_REST, (vx, vy, vz))
                          for (ux, uy, uz), (vx, vy, vz) in zip(by_right, by_down)])
    flat = by_corner[:, :, :2]
    by_area = np.add.reduce(flat * rays, axis=2) + by_corner[:, :, 2]
    return cosine, 0.5 * math.log(aa / bb), \
        (flat * area[:, None]).reshape(2, 8) + by_area @ slopes


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
        self.forget()

    def forget(self) -> None:
        """Begin anew with what the size of the face says."""
        self._mean = [0.0, self._ratio]
        self._variance, self._learnt = FIRST_SIGMA_PX ** 2, 0  # [px^2]
        self._asked: tuple[np.ndarray, Bent, np.ndarray] | None = None

    def prior(self, corners: np.ndarray) -> Prior | None:
        """Hold corners (4, 2) to a view of the face; None where they cannot be one."""
        self._asked = None
        bent = None if self._plane.camera is None else self._bent(corners)
        if bent is None:
            return None
        move = bent.moved(self._mean)
        self._asked = corners, bent, move
        return Prior(corners + (move @ bent.axes).reshape(4, 2),
                     (bent.axes.T @ bent.axes) / self._variance)

    def learn(self, fit: SnakeFit) -> None:
        """Compare a trusted fit with the prior that it used."""
        if self._asked is None:
            return
        (corners, bent, move), self._asked = self._asked, None
        first, second = (bent.axes @ (fit.corners - corners).ravel() - move).tolist()
        left = 0.5 * float(((bent.axes @ fit.covariance) * bent.axes).sum())
        told = self._variance - left  # what the picture took away
        share = told / self._variance
        if share < LEAST_TOLD:
            return
        # The fit gives in to the prior: it shows this share of what the picture says.
        surprise = (first * first + second * second) / (2.0 * told)
        gain = max(MEAN_GAIN, 1.0 / (self._learnt + 1.0)) \
            * min(1.0, math.sqrt(MOST_SURPRISED / max(surprise, 1e-12)))
        self._learnt += 1
        one, both, two = bent.scale
        self._mean[0] += gain * one * first
        self._mean[1] += gain * (both * first + two * second)
        grown = SPREAD_GAIN / share * (min(surprise, MOST_SURPRISED) - 1.0)
        self._variance = max(self._variance * (1.0 + grown), LEAST_SIGMA_PX ** 2)

    def _bent(self, corners: np.ndarray) -> Bent | None:
        found = angle_and_ratio(self._plane.rays(corners))
        if isinstance(found, Rejected):
            return None
        cosine, ratio, slopes = found
        slopes = (slopes.reshape(2, 4, 2) / self._plane.focal).reshape(2, 8)
        first, second = slopes
        one = math.sqrt(float(first @ first))
        first /= one
        both = float(first @ second)
        second -= both * first
        two = math.sqrt(float(second @ second))
        second /= two
        return Bent((cosine, ratio), slopes, (one, both, two))
