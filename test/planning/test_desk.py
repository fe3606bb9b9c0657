"""What the planner knows and answers: noise measured, mirrors chosen, goals taken or refused."""

from dataclasses import replace

from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import pose_difference
from homography_servo.geometry.rigid import rotation_angle
from homography_servo.planning.desk import PlanningDesk
from homography_servo.planning.feasibility import look
from homography_servo.planning.observer import Observer
from homography_servo.planning.observer_settings import ObserverSettings
from homography_servo.planning.settings import PlannerSettings
from homography_servo.result import Rejected
from homography_servo.robot.kinematics import object_pose
import numpy as np
from plan_setup import CAMERA
from plan_setup import GOAL_RAD
from plan_setup import POINTS_M
from plan_setup import ROBOT
from plan_setup import START_RAD
import pytest

START, GOAL = object_pose(ROBOT, START_RAD), object_pose(ROBOT, GOAL_RAD)
TILTED_RAD = START_RAD + np.radians([0.0, 0.0, 0.0, 8.0, 0.0, 0.0])
PERIOD_S = 1.0 / 30.0


def seen(pose):
    return look(pose[None], CAMERA, POINTS_M, 1.0).points_px[0]


class Bench:
    """A desk with a clock and a camera with noise."""

    def __init__(self, robot=ROBOT, noise_px=0.1, **settings):
        self.desk = PlanningDesk(POINTS_M, robot, replace(PlannerSettings(), **settings))
        self.rng, self.noise_px, self.now_s = np.random.default_rng(2), noise_px, 100.0
        self.desk.set_camera(CAMERA)

    def show(self, pose, joints_rad=None, looks=1):
        for _ in range(looks):
            self.now_s += PERIOD_S
            if joints_rad is not None:
                self.desk.set_joints(joints_rad, self.now_s)
            noisy = seen(pose) + self.rng.normal(0.0, self.noise_px, (4, 2))
            estimate = self.desk.see(noisy, self.now_s)
        return estimate


def test_no_pose_is_better_known_than_edges_can_be_trusted():
    """A tracker knows its noise only; what it cannot know is added to what it says."""
    def deviations(tracker_px, sigma_px):
        bench = Bench(noise_px=0.0, corner_sigma_px=sigma_px)
        estimate = bench.desk.see(seen(GOAL), 100.0, covariance_px2=tracker_px**2 * np.eye(8))
        return np.sqrt(estimate.covariance.diagonal())
    assert deviations(0.001, 0.2) == pytest.approx(deviations(0.2, 0.001), rel=1e-3)
    assert deviations(0.3, 0.4) == pytest.approx(5.0 * deviations(0.06, 0.08), rel=1e-3)


def test_several_looks_teach_a_goal_better_than_one():
    one, many = [], []
    for seed in range(10):
        bench = Bench(noise_px=0.3)
        bench.rng = np.random.default_rng(seed)
        one.append(pose_difference(bench.show(GOAL, GOAL_RAD).home_from_object, GOAL))
        bench.show(GOAL, GOAL_RAD, looks=39)
        answer = bench.desk.teach(bench.now_s)
        assert '40 looks' in answer
        many.append(pose_difference(bench.desk.goal, GOAL))
    ratio = np.sqrt(np.square(many).mean(axis=0) / np.square(one).mean(axis=0))
    assert ratio.max() < 0.5  # sqrt(1 / 40) = 0.16 and what chance adds


@pytest.mark.parametrize('noise_px', (0.03, 0.1, 0.6))
def test_noise_is_measured_and_goes_into_the_covariance(noise_px):
    bench = Bench(noise_px=noise_px)
    bench.show(START, START_RAD, looks=60)
    assert bench.desk.noise_px == pytest.approx(noise_px, rel=0.2)
    errors, covariances = [], []
    for _ in range(150):
        estimate = bench.show(START, START_RAD)
        errors.append(pose_difference(estimate.home_from_object, START))
        covariances.append(estimate.covariance)
    squared = [e @ np.linalg.solve(c, e) for e, c in zip(errors, covariances)]
    if noise_px < 0.5:  # beyond that the mirror of this square view is too near
        assert np.mean(squared) == pytest.approx(6.0, rel=0.35)


def test_noise_can_be_left_as_it_was_set():
    observer = Observer(POINTS_M, 1.0, 0.25, ObserverSettings(measure_noise=False))
    rng = np.random.default_rng(1)
    for k in range(30):
        observer.see(seen(START) + rng.normal(0.0, 0.1, (4, 2)), CAMERA, k * PERIOD_S)
    assert observer.noise_px == 0.25


