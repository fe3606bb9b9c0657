"""
The six parameters of a planar displacement: paper, section 3.1.

With unit focal length the homography from the virtual home image p_0 to p_k is
``H = [r1 r2 t / cZh]`` (eq. 15), where r1 and r2 are the first two columns of
R = Rx(alpha) Ry(beta) Rz(gamma) and t is the face's origin in the camera frame.
`decompose` reads the parameters off this form with signs; `decompose_paper` keeps
the printed eqs. 18-22 and their search over signs for comparison.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from homography_servo.geometry.rigid import checked_transforms
from homography_servo.geometry.rigid import transform
from homography_servo.result import Rejected
import numpy as np

_EDGE = 1e-12  # relative size below which a determinant or a depth counts as zero
_CUT_RAD = 4e-12  # gamma this near -pi is +pi: round-off must not choose the side


class DisplacementParameters(NamedTuple):
    """
    The paper's parameters; floats, or arrays (N,) along a path.

    Angles in rad; x = X / cZh, y = Y / cZh and divergence = cZh / (cZh + Z) have no unit.
    """

    alpha: float
    beta: float
    gamma: float
    x: float
    y: float
    divergence: float


def decompose(homography: np.ndarray) -> DisplacementParameters | Rejected:
    """
    Find the six parameters of a homography without searching for signs.

    Parameters
    ----------
    homography : (3, 3) array
        From the home image to the image, unit focal length, any positive scale. Its
        sign matters: H33 > 0 means the origin of the face is before the camera.

    Returns
    -------
    DisplacementParameters or Rejected
        gamma in (-pi, pi]. r1 and r2 are the orthonormal pair nearest to the first two
        columns; the divergence comes from the scale that fits them best, the mean of
        their singular values (eq. 19 takes the root mean square of the same).

    """
    elements = _elements(homography)
    if isinstance(elements, Rejected):
        return elements
    a, b, c, d, e, f, g, h, i = elements
    p, q, o = a * a + d * d + g * g, a * b + d * e + g * h, b * b + e * e + h * h
    product = math.sqrt(max(p * o - q * q, 0.0))  # of the two singular values
    total = math.sqrt(p + o + 2.0 * product)  # their sum
    if product <= _EDGE * (p + o):
        return Rejected('degenerate homography: its first two columns are parallel')
    # Polar factor of the 3x2 block: its columns times the inverse root of their Gram matrix.
    k = 1.0 / (product * total)
    m11, m12, m22 = (o + product) * k, -q * k, (p + product) * k
    r11, r12 = a * m11 + b * m12, a * m12 + b * m22
    r21, r22 = d * m11 + e * m12, d * m12 + e * m22
    r31, r32 = g * m11 + h * m12, g * m12 + h * m22
    r13, r23, r33 = r21 * r32 - r31 * r22, r31 * r12 - r11 * r32, r11 * r22 - r21 * r12
    gamma = math.atan2(-r12, r11)
    scale = 0.5 * total
    return DisplacementParameters(
        math.atan2(-r23, r33), math.atan2(r13, math.hypot(r23, r33)),
        gamma if gamma > _CUT_RAD - math.pi else math.pi, c / scale, f / scale, scale / i)


def decompose_paper(homography: np.ndarray) -> DisplacementParameters | Rejected:
    """
    Find the six parameters by eqs. 18-22 as printed, then search for the signs.

    It loses half of the digits near 0 deg and fails when noise pushes an arccos past
    1; it is kept for comparison, not for driving a robot.

    Parameters
    ----------
    homography : (3, 3) array
        As for `decompose`.

    Returns
    -------
    DisplacementParameters or Rejected
        The combination of signs whose eq. 15 is nearest to the homography.

    """
    elements = _elements(homography)
    if isinstance(elements, Rejected):
        return elements
    normal = np.reshape(elements, (3, 3)) / elements[8]
    (a, b, c), (d, e, f), (g, h, _) = normal.tolist()
    first = a * a + b * b
    if first == 0.0:
        return Rejected('eq. 21 is degenerate: a^2 + b^2 = 0')
    gamma = math.atan2(-b, a)
    divergence = math.sqrt((first + d * d + e * e + g * g + h * h) / 2.0)
    squared_cosines = ((divergence**2 - g * g - h * h) / first, first / divergence**2)
    if not all(0.0 <= value <= 1.0 + 1e-9 for value in squared_cosines):
        return Rejected('eqs. 21 and 22 have no solution: the squared cosines are '
                        f'{squared_cosines[0]:.6g} and {squared_cosines[1]:.6g}')
    alpha, beta = (math.acos(min(math.sqrt(value), 1.0)) for value in squared_cosines)
    candidates = [DisplacementParameters(s * alpha, t * beta, gamma, c / divergence,
                                         f / divergence, divergence)
                  for s in (1.0, -1.0) for t in (1.0, -1.0)]
    return min(candidates, key=lambda each: np.abs(
        divergence * compose(each) - normal).sum())


def compose(parameters: DisplacementParameters) -> np.ndarray:
    """
    Build the homography of eq. 15.

    Parameters
    ----------
    parameters : DisplacementParameters
        Floats, or arrays of one shape (...).

    Returns
    -------
    (..., 3, 3) array
        With H33 = 1 / divergence, as eq. 15 has it; divide by H33 for eq. 17.

    """
    alpha, beta, gamma, x, y, divergence = values = _arrays(parameters)
    if not (divergence != 0.0).all() or any(np.isnan(value).any() for value in values):
        raise ValueError(f'divergence must not be 0 and nothing nan, got {parameters}')
    homography = rotation_from_angles(alpha, beta, gamma)
    homography[..., 0, 2], homography[..., 1, 2] = x, y
    homography[..., 2, 2] = 1.0 / divergence
    return homography


def pose_from_parameters(parameters: DisplacementParameters,
                         home_depth_m: float = 1.0) -> np.ndarray:
    """Give the displacements T_k0 = ``home_from_object`` (..., 4, 4): eqs. 6, 7 and 16."""
    _check_depth(home_depth_m)
    alpha, beta, gamma, x, y, divergence = values = _arrays(parameters)
    if not (divergence > 0.0).all() or not all(np.isfinite(value).all() for value in values):
        raise ValueError(f'divergence must be > 0 and all finite, got {parameters}')
    origin = np.stack(np.broadcast_arrays(x, y, 1.0 / divergence - 1.0), axis=-1)
    return transform(rotation_from_angles(alpha, beta, gamma), home_depth_m * origin)


def parameters_from_pose(home_from_object: np.ndarray,
                         home_depth_m: float = 1.0) -> DisplacementParameters | Rejected:
    """
    Give the six parameters of displacements T_k0.

    Parameters
    ----------
    home_from_object : (..., 4, 4) array
        Poses.
    home_depth_m : float
        cZh.

    Returns
    -------
    DisplacementParameters or Rejected
        Floats for one pose, arrays for a stack; rejected when an object's origin is at
        or behind the focal plane.

    """
    _check_depth(home_depth_m)
    pose = checked_transforms(home_from_object)
    if not np.isfinite(pose).all():
        return Rejected('the pose is not finite')
    depth = 1.0 + pose[..., 2, 3] / home_depth_m
    if not (depth > _EDGE).all():
        return Rejected('the object is at or behind the focal plane of the camera')
    angles = angles_from_rotation(pose[..., :3, :3])
    values = (*angles, *np.moveaxis(pose[..., :2, 3] / home_depth_m, -1, 0), 1.0 / depth)
    return DisplacementParameters(*(value if value.ndim else float(value) for value in values))


def rotation_from_angles(alpha: np.ndarray, beta: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Give R = Rx(alpha) Ry(beta) Rz(gamma) (..., 3, 3): eq. 7 with (1, 3) = sin(beta)."""
    alpha, beta, gamma = np.broadcast_arrays(alpha, beta, gamma)
    (sa, sb, sg), (ca, cb, cg) = np.sin([alpha, beta, gamma]), np.cos([alpha, beta, gamma])
    rows = [cb * cg, -cb * sg, sb,
            ca * sg + sa * sb * cg, ca * cg - sa * sb * sg, -sa * cb,
            sa * sg - ca * sb * cg, sa * cg + ca * sb * sg, ca * cb]
    return np.stack(rows, axis=-1).reshape(*alpha.shape, 3, 3)


