"""What the servo benchmark is made of: laws, worlds, the search, outcomes."""

from dataclasses import replace

from homography_servo.experiments.benchmarks import servo as suite
from homography_servo.experiments.servo_classic import run_free
from homography_servo.experiments.servo_free import FreeWorld
from homography_servo.experiments.servo_free import run_free_pair
from homography_servo.experiments.servo_laws import interaction
from homography_servo.experiments.servo_laws import LAWS
from homography_servo.experiments.servo_outcome import lengths
from homography_servo.experiments.servo_outcome import Outcome
from homography_servo.experiments.servo_outcome import row
from homography_servo.experiments.servo_pairs import CAMERA
from homography_servo.experiments.servo_pairs import corners_px
from homography_servo.experiments.servo_pairs import Crowd
from homography_servo.experiments.servo_pairs import exact_world
from homography_servo.experiments.servo_pairs import free_poses
from homography_servo.experiments.servo_pairs import random_pairs
from homography_servo.experiments.servo_pairs import RobotPair
from homography_servo.experiments.servo_pairs import visible
from homography_servo.experiments.servo_pairs import wrong_world
from homography_servo.experiments.servo_runs import run_pair
from homography_servo.experiments.servo_scenarios import load_scenarios
from homography_servo.experiments.servo_scenarios import run_scenario
from homography_servo.geometry.face import face_corners
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import pose_difference
from homography_servo.places import find_config
from homography_servo.robot.robot_file import load_robot
import numpy as np
import pytest

ROBOT = load_robot(find_config('robix_rcs6.yaml'))
POINTS = face_corners(0.10, 0.06)
START = np.radians([-50.0, 40.0, 10.0, -10.0, 0.0, -20.0])
GOAL = np.radians([-5.0, 40.0, 10.0, -10.0, 0.0, -20.0])


def small_displacements(count=6):
    goals = free_poses(POINTS, count, 3)
    rng = np.random.default_rng(4)
    change = rng.normal(size=(count, 6)) * ([0.01] * 3 + [0.08] * 3)
    return displaced(goals, change), goals


def test_interaction_matrix_is_the_derivative_of_the_rays():
    poses = free_poses(POINTS, 4, 1)
    poses[:, 2, 3] += 1.0
    matrix = interaction(poses, POINTS)
    for axis, unit in enumerate(1e-6 * np.eye(6)):
        ends = [CAMERA.rays(corners_px(CAMERA, POINTS, displaced(poses, s * unit), 0.0))
                for s in (1.0, -1.0)]
        slope = (ends[0] - ends[1]).reshape(len(poses), -1) / 2e-6
        assert slope == pytest.approx(matrix[:, :, axis], abs=1e-6)


@pytest.mark.parametrize('name', sorted(LAWS))
def test_every_law_converges_from_nearby_with_perfect_sight(name):
    starts, goals = small_displacements()
    outcomes, _ = run_free(LAWS[name], CAMERA, POINTS, 1.0, starts, goals, 0.0, 0, 150)
    assert all(outcome.converged for outcome in outcomes)


def test_position_based_law_goes_straight_and_hybrid_straight_in_the_image():
    starts, goals = small_displacements()
    for name in ('pbvs', 'hybrid_2_5d'):
        _, trace = run_free(LAWS[name], CAMERA, POINTS, 1.0, starts, goals, 0.0, 0, 60)
        place = trace[:, :, :3, 3] + (0.0, 0.0, 1.0)
        line = place if name == 'pbvs' else place[..., :2] / place[..., 2:]
        way = line - line[0]
        across = way - way[-1] * ((way * way[-1]).sum(-1) / (way[-1] ** 2).sum(-1))[..., None]
        assert np.abs(across).max() < 2e-3 * np.abs(way[-1]).max()


@pytest.mark.parametrize('noise_px', (0.1, 1.0))
def test_free_body_settles_in_spite_of_noise(noise_px):
    poses = free_poses(POINTS, 6, 5)
    for index, (start, goal) in enumerate(zip(poses[:3], poses[3:])):
        world = FreeWorld(CAMERA, POINTS, 1.0, start, noise_px, index)
        outcome = run_free_pair(world, goal, 150)
        errors = pose_difference(np.array(world.trace[-50:]), goal[None].repeat(50, axis=0))
        rms = np.sqrt(np.square(errors).mean(axis=0))
        assert outcome.converged and rms[:3].max() < 0.005 and rms[3:].max() < 0.02