def is_mirror(found, true):
    """Tell whether a rotation is nearer to the mirror about the line of sight."""
    sight = true[:3, 3] + (0.0, 0.0, 1.0)
    sight = sight / np.linalg.norm(sight)
    mirror = (np.eye(3) - 2.0 * np.outer(sight, sight)) @ true[:3, :3] @ np.diag([1.0, 1.0, -1.0])
    return rotation_angle(found[:3, :3] @ mirror.T) < rotation_angle(found[:3, :3]
                                                                     @ true[:3, :3].T)


def test_the_arm_decides_between_the_minima_then_the_last_pose():
    tilted = object_pose(ROBOT, TILTED_RAD)
    alone = Observer(POINTS_M, 1.0, 0.5)
    rng = np.random.default_rng(3)
    guesses = [alone.pose_of(seen(tilted) + rng.normal(0.0, 0.5, (4, 2)), CAMERA)
               for _ in range(60)]
    assert sum(is_mirror(g.home_from_object, tilted) for g in guesses) > 5
    for joints_rad in (TILTED_RAD, None):
        bench = Bench(noise_px=0.5)
        bench.show(tilted, TILTED_RAD)
        wrong = [is_mirror(bench.show(tilted, joints_rad).home_from_object, tilted)
                 for _ in range(60)]
        assert sum(wrong) <= 2


def test_a_second_minimum_is_found_soon_after_it_was_born():
    watching, waited = Observer(POINTS_M, 1.0, 0.02), 0
    for time_s in np.arange(0.0, 0.6, 0.01):
        pose = exp_twist([0.0, 0.0, 0.0, 0.0, min(2.0 * time_s, 0.8), 0.0])
        alone = Observer(POINTS_M, 1.0, 0.02).see(seen(pose), CAMERA, time_s)
        found = watching.see(seen(pose), CAMERA, time_s)
        assert rotation_angle(found.home_from_object[:3, :3].T @ pose[:3, :3]) < 1e-4
        waited = waited + 1 if len(found.candidates) < len(alone.candidates) else 0
        assert waited <= 10  # looks in SEARCH_PERIOD_S
    assert len(found.candidates) == 2


def test_only_looks_since_the_last_motion_are_averaged():
    bench = Bench()
    bench.show(START, START_RAD, looks=30)
    bench.show(GOAL, GOAL_RAD, looks=12)
    assert 'from 12 looks' in bench.desk.teach(bench.now_s)
    assert np.abs(bench.desk.goal - GOAL).max() < 0.05


def test_a_goal_needs_looks_at_rest():
    bench = Bench()
    for k in range(30):
        moving = START.copy()
        moving[0, 3] += 0.004 * k  # 5 px per frame
        bench.show(moving)
    assert 'good looks at the object at rest' in bench.desk.teach(bench.now_s).reason


def missing(bench):
    answer = bench.desk.plan(bench.now_s)
    assert isinstance(answer, Rejected)
    return answer.reason


def test_every_missing_input_is_named():
    bench = Bench()
    bench.desk.set_camera(Rejected('k[0] is 0: not calibrated'))
    assert 'no camera_info' in missing(bench)
    assert 'no camera_info' in bench.desk.see(seen(START), 0.0).reason
    assert 'no camera_info' in bench.desk.teach(0.0).reason
    bench.desk.set_camera(CAMERA)
    assert 'the object is not seen' in missing(bench)
    bench.show(START)
    assert 'no joint_states yet' in missing(bench)
    bench.show(START, START_RAD)
    assert 'no goal' in missing(bench)
    bench.desk.set_goal_pose(GOAL)
    assert 'only 2 of 3 good looks' in missing(bench)
    bench.show(START, START_RAD)
    assert bench.desk.plan(bench.now_s).ok
    bench.now_s += 0.3
    assert 'no joint_states for 0.3 s' in missing(bench)
    bench.now_s += 0.3
    assert 'has not been seen for 0.6 s' in missing(bench)
    bench.desk.lose_sight()
    assert 'the object is not seen' in missing(bench)


def refused(bench, answer):
    assert isinstance(answer, Rejected) and answer.reason.startswith('the goal was refused: ')
    bench.show(START, START_RAD)
    assert missing(bench) == answer.reason  # a goal from before must not be taken instead
    return answer.reason


