"""
The robot file: a robot as YAML, see ``config/robots/robix_rcs6.yaml``.

Everything that is read is checked once, here; a problem names file, line, key and reason.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
import tempfile

from homography_servo.geometry.face import face_corners
from homography_servo.robot.robot_model import FieldError
from homography_servo.robot.robot_model import Joint
from homography_servo.robot.robot_model import Robot
from homography_servo.robot.robot_model import SETTABLE_UNITS
from homography_servo.robot.robot_model import transform_problem
from homography_servo.robot.yaml_lines import read_values
from homography_servo.robot.yaml_lines import Value
import numpy as np

__all__ = ['dump_robot', 'Joint', 'load_robot', 'Robot', 'save_robot']

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
    lines = [f'  - name: {json.dumps(joint.name)}']
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
    lines += [f'name: {json.dumps(robot.name)}', f'home_depth_m: {_digits(robot.home_depth_m)}']
    lines += _transform_lines('home_from_base', robot.home_from_base)
    lines += _transform_lines('tool_from_object', robot.tool_from_object)
    lines += ['object:', f'  face_size_m: {_row(robot.face_size_m)}',
              f'  box_height_m: {_digits(robot.box_height_m)}']
    if not np.array_equal(robot.object_points_m, face_corners(*robot.face_size_m)):
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
