"""Laws of the pose: recovery, both minima, covariance, invariance, prior, refusals."""

import cv2
from geometry_cases import BENT
from geometry_cases import FACE_M
from geometry_cases import PINHOLE
from geometry_cases import project
from geometry_cases import random_pose
from geometry_cases import seeds
from geometry_cases import SHAPES
from geometry_cases import SOLID_M
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.pose import Prior
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import pose_difference
from homography_servo.geometry.rigid import rotation_angle
from homography_servo.geometry.rigid import transform_points
from homography_servo.result import Rejected
from hypothesis import given
from hypothesis import settings
import numpy as np
import pytest

CORNERS_PX = project(random_pose(np.random.default_rng(20)))


def noisy_view(seed, noise_px=0.3, points_m=FACE_M, camera=PINHOLE):
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    image = project(pose, points_m, camera)
    return pose, image + noise_px * rng.normal(size=image.shape)


@pytest.mark.parametrize('camera', [PINHOLE, BENT], ids=['straight', 'bent'])
@pytest.mark.parametrize('shape', SHAPES)
@pytest.mark.parametrize('home_depth_m', [1.0, 0.95])
def test_exact_points_give_the_exact_pose(camera, shape, home_depth_m):
    rng = np.random.default_rng(21)
    for _ in range(15):
        pose = random_pose(rng, 75.0)
        image = project(pose, SHAPES[shape], camera, home_depth_m)
        found = estimate_pose(SHAPES[shape], image, camera, home_depth_m, prior=Prior(
            pose, 0.01 * np.eye(6)))
        assert np.abs(found.home_from_object - pose).max() < 1e-6
        assert found.candidates[0].residual_px < 1e-6


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_order_of_the_points_does_not_matter(seed):
    _, image = noisy_view(seed)
    order = np.random.default_rng(seed).permutation(4)
    one, other = (estimate_pose(FACE_M[i], image[i], PINHOLE) for i in (np.arange(4), order))
    assert other.home_from_object == pytest.approx(one.home_from_object, abs=1e-4)
    assert other.candidates[0].chi2 == pytest.approx(one.candidates[0].chi2, rel=1e-4, abs=1e-9)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_scale_of_image_and_world_does_not_matter(seed):
    _, image = noisy_view(seed)
    finer = Camera(1600.0, 1580.0, 639.0, 479.0, 1280, 960)
    one = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.09)
    scaled = estimate_pose(3.0 * FACE_M, 2.0 * image, finer, 3.0, covariance_px2=0.36)
    assert scaled.home_from_object[:3, 3] == pytest.approx(3.0 * one.home_from_object[:3, 3],
                                                           abs=1e-6)
    units = np.repeat([3.0, 1.0], 3)
    # In units of the deviations, for what is nearly uncorrelated may be any small number.
    deviations = np.sqrt(np.outer(one.covariance.diagonal(), one.covariance.diagonal()))
    assert scaled.covariance / np.outer(units, units) / deviations == pytest.approx(
        one.covariance / deviations, abs=1e-4)
    assert scaled.ambiguity == pytest.approx(one.ambiguity, abs=1e-4)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_every_candidate_is_a_minimum(seed):
    _, image = noisy_view(seed)
    estimate = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.09)
    rng = np.random.default_rng(seed)
    for candidate in estimate.candidates:
        def chi2(pose):
            return np.square(project(pose) - image).sum() / 0.09
        assert candidate.chi2 == pytest.approx(chi2(candidate.home_from_object), rel=1e-3,
                                               abs=1e-6)
        spread = np.linalg.cholesky(candidate.covariance)
        for _ in range(10):
            step = 0.1 * spread @ rng.normal(size=6)
            around = chi2(displaced(candidate.home_from_object, step))
            assert around > candidate.chi2 * (1.0 - 1e-4) - 1e-3