def test_every_bad_goal_is_refused_with_its_reason_and_forgets_the_one_before():
    bench = Bench()
    behind, aside, edge_on = np.eye(4), np.eye(4), object_pose(ROBOT, START_RAD)
    behind[2, 3], aside[0, 3] = -1.2, 0.7
    edge_on[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.05, 0.99875], [0.0, -0.99875, 0.05]]
    good = seen(GOAL)
    for goal, words in ((behind, 'behind the camera'), (aside, 'outside the image'),
                        (edge_on, 'line of sight'), (Rejected('no frame'), 'no frame')):
        bench.desk.set_goal_pose(GOAL)
        assert words in refused(bench, bench.desk.set_goal_pose(goal))
    for corners, words in ((good[::-1], 'mirror'), (np.roll(good, 1, axis=0), 'wrong order'),
                           (good[[0, 0, 2, 3]], ''), (good[:3], '4 corners'),
                           (np.full((4, 2), np.inf), 'finite'), (good + (300.0, 0.0), 'image')):
        bench.desk.set_goal_pose(GOAL)
        assert words in refused(bench, bench.desk.set_goal_corners(corners, bench.now_s))


def test_goal_corners_take_a_minimum_that_the_arm_can_reach():
    bench = Bench()
    assert 'goal set' in bench.desk.set_goal_corners(seen(GOAL), bench.now_s)
    assert np.abs(bench.desk.goal - GOAL).max() < 1e-3


def test_an_object_without_an_arm_needs_no_joints():
    bench = Bench(robot=None)
    bench.show(START, looks=5)
    bench.desk.set_goal_pose(GOAL)
    found = bench.desk.plan(bench.now_s)
    assert found.ok and found.joints_rad is None


def test_settings_change_at_run_time_and_a_new_camera_forgets_looks():
    bench = Bench()
    bench.show(START, START_RAD, looks=20)
    bench.desk.set_goal_pose(GOAL)
    bench.desk.change(replace(PlannerSettings(), poses=11), ObserverSettings())
    assert len(bench.desk.plan(bench.now_s).poses) == 11
    bench.desk.set_camera(replace(CAMERA, fx=700.0))
    assert 'not seen' in missing(bench)


@pytest.mark.parametrize('between', [[], [Rejected('k[0] is 0: not calibrated')]],
                         ids=['at once', 'after a bad one'])
def test_what_was_measured_with_another_camera_is_not_used(between):
    bench = Bench()
    bench.show(GOAL, GOAL_RAD, looks=20)
    assert 'goal taught' in bench.desk.teach(bench.now_s)
    for camera in [*between, replace(CAMERA, fx=700.0)]:
        bench.desk.set_camera(camera)
    assert 'not seen' in missing(bench)
    bench.show(START, START_RAD, looks=20)
    assert 'camera' in missing(bench) and 'teach it anew' in missing(bench)


def test_a_camera_that_is_said_again_changes_nothing():
    bench = Bench()
    bench.show(GOAL, GOAL_RAD, looks=20)
    bench.desk.teach(bench.now_s)
    for camera in (CAMERA, Rejected('k[0] is 0: not calibrated'), CAMERA):
        bench.desk.set_camera(camera)
    assert bench.desk.plan(bench.now_s).ok


def test_joints_that_come_late_or_twice_are_no_news():
    bench = Bench()
    bench.desk.set_goal_pose(GOAL)
    assert bench.desk.set_joints(START_RAD, 100.0, stamp_s=50.0) is None
    for stamp_s in np.arange(50.1, 51.1, 0.1):
        bench.desk.see(seen(START), 100.0, stamp_s)
    for stamp_s, late in ((49.9, '0.100'), (50.0, '0.000')):
        answer = bench.desk.set_joints(START_RAD + 0.1, 100.0, stamp_s)
        assert isinstance(answer, Rejected) and f'{late} s older' in answer.reason
    assert bench.desk.plan(100.0).ok
    assert bench.desk.set_joints(START_RAD, 100.0, stamp_s=20.0) is None  # the clock was set


def test_clocks_that_differ_are_called_that():
    bench = Bench()
    bench.desk.set_goal_pose(GOAL)
    bench.desk.set_joints(START_RAD + 0.1, 100.0, stamp_s=150.0)
    bench.desk.set_joints(START_RAD, 100.0, stamp_s=151.0)
    for stamp_s in np.arange(50.1, 51.1, 0.1):
        bench.desk.see(seen(START), 100.0, stamp_s)
    assert 'one clock?' in bench.desk.plan(100.0).reason


