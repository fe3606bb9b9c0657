"""Continuous mode: timed inside the limits, converging, holding, never running away."""

import math

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.control import displacement
from homography_servo.planning.control import errors_of
from homography_servo.planning.flow import Flow
from homography_servo.planning.flow import timed
from homography_servo.planning.follow import follow
from homography_servo.planning.joint_lead import JointLead
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_state import DONE
from homography_servo.planning.servo_state import FAILED
from homography_servo.planning.servo_state import HOLD
import numpy as np
import pytest
from servo_setup import FOCAL_PX
from servo_setup import GOAL_RAD
from servo_setup import ROBOT
from servo_setup import START_RAD
from servo_setup import straight_path
from servo_setup import world
from servo_setup import wrong_arm

FINAL = (0.7e-3, 2e-3, math.radians(0.5), math.radians(2.0))
CONTINUOUS = ServoSettings(mode='continuous')


def flowing(seed=0, truth=None, **kwargs):
    run = world(seed, truth, settings=CONTINUOUS, **kwargs)
    run.measure_moving = True
    return run


def started(seconds, **kwargs):
    run = flowing(**kwargs)
    run.run(0.4)
    assert run.servo.start(run.now_s)
    run.run(seconds)
    assert run.servo.active
    return run


def final_errors(run, path=None):
    goal = (straight_path(run.truth) if path is None else path)[-1]
    return errors_of(displacement(run.true_pose, goal))


@pytest.mark.parametrize('share', (0.0, 0.5))
def test_timing_keeps_speed_and_acceleration_and_ends_at_rest(share):
    points = np.linspace(START_RAD, GOAL_RAD, 9)[1:]
    way = timed(ROBOT, START_RAD, share, points, np.full(8, 0.8))
    assert (np.diff(way.times_s) > 0.0).all() and way.shares[-1] == 0.0
    assert (np.abs(way.velocities_rad_s) <= 0.8 * ROBOT.velocity_rad_s + 1e-9).all()
    assert (way.velocities_rad_s[-1] == 0.0).all()
    rise = np.diff(np.append(share, way.shares)) / np.diff(np.append(0.0, way.times_s))
    largest = (ROBOT.acceleration_rad_s2 / ROBOT.velocity_rad_s).min()
    assert rise.max() <= 0.7 * largest


def test_arm_that_does_not_obey_on_the_way_holds_and_goes_on_when_it_does():
    run = started(0.8)
    run.obey = False
    run.run(3.0)
    assert any(text.startswith('HOLD: the arm does not move') for _, text in run.states)
    run.obey = True
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE
    assert all(e < bound for e, bound in zip(final_errors(run), FINAL))


def test_mode_changed_on_the_way_ends_the_stream_at_the_next_poses():
    run = started(0.3)
    at_s = run.now_s
    run.servo.settings = ServoSettings()
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE
    looked_s = [time_s for time_s, text in run.states if time_s > at_s and text == 'LOOKING']
    assert len(looked_s) > 10 and looked_s[0] - at_s < 1.0
    assert not [c for _, c in run.commands if c.joints_rad is None]


def test_looks_on_the_way_are_not_held_against_those_at_rest():
    settings = ServoSettings(mode='continuous', speed_share=0.2)
    run = world(seed=3, count=2, noise_px=0.5, settings=settings)
    run.measure_moving = True
    run.finish()
    assert run.servo.state == DONE, run.servo.state_text


def test_new_path_past_a_singularity_ends_the_stream():
    """Planned joints have to lead there, from rest to rest."""
    run = started(0.8)
    path = straight_path(run.truth)
    joints_rad = follow(ROBOT, path, START_RAD).joints_rad
    led = np.zeros(31, dtype=bool)
    led[26] = True
    run.servo.set_path(path, True, '', JointLead(joints_rad, led))
    sent = len(run.commands)
    run.run(60.0, lambda: not run.servo.active)
    assert run.servo.state == DONE
    targets = [c.points_rad for _, c in run.commands[sent:] if c.joints_rad is not None]
    assert max(len(points) for points in targets) == 1
    assert min(np.abs(points - joints_rad[26]).max() for points in targets) < 0.01


def test_timing_slows_down_in_a_bend():
    there = START_RAD + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    straight = np.array([START_RAD + 0.5 * (there - START_RAD), there])
    bent = np.array([straight[0], straight[0] + [0.0, 0.15, 0.0, 0.0, 0.0, 0.0]])
    fast, slow = (timed(ROBOT, START_RAD, 0.0, p, np.ones(2)) for p in (straight, bent))
    assert slow.shares[0] < 0.9 * fast.shares[0]


def test_points_sent_end_before_a_joint_limit():
    start, beyond = START_RAD.copy(), START_RAD.copy()
    start[0], beyond[0] = np.radians(70.0), np.radians(90.0)
    path = straight_path(ArmModel(ROBOT), 21, start, beyond)
    flow = Flow(ROBOT, path, 1, 0.01)
    command = flow.command(ArmModel(ROBOT), start, 1.0, FOCAL_PX, 400.0, 0.0)
    assert command.points_rad[:, 0].max() <= ROBOT.upper_rad[0] - 0.01
    assert not flow.ends


def sent_poses(path, index=1):
    """Give the poses of the second command along a path; the first learns how dense it is."""
    flow = Flow(ROBOT, path, index, 0.01)
    for now_s in (0.0, 0.01):
        command = flow.command(ArmModel(ROBOT), START_RAD, 1.0, FOCAL_PX, 400.0, now_s)
    return ArmModel(ROBOT).pose(command.points_rad)


