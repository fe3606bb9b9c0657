"""
A robot: link table, limits, servo mapping, where it stands and how it holds the box.

The file format is YAML, see ``config/robots/robix_rcs6.yaml``. Everything that is read is
checked once, here; a problem names file, line, key and reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from functools import cached_property
import math
import os
from pathlib import Path
import tempfile

from homography_servo.robot.yaml_lines import read_values
from homography_servo.robot.yaml_lines import Value
import numpy as np

# What a servo can be told to do: minpos..maxpos can be set to 800 - p0pos..5400 - p0pos,
# and p0pos is 3000 unless somebody changed it.
SETTABLE_UNITS = (-2200, 2400)
_ROTATION_TOLERANCE = 1e-6


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
        Points of the object, by default the four corners of the face.

    """

    name: str
    joints: tuple[Joint, ...]
    home_depth_m: float
    home_from_base: np.ndarray
    tool_from_object: np.ndarray
    face_size_m: tuple[float, float]
    box_height_m: float = 0.0
    object_points_m: np.ndarray = field(default=None)

    def __post_init__(self) -> None:
        object.__setattr__(self, 'joints', tuple(self.joints))
        object.__setattr__(self, 'face_size_m', tuple(float(v) for v in self.face_size_m))
        points = _face_points(self.face_size_m) if self.object_points_m is None \
            else self.object_points_m
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


def _face_points(face_size_m: tuple[float, float]) -> np.ndarray:
    half = 0.5 * np.array([*face_size_m, 0.0])
    return half * [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]


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


def _check_object(robot: Robot) -> None:
    if len(robot.face_size_m) != 2 or not all(0.0 < v < math.inf for v in robot.face_size_m):
        raise ValueError(f'face_size_m must be two lengths above 0, got {robot.face_size_m}')
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


# --- reading ---------------------------------------------------------------------------

# Key in the file, with its range; keys in degrees become radians.
_JOINT_KEYS = {
    'theta0_deg': (-360.0, 360.0),
    'd_m': (-10.0, 10.0),
    'a_m': (-10.0, 10.0),
    'alpha_deg': (-180.0, 180.0),
    'lower_deg': (-360.0, 360.0),
    'upper_deg': (-360.0, 360.0),
    'velocity_deg_s': (0.001, 10000.0),
    'acceleration_deg_s2': (0.001, 1000000.0),
}
_KEY_OF_FIELD = {'upper_rad': 'upper_deg', 'units_per_rad': 'units_per_deg', 'sign': 'sign'}
_SERVO_KEYS = ('channel', 'units_per_deg', 'sign', 'zero_units')
_ROBOT_KEYS = ('name', 'home_depth_m', 'home_from_base', 'tool_from_object', 'object', 'joints')


def load_robot(path: str | Path) -> Robot:
    """
    Read a robot file.

    Parameters
    ----------
    path : str or path
        The YAML file; see `homography_servo.places.find_config` for bare names.

    Returns
    -------
    Robot

    Raises
    ------
    ConfigError
        That names file, line, key and reason.

    """
    top = read_values(path)
    keys = top.mapping(_ROBOT_KEYS)
    body = keys['object'].mapping(('face_size_m', 'box_height_m'), ('points_m',))
    values = {
        'name': keys['name'].text(),
        'joints': _read_joints(keys['joints']),
        'home_depth_m': keys['home_depth_m'].number(0.01, 100.0),
        'home_from_base': _read_transform(keys['home_from_base']),
        'tool_from_object': _read_transform(keys['tool_from_object']),
        'face_size_m': tuple(body['face_size_m'].numbers(2, 0.0005, 10.0)),
        'box_height_m': body['box_height_m'].number(0.0, 10.0),
        'object_points_m': _read_points(body.get('points_m')),
    }
    try:
        return Robot(**values)
    except ValueError as problem:
        raise top.error(str(problem)) from None


def _read_points(value: Value | None) -> list | None:
    return None if value is None else [row.numbers(3, -10.0, 10.0) for row in value.items()]


def _read_transform(value: Value) -> np.ndarray:
    keys = value.mapping(('rotation', 'translation_m'))
    transform = np.eye(4)
    transform[:3, 3] = keys['translation_m'].numbers(3, -100.0, 100.0)
    transform[:3, :3] = [row.numbers(3, -1.0001, 1.0001) for row in keys['rotation'].items(3)]
    problem = transform_problem(transform)
    if problem:
        raise keys['rotation'].error(problem)
    # Digits in a file are rounded; make the rotation exact again.
    left, _, right = np.linalg.svd(transform[:3, :3])
    transform[:3, :3] = left @ right
    return transform


