"""Laws of the six parameters: exact round trips, signs, refusals."""

import math

from geometry_cases import seeds
from homography_servo.geometry import decomposition
from homography_servo.geometry.decomposition import compose
from homography_servo.geometry.decomposition import decompose
from homography_servo.geometry.decomposition import decompose_paper
from homography_servo.geometry.decomposition import DisplacementParameters
from homography_servo.geometry.decomposition import parameters_from_pose
from homography_servo.geometry.decomposition import pose_from_parameters
from homography_servo.geometry.rigid import transform
from homography_servo.result import Rejected
from hypothesis import assume
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import numpy as np
import pytest

STEEP = np.radians(89.9)
tilts = st.floats(-STEEP, STEEP)
parameters = st.builds(DisplacementParameters, tilts, tilts, st.floats(-math.pi, math.pi),
                       st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.2, 5.0))


def off(found, expected):
    """Give the largest difference, angles compared around the circle."""
    difference = np.subtract(found, expected)
    difference[2] = (difference[2] + np.pi) % (2.0 * np.pi) - np.pi
    return np.abs(difference).max()


@given(parameters, st.floats(1e-3, 1e3))
@settings(max_examples=300, deadline=None)
def test_decompose_undoes_compose_at_any_scale(expected, scale):
    homography = compose(expected)
    assume(np.linalg.det(homography) > 1e-9)  # the face is turned to the camera
    assert off(decompose(scale * homography), expected) < 1e-12 * max(1.0, expected.divergence)


@pytest.mark.parametrize('alpha', [-STEEP, 0.0, STEEP])
@pytest.mark.parametrize('beta', [-STEEP, 0.0, STEEP])
@pytest.mark.parametrize('gamma', [-np.pi / 2, 0.0, 1.0, np.pi - 1e-9, np.pi])
def test_the_extremes_are_exact_to_1e_12(alpha, beta, gamma):
    expected = DisplacementParameters(alpha, beta, gamma, 0.0, 0.0, 0.8)
    assert np.abs(np.subtract(decompose(compose(expected)), expected)).max() < 1e-12


def test_half_a_turn_is_always_plus_180_degrees():
    for noise in (0.0, 1e-15, -1e-15):
        homography = np.diag([-1.0, -1.0, 1.0])
        homography[0, 1] += noise
        assert decompose(homography).gamma == pytest.approx(np.pi, abs=1e-12)
        pose = transform(homography, np.zeros(3))
        assert parameters_from_pose(pose).gamma == pytest.approx(np.pi, abs=1e-12)


@given(parameters, st.floats(0.1, 10.0))
@settings(max_examples=200, deadline=None)
def test_poses_and_parameters_are_the_same_thing(expected, home_depth_m):
    pose = pose_from_parameters(expected, home_depth_m)
    assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert pose[2, 3] == pytest.approx(home_depth_m * (1.0 / expected.divergence - 1.0))  # eq. 16
    assert off(parameters_from_pose(pose, home_depth_m), expected) < 1e-11
    # Eq. 15 from the pose itself, independent of `compose`.
    origin = pose[:3, 3] / home_depth_m + (0.0, 0.0, 1.0)
    assert compose(expected) == pytest.approx(np.column_stack([pose[:3, :2], origin]), abs=1e-12)


def test_the_rotation_is_rx_ry_rz_with_positive_turns():
    for axis in range(3):
        angles = np.zeros(3)
        angles[axis] = 0.3
        rotation = decomposition.rotation_from_angles(*angles)
        expected = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        expected[[i, j], [i, j]] = np.cos(0.3)
        expected[i, j], expected[j, i] = -np.sin(0.3), np.sin(0.3)
        assert rotation == pytest.approx(expected)
    a, b, c = (decomposition.rotation_from_angles(*row) for row in np.diag([0.4, -0.3, 1.2]))
    assert decomposition.rotation_from_angles(0.4, -0.3, 1.2) == pytest.approx(a @ b @ c)


@pytest.mark.parametrize('beta', [-np.pi / 2, np.pi / 2])
def test_locked_angles_still_give_the_rotation(beta):
    rotation = decomposition.rotation_from_angles(0.3, beta, 0.5)
    angles = decomposition.angles_from_rotation(rotation)
    assert angles[0] == 0.0
    assert decomposition.rotation_from_angles(*angles) == pytest.approx(rotation, abs=1e-12)


