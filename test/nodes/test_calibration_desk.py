"""The calibration desk of the servo node: every end has its answer."""

import sys

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
sys.path.insert(0, __file__.rsplit('/nodes/', 1)[0] + '/planning')

from homography_servo.geometry.camera import Camera  # noqa: E402,I100
from homography_servo.nodes.calibration_desk import CalibrationDesk  # noqa: E402
from homography_servo.planning.calibration import CalibrationPoseSettings  # noqa: E402
from homography_servo.planning.calibration import CalibrationSettings  # noqa: E402
from homography_servo.planning.calibration_run import CalibrationRunSettings  # noqa: E402
from homography_servo.robot.robot_file import load_robot  # noqa: E402
from servo_setup import FOCAL_PX  # noqa: E402
from servo_setup import ROBOT  # noqa: E402
from servo_setup import world  # noqa: E402

CAMERA = Camera(FOCAL_PX, FOCAL_PX, 319.5, 239.5, 640, 480)


def opened(file='', limits=CalibrationSettings()):
    """Give a simulated world whose arm a new calibration has."""
    run = world(1)
    run.run(0.5)
    desk = CalibrationDesk(ROBOT, run.servo, {
        CalibrationRunSettings: CalibrationRunSettings(calibration_file=str(file)),
        CalibrationPoseSettings: CalibrationPoseSettings(), CalibrationSettings: limits})
    assert desk.begin(CAMERA, run.now_s) is None and desk.open and not desk.over
    run.servo.tick = desk.tick
    return run, desk


def answer(run, desk):
    run.run(120.0, lambda: desk.over)
    assert desk.over
    success, sentence = desk.result()
    assert not desk.open
    return success, sentence


def test_what_is_found_is_written(tmp_path):
    run, desk = opened(tmp_path / 'found.yaml')
    success, sentence = answer(run, desk)
    assert success and sentence.endswith(f'written to {tmp_path / "found.yaml"}')
    assert load_robot(tmp_path / 'found.yaml').joint_names == ROBOT.joint_names
    assert desk.state_text == 'DONE'
    desk.clear()
    assert desk.state_text == ''


def test_looks_that_are_not_good_enough_are_answered_with_the_reason(tmp_path):
    file = tmp_path / 'found.yaml'
    run, desk = opened(file, CalibrationSettings(calibration_residual_px=0.01))
    success, sentence = answer(run, desk)
    assert not success and '0.01 px are allowed' in sentence and not file.exists()
    assert desk.state_text == f'FAILED: {sentence}'


def test_an_operator_who_stops_is_answered():
    run, desk = opened()
    run.run(0.2)
    desk.stop('stopped by the operator')
    assert answer(run, desk) == (False, 'stopped by the operator')
    assert desk.state_text == 'IDLE'


def test_a_file_that_cannot_be_written_loses_no_result(tmp_path):
    run, desk = opened(tmp_path / 'no folder' / 'found.yaml')
    success, sentence = answer(run, desk)
    assert not success and sentence.startswith('residual') and 'was not written' in sentence


def test_nothing_begins_while_the_arm_is_latched():
    run, desk = opened()
    desk.stop('enough')
    desk.result()
    run.servo.watch.arm_latched = 'the operator'
    refused = desk.begin(CAMERA, run.now_s)
    assert 'latched' in refused.reason and not desk.open
