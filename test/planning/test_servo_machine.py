"""The servo's states in a world without images: convergence, holds, refusals, stops."""

import math

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.control import displacement
from homography_servo.planning.control import errors_of
from homography_servo.planning.joint_track import JointTrack
from homography_servo.planning.servo import Servo
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_state import DONE
from homography_servo.planning.servo_state import FAILED
from homography_servo.planning.servo_state import HOLD
from homography_servo.planning.servo_state import IDLE
from homography_servo.result import Rejected
import numpy as np
import pytest
from servo_setup import GOAL_RAD
from servo_setup import ROBOT
from servo_setup import START_RAD
from servo_setup import straight_path
from servo_setup import world
from servo_setup import wrong_arm

FINAL = (0.7e-3, 2e-3, math.radians(0.5), math.radians(2.0))


def moves(run):
    return [(at_s, c) for at_s, c in run.commands if c.joints_rad is not None]


def stops(run):
    return [at_s for at_s, c in run.commands if c.joints_rad is None]


def final_errors(run):
    goal = straight_path(run.truth)[-1]
    return errors_of(displacement(run.true_pose, goal))


def started(seconds=1.0, **kwargs):
    """Give a world whose servo has been on its way for a while."""
    run = world(**kwargs)
    run.run(0.4)
    assert run.servo.start(run.now_s)
    run.run(seconds)
    assert run.servo.active
    return run


@pytest.mark.parametrize('truth', [ArmModel(ROBOT), wrong_arm(1), wrong_arm(2)],
                         ids=['exact', 'wrong', 'wrong too'])
def test_trial_ends_within_the_bounds_in_time(truth):
    run = world(seed=4, truth=truth)
    start_s = run.now_s + 0.4
    run.finish()
    assert run.servo.state == DONE, run.servo.state_text
    assert all(e < bound for e, bound in zip(final_errors(run), FINAL))
    motion_s = sum(c.time_s for _, c in moves(run))
    assert run.now_s - start_s < 2.0 * motion_s + len(moves(run)) / 30.0
    assert run.servo.progress.pose == run.servo.progress.of == 31


def test_commands_keep_the_limits_of_the_joints():
    run = world(seed=1)
    run.finish()
    here = START_RAD
    for _, command in moves(run):
        assert (command.joints_rad > ROBOT.lower_rad).all()
        assert (command.joints_rad < ROBOT.upper_rad).all()
        size = np.abs(command.joints_rad - here)
        assert (1.5 * size / command.time_s < ROBOT.velocity_rad_s + 1e-2).all()
        here = command.joints_rad


@pytest.mark.parametrize('cut, back, word', [('see', 5, 'sight'), ('feel', 1, 'joint_states')])
def test_lost_input_holds_at_once_and_goes_on_by_itself(cut, back, word):
    run = started()
    setattr(run, cut, False)
    lost_s = run.now_s
    run.run(1.0)
    assert run.servo.state == HOLD and word in run.servo.reason
    assert stops(run) and stops(run)[0] - lost_s < 0.30
    assert not [at_s for at_s, _ in moves(run) if at_s > stops(run)[0]]
    setattr(run, cut, True)
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE
    assert all(e < bound for e, bound in zip(final_errors(run), FINAL))


def test_what_the_tracker_says_holds_sooner_than_silence():
    run = started()
    run.see, run.servo.watch.sight.tracker_lost = False, True
    lost_s = run.now_s
    run.run(0.1)
    assert run.servo.state_text == 'HOLD: the tracker has lost the object'
    assert stops(run)[0] - lost_s < 0.03
    run.see, run.servo.watch.sight.tracker_lost = True, False
    run.run(0.1)  # three frames
    assert 'waiting for 5' in run.servo.reason
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE


def test_an_arm_that_is_latched_ends_the_way_and_a_reset_alone_moves_nothing():
    run = started()
    run.servo.watch.arm_latched = 'stopped by ~/stop'
    latched_s = run.now_s
    run.run(0.5)
    reason = 'the arm is latched (stopped by ~/stop); call robix_bridge/reset'
    assert run.servo.state_text == f'FAILED: {reason}'
    assert run.servo.start(run.now_s) == Rejected(reason)
    run.servo.watch.arm_latched = ''
    run.run(2.0)
    assert not [at_s for at_s, _ in moves(run) if at_s > latched_s + 0.03]
    assert isinstance(run.servo.start(run.now_s), str)
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE


