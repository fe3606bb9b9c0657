"""Laws of paths: ends, both routes, turns, families, the number of poses."""

import time

from geometry_cases import FACE_M
from geometry_cases import PINHOLE
from geometry_cases import project
from geometry_cases import random_pose
from geometry_cases import seeds
from geometry_cases import SOLID_M
from homography_servo.geometry.decomposition import compose
from homography_servo.geometry.decomposition import decompose
from homography_servo.geometry.decomposition import DisplacementParameters
from homography_servo.geometry.decomposition import parameters_from_pose
from homography_servo.geometry.decomposition import pose_from_parameters
from homography_servo.geometry.homography import estimate_homography
from homography_servo.geometry.path import choose_count
from homography_servo.geometry.path import FAMILIES
from homography_servo.geometry.path import interpolate
from homography_servo.geometry.path import interpolate_image
from homography_servo.geometry.path import interpolate_parameters
from homography_servo.geometry.path import TURNS
from homography_servo.geometry.rigid import rotation_angle
from homography_servo.geometry.rigid import screw_between
from homography_servo.geometry.rigid import transform
from homography_servo.result import Rejected
from hypothesis import given
from hypothesis import settings
import numpy as np
import pytest


def pose_of(*values):
    return pose_from_parameters(DisplacementParameters(*values))


def gammas(poses):
    return np.unwrap(parameters_from_pose(poses).gamma)


def ends(seed):
    rng = np.random.default_rng(seed)
    return random_pose(rng), random_pose(rng)


@pytest.mark.parametrize('family', FAMILIES)
@pytest.mark.parametrize('turn', TURNS)
def test_a_path_begins_at_the_start_and_ends_at_the_goal(family, turn):
    for seed in range(20):
        start, goal = ends(seed)
        poses = interpolate(start, goal, 9, 0.95, family, turn)
        assert poses.shape == (9, 4, 4)
        assert poses[0] == pytest.approx(start, abs=1e-9)
        assert poses[-1] == pytest.approx(goal, abs=1e-9)
        rotations = poses[:, :3, :3]
        assert rotations @ rotations.swapaxes(1, 2) == pytest.approx(
            np.tile(np.eye(3), (9, 1, 1)), abs=1e-12)


@pytest.mark.parametrize('family', FAMILIES)
def test_a_path_back_is_the_path_reversed(family):
    for seed in range(10):
        start, goal = ends(seed)
        there = interpolate(start, goal, 7, family=family)
        back = interpolate(goal, start, 7, family=family)
        assert back[::-1] == pytest.approx(there, abs=1e-9)


@given(seeds)
@settings(max_examples=50, deadline=None)
@pytest.mark.parametrize('points_m', [FACE_M, SOLID_M], ids=['flat', 'solid'])
@pytest.mark.parametrize('turn', TURNS)
def test_the_path_in_space_projects_onto_the_path_in_the_image(points_m, turn, seed):
    start, goal = ends(seed)
    poses = interpolate(start, goal, 11, 0.95, turn=turn)
    seen_px = project(poses, points_m, home_depth_m=0.95)
    # The other route knows the images of the face only.
    parameters = [decompose(estimate_homography(
        FACE_M[:, :2] / 0.95, PINHOLE.rays(project(pose, home_depth_m=0.95))))
        for pose in (start, goal)]
    image = interpolate_image(*parameters, 11, points_m, 0.95, turn)
    ahead = np.isfinite(image)
    assert ahead.mean() > 0.5 and np.array_equal(ahead, np.isfinite(seen_px))
    assert PINHOLE.project_rays(image)[ahead] == pytest.approx(seen_px[ahead], abs=1e-8, rel=1e-11)


