"""The arm as it really is: errors that nobody believes in, and joints between reports."""

from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import log_transform
from homography_servo.places import find_config
from homography_servo.robot.kinematics import forward
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
from homography_servo.simulation.true_arm import ArmErrors
from homography_servo.simulation.true_arm import EXTRAPOLATE_S
from homography_servo.simulation.true_arm import SILENT_S
from homography_servo.simulation.true_arm import true_home_from_object
from homography_servo.simulation.true_arm import TrueArm
import numpy as np
import pytest

ROBOT = load_robot(find_config('robix_rcs6.yaml'))
JOINTS_RAD = np.radians([-50.0, 40.0, 10.0, -10.0, 0.0, -20.0])


def test_without_errors_the_truth_is_what_is_believed():
    assert true_home_from_object(ROBOT, JOINTS_RAD, ArmErrors()) == pytest.approx(
        object_pose(ROBOT, JOINTS_RAD), abs=1e-12)


def test_each_error_sits_at_its_own_place_in_the_chain():
    errors = ArmErrors(
        placement_error_m=(0.01, -0.02, 0.005), placement_error_rad=(0.02, 0.01, -0.03),
        grip_error_m=(0.003, 0.001, -0.002), grip_error_rad=(0.0, 0.05, 0.1),
        joint_zero_error_rad=(0.01, -0.01, 0.02, 0.0, 0.03, -0.02))
    base = ROBOT.home_from_base.copy()
    turn = exp_twist(np.array([0.0, 0.0, 0.0, *errors.placement_error_rad]))[:3, :3]
    base[:3, :3] = turn @ base[:3, :3]
    base[:3, 3] += errors.placement_error_m
    grip = exp_twist(np.array([0.0, 0.0, 0.0, *errors.grip_error_rad]))
    grip[:3, 3] = errors.grip_error_m
    joints_rad = JOINTS_RAD + errors.joint_zero_error_rad
    expected = base @ forward(ROBOT, joints_rad) @ ROBOT.tool_from_object @ grip
    assert true_home_from_object(ROBOT, JOINTS_RAD, errors) == pytest.approx(expected, abs=1e-12)


def test_a_wrong_number_of_joint_errors_is_named():
    errors = ArmErrors(joint_zero_error_rad=(0.1,))
    assert 'must have 6 items or none, got 1' in errors.problem_with(ROBOT)
    with pytest.raises(ValueError, match='6 items or none, got 1'):
        true_home_from_object(ROBOT, JOINTS_RAD, errors)


def test_the_arm_moves_on_between_reports_and_holds_when_they_stop():
    arm, velocity = TrueArm(ROBOT), np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert arm.home_from_object(0.0) is None and arm.in_camera(None) is None and not arm.known
    arm.report(JOINTS_RAD, velocity, 10.0)
    for since_s, moved_s in ((0.0, 0.0), (0.02, 0.02), (5.0, EXTRAPOLATE_S), (-1.0, 0.0)):
        expected = object_pose(ROBOT, JOINTS_RAD + moved_s * velocity)
        assert arm.home_from_object(10.0 + since_s) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize('velocity', [None, np.full(6, np.nan)])
def test_unusable_velocities_count_as_standing_still(velocity):
    arm = TrueArm(ROBOT)
    arm.report(JOINTS_RAD, velocity, 0.0)
    assert arm.home_from_object(0.04) == pytest.approx(object_pose(ROBOT, JOINTS_RAD), abs=1e-12)


def test_home_lies_on_the_optical_axis():
    moved = TrueArm(ROBOT).in_camera(object_pose(ROBOT, JOINTS_RAD))
    difference = log_transform(moved @ np.linalg.inv(object_pose(ROBOT, JOINTS_RAD)))
    assert difference == pytest.approx([0.0, 0.0, ROBOT.home_depth_m, 0.0, 0.0, 0.0], abs=1e-9)


def test_late_reports_date_the_picture_back_but_silence_does_not():
    arm = TrueArm(ROBOT)
    assert arm.known_until(5.0) == 5.0  # nothing is known: the background is of now
    arm.report(JOINTS_RAD, None, 10.0)
    assert arm.known_until(10.0) == 10.0
    assert arm.known_until(10.0 + 0.5 * EXTRAPOLATE_S) == 10.0 + 0.5 * EXTRAPOLATE_S
    assert arm.known_until(10.3) == 10.0 + EXTRAPOLATE_S
    assert arm.known_until(10.0 + 2.0 * SILENT_S) == 10.0 + 2.0 * SILENT_S