def test_both_minima_are_found_where_a_search_finds_two():
    rng = np.random.default_rng(22)
    missed = 0
    for _ in range(40):
        pose = random_pose(rng)
        image = project(pose) + 0.2 * rng.normal(size=(4, 2))
        found = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.04)
        known = [each.home_from_object for each in found.candidates]
        others = searched_minima(image, pose, rng)
        missed += sum(all(far_apart(each, own) for own in known) for each in others)
    assert missed == 0


def searched_minima(image, pose, rng):
    """Find minima by many starts and scipy's own minimiser: slow, and independent."""
    from scipy.optimize import least_squares
    minima = []
    for _ in range(12):
        start = displaced(pose, np.concatenate([np.zeros(3), rng.normal(scale=0.7, size=3)]))
        found = least_squares(lambda d: (project_or_far(displaced(start, d)) - image).ravel(),
                              np.zeros(6), x_scale=np.repeat([0.1, 1.0], 3), xtol=1e-10)
        minimum = displaced(start, found.x)
        faces = minimum[:3, 2] @ (minimum[:3, 3] + (0.0, 0.0, 1.0)) > 0.0
        small = np.abs(found.grad).max() < 1e-2 and np.sqrt(found.cost) < 30.0
        if faces and small and all(far_apart(minimum, each) for each in minima):
            minima.append(minimum)
    return minima


def project_or_far(pose):
    points = transform_points(pose, FACE_M) + (0.0, 0.0, 1.0)
    return 800.0 * points[:, :2] / np.maximum(points[:, 2:], 0.05) * (1.0, 790.0 / 800.0) \
        + (319.5, 239.5)


def far_apart(a, b):
    return rotation_angle(a[:3, :3].T @ b[:3, :3]) > np.radians(2.0)


def test_covariance_is_honest():
    squared = []
    for seed in range(400):
        pose, image = noisy_view(seed, 0.1)
        found = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.01,
                              prior=Prior(pose, np.diag(np.repeat([0.02, 0.1], 3)**2)))
        difference = pose_difference(found.home_from_object, pose)
        if rotation_angle(pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])) < np.pi:
            squared.append(difference @ np.linalg.solve(found.covariance, difference))
    # 400 values of a chi squared of 6: median 5.35 +- 0.2.
    assert np.median(squared) == pytest.approx(5.35, abs=0.7)


@pytest.mark.parametrize('camera', [PINHOLE, BENT], ids=['straight', 'bent'])
def test_the_three_ways_to_give_a_covariance_agree(camera):
    _, image = noisy_view(5, camera=camera)
    found = [estimate_pose(FACE_M, image, camera, covariance_px2=each) for each in (
        0.09, np.tile(0.09 * np.eye(2), (4, 1, 1)), 0.09 * np.eye(8))]
    for other in found[1:]:
        assert other.home_from_object == pytest.approx(found[0].home_from_object, abs=1e-9)
        assert other.covariance == pytest.approx(found[0].covariance, rel=1e-6)
        assert other.candidates[0].chi2 == pytest.approx(found[0].candidates[0].chi2)
    assert found[0].covariance == pytest.approx(0.09 * estimate_pose(
        FACE_M, image, camera).covariance, rel=1e-4)


def test_a_full_covariance_is_ordered_point_by_point():
    pose, image = noisy_view(6, 0.0)
    points = SHAPES['grid']
    image = project(pose, points)
    image[2] += (6.0, -4.0)
    uncertain = np.tile(0.01 * np.eye(2), (len(points), 1, 1))
    uncertain[2] = [[900.0, 100.0], [100.0, 400.0]]
    full = np.zeros((2 * len(points),) * 2)
    for i, block in enumerate(uncertain):
        full[2 * i:2 * i + 2, 2 * i:2 * i + 2] = block
    by_block, by_all = (estimate_pose(points, image, PINHOLE, covariance_px2=each, prior=Prior(
        pose, 0.01 * np.eye(6))) for each in (uncertain, full))
    assert by_all.home_from_object == pytest.approx(by_block.home_from_object, abs=1e-6)
    assert np.abs(by_block.home_from_object - pose).max() < 1e-4  # the bad point has no say


