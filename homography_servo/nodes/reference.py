"""
Write docs/reference.md: topics, services, parameters and frames, from the code.

Run ``python -m homography_servo.nodes.reference > docs/reference.md``; a test holds
the file against the code.
"""

from __future__ import annotations

from pathlib import Path
import tempfile

import cv2
from homography_servo.launch.registry import CHAIN
from homography_servo.launch.registry import CHAIN_PROGRAM
from homography_servo.launch.registry import node_type
from homography_servo.launch.registry import NODES
from homography_servo.nodes.transforms import arm_frames
from homography_servo.nodes.transforms import camera_frames
from homography_servo.nodes.transforms import fixed_frames
from homography_servo.places import find_config
from homography_servo.robot.robot_file import load_robot
from homography_servo.settings import defaults_of
from homography_servo.settings import rules_of
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rclpy.qos import ReliabilityPolicy

UNTOUCHED = {'robix_bridge': {'autostart': False}, 'dashboard': {'port': 0}}
PLUMBING = ('/rosout', '/parameter_events', '/diagnostics', '/tf', '/tf_static')
ROBOT_FILE = 'robix_rcs6.yaml'
HEAD = """# Reference

Made from the code by `python -m homography_servo.nodes.reference`; do not edit by hand.
Names are relative to the node's namespace; `~` is the node's name. Every node also publishes
`/diagnostics` once a second and offers the parameter services of ROS.
"""
CHAIN_SECTION = f"""
## {CHAIN_PROGRAM}

Tracker, planner and servo in one process: topics, services and parameters are those of
{', '.join(CHAIN)}. A file of parameters serves as it is; on the command
line a parameter needs the name of its node: `-p {CHAIN[-1]}:speed_share:=0.2`.
"""
FRAMES_HEAD = f"""
## Frames

Sent where tf2_msgs is installed; the joints are those of `{ROBOT_FILE}`. `box` is where the arm
says the object is, `object` where the camera sees it. A namespace does not change these names.

| topic | parent | child | from |
|---|---|---|---|
"""


def _quality(qos) -> str:
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    kind = 'latched' if latched else 'reliable' if reliable else 'best effort'
    return f'{kind}, depth {qos.depth}'


def _type_name(kind: type) -> str:
    package = kind.__module__.split('.')[0]
    return f'{package}/{kind.__name__}'


def _local(node, topic: str) -> str:
    name = topic.removeprefix('/')
    return name.replace(f'{node.get_name()}/', '~/', 1) if name.startswith(
        f'{node.get_name()}/') else name


def _interface_rows(node) -> list[str]:
    rows = []
    for way, items in (('out', node.publishers), ('in', node.subscriptions)):
        for item in items:
            if item.topic_name not in PLUMBING:
                rows.append((way, _local(node, item.topic_name), _type_name(item.msg_type),
                             _quality(item.qos_profile)))
    for item in node.services:
        if _type_name(item.srv_type).split('/')[0] in ('std_srvs', 'lifecycle_msgs'):
            rows.append(('service', _local(node, item.srv_name.removeprefix('/')),
                         _type_name(item.srv_type), ''))
    order = {'in': 0, 'out': 1, 'service': 2}
    return [f'| {way} | `{name}` | {kind} | {qos} |'
            for way, name, kind, qos in sorted(set(rows), key=lambda r: (order[r[0]], r[1]))]


def _value_text(value) -> str:
    if isinstance(value, tuple):
        return '[' + ', '.join(str(item) for item in value) + ']'
    return f"'{value}'" if isinstance(value, str) else str(value).lower() if isinstance(
        value, bool) else str(value)


def _parameter_rows(kinds) -> list[str]:
    rows = []
    for kind in kinds:
        defaults = defaults_of(kind)
        for key, rule in rules_of(kind).items():
            allowed = ', '.join(rule.choices) if rule.choices else \
                '' if rule.low is None or rule.high is None else f'{rule.low:g} to {rule.high:g}'
            change = 'at start' if rule.read_only else 'any time'
            rows.append(f'| `{key}` | {_value_text(defaults[key])} | {rule.unit} | {allowed} | '
                        f'{change} | {rule.about} |')
    return rows


def node_section(name: str, context: Context, video: Path) -> str:
    """Describe one node."""
    kind = node_type(name)
    given = {'source': str(video)} if name == 'video_camera' else UNTOUCHED.get(name, {})
    overrides = [Parameter(key, value=value) for key, value in given.items()]
    node = kind(context=context, parameter_overrides=overrides)
    try:
        interfaces = _interface_rows(node)
    finally:
        node.close()
        node.destroy_node()
    return '\n'.join([
        f'\n## {name}\n', (kind.__doc__ or '').strip().splitlines()[0], '',
        '| | name | type | quality of service |', '|---|---|---|---|', *interfaces, '',
        '| parameter | default | unit | allowed | change | meaning |', '|---|---|---|---|---|---|',
        *_parameter_rows(kind.SETTINGS)]) + '\n'


def frames_section() -> str:
    """Describe the frames, which no node publishes where tf2_msgs is missing."""
    robot = load_robot(find_config(ROBOT_FILE))
    at_home = {frame.child for frame in camera_frames(robot.home_depth_m)}
    rows = [('/tf_static', frame.parent, frame.child,
             'path_planner, robix_bridge' if frame.child in at_home else 'robix_bridge')
            for frame in fixed_frames(robot)]
    rows += [('/tf', frame.parent, frame.child, 'robix_bridge')
             for frame in arm_frames(robot, np.zeros(robot.count))]
    rows.append(('/tf', 'home', 'object', 'path_planner'))
    return FRAMES_HEAD + ''.join(f'| `{topic}` | `{parent}` | `{child}` | {source} |\n'
                                 for topic, parent, child, source in rows)


def reference_text() -> str:
    """Give the whole page."""
    context = Context()
    rclpy.init(args=[], context=context)
    with tempfile.TemporaryDirectory() as folder:
        video = _short_video(Path(folder))
        try:
            nodes = ''.join(node_section(name, context, video) for name in NODES)
        finally:
            context.try_shutdown()
    return HEAD + nodes + CHAIN_SECTION + frames_section()


def _short_video(folder: Path) -> Path:
    """Make a file that video_camera can open, in place of a device."""
    path = folder / 'short.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), 30.0, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    return path


if __name__ == '__main__':
    print(reference_text(), end='')
