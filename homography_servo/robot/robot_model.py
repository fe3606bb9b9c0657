"""A robot: link table, limits, servo mapping, where it stands and how it holds the box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any

from homography_servo.geometry.face import face_corners
import numpy as np

# What a servo can be told to do: minpos..maxpos can be set to 800 - p0pos..5400 - p0pos,
# and p0pos is 3000 unless somebody changed it.
SETTABLE_UNITS = (-2200, 2400)
_ROTATION_TOLERANCE = 1e-6
_CORNERS_OF_FACE: Any = None  # put there when a robot is made


def _frozen(values) -> np.ndarray:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


class FieldError(ValueError):
    """A field of a joint is not sane; it says which one."""

    def __init__(self, joint: str, name: str, reason: str) -> None:
        super().__init__(f'{joint}: {name} {reason}')
        self.field = name
        self.reason = reason


@dataclass(frozen=True)
class Joint:
    """
    One turning joint: its Denavit-Hartenberg row, its limits and its servo.

    The row is A = Rz(theta0 + joint) Tz(d) Tx(a) Rx(alpha). The servo stands at
    ``zero_units + sign * units_per_rad * joint``.
    """

    name: str
    theta0_rad: float
    d_m: float
    a_m: float
    alpha_rad: float
    lower_rad: float
    upper_rad: float
    velocity_rad_s: float
    acceleration_rad_s2: float
    channel: int
    units_per_rad: float
    sign: int
    zero_units: float

    def __post_init__(self) -> None:
        problem = joint_problem(self)
        if problem:
            raise FieldError(self.name, *problem)

    @property
    def limits_units(self) -> tuple[float, float]:
        """Smallest and largest servo position that the limits allow, not rounded."""
        ends = [self.zero_units + self.sign * self.units_per_rad * end
                for end in (self.lower_rad, self.upper_rad)]
        return min(ends), max(ends)


def joint_problem(joint: Joint) -> tuple[str, str] | None:
    """Find the first field of a joint that is not sane, and say why."""
    numbers = {name: value for name, value in vars(joint).items() if name != 'name'}
    for name, value in numbers.items():
        if not math.isfinite(value):
            return name, f'must be finite, got {value}'
    for name in ('velocity_rad_s', 'acceleration_rad_s2', 'units_per_rad'):
        if numbers[name] <= 0.0:
            return name, f'must be above 0, got {numbers[name]:g}'
    if joint.lower_rad >= joint.upper_rad:
        return 'upper_rad', f'must be above lower_rad, got {joint.upper_rad:g} rad'
    if joint.sign not in (-1, 1):
        return 'sign', f'must be 1 or -1, got {joint.sign}'
    return _servo_problem(joint)


def _servo_problem(joint: Joint) -> tuple[str, str] | None:
    low, high = joint.limits_units
    if low < SETTABLE_UNITS[0] or high > SETTABLE_UNITS[1]:
        return 'units_per_rad', (f'puts the joint limits at {low:.0f}..{high:.0f} servo units, '
                                 f'the servo can be set to {SETTABLE_UNITS[0]}..'
                                 f'{SETTABLE_UNITS[1]}')
    return None


@dataclass(frozen=True, eq=False)
class Robot:
    """
    An arm that stands somewhere and holds a box.

    Parameters
    ----------
    name : str
        What it is called in the URDF and in reports.
    joints : tuple of Joint
        From the base to the flange.
    home_depth_m : float
        Distance of the home frame from the camera (cZh).
    home_from_base, tool_from_object : (4, 4) array
        Where the robot stands, and how the box is held.
    face_size_m : (width, height)
        The tracked face; the box behind it is `box_height_m` high.
    object_points_m : (N, 3) array, optional
        Points of the object, by default the four corners of the face. Give them anew when
        `face_size_m` is replaced (None for the corners).

    """

    name: str
    joints: tuple[Joint, ...]
    home_depth_m: float
    home_from_base: np.ndarray
    tool_from_object: np.ndarray
    face_size_m: tuple[float, float]
    box_height_m: float = 0.0
    object_points_m: np.ndarray = _CORNERS_OF_FACE

    def __post_init__(self) -> None:
        object.__setattr__(self, 'joints', tuple(self.joints))
        object.__setattr__(self, 'face_size_m', tuple(float(v) for v in self.face_size_m))
        points = self.object_points_m
        if points is None:
            points = face_corners(*_checked_face(self.face_size_m))
        for name, values in (('home_from_base', self.home_from_base),
                             ('tool_from_object', self.tool_from_object),
                             ('object_points_m', points)):
            object.__setattr__(self, name, _frozen(values))
        _check_robot(self)

    @property
    def count(self) -> int:
        """Count the joints."""
        return len(self.joints)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints from the base to the flange."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def lower_rad(self) -> np.ndarray:
        """(n,) lower joint limits."""
        return _frozen([joint.lower_rad for joint in self.joints])

    @cached_property
    def upper_rad(self) -> np.ndarray:
        """(n,) upper joint limits."""
        return _frozen([joint.upper_rad for joint in self.joints])

    @cached_property
    def velocity_rad_s(self) -> np.ndarray:
        """(n,) velocity limits."""
        return _frozen([joint.velocity_rad_s for joint in self.joints])

    @cached_property
    def acceleration_rad_s2(self) -> np.ndarray:
        """(n,) acceleration limits."""
        return _frozen([joint.acceleration_rad_s2 for joint in self.joints])

    @cached_property
    def units_per_rad(self) -> np.ndarray:
        """(n,) servo units per radian, with the sign of the servo."""
        return _frozen([joint.sign * joint.units_per_rad for joint in self.joints])

    @cached_property
    def zero_units(self) -> np.ndarray:
        """(n,) servo position of joint angle zero."""
        return _frozen([joint.zero_units for joint in self.joints])


def _check_robot(robot: Robot) -> None:
    if not robot.joints:
        raise ValueError('a robot needs at least one joint')
    for what in ('name', 'channel'):
        seen = [getattr(joint, what) for joint in robot.joints]
        if len(set(seen)) != len(seen):
            raise ValueError(f'every joint needs its own {what}, got {seen}')
    if not (math.isfinite(robot.home_depth_m) and robot.home_depth_m > 0.0):
        raise ValueError(f'home_depth_m must be above 0, got {robot.home_depth_m}')
    for name in ('home_from_base', 'tool_from_object'):
        problem = transform_problem(getattr(robot, name))
        if problem:
            raise ValueError(f'{name} {problem}')
    _check_object(robot)


def _checked_face(face_size_m: tuple[float, ...]) -> tuple[float, ...]:
    if len(face_size_m) != 2 or not all(0.0 < side < math.inf for side in face_size_m):
        raise ValueError(f'face_size_m must be two lengths above 0, got {face_size_m}')
    return face_size_m


def _check_object(robot: Robot) -> None:
    _checked_face(robot.face_size_m)
    if not 0.0 <= robot.box_height_m < math.inf:
        raise ValueError(f'box_height_m must be 0 or above, got {robot.box_height_m}')
    points = robot.object_points_m
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise ValueError(f'object_points_m must have shape (N >= 4, 3), got {points.shape}')
    if not np.isfinite(points).all():
        raise ValueError('object_points_m must be finite')


def transform_problem(transform: np.ndarray) -> str | None:
    """Say why an array is not a rigid transform, or None."""
    if transform.shape != (4, 4):
        return f'must have shape (4, 4), got {transform.shape}'
    if not np.isfinite(transform).all():
        return 'must be finite'
    rotation = transform[:3, :3]
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        return f'must hold a rotation; rows are off by {error:.2g}, ' \
               f'determinant {np.linalg.det(rotation):.3g}'
    if np.any(transform[3] != (0.0, 0.0, 0.0, 1.0)):
        return f'must end in the row 0 0 0 1, got {transform[3]}'
    return None