def angles_from_rotation(rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give alpha, beta, gamma [rad] of rotations (..., 3, 3); alpha = 0 where beta = +-90 deg."""
    r = np.asarray(rotation, float)
    cosine = np.hypot(r[..., 0, 0], r[..., 0, 1])
    locked = cosine < _EDGE
    alpha = np.where(locked, 0.0, np.arctan2(-r[..., 1, 2], r[..., 2, 2]))
    gamma = np.where(locked, np.arctan2(r[..., 1, 0], r[..., 1, 1]),
                     np.arctan2(-r[..., 0, 1], r[..., 0, 0]))
    gamma = np.where(gamma > _CUT_RAD - math.pi, gamma, math.pi)
    return alpha, np.arctan2(r[..., 0, 2], cosine), gamma


def _elements(homography: np.ndarray) -> list[float] | Rejected:
    """Give the nine elements by rows, the largest of size 1, if they show a face."""
    rows = np.asarray(homography, float)
    if rows.shape != (3, 3):
        raise ValueError(f'homography must have shape (3, 3), got {rows.shape}')
    # Plain floats: on nine numbers they are several times faster than array calls.
    elements = rows.ravel().tolist()
    size = max(map(abs, elements))
    if not all(map(math.isfinite, elements)):
        return Rejected('the homography is not finite')
    if size == 0.0:
        return Rejected('degenerate homography: it is zero')
    elements = a, b, c, d, e, f, g, h, i = [value / size for value in elements]
    if i <= _EDGE:
        return Rejected('the object is at or behind the focal plane of the camera (H33 <= 0)')
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if abs(determinant) <= _EDGE:
        return Rejected('degenerate homography: the face is seen edge on (determinant 0)')
    if determinant < 0.0:
        return Rejected('mirrored homography: the face looks away from the camera '
                        '(determinant < 0)')
    return elements


def _arrays(parameters: DisplacementParameters) -> list[np.ndarray]:
    return [np.asarray(value, float) for value in parameters]


def _check_depth(home_depth_m: float) -> None:
    if not 0.0 < home_depth_m < math.inf:
        raise ValueError(f'home_depth_m must be > 0 and finite, got {home_depth_m}')