def test_pictures_from_before_the_arm_stopped_are_no_looks_at_rest():
    bench = Bench()
    bench.desk.set_goal_pose(GOAL)
    bench.desk.set_joints(START_RAD + 0.1, 100.0, stamp_s=50.0)
    bench.desk.set_joints(START_RAD, 100.0, stamp_s=51.0)  # the arm moved until here
    for stamp_s in (50.0, 50.2, 50.4, 50.6, 50.8, 51.0):
        bench.desk.see(seen(START), 100.0, stamp_s)
    bench.desk.set_joints(START_RAD, 100.0, stamp_s=51.1)
    assert 'only 1 of 3 good looks' in bench.desk.plan(100.0).reason
    for stamp_s in (51.2, 51.4):
        bench.desk.see(seen(START), 100.0, stamp_s)
    assert bench.desk.plan(100.0).ok


def test_joints_and_looks_of_a_goal_or_start_belong_together():
    bench = Bench()
    bench.desk.set_goal_pose(GOAL)
    bench.desk.set_joints(START_RAD, 100.0, stamp_s=50.0)
    for stamp_s in np.arange(50.1, 51.1, 0.1):
        bench.desk.see(seen(START), 100.0, stamp_s)
    bench.desk.set_joints(START_RAD + 0.05, 100.0, stamp_s=51.2)
    for answer in (bench.desk.plan(100.0), bench.desk.teach(100.0)):
        assert isinstance(answer, Rejected) and 'has moved since' in answer.reason
    bench.desk.set_joints(START_RAD, 100.0, stamp_s=51.3)
    for stamp_s in np.arange(51.4, 52.4, 0.1):
        bench.desk.see(seen(START), 100.0, stamp_s)
    assert bench.desk.plan(100.0).ok


def test_joints_that_are_measured_with_noise_are_at_rest():
    bench = Bench()
    bench.desk.set_goal_pose(GOAL)
    for stamp_s in np.arange(50.0, 51.0, 0.1):
        noisy_rad = START_RAD + bench.rng.uniform(-5e-5, 5e-5, 6)
        bench.desk.set_joints(noisy_rad, 100.0, stamp_s)
        bench.desk.see(seen(START), 100.0, stamp_s - 0.03)
    assert bench.desk.plan(100.0).ok


def test_slow_motion_is_no_rest_however_often_joints_come():
    bench = Bench()
    bench.desk.set_goal_pose(GOAL)
    for stamp_s in np.arange(50.0, 51.0, 0.001):
        bench.desk.set_joints(START_RAD + 0.05 * (stamp_s - 51.0), 100.0, stamp_s)
        if round(1000.0 * stamp_s) % 100 == 0:
            bench.desk.see(seen(START), 100.0, stamp_s - 0.03)
    assert 'hold it still' in bench.desk.plan(100.0).reason


def test_a_clock_set_back_leaves_no_motion_in_the_future():
    bench = Bench()
    bench.desk.set_goal_pose(GOAL)
    bench.desk.set_joints(START_RAD + 0.1, 100.0, stamp_s=3650.0)
    bench.desk.set_joints(START_RAD, 100.0, stamp_s=3651.0)
    bench.desk.set_joints(START_RAD, 100.0, stamp_s=51.0)
    for stamp_s in (51.2, 51.4, 51.6):
        bench.desk.see(seen(START), 100.0, stamp_s)
    assert bench.desk.plan(100.0).ok


def test_what_the_tracker_says_of_its_corners_goes_into_the_pose():
    bench = Bench(corner_sigma_px=0.001)
    sure, unsure = (bench.desk.see(seen(START), 100.0, covariance_px2=sigma**2 * np.eye(8))
                    for sigma in (0.02, 0.2))
    ratio = (0.2**2 + 0.001**2) / (0.02**2 + 0.001**2)
    assert unsure.covariance == pytest.approx(ratio * sure.covariance, rel=1e-3)


def test_looks_that_are_known_better_weigh_more_in_an_average():
    bench = Bench(corner_sigma_px=0.001)
    bench.desk.set_joints(START_RAD, 100.0)
    for shift_px, sigma in ((0.5, 0.5), (0.0, 0.05), (0.5, 0.5)):
        bench.desk.see(seen(START) + shift_px, 100.0, covariance_px2=sigma**2 * np.eye(8))
    view = bench.desk._observer.still_view(100.0)
    assert view.looks == 3
    assert view.corners_px == pytest.approx(seen(START), abs=0.02)