def test_wrong_world_is_wrong_and_in_view():
    pair = random_pairs(ROBOT, 1, 7)[0]
    world = wrong_world(ROBOT, pair)
    ends = world.arm.pose(np.array([pair.start_rad, pair.goal_rad]))
    assert visible(world.camera, ends, ROBOT.object_points_m, ROBOT.home_depth_m).all()
    away = pose_difference(ends, exact_world(ROBOT).arm.pose(
        np.array([pair.start_rad, pair.goal_rad])))
    assert np.linalg.norm(away[:, :3], axis=1).min() > 0.003
    assert world.camera.fx != CAMERA.fx


def test_a_crowd_sees_what_each_world_alone_would_see():
    pairs = random_pairs(ROBOT, 6, 7)
    worlds = [wrong_world(ROBOT, pair) for pair in pairs[:5]] + [exact_world(ROBOT)]
    crowd = Crowd(worlds)
    poses = crowd.pose(np.array([pair.start_rad for pair in pairs]))
    poses[1, 0, 3] += 0.3
    seen_px, inside = crowd.see(poses)
    for index, (world, pair) in enumerate(zip(worlds, pairs)):
        if index != 1:
            assert poses[index] == pytest.approx(world.arm.pose(pair.start_rad))
        alone_px = world.corners_px(poses[index])
        assert seen_px[index] == pytest.approx(alone_px)
        assert inside[index] == world.camera.contains(alone_px).all()
    assert inside.tolist() == [True, False, True, True, True, True]


def test_pair_is_planned_and_servoed_to_the_true_goal():
    pair = random_pairs(ROBOT, 1, 7)[0]
    outcome = run_pair(wrong_world(ROBOT, pair), pair, 0.1, lambda *_: False)
    assert outcome.converged, outcome.why
    assert not (outcome.left_image or outcome.limit_broken or outcome.jumped)


def test_a_veto_is_searched_for_in_the_world_as_it_is():
    pair = random_pairs(ROBOT, 1, 7)[0]
    world = wrong_world(ROBOT, pair)
    there = RobotPair(START, GOAL, 0)
    assert not suite._confirmed(world, there, nodes=200, seed=0)
    away = GOAL.copy()
    away[0] = ROBOT.upper_rad[0] - 0.01  # nearer to the limit than a plan may end
    assert suite._confirmed(world, replace(there, goal_rad=away), nodes=200, seed=0)


def test_lengths_compare_with_the_straight_way():
    corner = np.array([np.eye(4)] * 3)
    corner[1, 0, 3], corner[2, :2, 3] = 0.1, 0.1
    path, turn = lengths(corner)
    assert path == pytest.approx(np.sqrt(2.0)) and np.isnan(turn)


def test_row_counts_shares_and_takes_medians_of_what_converged():
    outcomes = [Outcome(True, iterations=10), Outcome(True, iterations=20),
                Outcome(False, left_image=True, iterations=500),
                Outcome(False, vetoed=True, confirmed=True)]
    result = row('homography_servo', 'a case', outcomes, robot=True)
    assert result['converged_share'] == 0.5 and result['left_image_share'] == 0.25
    assert result['iterations_median'] == 15.0
    assert result['vetoed_confirmed'] == 1 and result['failed'] == 1


@pytest.mark.parametrize('name', ['B4', 'C1', 'D2', 'D4'])
def test_hard_scenarios_converge_inside_the_image(name, shared_dir):
    scenarios = {s.name: s for s in load_scenarios(shared_dir / 'scenarios.yaml')}
    outcome = run_scenario(scenarios[name], 0.1, 1)
    assert outcome.converged and not outcome.left_image, outcome


def test_missing_scenarios_are_left_out(tmp_path):
    assert load_scenarios(tmp_path / 'none.yaml') == []