def _read_joints(value: Value) -> tuple[Joint, ...]:
    items = value.items()
    if not items:
        raise value.error('must list at least one joint')
    joints: list[Joint] = []
    for item in items:
        joint = _read_joint(item)
        for other in joints:
            if other.name == joint.name or other.channel == joint.channel:
                raise item.error(f'{joint.name} on channel {joint.channel} repeats '
                                 f'{other.name} on channel {other.channel}')
        joints.append(joint)
    return tuple(joints)


def _read_joint(value: Value) -> Joint:
    keys = value.mapping(('name', *_JOINT_KEYS, 'servo'))
    servo = keys['servo'].mapping(_SERVO_KEYS)
    numbers = dict(_read_field(name, keys[name]) for name in _JOINT_KEYS)
    try:
        return Joint(
            name=keys['name'].text(),
            channel=servo['channel'].whole(1, 64),
            units_per_rad=math.degrees(servo['units_per_deg'].number(0.001, 10000.0)),
            sign=servo['sign'].whole(-1, 1),
            zero_units=servo['zero_units'].number(*SETTABLE_UNITS),
            **numbers)
    except FieldError as problem:
        at = {**keys, **servo}.get(_KEY_OF_FIELD.get(problem.field), value)
        raise at.error(problem.reason.replace('lower_rad', 'lower_deg')) from None


def _read_field(key: str, value: Value) -> tuple[str, float]:
    number = value.number(*_JOINT_KEYS[key])
    if '_deg' not in key:
        return key, number
    return key.replace('_deg', '_rad'), math.radians(number)


# --- writing ---------------------------------------------------------------------------

def _digits(value: float) -> str:
    """Write 12 digits: enough for any robot, and 17.5 stays 17.5 after the turn to rad."""
    text = f'{value:.12g}'
    return '0' if text == '-0' else text


def _row(values) -> str:
    return '[' + ', '.join(_digits(float(v)) for v in values) + ']'


def _transform_lines(name: str, transform: np.ndarray) -> list[str]:
    rows = ',\n             '.join(_row(row) for row in transform[:3, :3])
    return [f'{name}:', f'  rotation: [{rows}]', f'  translation_m: {_row(transform[:3, 3])}']


def _joint_lines(joint: Joint) -> list[str]:
    lines = [f'  - name: "{joint.name}"']
    for key in _JOINT_KEYS:
        value = getattr(joint, key.replace('_deg', '_rad'))
        lines.append(f'    {key}: {_digits(math.degrees(value) if "_deg" in key else value)}')
    units_per_deg = _digits(math.radians(joint.units_per_rad))
    servo = f'channel: {joint.channel}, units_per_deg: {units_per_deg}, sign: {joint.sign}, ' \
            f'zero_units: {_digits(joint.zero_units)}'
    return [*lines, f'    servo: {{{servo}}}']


def dump_robot(robot: Robot, comment: str = '') -> str:
    """Write a robot as the text of a robot file, with a comment on top."""
    lines = [f'# {line}' for line in comment.splitlines()]
    lines += [f'name: "{robot.name}"', f'home_depth_m: {_digits(robot.home_depth_m)}']
    lines += _transform_lines('home_from_base', robot.home_from_base)
    lines += _transform_lines('tool_from_object', robot.tool_from_object)
    lines += ['object:', f'  face_size_m: {_row(robot.face_size_m)}',
              f'  box_height_m: {_digits(robot.box_height_m)}']
    if not np.array_equal(robot.object_points_m, _face_points(robot.face_size_m)):
        lines += ['  points_m:', *(f'    - {_row(row)}' for row in robot.object_points_m)]
    lines += ['joints:']
    for joint in robot.joints:
        lines += _joint_lines(joint)
    return '\n'.join(lines) + '\n'


def save_robot(path: str | Path, robot: Robot, comment: str = '') -> None:
    """
    Write a robot file; an old one is replaced only by a whole new one.

    Raises
    ------
    OSError
        When the file cannot be written; the old one is then untouched.

    """
    target = Path(path)
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f'.{target.name}.')
    try:
        with os.fdopen(handle, 'w', encoding='utf-8') as file:
            file.write(dump_robot(robot, comment))
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