def test_vision_must_be_back_for_some_looks():
    run = started()
    run.see = False
    run.run(1.0)
    run.see = True
    run.run(0.1)  # three frames
    assert run.servo.state == HOLD and 'waiting for 5' in run.servo.reason


def test_every_second_frame_lost_does_not_matter():
    run = world(seed=2)
    rng, measure = np.random.default_rng(2), run.measure
    run.measure = lambda pose: measure(pose) if rng.random() < 0.5 else None
    run.finish()
    assert run.servo.state == DONE


def test_pause_holds_and_taking_it_back_goes_on():
    run = started()
    run.servo.pause(True)
    run.run(1.0)
    assert run.servo.state_text == 'HOLD: paused by the operator'
    held_rad = run.joints_at(run.now_s)
    run.run(1.0)
    assert run.joints_at(run.now_s) == pytest.approx(held_rad)
    run.servo.pause(False)
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE


def test_sight_lost_in_a_pause_must_be_back_for_some_looks():
    run = started()
    run.servo.pause(True)
    run.see = False
    run.run(1.0)
    run.see = True
    run.run(0.1)  # three frames
    run.servo.pause(False)
    run.servo.tick(run.now_s)
    assert 'waiting for 5' in run.servo.state_text


def test_sight_lost_before_a_start_must_be_back_for_some_looks():
    run = started()
    run.servo.stop()
    run.see = False
    run.run(1.0)
    run.see = True
    run.run(0.1)  # three frames
    assert 'waiting for 5' in run.servo.start(run.now_s).reason


def test_arm_that_moved_unseen_in_a_pause_needs_a_new_start():
    run = started()
    run.servo.pause(True)
    run.run(0.5)
    run.feel = False
    run.run(1.0)
    run._motion._points = run._motion._points + 0.4
    run.feel = True
    run.run(1.0)
    run.servo.pause(False)
    run.run(1.0)
    assert run.servo.state == FAILED and 'while joint_states were missing' in run.servo.reason


def test_stop_is_immediate_and_final_until_start():
    run = started()
    run.servo.stop()
    assert run.servo.tick(run.now_s).joints_rad is None
    assert run.servo.state == IDLE
    run.run(1.0)
    count = len(run.commands)
    run.run(2.0)
    assert len(run.commands) == count
    assert run.servo.start(run.now_s)
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE


@pytest.mark.parametrize('prepare, word', [
    (lambda r: r.servo.set_focal(None), 'camera_info'),
    (lambda r: setattr(r, 'see', False), 'never seen'),
    (lambda r: setattr(r, 'feel', False), 'joint_states'),
    (lambda r: r.servo.pause(True), 'paused'),
    (lambda r: r.servo.set_path(np.zeros((0, 4, 4)), True, ''), 'empty'),
    (lambda r: r.servo.set_path(straight_path(r.truth), False, 'pose 3: joint2 beyond its limit'),
     'joint2'),
])
def test_start_is_refused_with_a_sentence_and_nothing_moves(prepare, word):
    run = world()
    prepare(run)
    run.run(0.5)
    answer = run.servo.start(run.now_s)
    assert isinstance(answer, Rejected) and word in answer.reason
    run.run(0.5)
    assert not run.commands and run.servo.state == IDLE


def test_start_without_any_path_is_refused():
    assert 'no path' in Servo(ROBOT).start(0.0).reason


def test_start_far_from_the_path_fails_with_the_distance():
    run = world()
    away = straight_path(run.truth)
    away[:, 0, 3] += 0.2
    run.servo.set_path(away, True, '')
    run.finish()
    assert run.servo.state == FAILED and '200 mm' in run.servo.reason
    assert not moves(run)


@pytest.mark.parametrize('count', (2, 3))
@pytest.mark.parametrize('mode', ('look_then_move', 'continuous'))
def test_start_at_the_goal_of_a_path_of_few_poses_is_done(count, mode):
    run = world(count=count, settings=ServoSettings(mode=mode))
    run.finish()
    run.finish()
    assert run.servo.state == DONE, run.servo.state_text


def test_new_path_in_mid_motion_is_taken_over_without_a_stop():
    run = started(3.0)
    halfway = 0.5 * (START_RAD + GOAL_RAD)
    path = straight_path(run.truth, 31, START_RAD, halfway)
    run.servo.set_path(path, True, '')
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE and not stops(run)
    assert all(e < bound for e, bound in zip(
        errors_of(displacement(run.true_pose, path[-1])), FINAL))