def position_in(path, poses):
    """Find each of some poses in a path."""
    away = [np.linalg.norm(displacement(pose, path), axis=1) for pose in poses]
    assert max(far.min() for far in away) < 1e-4  # they are poses of the path
    return [int(np.argmin(far)) for far in away]


def test_every_pose_is_sent_where_they_are_apart():
    path = straight_path(ArmModel(ROBOT), 11)
    places = position_in(path, sent_poses(path))
    assert len(places) > 2 and places == list(range(1, 1 + len(places)))


def test_poses_close_together_are_left_out_and_what_is_sent_reaches_as_far():
    few, many = (straight_path(ArmModel(ROBOT), count) for count in (11, 1501))
    places = position_in(many, sent_poses(many, 150))
    assert places[0] == 150 and 8 <= len(places) <= 12
    assert np.ptp(np.diff(places)) <= 2  # evenly
    assert places[-1] / 150 == pytest.approx(position_in(few, sent_poses(few))[-1], abs=2.0)


def test_poses_after_a_stay_are_not_passed_over():
    apart = straight_path(ArmModel(ROBOT), 31)
    path = np.concatenate([np.repeat(apart[:1], 200, axis=0), apart[1:]])
    places = [max(place, 199) for place in position_in(path, sent_poses(path, 195))]
    assert np.diff(places).max() == 2  # with 10 of all the poses in reach it would be 20


@pytest.mark.parametrize('seed', range(3))
def test_looks_on_the_way_to_the_last_pose_count_when_the_arm_stands_there(seed):
    run = flowing(seed, count=7, frame_hz=30.0)
    run.finish(30.0)
    assert run.servo.state == DONE
    assert run.now_s - run.commands[-1][0] < 0.25  # after that a bridge calls it silence


def test_dense_path_takes_no_longer():
    seconds = []
    for count in (31, 501):
        run = flowing(3, count=count)
        run.finish(30.0)
        assert run.servo.state == DONE
        assert all(e < bound for e, bound in zip(final_errors(run), FINAL))
        seconds.append(run.now_s)
    assert seconds[1] - seconds[0] < 0.7  # with a fixed number of poses 2.8 s


@pytest.mark.parametrize('frame_hz', (30.0, 120.0))
@pytest.mark.parametrize('truth', [ArmModel(ROBOT), wrong_arm(1)], ids=['exact', 'wrong'])
def test_continuous_trial_ends_within_the_bounds_and_sooner(truth, frame_hz):
    run = flowing(3, truth, frame_hz=frame_hz)
    run.finish(30.0)
    assert run.servo.state == DONE, run.servo.state_text
    assert all(e < bound for e, bound in zip(final_errors(run), FINAL))
    assert run.now_s - 100.4 < 4.0  # stopping at every pose takes 7 s


def test_motion_is_smooth_and_keeps_the_limits():
    run = flowing(1, wrong_arm(1), frame_hz=60.0)
    joints, step_s = [], 1e-3
    frame = run._frame

    def sample():
        joints.append(run._motion.at(run.now_s))
        run._at(run.now_s + step_s, sample)
    run.run(0.4)
    run.servo.start(run.now_s)
    sample()
    run.run(30.0, lambda: not run.servo.active)
    assert frame is not None and run.servo.state == DONE
    speed = np.diff(joints, axis=0) / step_s
    assert (np.abs(speed) < 1.05 * ROBOT.velocity_rad_s).all()
    jumps = np.abs(np.diff(speed, axis=0)).max(axis=0)
    assert (jumps < 0.1 * ROBOT.velocity_rad_s).all()  # no step in speed


@pytest.mark.parametrize('cut', ['see', 'feel'])
def test_loss_in_full_motion_holds_and_goes_on(cut):
    run = started(0.8)
    setattr(run, cut, False)
    lost_s = run.now_s
    run.run(1.0)
    assert run.servo.state == HOLD
    stop_s = next(at_s for at_s, c in run.commands if c.joints_rad is None)
    assert stop_s - lost_s < 0.30
    held_rad = run.joints_at(run.now_s)
    setattr(run, cut, True)
    run.run(0.02)
    assert run.joints_at(run.now_s) == pytest.approx(held_rad)
    run.run(30.0, lambda: not run.servo.active)
    assert run.servo.state == DONE
    assert all(e < bound for e, bound in zip(final_errors(run), FINAL))


def test_arm_that_hears_nothing_more_comes_to_rest_by_itself():
    run = started(0.8)
    run.obey = False
    run.run(1.5)
    rest_rad = run.joints_at(run.now_s)
    run.run(0.5)
    assert run.joints_at(run.now_s) == pytest.approx(rest_rad)


def test_new_path_in_full_motion_is_taken_over_without_a_stop():
    run = started(0.7)
    path = straight_path(run.truth, 31, START_RAD, 0.3 * START_RAD + 0.7 * GOAL_RAD)
    run.servo.set_path(path, True, '')
    run.run(30.0, lambda: not run.servo.active)
    assert run.servo.state == DONE
    assert not [c for _, c in run.commands if c.joints_rad is None]
    assert all(e < bound for e, bound in zip(final_errors(run, path), FINAL))


def test_joint_limit_in_the_way_is_named():
    start, beyond = START_RAD.copy(), START_RAD.copy()
    start[0], beyond[0] = np.radians(60.0), np.radians(84.0)
    run = flowing()
    run._motion.__init__(start)
    run.servo.set_path(straight_path(run.truth, 20, start, beyond), True, '')
    run.finish(30.0)
    assert run.servo.state == FAILED and 'joint1' in run.servo.reason
    assert max(joints[0] for _, joints in run.trace) < ROBOT.upper_rad[0]
