"""Poses in batches: the same answers as one by one, and the statistics they are for."""

from geometry_cases import BENT
from geometry_cases import FACE_M
from geometry_cases import PINHOLE
from geometry_cases import project
from geometry_cases import random_pose
from geometry_cases import SHAPES
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.pose_batch import estimate_poses
from homography_servo.geometry.pose_residuals import linearise
from homography_servo.geometry.pose_views import views_of
from homography_servo.geometry.rigid import pose_difference
from homography_servo.result import Rejected
import numpy as np
import pytest

NOISE_PX = 0.1


@pytest.mark.parametrize('camera', [PINHOLE, BENT], ids=['straight', 'bent'])
@pytest.mark.parametrize('shape', SHAPES)
def test_a_batch_gives_what_single_calls_give(camera, shape):
    rng = np.random.default_rng(31)
    points = SHAPES[shape]
    image = np.stack([project(random_pose(rng), points, camera) for _ in range(12)])
    image += 0.3 * rng.normal(size=image.shape)
    stack = estimate_poses(points, image, camera, 0.9, 0.09)
    for i in range(12):
        single = estimate_pose(points, image[i], camera, 0.9, 0.09)
        assert stack.minima[i] == len(single.candidates)
        assert stack.ambiguity[i] == pytest.approx(single.ambiguity, abs=1e-3)
        for k, candidate in enumerate(single.candidates):
            difference = pose_difference(stack.home_from_object[i, k],
                                         candidate.home_from_object)
            # Far below what the measurement tells: both stop there.
            assert difference @ np.linalg.solve(candidate.covariance, difference) < 1e-4 * max(
                candidate.chi2, 1.0)
            assert stack.chi2[i, k] == pytest.approx(candidate.chi2, rel=1e-3, abs=1e-6)
            assert stack.covariance[i, k] == pytest.approx(
                candidate.covariance, rel=0.02, abs=0.02 * np.abs(candidate.covariance).max())


def test_seen_from_the_front_a_single_call_leaves_out_walks_but_no_minimum():
    """A batch follows both starts to the end; a single view stops one that leads nowhere."""
    rng = np.random.default_rng(33)
    image = np.stack([project(random_pose(rng, tilt_deg=12.0)) for _ in range(300)])
    image += NOISE_PX * rng.normal(size=image.shape)
    stack = estimate_poses(FACE_M, image, PINHOLE, 0.9, NOISE_PX ** 2)
    assert 30 < (stack.minima == 2).sum() < 270
    found = 0
    for i, corners_px in enumerate(image):
        single = estimate_pose(FACE_M, corners_px, PINHOLE, 0.9, NOISE_PX ** 2)
        assert stack.chi2[i, 0] == pytest.approx(single.candidates[0].chi2, rel=1e-3, abs=1e-3)
        found += stack.minima[i] == len(single.candidates)
    assert found >= 299


def test_bad_images_are_marked_and_do_not_spoil_the_others():
    good = project(random_pose(np.random.default_rng(32)))
    image = np.stack([good, good[::-1], np.full((4, 2), np.nan), good[[0, 2, 1, 3]], good * 0.0])
    stack = estimate_poses(FACE_M, image, PINHOLE)
    assert (stack.minima > 0).tolist() == [True, False, False, False, False]
    assert np.isfinite(stack.home_from_object[0]).all()
    assert np.isnan(stack.home_from_object[1:]).all() and np.isnan(stack.ambiguity[1:]).all()
    nothing = estimate_poses(FACE_M, image[1:], PINHOLE)
    assert not nothing.minima.any()
    assert estimate_poses(FACE_M, image[:0], PINHOLE).minima.shape == (0,)


def test_what_is_wrong_for_every_image_is_refused_or_raised():
    image = np.zeros((2, 4, 2))
    assert 'need 4 points' in estimate_poses(FACE_M[:3], image[:, :3], PINHOLE).reason
    assert isinstance(estimate_poses(FACE_M * 0.0, image, PINHOLE), Rejected)
    assert 'positive definite' in estimate_poses(FACE_M, image, PINHOLE,
                                                 covariance_px2=-1.0).reason
    with pytest.raises(ValueError, match=r'\(M, N, 2\), got \(4, 2\)'):
        estimate_poses(FACE_M, image[0], PINHOLE)


@pytest.fixture(scope='module')
def sample():
    """Estimate 4000 poses tilted by 20 to 60 deg, wrong minima left out."""
    rng = np.random.default_rng(33)
    truth = []
    while len(truth) < 4000:
        pose = random_pose(rng)
        if pose[2, 2] < np.cos(np.radians(20.0)):
            truth.append(pose)
    truth = np.stack(truth)
    image = project(truth) + NOISE_PX * rng.normal(size=(len(truth), 4, 2))
    stack = estimate_poses(FACE_M, image, PINHOLE, covariance_px2=NOISE_PX**2)
    error = [pose_difference(stack.home_from_object[:, k], truth) for k in (0, 1)]
    turn = [np.linalg.norm(each[:, 3:], axis=1) for each in error]
    right = turn[0] <= turn[1]
    assert right.mean() > 0.99
    return truth[right], error[0][right], stack.covariance[right, 0]


def test_errors_reach_the_cramer_rao_bound(sample):
    truth, error, _ = sample
    views, _ = views_of(FACE_M, project(truth), PINHOLE, NOISE_PX**2)
    bound = np.linalg.inv(linearise(views, truth[:, :3, :3],
                                    truth[:, :3, 3] + (0.0, 0.0, 1.0)).normal)
    for part in (slice(0, 3), slice(3, 6)):
        over = np.sqrt((error[:, part]**2).sum() / np.trace(
            bound[:, part, part], axis1=1, axis2=2).sum())
        assert 0.95 < over < 1.05


def test_the_normalised_squared_error_averages_six(sample):
    _, error, covariance = sample
    whitened = np.linalg.solve(covariance, error[..., None])[..., 0]
    assert (whitened * error).sum(axis=1).mean() == pytest.approx(6.0, rel=0.05)