def test_new_path_between_start_and_first_look_is_not_gone_to_from_afar():
    run = world()
    run.run(0.4)
    assert run.servo.start(run.now_s)
    away = straight_path(run.truth)
    away[:, 0, 3] += 0.2
    run.servo.set_path(away, True, '')
    run.run(10.0, lambda: not run.servo.active)
    assert run.servo.state == FAILED and '200 mm' in run.servo.reason
    assert not moves(run)


@pytest.mark.parametrize('mode', ['look_then_move', 'continuous'])
def test_new_path_far_from_a_moving_arm_is_not_gone_to(mode):
    run = world(0, settings=ServoSettings(mode=mode))
    run.run(0.5)
    assert run.servo.start(run.now_s)
    run.run(1.0)
    assert run.servo.active
    far = START_RAD + np.radians([70.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    run.servo.set_path(straight_path(run.truth, 11, far, far + 0.05), True, 'good')
    assert run.servo.state == 'FAILED' and 'away from the path' in run.servo.state_text
    run.run(0.5)  # it brakes
    where = run.joints_at(run.now_s)
    run.run(1.0)
    assert np.allclose(run.joints_at(run.now_s), where, atol=1e-6)


def test_new_veto_in_mid_motion_stops():
    run = started()
    run.servo.set_path(straight_path(run.truth), False, 'pose 7 leaves the image')
    run.run(0.1)
    assert run.servo.state == FAILED and 'pose 7 leaves the image' in run.servo.reason
    assert len(stops(run)) == 1


def test_arm_that_does_not_obey_holds_as_long_as_it_takes_and_goes_on():
    run = started()
    run.obey = False
    run.run(3.0)
    assert any(text.startswith('HOLD: the arm does not move') for _, text in run.states)
    run.run(57.0)
    assert run.servo.active
    run.obey = True
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE


def test_arm_that_never_rests_is_said_and_waited_for():
    run = world()
    rng, joints_at = np.random.default_rng(0), run.joints_at
    run.joints_at = lambda time_s: joints_at(time_s) + 1e-3 * rng.normal(size=6)
    run.run(0.4)
    assert run.servo.start(run.now_s)
    run.run(3.0)
    assert any(text == 'HOLD: the arm does not come to rest' for _, text in run.states)
    run.joints_at = joints_at
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE


@pytest.mark.parametrize('ahead_s', (-10.0, 10.0))
def test_images_by_another_clock_than_the_joints_are_said(ahead_s):
    run = world()
    add_look = run.servo.add_look
    run.servo.add_look = lambda pose, covariance, stamp_s, now_s: add_look(
        pose, covariance, stamp_s + ahead_s, now_s)
    run.run(0.4)
    assert run.servo.start(run.now_s)
    run.run(3.0)
    assert any('one clock' in text for _, text in run.states)
    assert not moves(run)


def test_arm_that_moved_unseen_needs_a_new_start():
    run = started()
    run.feel = False
    run.run(1.0)
    run._motion._points = run._motion._points + 0.4
    run.feel = True
    run.run(1.0)
    assert run.servo.state == FAILED and 'while joint_states were missing' in run.servo.reason


def test_noise_above_the_tolerance_is_said():
    run = world(noise_px=3.0, settings=ServoSettings(looks_max=20))
    run.finish()
    assert run.servo.state == FAILED
    assert 'cannot be reached with this noise' in run.servo.reason


def test_more_looks_asked_for_at_the_end_than_allowed_blames_no_noise():
    run = world(settings=ServoSettings(final_looks=100))
    run.finish()
    assert run.servo.state == DONE, run.servo.state_text
    assert run.servo.progress.looks >= 100


def test_joint_at_its_limit_is_named():
    start = START_RAD.copy()
    start[0] = np.radians(60.0)
    beyond = start.copy()
    beyond[0] = np.radians(84.0)
    run = world()
    run._motion.__init__(start)
    run.servo.set_path(straight_path(run.truth, 20, start, beyond), True, '')
    run.finish()
    assert run.servo.state == FAILED and 'joint1 is at its limit' in run.servo.reason
    assert max(c.joints_rad[0] for _, c in moves(run)) < ROBOT.upper_rad[0]


@pytest.mark.parametrize('jump_s', (-3600.0, 3600.0))
def test_clock_jump_changes_nothing(jump_s):
    run = started()
    run.stamp_offset_s += jump_s
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE
    assert not any(text.startswith(HOLD) for _, text in run.states)


@pytest.mark.parametrize('depth_m, variance', [(0.0, 1.7e308), (1e200, 1e-6)])
def test_numbers_that_overflow_are_refused_and_spoil_nothing(depth_m, variance):
    run, away = world(), np.eye(4)
    away[2, 3] = depth_m
    run.run(0.3)
    answer = run.servo.add_look(away, variance * np.eye(6), run.now_s + 1e6 + 1e-3, run.now_s)
    assert 'too large' in answer.reason
    run.finish()
    assert run.servo.state == DONE


@pytest.mark.parametrize('stamp_s, word', [(0.0, 'no time stamp'), (5.0, 'older'), (5.2, 'older')])
def test_bad_stamps_of_images_are_refused(stamp_s, word):
    servo, pose, covariance = Servo(ROBOT), np.eye(4), 1e-6 * np.eye(6)
    assert servo.add_look(pose, covariance, 5.2, 1.0) is None
    assert word in servo.add_look(pose, covariance, stamp_s, 1.1).reason


def test_late_images_fit_joint_states_of_any_rate():
    track = JointTrack()
    for tick in range(10000):
        assert track.add(START_RAD + 1e-3 * tick, 1e-3 * tick, 1e-3 * tick) is None
    assert track.at(9.5) == pytest.approx(START_RAD + 9.5)
    assert track.at(9.0) is not None and track.at(1.0) is None


@pytest.mark.parametrize('rate_hz', (50.0, 1000.0))
def test_slow_motion_is_no_rest_however_often_joints_come(rate_hz):
    track = JointTrack()
    for stamp_s in np.arange(1.0, 2.0, 1.0 / rate_hz):
        track.add(START_RAD + 0.05 * stamp_s, stamp_s, stamp_s)
        assert track.still_since_s == math.inf or stamp_s - track.still_since_s < 0.01
    for stamp_s in np.arange(2.0, 2.1, 1.0 / rate_hz):
        track.add(START_RAD + 0.1, stamp_s, stamp_s)
    assert track.still_since_s == pytest.approx(2.0)


def test_bad_joint_states_are_refused():
    servo = Servo(ROBOT)
    assert servo.add_joints(START_RAD, 5.0, 1.0) is None
    assert 'finite' in servo.add_joints(np.full(6, np.nan), 5.1, 1.1).reason
    assert 'older' in servo.add_joints(START_RAD, 4.9, 1.2).reason
    assert 'older' in servo.add_joints(START_RAD, 5.0, 1.2).reason


def test_looks_during_motion_are_not_used():
    run = world(seed=3)
    run.measure_moving = True
    measure = run.measure

    def liar(pose):
        moving = np.abs(run._motion.at(run.now_s + 1e-3) - run._motion.at(run.now_s)).max() > 1e-7
        home_from_object, covariance = measure(pose)
        home_from_object[:3, 3] += 0.05 * moving
        return home_from_object, covariance
    run.measure = liar
    run.finish()
    assert run.servo.state == DONE
    assert all(e < bound for e, bound in zip(final_errors(run), FINAL))


@pytest.mark.parametrize('lag_s', (0.05, 0.15))
def test_images_older_than_their_stamps_do_not_lead_astray(lag_s):
    run = world(seed=5)
    run.lag_s, run.measure_moving = lag_s, True
    run.finish()
    assert run.servo.state == DONE, run.servo.state_text
    assert all(e < bound for e, bound in zip(final_errors(run), FINAL))


def test_pose_that_a_joint_limit_keeps_out_of_reach_is_passed_over():
    start, bulge, goal = (START_RAD.copy() for _ in range(3))
    start[1], bulge[1], goal[1] = np.radians([71.0, 77.0, 71.0])
    goal[0] += 0.2
    bulge[0] += 0.1
    run = world()
    run._motion.__init__(start)
    there = straight_path(run.truth, 8, start, bulge)
    back = straight_path(run.truth, 8, bulge, goal)
    run.servo.set_path(np.concatenate([there, back[1:]]), True, '')
    run.finish()
    assert run.servo.state == DONE, run.servo.state_text
    assert run.servo.passed_over > 0
    assert max(c.joints_rad[1] for _, c in moves(run)) < ROBOT.upper_rad[1]
    errors = errors_of(displacement(run.true_pose, back[-1]))
    assert all(e < bound for e, bound in zip(errors, FINAL))
