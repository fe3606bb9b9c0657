"""The report says what happened, whatever happened."""

import json
import re

from homography_servo.experiments.report import print_summary
from homography_servo.experiments.report import shown_value
from homography_servo.experiments.report import summary
from homography_servo.experiments.report import write_report
from homography_servo.experiments.trial_data import face_seen_at
from homography_servo.experiments.trial_data import PlanRecord
from homography_servo.experiments.trial_data import PoseRecord
from homography_servo.experiments.trial_data import Snapshot
from homography_servo.experiments.trial_data import snapshot_indices
from homography_servo.experiments.trial_data import TrialData
from homography_servo.experiments.trial_data import true_error
from homography_servo.geometry.camera import Camera
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)


def made_trial(count: int = 31) -> TrialData:
    """Make the data of a trial that converged."""
    joints = np.linspace(0.0, 1.0, count)[:, None] * np.ones(6)
    corners = np.linspace(100.0, 300.0, count)[:, None, None] + np.array(
        [[0.0, 0.0], [100.0, 0.0], [100.0, 60.0], [0.0, 60.0]])
    plan = PlanRecord(np.tile(np.eye(4), (count, 1, 1)), corners, [f'j{i}' for i in range(6)],
                      joints, [{'name': 'path', 'message': 'good <all>', 'level': '0'},
                               {'name': 'pose 1', 'message': 'good', 'level': '0', 'm_px': '50'}])
    poses = [PoseRecord(k, 2, joints[k - 1].tolist(), 1e-4, 1e-3, True, 0.5 * k)
             for k in range(1, count + 1)]
    shots = [Snapshot(k, np.full((480, 640), 90, np.uint8), corners[k - 1], None)
             for k in snapshot_indices(count)]
    return TrialData(True, 'the object is at the goal', 'good', poses, plan, shots,
                     [(0.5 * k, k, 1e-4, 1e-3) for k in range(1, count + 1)],
                     plan.joint_names, [(0.0, joints[0].tolist())], corners[0],
                     {'lateral_m': 5e-4, 'depth_m': 1e-3, 'gamma_rad': 2e-3, 'tilt_rad': 0.01},
                     20.0, 12.0, 62, [(0.0, 'MOVING')])


def named(page: str) -> set[str]:
    """List the pictures that a page asks for."""
    return set(re.findall('src(?:set)?="([^"]*)"', page))


def test_the_page_shows_numbers_and_every_figure_it_names(tmp_path):
    page = write_report(made_trial(), tmp_path, CAMERA).read_text()
    figures = sorted(path.name for path in tmp_path.glob('*.png'))
    stems = ['figure_2_paths', 'figure_3_joints', 'figure_4_errors']
    assert figures == sorted(f'{stem}{end}.png' for stem in stems for end in ('', '_narrow'))
    assert named(page) == set(figures)
    assert 'converged' in page and '0.50 mm' in page and '31 of 31' in page
    assert 'Good &lt;all&gt;.' in page


def test_the_numbers_are_json_that_others_can_read(tmp_path):
    write_report(made_trial(), tmp_path, CAMERA)
    numbers = json.loads((tmp_path / 'trial.json').read_text())
    assert numbers['converged'] is True and len(numbers['poses']) == 31
    assert set(numbers['poses'][0]) >= {'index', 'iterations', 'joints_rad', 'position_error_m',
                                        'rotation_error_rad'}
    assert set(numbers['final_true_error']) == {'lateral_m', 'depth_m', 'gamma_rad', 'tilt_rad'}
    assert numbers['duration_s'] == 20.0 and numbers['motion_s'] == 12.0


@pytest.mark.parametrize('trial', [
    TrialData(verdict='no image'), TrialData(verdict='x', poses=made_trial().poses[:3]),
    TrialData(verdict='x', plan=made_trial().plan)], ids=['nothing', 'some poses', 'a plan'])
def test_an_incomplete_trial_has_a_report_too(trial, tmp_path, capsys):
    write_report(made_trial(), tmp_path, CAMERA)
    page = write_report(trial, tmp_path, None).read_text()
    print_summary(trial, tmp_path)
    assert f'did not converge: {trial.verdict}' in page
    assert capsys.readouterr().out.strip().splitlines()[-1] == summary(trial)
    assert {path.name for path in tmp_path.glob('*.png')} == named(page)


def test_colour_images_and_short_paths_can_be_drawn(tmp_path):
    trial = made_trial(2)
    for shot in trial.snapshots:
        shot.image = np.repeat(shot.image[:, :, None], 3, axis=2)
    write_report(trial, tmp_path, CAMERA)
    assert (tmp_path / 'figure_2_paths.png').stat().st_size > 1000


@pytest.mark.parametrize('count, wanted', [(31, [1, 14, 23, 31]), (2, [1, 2]), (1, [1])])
def test_the_poses_of_the_paper_are_shown(count, wanted):
    assert snapshot_indices(count) == wanted


def test_true_error_takes_a_displacement_apart():
    goal, final = np.eye(4), np.eye(4)
    goal[:3, :3] = Rotation.from_euler('z', 0.5).as_matrix()
    final[:3, :3] = Rotation.from_rotvec([0.03, 0.04, -0.1]).as_matrix() @ goal[:3, :3]
    final[:3, 3] = [0.003, -0.004, -0.01]
    error = true_error(goal, final)
    assert error == pytest.approx(
        {'lateral_m': 0.005, 'depth_m': 0.01, 'gamma_rad': 0.1, 'tilt_rad': 0.05})


def test_points_of_the_face_are_found_where_they_are_seen():
    points_m = np.array([[-0.05, -0.03, 0.0], [0.05, -0.03, 0.0], [0.02, 0.03, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler('xyz', [0.3, -0.2, 0.8]).as_matrix()
    pose[:3, 3] = [0.1, 0.02, -0.1]
    seen = CAMERA.project(points_m @ pose[:3, :3].T + pose[:3, 3] + (0.0, 0.0, 0.8))
    assert face_seen_at(pose, CAMERA.rays(seen), 0.8) == pytest.approx(points_m, abs=1e-12)


@pytest.mark.parametrize('key, value, shown', [
    ('border_px', '61.6709', '62'), ('ambiguity', '7.87549e-10', '0.00'), ('led', 'false', 'no'),
    ('joint_margin_rad', '0.523599', '30.0'), ('nearest_limit', 'joint2', 'joint2'),
    ('joint_margin_rad', 'unknown', 'unknown'), ('m_px', '50', '50'), ('border_px', '', '')])
def test_values_of_the_verdict_are_written_for_people(key, value, shown):
    assert shown_value(key, value) == shown