@given(seeds, st.floats(0.0, 0.03))
@settings(max_examples=100, deadline=None)
def test_with_noise_the_rotation_is_the_nearest_one(seed, noise):
    rng = np.random.default_rng(seed)
    exact = DisplacementParameters(*rng.uniform(-1.0, 1.0, 3), 0.1, -0.1, 0.9)
    noisy = compose(exact) + noise * rng.normal(size=(3, 3))
    found = decompose(noisy)
    u, s, vt = np.linalg.svd(noisy[:, :2], full_matrices=False)
    rotation = pose_from_parameters(found)[:3, :3]
    assert rotation[:, :2] == pytest.approx(u @ vt, abs=1e-12)
    assert found.divergence == pytest.approx(s.mean() / noisy[2, 2])


@given(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(-math.pi, math.pi))
@settings(max_examples=100, deadline=None)
def test_the_papers_equations_find_the_same_up_to_half_of_the_digits(alpha, beta, gamma):
    expected = DisplacementParameters(alpha, beta, gamma, 0.02, -0.03, 1.1)
    homography = compose(expected)
    assume(np.linalg.det(homography) > 0.01)
    assert off(decompose_paper(homography), expected) < 1e-6


def test_the_papers_equations_lose_half_of_the_digits_near_zero_and_fail_with_noise():
    homography = compose(DisplacementParameters(1e-9, 1e-9, 0.3, 0.0, 0.0, 1.0))
    errors = [max(abs(found.alpha - 1e-9), abs(found.beta - 1e-9))
              for found in (decompose(homography), decompose_paper(homography))]
    assert errors[0] < 1e-15 < 1e-10 < errors[1]
    noisy = np.diag([1.0, 0.99, 1.0])
    assert decompose(noisy)
    assert 'no solution' in decompose_paper(noisy).reason


FACING = compose(DisplacementParameters(0.3, -0.2, 1.0, 0.1, 0.05, 1.1))


@pytest.mark.parametrize('decomposer', [decompose, decompose_paper])
@pytest.mark.parametrize('homography, reason', [
    (FACING @ np.diag([1.0, -1.0, 1.0]), 'mirrored'),
    (-FACING, 'behind the focal plane'),
    (FACING * [[1.0], [1.0], [0.0]], 'behind the focal plane'),
    (compose(DisplacementParameters(0.1, 0.1, 0.1, 0.0, 0.0, -2.0)), 'behind the focal plane'),
    (compose(DisplacementParameters(0.1, 0.1, 0.1, 0.0, 0.0, np.inf)), 'behind the focal plane'),
    (np.zeros((3, 3)), 'zero'),
    (FACING @ np.diag([1.0, 0.0, 1.0]), 'degenerate'),
    (np.column_stack([FACING[:, 0], FACING[:, 0], FACING[:, 2]]), 'degenerate'),
    (FACING * np.nan, 'not finite'),
    (np.where(np.eye(3) == 1.0, np.inf, FACING), 'not finite'),
])
def test_what_shows_no_face_is_refused_with_the_reason(decomposer, homography, reason):
    result = decomposer(homography)
    assert isinstance(result, Rejected)
    assert reason in result.reason


@pytest.mark.parametrize('scale', [1e-300, 1e-100, 1e100, 1e300])
def test_extreme_scales_change_nothing(scale):
    assert decompose(scale * FACING) == pytest.approx(decompose(FACING))


def test_poses_at_the_focal_plane_are_refused():
    for z in (-1.0, -2.0, np.nan):
        assert isinstance(parameters_from_pose(transform(np.eye(3), [0.0, 0.0, z])), Rejected)


def test_stacks_agree_with_single_poses():
    rows = np.random.default_rng(2).uniform(-0.5, 0.5, (6, 7)) + [[0], [0], [0], [0], [0], [1.0]]
    stack = DisplacementParameters(*rows)
    poses = pose_from_parameters(stack, 0.9)
    back = parameters_from_pose(poses, 0.9)
    for i in range(7):
        single = DisplacementParameters(*rows[:, i])
        assert poses[i] == pytest.approx(pose_from_parameters(single, 0.9))
        assert compose(stack)[i] == pytest.approx(compose(single))
        assert [values[i] for values in back] == pytest.approx(list(single))


def test_misuse_names_what_was_expected():
    with pytest.raises(ValueError, match=r'\(3, 3\), got \(2, 2\)'):
        decompose(np.eye(2))
    with pytest.raises(ValueError, match='must not be 0'):
        compose(DisplacementParameters(0, 0, 0, 0, 0, 0.0))
    for function in (compose, pose_from_parameters):
        with pytest.raises(ValueError, match='got'):
            function(DisplacementParameters(np.nan, 0, 0, 0, 0, 1.0))
    with pytest.raises(ValueError, match='> 0'):
        pose_from_parameters(DisplacementParameters(0, 0, 0, 0, 0, -1.0))
    with pytest.raises(ValueError, match='home_depth_m'):
        parameters_from_pose(np.eye(4), 0.0)
