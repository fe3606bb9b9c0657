"""Frames on /tf: the same tree as the URDF, and silence where tf2_msgs is missing."""

import sys
import types
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from builtin_interfaces.msg import Time  # noqa: E402,I100
from homography_servo.nodes.conversions import transform_from_pose  # noqa: E402
from homography_servo.nodes.transforms import arm_frames  # noqa: E402
from homography_servo.nodes.transforms import camera_frames  # noqa: E402
from homography_servo.nodes.transforms import fixed_frames  # noqa: E402
from homography_servo.nodes.transforms import Frame  # noqa: E402
from homography_servo.nodes.transforms import Transforms  # noqa: E402
from homography_servo.places import find_config  # noqa: E402
from homography_servo.robot.kinematics import forward  # noqa: E402
from homography_servo.robot.kinematics import object_pose  # noqa: E402
from homography_servo.robot.robot_file import load_robot  # noqa: E402
from homography_servo.robot.urdf import urdf_text  # noqa: E402
from geometry_msgs.msg import Point  # noqa: E402,I100
from geometry_msgs.msg import Pose  # noqa: E402

ROBOT = load_robot(find_config('robix_rcs6.yaml'))


class Recorder:
    """A node that records what it is told to publish."""

    def __init__(self) -> None:
        self.sent = {}

    def create_publisher(self, kind, topic, qos):
        messages = self.sent.setdefault(topic, [])
        return types.SimpleNamespace(publish=messages.append)

    def get_clock(self):
        now = types.SimpleNamespace(to_msg=lambda: Time(sec=7))
        return types.SimpleNamespace(now=lambda: now)


@pytest.fixture
def with_tf2(monkeypatch):
    """Play the package tf2_msgs, which the wheels lack."""
    module = types.ModuleType('tf2_msgs.msg')
    module.TFMessage = types.SimpleNamespace
    monkeypatch.setitem(sys.modules, 'tf2_msgs', types.ModuleType('tf2_msgs'))
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', module)


def chain(frames, leaf):
    """Multiply the transforms from the root down to a frame."""
    parents = {frame.child: frame for frame in frames}
    product = np.eye(4)
    while leaf in parents:
        product = parents[leaf].parent_from_child @ product
        leaf = parents[leaf].parent
    return leaf, product


@pytest.mark.parametrize('seed', range(5))
def test_the_tree_leads_where_the_kinematics_do(seed):
    rng = np.random.default_rng(seed)
    joints_rad = rng.uniform(ROBOT.lower_rad, ROBOT.upper_rad)
    frames = [*fixed_frames(ROBOT), *arm_frames(ROBOT, joints_rad)]
    assert len({frame.child for frame in frames}) == len(frames)  # one parent each
    root, camera_from_box = chain(frames, 'box')
    camera_from_home = camera_frames(ROBOT.home_depth_m)[0].parent_from_child
    assert root == 'camera_optical'
    assert camera_from_box == pytest.approx(
        camera_from_home @ object_pose(ROBOT, joints_rad), abs=1e-12)
    _, camera_from_tool = chain(frames, 'tool0')
    assert camera_from_tool == pytest.approx(
        camera_from_home @ ROBOT.home_from_base @ forward(ROBOT, joints_rad), abs=1e-12)


def test_the_tree_is_that_of_the_urdf():
    joints = ElementTree.fromstring(urdf_text(ROBOT)).findall('joint')
    frames = {frame.child: frame
              for frame in [*fixed_frames(ROBOT), *arm_frames(ROBOT, np.zeros(ROBOT.count))]}
    assert {joint.find('child').get('link'): joint.find('parent').get('link')
            for joint in joints} == {child: frame.parent for child, frame in frames.items()}
    for joint in joints:
        place = [float(v) for v in joint.find('origin').get('xyz').split()]
        frame = frames[joint.find('child').get('link')]
        assert frame.parent_from_child[:3, 3] == pytest.approx(place, abs=1e-9)


def test_frames_are_sent_as_they_are(with_tf2):
    node = Recorder()
    transforms = Transforms(node, fixed_frames(ROBOT))
    joints_rad = 0.5 * (ROBOT.lower_rad + ROBOT.upper_rad) + 0.1
    transforms.send_arm(ROBOT, joints_rad, Time(sec=3))
    transforms.send([Frame('home', 'object', np.eye(4))], Time(sec=4))
    assert [t.child_frame_id for t in node.sent['/tf_static'][0].transforms] == [
        'home', 'base_link', 'tool0', 'box']
    arm, seen = (message.transforms for message in node.sent['/tf'])
    assert [t.header.stamp.sec for t in (*arm, *seen)] == [3] * ROBOT.count + [4]
    for sent, frame in zip(arm, arm_frames(ROBOT, joints_rad)):
        place = sent.transform.translation
        pose = Pose(position=Point(x=place.x, y=place.y, z=place.z),
                    orientation=sent.transform.rotation)
        assert (sent.header.frame_id, sent.child_frame_id) == frame[:2]
        assert transform_from_pose(pose) == pytest.approx(frame.parent_from_child, abs=1e-12)


def test_nothing_is_sent_where_tf2_msgs_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)
    node = Recorder()
    transforms = Transforms(node, fixed_frames(ROBOT))
    transforms.send_arm(ROBOT, np.zeros(ROBOT.count), Time())
    transforms.send([Frame('home', 'object', np.eye(4))], Time())
    assert not node.sent