def test_all_six_parameters_are_linear_and_depth_follows_from_the_divergence():
    start, goal = ends(3)
    values = np.array(parameters_from_pose(interpolate(start, goal, 21, 1.3), 1.3))
    values[2] = np.unwrap(values[2])
    straight = values[:, :1] + np.linspace(0.0, 1.0, 21) * (values[:, -1:] - values[:, :1])
    assert values == pytest.approx(straight, abs=1e-9)
    depth = interpolate(start, goal, 21, 1.3)[:, 2, 3]
    assert np.abs(np.diff(depth, 2)).max() > 1e-6


@pytest.mark.parametrize('noise', [0.0, 1e-13, -1e-13])
@pytest.mark.parametrize('family', FAMILIES)
def test_half_a_turn_goes_in_the_positive_direction_whatever_the_round_off(noise, family):
    start = pose_of(0, 0, 0.4, 0.1, 0, 1.0)
    goal = pose_of(0, 0, 0.4 + np.pi + noise, -0.1, 0, 1.1)
    turned = gammas(interpolate(start, goal, 9, family=family))
    assert turned[-1] - turned[0] == pytest.approx(np.pi)
    negative = gammas(interpolate(start, goal, 9, family=family, turn='negative'))
    assert negative[-1] - negative[0] == pytest.approx(-np.pi)


@pytest.mark.parametrize('family', FAMILIES)
@pytest.mark.parametrize('turn, difference, expected', [
    ('shorter', 1.0, 1.0), ('shorter', -1.0, -1.0), ('shorter', 4.0, 4.0 - 2 * np.pi),
    ('positive', 1.0, 1.0), ('positive', -1.0, 2 * np.pi - 1.0), ('positive', 0.0, 0.0),
    ('negative', 1.0, 1.0 - 2 * np.pi), ('negative', -1.0, -1.0), ('negative', 1e-12, 0.0)])
def test_the_turn_goes_where_it_is_told(family, turn, difference, expected):
    start, goal = (pose_of(0, 0, 0.3 + each, 0, 0, 1.0) for each in (0.0, difference))
    turned = gammas(interpolate(start, goal, 33, family=family, turn=turn))
    assert turned[-1] - turned[0] == pytest.approx(expected, abs=1e-9)


def test_the_screw_family_advances_by_equal_screws():
    start, goal = ends(5)
    poses = interpolate(start, goal, 6, family='screw')
    steps = screw_between(poses[:-1], poses[1:])
    assert steps == pytest.approx(np.tile(screw_between(start, goal) / 5, (5, 1)), abs=1e-9)


def test_the_straight_family_moves_on_a_line_and_turns_evenly():
    start, goal = ends(6)
    poses = interpolate(start, goal, 6, family='straight')
    assert np.diff(poses[:, :3, 3], 2, axis=0) == pytest.approx(0.0, abs=1e-12)
    angles = rotation_angle(poses[1:, :3, :3] @ poses[:-1, :3, :3].swapaxes(1, 2))
    assert angles == pytest.approx(rotation_angle(goal[:3, :3] @ start[:3, :3].T) / 5)


def test_the_papers_path_is_a_screw_for_turns_about_the_optical_axis_only():
    def worst(start, goal):
        paths = [interpolate(start, goal, 9, family=family) for family in ('paper', 'screw')]
        return np.abs(paths[0][:, :3, :3] - paths[1][:, :3, :3]).max()
    assert worst(pose_of(0, 0, 0.2, 0, 0, 1.0), pose_of(0, 0, 1.2, 0, 0, 1.0)) < 1e-12
    assert worst(pose_of(0.5, -0.4, 0.2, 0, 0, 1.0), pose_of(-0.5, 0.4, 2.2, 0, 0, 1.0)) > 0.05


@pytest.mark.parametrize('family', FAMILIES)
@pytest.mark.parametrize('limits', [{'max_step_m': 0.01}, {'max_step_rad': 0.05},
                                    {'max_step_px': 4.0}, {'max_step_m': 0.02,
                                                           'max_step_px': 9.0}])
