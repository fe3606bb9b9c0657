"""URDF: the chain read back from the XML is the chain of the robot file."""

import xml.etree.ElementTree as ElementTree

from arm_setup import changed_joint
from arm_setup import default_robot
from arm_setup import elbow_arm
from arm_setup import random_joints
from homography_servo.geometry.rigid import transform
from homography_servo.robot.kinematics import forward
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.urdf import urdf_text
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

ROBOTS = [default_robot(), elbow_arm(), changed_joint(default_robot(), 2, name='a "b" <c> & d')]


def numbers(text: str) -> np.ndarray:
    return np.array([float(part) for part in text.split()])


def read(text: str) -> dict:
    """Collect child link -> (joint name, parent link, origin, kind, limit)."""
    tree = {}
    for joint in ElementTree.fromstring(text.encode()).findall('joint'):
        origin = joint.find('origin')
        turn = Rotation.from_euler('xyz', numbers(origin.get('rpy'))).as_matrix()
        tree[joint.find('child').get('link')] = (
            joint.get('name'), joint.find('parent').get('link'),
            transform(turn, numbers(origin.get('xyz'))), joint.get('type'), joint.find('limit'))
    return tree


def pose_of(tree: dict, link: str, angles: dict) -> np.ndarray:
    """Walk from the root to a link, as a tf tree does."""
    if link not in tree:
        return np.eye(4)
    name, parent, origin, _, _ = tree[link]
    turn = Rotation.from_rotvec([0, 0, angles.get(name, 0.0)]).as_matrix()
    return pose_of(tree, parent, angles) @ origin @ transform(turn, np.zeros(3))


@pytest.mark.parametrize('robot', ROBOTS, ids=['robix', 'elbow', 'odd names'])
def test_the_tree_stands_where_the_kinematics_say(robot):
    tree = read(urdf_text(robot))
    for joints in random_joints(robot, 20, 1):
        angles = dict(zip(robot.joint_names, joints))
        home = pose_of(tree, 'home', angles)
        np.testing.assert_allclose(home[:3, 3], [0, 0, robot.home_depth_m])
        base = pose_of(tree, 'base_link', angles)
        np.testing.assert_allclose(np.linalg.inv(home) @ base, robot.home_from_base, atol=1e-9)
        np.testing.assert_allclose(np.linalg.inv(base) @ pose_of(tree, 'tool0', angles),
                                   forward(robot, joints), atol=1e-9)
        np.testing.assert_allclose(np.linalg.inv(home) @ pose_of(tree, 'box', angles),
                                   object_pose(robot, joints), atol=1e-9)


@pytest.mark.parametrize('robot', ROBOTS, ids=['robix', 'elbow', 'odd names'])
def test_limits_are_written_to_the_last_digit(robot):
    moving = {name: limit for name, _, _, kind, limit in read(urdf_text(robot)).values()
              if kind == 'revolute'}
    assert tuple(moving) == robot.joint_names
    for joint in robot.joints:
        limit = moving[joint.name]
        assert float(limit.get('lower')) == joint.lower_rad
        assert float(limit.get('upper')) == joint.upper_rad
        assert float(limit.get('velocity')) == pytest.approx(joint.velocity_rad_s)
        assert float(limit.get('effort')) > 0.0


def test_links_have_one_parent_and_shapes_have_a_size():
    root = ElementTree.fromstring(urdf_text(default_robot()).encode())
    links = [link.get('name') for link in root.findall('link')]
    children = [joint.find('child').get('link') for joint in root.findall('joint')]
    assert len(set(links)) == len(links) == len(children) + 1
    assert set(links) - set(children) == {'camera_optical'}
    assert root.get('name') == 'robix_rcs6'
    for shape in root.iter('cylinder'):
        assert float(shape.get('length')) > 0.0
    box = root.find("link[@name='box']/visual/geometry/box")
    np.testing.assert_allclose(numbers(box.get('size')),
                               [0.10, 0.06, default_robot().box_height_m])