def test_a_prior_decides_between_the_minima_and_does_not_pull():
    wrong = decided = 0
    for seed in range(60):
        pose, image = noisy_view(seed, 1.0)
        free = estimate_pose(FACE_M, image, PINHOLE)
        if len(free.candidates) < 2 or free.ambiguity < 0.1:
            continue
        decided += 1
        for target in free.candidates:
            prior = Prior(exp_twist([0, 0, 0, 0.05, -0.05, 0.05]) @ target.home_from_object,
                          np.diag(np.repeat([0.05, 0.1], 3)**2))
            found = estimate_pose(FACE_M, image, PINHOLE, prior=prior)
            wrong += found.home_from_object is not None and not np.array_equal(
                found.home_from_object, target.home_from_object)
    assert decided > 10
    assert wrong == 0


def test_ambiguity_tells_a_toss_up_from_certainty():
    steep = estimate_pose(FACE_M, project(exp_twist([0, 0, 0, 0.8, 0, 0])), PINHOLE,
                          covariance_px2=0.0025)
    distant = exp_twist([0, 0, 5.0, 0.5, 0, 0])
    far = estimate_pose(FACE_M, project(distant), PINHOLE, covariance_px2=1.0)
    assert steep.ambiguity < 1e-6
    assert far.ambiguity > 0.9 and len(far.candidates) == 2
    assert not far_apart(far.home_from_object, distant) or not far_apart(
        far.candidates[1].home_from_object, distant)


def test_covariance_is_symmetric_and_positive():
    for seed in range(20):
        _, image = noisy_view(seed)
        for candidate in estimate_pose(FACE_M, image, PINHOLE).candidates:
            assert np.array_equal(candidate.covariance, candidate.covariance.T)
            assert np.linalg.eigvalsh(candidate.covariance).min() > 0.0
            assert candidate.home_from_object[3].tolist() == [0, 0, 0, 1]


REFUSALS = {
    'need 4 points': (FACE_M[:3], CORNERS_PX[:3], {}),
    'image is not finite': (FACE_M, np.where(np.eye(4)[:, :2] == 1, np.nan, CORNERS_PX), {}),
    'coincide or lie on one line': (FACE_M, np.outer(np.arange(4.0), [30.0, 20.0]), {}),
    'image coincide': (FACE_M, np.tile(CORNERS_PX[:1], (4, 1)), {}),
    'image coincide ': (FACE_M, CORNERS_PX[[0, 1, 2, 2]], {}),
    'not in the order': (FACE_M, CORNERS_PX[[0, 2, 1, 3]], {}),
    'mirrored': (FACE_M, CORNERS_PX[::-1], {}),
    'object is not finite': (FACE_M + np.nan, CORNERS_PX, {}),
    'object lie on one line': (FACE_M * (1, 0, 0), CORNERS_PX, {}),
    'object coincide': (FACE_M * 0, CORNERS_PX, {}),
    'object lie on one': (np.outer(np.arange(5.0), [1, 2, 3]), np.tile(CORNERS_PX[0], (5, 1)), {}),
    'three of the four': (np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0.0]]), CORNERS_PX,
                          {}),
    'not positive definite': (FACE_M, CORNERS_PX, {'covariance_px2': -1.0}),
    'positive definite': (FACE_M, CORNERS_PX, {'covariance_px2': np.zeros((8, 8))}),
    'points is not finite': (FACE_M, CORNERS_PX, {'covariance_px2': np.full((4, 2, 2), np.nan)}),
    'prior is not finite': (FACE_M, CORNERS_PX,
                            {'prior': Prior(np.full((4, 4), np.nan), np.eye(6))}),
    'prior is not positive': (FACE_M, CORNERS_PX, {'prior': Prior(np.eye(4), -9.0 * np.eye(6))}),
}


