"""Laws of homographies: recovery, invariance, points off the plane, refusals."""

from geometry_cases import FACE_M
from geometry_cases import project
from geometry_cases import random_pose
from geometry_cases import seeds
from geometry_cases import SOLID_M
from homography_servo.geometry.decomposition import compose
from homography_servo.geometry.decomposition import parameters_from_pose
from homography_servo.geometry.homography import apply_homography
from homography_servo.geometry.homography import estimate_homography
from homography_servo.geometry.homography import home_image
from homography_servo.geometry.homography import point_homographies
from homography_servo.geometry.homography import transfer_error
from homography_servo.geometry.rigid import transform_points
from homography_servo.result import Rejected
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import numpy as np
import pytest

SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def random_homography(rng):
    return np.eye(3) + rng.uniform(-0.3, 0.3, (3, 3))


@given(seeds, st.integers(4, 30), st.floats(-3.0, 3.0))
@settings(max_examples=60, deadline=None)
def test_exact_points_give_their_homography_in_any_unit(seed, count, log_scale):
    rng = np.random.default_rng(seed)
    truth = random_homography(rng)
    src = np.vstack([SQUARE, rng.uniform(-1.0, 1.0, (count - 4, 2))])
    dst = apply_homography(truth, src)
    scale = 10.0**log_scale
    found = estimate_homography(src, scale * dst)
    assert transfer_error(found, src, scale * dst) == pytest.approx(0.0, abs=1e-9 * scale)
    expected = np.diag([scale, scale, 1.0]) @ truth
    assert found / found[2, 2] == pytest.approx(expected / expected[2, 2], rel=1e-7, abs=1e-7)
    assert abs(found[2, 2]) == pytest.approx(1.0)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_the_order_of_the_points_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    src = rng.uniform(-1.0, 1.0, (8, 2))
    dst = apply_homography(random_homography(rng), src) + 0.01 * rng.normal(size=(8, 2))
    order = rng.permutation(8)
    assert estimate_homography(src[order], dst[order]) == pytest.approx(
        estimate_homography(src, dst), abs=1e-8)


def test_weights_count_points_and_zero_leaves_them_out():
    rng = np.random.default_rng(3)
    src = rng.uniform(-1.0, 1.0, (9, 2))
    dst = apply_homography(random_homography(rng), src) + 0.01 * rng.normal(size=(9, 2))
    twice = estimate_homography(np.vstack([src, src[:1]]), np.vstack([dst, dst[:1]]))
    weighted = estimate_homography(src, dst, [2.0] + [1.0] * 8)
    assert weighted == pytest.approx(twice, abs=1e-9)
    assert np.abs(weighted - estimate_homography(src, dst)).max() > 1e-6
    spoilt = dst.copy()
    spoilt[4] += 100.0
    weights = np.where(np.arange(9) == 4, 0.0, 2.5)
    kept = np.arange(9) != 4
    assert estimate_homography(src, spoilt, weights) == pytest.approx(
        estimate_homography(src[kept], dst[kept]), abs=1e-9)


def test_mapped_points_have_positive_depth():
    mirrored = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, -1.0]])
    src = SQUARE + (5.0, 0.0)  # beyond the horizon of the origin
    found = estimate_homography(src, apply_homography(mirrored, src))
    assert (src @ found[2, :2] + found[2, 2] > 0.0).all()
    assert found[2, 2] == pytest.approx(-1.0)


@pytest.mark.parametrize('src, reason', [
    (SQUARE[:3], 'need 4 points, have 3'),
    (np.zeros((4, 2)), 'coincide'),
    (np.outer(np.arange(5.0), [1.0, 2.0]), 'line'),
    (np.vstack([SQUARE[:3], 0.5 * (SQUARE[0] + SQUARE[1])]), 'line'),
    (np.vstack([SQUARE[:3], SQUARE[:1]]), 'coincide'),
    (np.vstack([SQUARE[:3], [[np.nan, 0.0]]]), 'not finite'),
    (np.vstack([SQUARE[:3], [[np.inf, 0.0]]]), 'not finite'),
])
def test_points_that_fix_nothing_are_refused_with_the_reason(src, reason):
    dst = np.random.default_rng(1).uniform(-1.0, 1.0, src.shape)
    for result in (estimate_homography(src, dst), estimate_homography(dst, src)):
        assert isinstance(result, Rejected)
        assert reason in result.reason


def test_misuse_names_the_shape_expected():
    with pytest.raises(ValueError, match=r'src must have shape \(N, 2\), got \(4, 3\)'):
        estimate_homography(np.zeros((4, 3)), SQUARE)
    with pytest.raises(ValueError, match='must match'):
        estimate_homography(SQUARE, np.zeros((5, 2)))
    with pytest.raises(ValueError, match=r'weights must have shape \(4,\)'):
        estimate_homography(SQUARE, SQUARE, np.ones(3))
    with pytest.raises(ValueError, match='>= 0'):
        estimate_homography(SQUARE, SQUARE, -np.ones(4))
    with pytest.raises(ValueError, match=r'\(\.\.\., 3, 3\)'):
        apply_homography(np.eye(4), SQUARE)
    with pytest.raises(ValueError, match='before the camera'):
        point_homographies(np.eye(3), [[0.0, 0.0, -2.0]], 1.0)


def test_points_on_the_horizon_are_infinitely_far():
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.isinf(transfer_error(tilt, np.zeros((1, 2)), np.zeros((1, 2)))).all()


@pytest.mark.parametrize('points_m', [FACE_M, SOLID_M], ids=['flat', 'solid'])
def test_point_homographies_map_the_home_image_to_every_view(points_m):
    rng = np.random.default_rng(6)
    for _ in range(20):
        pose = random_pose(rng)
        homographies = point_homographies(compose(parameters_from_pose(pose, 0.9)), points_m, 0.9)
        home = np.column_stack([home_image(points_m, 0.9), np.ones(len(points_m))])
        mapped = (homographies @ home[..., None])[..., 0]
        camera_m = transform_points(pose, points_m) + (0.0, 0.0, 0.9)
        assert mapped[:, :2] / mapped[:, 2:] == pytest.approx(camera_m[:, :2] / camera_m[:, 2:])


def test_points_on_the_plane_share_the_homography_of_eq_15():
    pose = random_pose(np.random.default_rng(7))
    plane = compose(parameters_from_pose(pose))
    assert point_homographies(plane, FACE_M) == pytest.approx(np.stack([plane] * 4))


def test_a_view_in_pixels_gives_the_homography_between_pixels():
    pose = random_pose(np.random.default_rng(8))
    home_px, view_px = project(np.eye(4)), project(pose)
    found = estimate_homography(home_px, view_px)
    assert apply_homography(found, home_px) == pytest.approx(view_px, abs=1e-9)