def test_the_chosen_count_is_the_smallest_that_keeps_the_steps(family, limits):
    for seed in range(4):
        start, goal = ends(seed)
        view = {'camera': PINHOLE, 'object_points_m': FACE_M}
        count = choose_count(start, goal, family=family, **limits, **view)

        def kept(number):
            poses = interpolate(start, goal, number, family=family)
            steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).max()
            steps_rad = rotation_angle(poses[1:, :3, :3]
                                       @ poses[:-1, :3, :3].swapaxes(1, 2)).max()
            steps_px = np.linalg.norm(np.diff(project(poses), axis=0), axis=2).max()
            return (steps_m <= limits.get('max_step_m', np.inf) * (1 + 1e-6)
                    and steps_rad <= limits.get('max_step_rad', np.inf) * (1 + 1e-6)
                    and steps_px <= limits.get('max_step_px', np.inf) * (1 + 1e-6))
        assert kept(count)
        assert count == 2 or not kept(count - 1)


def test_no_motion_needs_two_poses():
    pose = random_pose(np.random.default_rng(1))
    assert choose_count(pose, pose, max_step_m=0.01, max_step_rad=0.01) == 2
    for family in FAMILIES:
        assert interpolate(pose, pose, 2, family=family) == pytest.approx(np.stack([pose, pose]))


def test_a_thousand_poses_take_milliseconds():
    start, goal = ends(7)
    for family in FAMILIES:
        elapsed = []
        for _ in range(5):
            began_s = time.perf_counter()
            interpolate(start, goal, 1000, family=family)
            elapsed.append(time.perf_counter() - began_s)
        assert min(elapsed) < 0.01


def test_expected_misses_are_refused_with_the_reason():
    behind = transform(np.eye(3), [0.0, 0.0, -1.5])
    result = interpolate(np.eye(4), behind, 5)
    assert isinstance(result, Rejected) and 'focal plane' in result.reason
    assert isinstance(choose_count(np.eye(4), behind, max_step_m=0.1), Rejected)
    near = transform(np.eye(3), [0.0, 0.0, -0.999])
    assert isinstance(choose_count(np.eye(4), near, family='straight', max_step_px=1e-3,
                                   camera=PINHOLE, object_points_m=FACE_M), Rejected)


@pytest.mark.parametrize('change, reason', [
    ({'count': 1}, 'whole number >= 2'), ({'count': 2.5}, 'whole number'),
    ({'family': 'cubic'}, 'paper, screw, straight'), ({'turn': 'left'}, 'shorter, positive'),
    ({'start': np.eye(3)}, r'\(4, 4\), got \(3, 3\)'),
    ({'goal': np.full((4, 4), np.nan)}, 'rigid'),
    ({'goal': np.diag([1.0, 1.0, -1.0, 1.0])}, 'rigid'), ({'home_depth_m': 0.0}, 'home_depth_m')])
def test_misuse_names_what_was_expected(change, reason):
    arguments = {'start': np.eye(4), 'goal': np.eye(4), 'count': 3, **change}
    with pytest.raises(ValueError, match=reason):
        interpolate(**arguments)


def test_limits_and_parameters_are_checked():
    with pytest.raises(ValueError, match='at least one limit'):
        choose_count(np.eye(4), np.eye(4))
    with pytest.raises(ValueError, match='needs camera'):
        choose_count(np.eye(4), np.eye(4), max_step_px=1.0)
    with pytest.raises(ValueError, match='six finite'):
        interpolate_parameters((0, 0, 0, 0, 0, np.nan), (0, 0, 0, 0, 0, 1), 3)


def test_the_homographies_along_the_path_are_those_of_its_poses():
    start, goal = ends(9)
    along = interpolate_parameters(parameters_from_pose(start), parameters_from_pose(goal), 5)
    poses = interpolate(start, goal, 5)
    origin = poses[:, :3, 3] + (0.0, 0.0, 1.0)
    expected = np.concatenate([poses[:, :3, :2], origin[..., None]], axis=2)
    assert compose(along) == pytest.approx(expected, abs=1e-12)
