"""Kinematics: laws, finite differences, and every posture that a search finds."""

import dataclasses
import time

from arm_setup import arm
from arm_setup import changed_joint
from arm_setup import default_robot
from arm_setup import elbow_arm
from arm_setup import random_joints
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import pose_difference
from homography_servo.robot.branches import is_yaw_pitch_arm
from homography_servo.robot.kinematics import forward
from homography_servo.robot.kinematics import inverse
from homography_servo.robot.kinematics import object_jacobian
from homography_servo.robot.kinematics import object_pose
import numpy as np
import pytest

ROBOT = default_robot()
DEG = np.pi / 180
TRIAL = np.array([-50, 40, 10, -10, 0, -20]) * DEG


def test_the_default_robot_at_zero():
    np.testing.assert_allclose(
        forward(ROBOT, np.zeros(6)),
        [[1, 0, 0, 0.342], [0, 1, 0, 0], [0, 0, 1, 0.194], [0, 0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(
        object_pose(ROBOT, np.zeros(6)),
        [[1, 0, 0, 0.092], [0, 1, 0, 0], [0, 0, 1, 0.756 - 1], [0, 0, 0, 1]], atol=1e-12)


def by_hand(robot, joints):
    """Multiply the rows of the table one after the other."""
    result = np.eye(4)
    for row, angle in zip(robot.joints, joints):
        c, s = np.cos(row.theta0_rad + angle), np.sin(row.theta0_rad + angle)
        ca, sa = np.cos(row.alpha_rad), np.sin(row.alpha_rad)
        result = result @ [[c, -s * ca, s * sa, row.a_m * c], [s, c * ca, -c * sa, row.a_m * s],
                           [0, sa, ca, row.d_m], [0, 0, 0, 1]]
    return result


@pytest.mark.parametrize('robot', [ROBOT, elbow_arm(), arm([(0.3, 0.1, 0.2, 0.7)] * 4)],
                         ids=['robix', 'elbow', 'four'])
def test_forward_is_the_product_of_the_rows(robot):
    joints = random_joints(robot, 50, 1)
    expected = np.array([by_hand(robot, row) for row in joints])
    np.testing.assert_allclose(forward(robot, joints), expected, atol=1e-12)
    np.testing.assert_allclose(object_pose(robot, joints[3]),
                               robot.home_from_base @ expected[3] @ robot.tool_from_object,
                               atol=1e-12)


def test_stacks_of_any_shape_give_the_same_as_one_by_one():
    joints = random_joints(ROBOT, 6, 2).reshape(2, 3, 6)
    poses, jacobians = object_pose(ROBOT, joints), object_jacobian(ROBOT, joints)
    assert poses.shape == (2, 3, 4, 4) and jacobians.shape == (2, 3, 6, 6)
    np.testing.assert_array_equal(poses[1, 2], object_pose(ROBOT, joints[1, 2]))
    np.testing.assert_array_equal(jacobians[1, 2], object_jacobian(ROBOT, joints[1, 2]))
    assert object_pose(ROBOT, np.zeros((0, 6))).shape == (0, 4, 4)


@pytest.mark.parametrize('robot', [ROBOT, elbow_arm()], ids=['robix', 'elbow'])
def test_jacobian_is_the_limit_of_differences(robot):
    step = 1e-5
    for joints in random_joints(robot, 20, 3):
        ahead = object_pose(robot, joints + step * np.eye(6))
        behind = object_pose(robot, joints - step * np.eye(6))
        # Central differences of the second kind cancel the next error term too.
        far_ahead = object_pose(robot, joints + 2 * step * np.eye(6))
        far_behind = object_pose(robot, joints - 2 * step * np.eye(6))
        near = pose_difference(ahead, behind) / (2 * step)
        far = pose_difference(far_ahead, far_behind) / (4 * step)
        numeric = ((4 * near - far) / 3).T
        np.testing.assert_allclose(object_jacobian(robot, joints), numeric, atol=1e-8)


def test_wrong_shapes_are_named():
    for call in (forward, object_pose, object_jacobian):
        with pytest.raises(ValueError, match=r'\(\.\.\., 6\), got \(5,\)'):
            call(ROBOT, np.zeros(5))
        with pytest.raises(ValueError, match='joints_rad'):
            call(ROBOT, 0.0)
    with pytest.raises(ValueError, match=r'finite \(4, 4\)'):
        inverse(ROBOT, np.eye(3))
    with pytest.raises(ValueError, match=r'finite \(4, 4\)'):
        inverse(ROBOT, np.full((4, 4), np.nan))


def contains(postures, joints, tolerance=1e-5) -> bool:
    return len(postures) > 0 and np.abs(postures - joints).max(axis=1).min() < tolerance


def check_postures(robot, pose, postures):
    assert np.all(postures >= robot.lower_rad) and np.all(postures <= robot.upper_rad)
    np.testing.assert_allclose(object_pose(robot, postures),
                               np.broadcast_to(pose, (len(postures), 4, 4)), atol=1e-8)


def test_a_thousand_random_poses_are_all_reached():
    joints = random_joints(ROBOT, 1000, 4)
    poses, times_s = object_pose(ROBOT, joints), []
    for pose, truth in zip(poses, joints):
        began_s = time.perf_counter()
        postures = inverse(ROBOT, pose)
        times_s.append(time.perf_counter() - began_s)
        check_postures(ROBOT, pose, postures)
        assert contains(postures, truth)
    # The bound is 5 ms; a shared machine may be slow, its median hardly ever this slow.
    assert np.median(times_s) < 0.02


def brute_force(robot, pose, seed, starts=400):
    """Search with plain Gauss-Newton from many starts; written apart from the package."""
    joints = random_joints(robot, starts, seed)
    for _ in range(60):
        error = pose_difference(np.broadcast_to(pose, (len(joints), 4, 4)),
                                object_pose(robot, joints))
        jacobian = object_jacobian(robot, joints)
        step = np.linalg.solve(np.swapaxes(jacobian, 1, 2) @ jacobian + 1e-9 * np.eye(6),
                               np.swapaxes(jacobian, 1, 2) @ error[..., None])[..., 0]
        joints = joints + np.clip(step, -0.3, 0.3)
        joints = (joints + np.pi) % (2 * np.pi) - np.pi
    good = np.abs(pose_difference(np.broadcast_to(pose, (len(joints), 4, 4)),
                                  object_pose(robot, joints))).max(axis=1) < 1e-7
    inside = np.all((joints >= robot.lower_rad) & (joints <= robot.upper_rad), axis=1)
    return joints[good & inside]


def test_every_branch_that_a_search_finds():
    for seed, truth in enumerate(random_joints(ROBOT, 12, 5)):
        pose = object_pose(ROBOT, truth)
        postures = inverse(ROBOT, pose)
        for found in brute_force(ROBOT, pose, seed):
            assert contains(postures, found, 1e-3), (truth, found)


def wide(robot):
    """Let all joints but one turn nearly all the way."""
    joints = [dataclasses.replace(joint, lower_rad=-3.1, upper_rad=3.1, units_per_rad=500.0)
              for joint in robot.joints]
    return dataclasses.replace(robot, joints=tuple(joints))


def test_every_branch_of_an_arm_with_wide_limits():
    robot, most = wide(ROBOT), 0
    for seed, truth in enumerate(random_joints(robot, 8, 6)):
        pose = object_pose(robot, truth)
        postures = inverse(robot, pose)
        check_postures(robot, pose, postures)
        assert contains(postures, truth)
        most = max(most, len(postures))
        for found in brute_force(robot, pose, seed):
            assert contains(postures, found, 1e-3), (truth, found)
    assert most >= 4


@pytest.mark.parametrize('index, angle', [
    (1, 0.0), (1, 1e-3), (2, 0.0), (2, np.pi / 2 - 1e-4), (2, 1.54), (2, -1.53), (4, 0.0)])
def test_postures_where_branches_meet(index, angle):
    """At a singular posture the object pose still has its posture, to what it can be told."""
    robot = wide(ROBOT)
    for joints in random_joints(robot, 20, 7):
        joints[index] = angle
        postures = inverse(robot, object_pose(robot, joints))
        assert len(postures) > 0
        assert contains(postures, joints, 2e-3)


def test_a_level_axis_of_the_last_joint():
    """Pitch so that joint 6 lies level: the roll axis can be upright there."""
    robot = wide(ROBOT)
    for seed in range(10):
        joints = random_joints(robot, 1, seed)[0]
        joints[4] = 0.0
        joints[3] = np.pi / 2 - joints[2]
        assert len(inverse(robot, object_pose(robot, joints))) > 0


def test_other_signs_of_the_table_and_offsets_are_solved_too():
    robot = changed_joint(ROBOT, 1, alpha_rad=-np.pi / 2, d_m=0.02)
    robot = changed_joint(robot, 4, alpha_rad=-np.pi / 2)
    robot = changed_joint(robot, 5, theta0_rad=0.4, a_m=0.02, alpha_rad=0.3)
    robot = dataclasses.replace(robot, tool_from_object=displaced(np.eye(4), 0.1 * np.ones(6)))
    assert is_yaw_pitch_arm(robot)
    for truth in random_joints(robot, 50, 8):
        pose = object_pose(robot, truth)
        postures = inverse(robot, pose)
        check_postures(robot, pose, postures)
        assert contains(postures, truth)


def test_an_arm_of_another_build_is_solved_by_search():
    robot = elbow_arm()
    assert not is_yaw_pitch_arm(robot)
    found = 0
    for truth in random_joints(robot, 20, 9):
        pose = object_pose(robot, truth)
        postures = inverse(robot, pose)
        check_postures(robot, pose, postures)
        found += contains(postures, truth)
    assert found >= 19


def test_postures_are_sorted_by_distance():
    pose = object_pose(ROBOT, TRIAL)
    postures = inverse(ROBOT, pose)
    assert len(postures) == 2
    for near in postures:
        order = inverse(ROBOT, pose, near_rad=near)
        np.testing.assert_allclose(order[0], near, atol=1e-9)
    np.testing.assert_array_equal(postures, inverse(ROBOT, pose))


def test_what_is_out_of_reach_has_no_posture():
    pose = object_pose(ROBOT, np.zeros(6))
    pose[0, 3] += 1.0
    assert inverse(ROBOT, pose).shape == (0, 6)
    beyond = TRIAL.copy()
    beyond[4] = 76 * DEG
    for posture in inverse(ROBOT, object_pose(ROBOT, beyond)):
        assert posture[4] <= 75 * DEG


def test_a_joint_exactly_at_its_limit_is_inside():
    joints = np.array([80, 75, -80, 85, -75, 80]) * DEG
    joints = np.clip(joints, ROBOT.lower_rad, ROBOT.upper_rad)
    postures = inverse(ROBOT, object_pose(ROBOT, joints), joints)
    assert contains(postures, joints)
    check_postures(ROBOT, object_pose(ROBOT, joints), postures)
