"""Calibration as a run of the arm: postures, looks, result, reasons."""

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import pose_difference
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.calibration import calibration_poses
from homography_servo.planning.calibration_run import CalibrationRun
from homography_servo.planning.calibration_run import CalibrationRunSettings
from homography_servo.planning.model_learner import ModelLearner
from homography_servo.result import Rejected
import numpy as np
import pytest
from servo_setup import camera
from servo_setup import GOAL_RAD
from servo_setup import ROBOT
from servo_setup import START_RAD
from servo_setup import twist_of_size
from servo_setup import world
from servo_setup import wrong_arm

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)


@pytest.fixture(scope='module')
def postures():
    return calibration_poses(ROBOT, CAMERA, 12, start_rad=START_RAD)


def begun(postures, truth=None, **settings):
    run = world(1, truth)
    run.run(0.5)
    calibration = CalibrationRun(ROBOT, CAMERA, postures, run.servo.watch,
                                 settings=CalibrationRunSettings(**settings))
    run.servo.tick = calibration.tick
    return run, calibration


def test_placement_20_mm_and_5_deg_off_is_found(postures):
    shift = twist_of_size(np.random.default_rng(3), 0.02, np.radians(5.0))
    truth = ArmModel(ROBOT, exp_twist(shift))
    run, calibration = begun(postures, truth)
    run.run(120.0, lambda: not calibration.active)
    assert calibration.state_text == 'DONE', calibration.state_text
    assert 'px' in calibration.result.sentence and 'mm' in calibration.result.sentence
    error = pose_difference(calibration.result.home_from_base, truth.corrected.home_from_base)
    assert np.linalg.norm(error[:3]) < 1e-3
    assert np.linalg.norm(error[3:]) < np.radians(0.5)


def test_looks_of_before_and_after_the_arm_sagged_are_not_averaged(postures):
    truth = ArmModel(ROBOT, exp_twist(twist_of_size(np.random.default_rng(3), 0.02, 0.1)))
    run, calibration = begun(postures, truth)
    for index in range(len(postures)):
        run.run(20.0, lambda: len(calibration._seen) == index and len(calibration._rays) > 3)
        run.drive(run.joints_at(run.now_s) + 0.01)
    run.run(20.0, lambda: not calibration.active)
    assert calibration.state_text == 'DONE', calibration.state_text
    error = pose_difference(calibration.result.home_from_base, truth.corrected.home_from_base)
    assert np.linalg.norm(error[:3]) < 1e-3
    assert calibration.result.residual_px < 0.2 and not calibration.result.left_out


def test_loss_of_sight_holds_then_gives_up(postures):
    run, calibration = begun(postures, calibration_lost_s=2.0)
    run.run(1.0)
    run.see = False
    run.run(1.0)
    assert calibration.state_text.startswith('HOLD: the object is out of sight')
    stops = [at_s for at_s, c in run.commands if c.joints_rad is None]
    assert stops and not [at_s for at_s, c in run.commands if at_s > stops[0]]
    run.run(3.0)
    assert isinstance(calibration.result, Rejected) and 'posture' in calibration.result.reason


def test_short_loss_of_sight_is_survived(postures):
    run, calibration = begun(postures)
    run.run(1.0)
    run.see = False
    run.run(1.0)
    run.see = True
    run.run(120.0, lambda: not calibration.active)
    assert calibration.state_text == 'DONE'


def test_arm_that_does_not_move_ends_it_with_a_reason(postures):
    run, calibration = begun(postures)
    run.obey = False
    run.run(20.0, lambda: not calibration.active)
    assert 'does not reach posture 1' in calibration.state_text


def test_stop_ends_it(postures):
    run, calibration = begun(postures)
    run.run(1.0)
    calibration.stop('stopped by the operator')
    assert calibration.tick(run.now_s).joints_rad is None
    assert not calibration.active and calibration.state_text == 'IDLE'


def test_learner_agrees_with_every_posture_it_has_seen():
    truth, learner = wrong_arm(5), ModelLearner(ROBOT)
    measure = camera(0, 0.02)
    for joints_rad in (GOAL_RAD, START_RAD):
        learner.learn(*measure(truth.pose(joints_rad)), joints_rad)
    found = ArmModel(learner.robot)
    for joints_rad in (GOAL_RAD, START_RAD):
        error = pose_difference(found.pose(joints_rad), truth.pose(joints_rad))
        assert np.linalg.norm(error[:3]) < 5e-4 and np.linalg.norm(error[3:]) < np.radians(0.8)
    far = pose_difference(ArmModel(ROBOT).pose(GOAL_RAD), truth.pose(GOAL_RAD))
    assert np.linalg.norm(far[:3]) > 5e-3


def test_an_arm_that_is_latched_ends_it_and_a_reset_alone_moves_nothing(postures):
    run, calibration = begun(postures)
    run.run(1.0)
    run.servo.watch.arm_latched = 'stopped by ~/stop'
    latched_s = run.now_s
    run.run(0.5)
    run.servo.watch.arm_latched = ''
    run.run(3.0)
    assert not [at_s for at_s, c in run.commands if c.joints_rad is not None and at_s > latched_s]
    assert 'stopped by ~/stop' in calibration.result.reason


def test_a_pause_is_no_time_out_of_sight(postures):
    run, calibration = begun(postures)
    run.run(1.0)
    run.servo.watch.paused = True
    run.run(10.0)
    run.see = False
    run.run(0.5)
    run.servo.watch.paused = False
    run.run(1.0)
    assert calibration.state_text.startswith('HOLD: the object is out of sight')
    run.see = True
    run.run(1.0)
    assert calibration.active and not calibration.state_text.startswith('HOLD')


@pytest.mark.parametrize('jump_s', (-3600.0, 3600.0))
@pytest.mark.parametrize('at_s', (0.3, 0.7))
def test_clock_jump_changes_nothing(postures, jump_s, at_s):
    run, calibration = begun(postures)
    run.run(at_s)
    run.stamp_offset_s += jump_s
    run.run(120.0, lambda: not calibration.active)
    assert calibration.state_text == 'DONE', calibration.state_text


@pytest.mark.parametrize('ahead_s', (-10.0, 10.0))
def test_images_by_another_clock_than_the_joints_end_it(postures, ahead_s):
    run, calibration = begun(postures)
    add_look = run.servo.add_look
    run.servo.add_look = lambda pose, covariance, stamp_s, now_s: add_look(
        pose, covariance, stamp_s + ahead_s, now_s)
    run.run(0.5)
    run.run(20.0, lambda: not calibration.active)
    assert 'one clock' in calibration.result.reason


def test_loss_before_the_first_posture_does_not_lead_to_the_last(postures):
    run = world(1)
    run.run(0.5)
    run.see = False
    run.run(0.5)
    calibration = CalibrationRun(ROBOT, CAMERA, postures, run.servo.watch)
    run.servo.tick = calibration.tick
    run.run(0.1)
    assert calibration.state_text.startswith('HOLD')
    run.see = True
    run.run(1.0)
    targets = [c.joints_rad for _, c in run.commands if c.joints_rad is not None]
    assert targets and np.allclose(targets, postures[0])
