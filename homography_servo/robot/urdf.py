"""
The robot as URDF text, for robot_state_publisher, RViz and others.

A link frame of the URDF is the Denavit-Hartenberg frame; the joint sits at the frame before
it, turned by theta0, and its axis is z. So joint angle zero of the URDF is that of the file.
"""

from __future__ import annotations

import math
from xml.sax.saxutils import quoteattr

from homography_servo.robot.chain import after_turn
from homography_servo.robot.robot_model import Joint
from homography_servo.robot.robot_model import Robot
import numpy as np

_RADIUS_M = 0.012
_EFFORT_NM = 1.0  # URDF wants one; a hobby servo has about this much
_COLOURS = {'arm': '0.25 0.35 0.55 1', 'servo': '0.15 0.15 0.15 1', 'box': '0.85 0.85 0.8 1'}


def urdf_text(robot: Robot) -> str:
    """
    Write the robot as URDF: camera_optical, home, base_link, one link a joint, tool0, box.

    Parameters
    ----------
    robot : Robot
        Link table, limits, how the box is held.

    Returns
    -------
    str
        XML. The root is `camera_optical`, so that the arm stands where the camera has it. The
        box is where the arm says it is; `object` is left to what the camera measures.

    """
    names = ['base_link', *(f'{joint.name}_link' for joint in robot.joints)]
    depth = np.eye(4)
    depth[2, 3] = robot.home_depth_m
    parts = [_link('camera_optical', ''), _fixed('camera_optical', 'home', depth),
             _link('home', ''), _fixed('home', names[0], robot.home_from_base)]
    parts += [_link(names[0], _cylinder(np.zeros(3), robot.joints[0].d_m * np.array([0, 0, 1])))]
    before = np.eye(4)
    for index, joint in enumerate(robot.joints):
        parts.append(_joint(joint, names[index], names[index + 1],
                            before @ _turn_z(joint.theta0_rad)))
        after = after_turn(joint)
        parts.append(_link(names[index + 1], _arm(after)))
        before = after
    parts += [_link('tool0', ''), _fixed(names[-1], 'tool0', before)]
    parts += [_link('box', _box(robot)), _fixed('tool0', 'box', robot.tool_from_object)]
    body = '\n'.join(part for part in parts if part)
    return f'<?xml version="1.0"?>\n<robot name={quoteattr(robot.name)}>\n' \
           f'{_materials()}\n{body}\n</robot>\n'


def _turn_z(angle_rad: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:2, :2] = [[math.cos(angle_rad), -math.sin(angle_rad)],
                    [math.sin(angle_rad), math.cos(angle_rad)]]
    return turn


def _numbers(values) -> str:
    return ' '.join(f'{0.0 if abs(v) < 1e-15 else v:.12g}' for v in values)


def _origin(transform: np.ndarray) -> str:
    return f'<origin xyz="{_numbers(transform[:3, 3])}" rpy="{_numbers(_rpy(transform))}"/>'


def _rpy(transform: np.ndarray) -> tuple[float, float, float]:
    """Give roll, pitch, yaw of URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    r = transform[:3, :3]
    level = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], level)
    if level < 1e-9:  # yaw and roll turn about the same axis: roll alone does it
        return math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0
    return math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])


def _materials() -> str:
    return '\n'.join(f'  <material name="{name}"><color rgba="{rgba}"/></material>'
                     for name, rgba in _COLOURS.items())


def _link(name: str, visuals: str) -> str:
    return f'  <link name={quoteattr(name)}>{visuals}</link>' if visuals \
        else f'  <link name={quoteattr(name)}/>'


def _fixed(parent: str, child: str, transform: np.ndarray) -> str:
    return f'  <joint name={quoteattr(f"{parent}_to_{child}")} type="fixed">' \
           f'<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>' \
           f'{_origin(transform)}</joint>'


def _joint(joint: Joint, parent: str, child: str, origin: np.ndarray) -> str:
    return f'  <joint name={quoteattr(joint.name)} type="revolute">' \
           f'<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>' \
           f'{_origin(origin)}<axis xyz="0 0 1"/>' \
           f'<limit lower="{joint.lower_rad!r}" upper="{joint.upper_rad!r}" ' \
           f'velocity="{joint.velocity_rad_s:.12g}" effort="{_EFFORT_NM:g}"/></joint>'


def _visual(origin: np.ndarray, shape: str, colour: str) -> str:
    return f'<visual>{_origin(origin)}<geometry>{shape}</geometry>' \
           f'<material name="{colour}"/></visual>'


def _arm(after: np.ndarray) -> str:
    """Draw the servo at the joint, and the way to the next frame."""
    servo = _visual(np.eye(4), '<box size="0.024 0.024 0.036"/>', 'servo')
    return servo + _cylinder(np.zeros(3), after[:3, 3])


def _cylinder(start: np.ndarray, end: np.ndarray) -> str:
    way = end - start
    length = float(np.linalg.norm(way))
    if length < 1e-6:
        return ''
    origin = np.eye(4)
    origin[:3, :3] = _z_along(way / length)
    origin[:3, 3] = 0.5 * (start + end)
    shape = f'<cylinder radius="{_RADIUS_M:g}" length="{length:.6g}"/>'
    return _visual(origin, shape, 'arm')


def _z_along(axis: np.ndarray) -> np.ndarray:
    """Build some rotation whose z is a unit vector."""
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(other, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _box(robot: Robot) -> str:
    """Draw the box behind the face, z = 0 to its height; a thin one when it has none."""
    height = max(robot.box_height_m, 0.001)
    origin = np.eye(4)
    origin[2, 3] = 0.5 * height
    size = _numbers((*robot.face_size_m, height))
    return _visual(origin, f'<box size="{size}"/>', 'box')
