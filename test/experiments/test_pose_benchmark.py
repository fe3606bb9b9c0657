"""The pose benchmark measures what it says, on a few poses."""

from homography_servo.experiments.benchmarks import pose as suite
from homography_servo.experiments.benchmarks.pose_methods import methods
from homography_servo.geometry.rigid import pose_difference
import numpy as np
import pytest


@pytest.fixture(scope='module')
def sample():
    return suite.random_poses(np.random.default_rng(1), 40)


def test_the_sample_is_the_one_described(sample):
    poses, tilt_deg = sample
    corners_px = suite.CAMERA.project(
        suite.transform_points(poses, suite.FACE_M) + (0.0, 0.0, suite.HOME_DEPTH_M))
    depth_m = poses[:, 2, 3] + suite.HOME_DEPTH_M
    assert suite.CAMERA.contains(corners_px).all()
    assert ((0.7 <= depth_m) & (depth_m <= 1.3)).all()
    assert np.degrees(np.arccos(poses[:, 2, 2])) == pytest.approx(tilt_deg)
    assert tilt_deg.max() <= 60.0


def test_every_peer_finds_the_pose_of_exact_corners(sample):
    for name, method in methods(suite.FACE_M, suite.CAMERA).items():
        off = [np.abs(pose_difference(method(suite._corners(pose)), pose)).max()
               for pose in sample[0] if np.degrees(np.arccos(pose[2, 2])) > 15.0]
        assert np.median(off) < 1e-4, name


def test_the_mirror_image_counts_as_wrong_and_the_truth_does_not(sample):
    poses, tilt_deg = sample
    bound = suite.crlb(poses, 0.1)
    mirror = poses.copy()
    mirror[:, :3, :3] = suite.mirrored_rotation(
        poses[:, :3, :3], poses[:, :3, 3] + (0.0, 0.0, 1.0), suite.shape_of(suite.FACE_M))
    assert not suite.wrong_minimum(poses, poses, bound).any()
    assert suite.wrong_minimum(mirror, poses, bound)[tilt_deg > 25.0].all()


def test_rows_have_the_columns_that_are_promised(monkeypatch):
    draw = suite.random_poses
    monkeypatch.setattr(suite, 'random_poses', lambda rng, count: draw(rng, min(count, 30)))
    rows = suite.run(True, 3)
    ours = [row for row in rows if row['method'] == 'homography_servo']
    for noise in suite.NOISE_PX:
        row = next(row for row in ours if row['case'] == f'noise {noise} px')
        assert {'rotation_error_deg_median', 'translation_error_mm_p95', 'wrong_minimum_share',
                'rms_over_bound_rotation', 'rms_over_bound_translation', 'nees_mean',
                'time_us_median'} <= set(row)
        assert 0.3 < row['rms_over_bound_translation'] < 2.0
    cases = {row['case'] for row in ours}
    assert {'batch of 1000, each', 'six parameters of a homography'} < cases
    assert all(row['time_us_median'] > 0.0 for row in rows)