@pytest.mark.parametrize('reason', REFUSALS)
def test_what_gives_no_pose_is_refused_with_the_reason(reason):
    points, image, extra = REFUSALS[reason]
    result = estimate_pose(points, image, PINHOLE, **extra)
    assert isinstance(result, Rejected)
    assert reason.strip() in result.reason


def test_pixels_that_no_ray_reaches_are_refused():
    barrel = Camera(400.0, 400.0, 320.0, 240.0, 640, 480, 'plumb_bob', (-0.4, 0.0, 0.0, 0.0, 0.0))
    result = estimate_pose(FACE_M, CORNERS_PX * 10.0, barrel)
    assert isinstance(result, Rejected) and 'lens' in result.reason


@given(seeds)
@settings(max_examples=100, deadline=None)
def test_nonsense_never_gives_a_number_that_is_not_finite(seed):
    rng = np.random.default_rng(seed)
    image = 10.0**rng.uniform(-3, 12) * rng.normal(size=(4, 2)) + rng.uniform(-1e3, 1e3, 2)
    points = (FACE_M, SOLID_M[[0, 1, 2, 7]])[seed % 2]
    for camera in (PINHOLE, BENT):
        result = estimate_pose(points, image, camera)
        if result:
            for candidate in result.candidates:
                assert np.isfinite(candidate.home_from_object).all()
                assert np.isfinite(candidate.covariance).all()
                assert np.isfinite([candidate.chi2, candidate.residual_px]).all()
            assert 0.0 <= result.ambiguity <= 1.0


def test_misuse_names_the_shape_expected():
    with pytest.raises(ValueError, match=r'object_points_m must have shape \(N, 3\)'):
        estimate_pose(FACE_M[:, :2], CORNERS_PX, PINHOLE)
    with pytest.raises(ValueError, match=r'\(4, 2\) to match the object, got \(5, 2\)'):
        estimate_pose(FACE_M, np.zeros((5, 2)), PINHOLE)
    with pytest.raises(ValueError, match=r'\(4, 2, 2\) or \(8, 8\), got \(3, 3\)'):
        estimate_pose(FACE_M, CORNERS_PX, PINHOLE, covariance_px2=np.eye(3))
    with pytest.raises(ValueError, match='home_depth_m'):
        estimate_pose(FACE_M, CORNERS_PX, PINHOLE, home_depth_m=-1.0)
    with pytest.raises(ValueError, match=r'covariance of a prior must have shape \(6, 6\)'):
        Prior(np.eye(4), np.eye(3))


def on_the_way(noise_px=0.1, steps=60):
    """See the face turn from a tilt of 40 degrees through the frontal view to the other side."""
    rng = np.random.default_rng(31)
    for angle_rad in np.radians(np.linspace(-40.0, 40.0, steps)):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array([0.3 * angle_rad, angle_rad, 0.1]))[0]
        yield project(pose) + noise_px * rng.normal(size=(4, 2))


def test_minima_of_the_view_before_lead_to_those_of_this_one():
    near, numbers = (), []
    for image in on_the_way():
        whole = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.01)
        found = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.01, near=near)
        near = whole.candidates
        numbers.append(len(near))
        # A minimum that is born on the way may be missed; the best one is not.
        assert len(found.candidates) <= len(near)
        difference = pose_difference(found.home_from_object, whole.home_from_object)
        assert difference @ np.linalg.solve(whole.covariance, difference) < 0.01
        assert found.candidates[0].chi2 == pytest.approx(near[0].chi2, rel=1e-3, abs=1e-3)
    assert set(numbers) == {1, 2}


def test_minima_that_explain_nothing_are_left_for_a_search():
    image = next(on_the_way())
    both = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.01)
    assert both.candidates[1].chi2 > 30.0
    found = estimate_pose(FACE_M, image, PINHOLE, covariance_px2=0.01,
                          near=both.candidates[1:])  # the mirror alone
    assert found.home_from_object == pytest.approx(both.home_from_object, abs=1e-6)
    assert len(found.candidates) == 2
