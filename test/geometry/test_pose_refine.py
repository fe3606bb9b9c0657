"""The refinement's derivatives against finite differences, its minima against scipy."""

from geometry_cases import BENT
from geometry_cases import FACE_M
from geometry_cases import PINHOLE
from geometry_cases import project
from geometry_cases import random_pose
from geometry_cases import SOLID_M
from homography_servo.geometry.pose_curvature import curvature
from homography_servo.geometry.pose_refine import moved
from homography_servo.geometry.pose_refine import refine
from homography_servo.geometry.pose_residuals import linearise
from homography_servo.geometry.pose_residuals import residuals
from homography_servo.geometry.pose_views import views_of
from homography_servo.geometry.rigid import exp_twist
import numpy as np
import pytest
from scipy.optimize import least_squares


def covariance_of(kind, count, rng):
    if kind == 'blocks':
        return np.stack([np.diag(rng.uniform(0.1, 1.0, 2)) + 0.05 for _ in range(count)])
    factor = rng.normal(size=(2 * count, 2 * count))
    return {'one': None, 'scalar': 0.3, 'full': factor @ factor.T + np.eye(2 * count)}[kind]


@pytest.fixture(params=[(camera, points, kind) for camera in (PINHOLE, BENT)
                        for points in (FACE_M, SOLID_M)
                        for kind in ('one', 'scalar', 'blocks', 'full')],
                ids=lambda p: f'{"bent" if p[0].bends else "straight"}-{len(p[1])}-{p[2]}')
def problem(request):
    """Give five noisy views, and poses near the true ones."""
    camera, points, kind = request.param
    rng = np.random.default_rng(11)
    poses = np.stack([random_pose(rng) for _ in range(5)])
    image = project(poses, points, camera) + 3.0 * rng.normal(size=(5, len(points), 2))
    views, _ = views_of(points, image, camera, covariance_of(kind, len(points), rng))
    return views, poses[:, :3, :3].copy(), poses[:, :3, 3] + (0.0, 0.0, 1.0)


def steps(size):
    return [np.tile(row, (5, 1)) for row in size * np.eye(6)]


def test_rows_are_derivatives_of_the_errors(problem):
    views, *pose = problem
    rows = residuals(views, *pose)
    for axis, step in enumerate(steps(1e-6)):
        slope = (residuals(views, *moved(*pose, step))[:, 6]
                 - residuals(views, *moved(*pose, -step))[:, 6]) / 2e-6
        assert rows[:, axis] == pytest.approx(slope, rel=1e-6, abs=1e-6 * np.abs(slope).max())


def test_gradient_is_the_derivative_of_half_of_chi_squared(problem):
    views, *pose = problem
    state = linearise(views, *pose)
    for axis, step in enumerate(steps(1e-6)):
        slope = (linearise(views, *moved(*pose, step)).chi2
                 - linearise(views, *moved(*pose, -step)).chi2) / 4e-6
        assert state.gradient[:, axis] == pytest.approx(
            slope, rel=1e-5, abs=1e-6 * np.abs(state.gradient).max())


def test_normal_matrix_and_curvature_make_the_second_derivative(problem):
    views, *pose = problem
    state = linearise(views, *pose)
    hessian = state.normal + curvature(views, *pose, state.residual)
    size, scale = 1e-4, np.abs(state.normal).max()

    def half_chi2(step):
        return 0.5 * linearise(views, *moved(*pose, step)).chi2

    for i, a in enumerate(steps(size)):
        for j, b in enumerate(steps(size)):
            second = (half_chi2(a + b) - half_chi2(a - b) - half_chi2(b - a)
                      + half_chi2(-a - b)) / (4.0 * size**2)
            assert hessian[:, i, j] == pytest.approx(second, rel=1e-5, abs=1e-7 * scale)


def test_small_motions_agree_with_the_exponential_to_second_order():
    rng = np.random.default_rng(12)
    pose = random_pose(rng)
    for size in (1e-2, 1e-3):
        step = size * rng.normal(size=6)
        rotation, translation = moved(pose[None, :3, :3], pose[None, :3, 3], step[None])
        turn = exp_twist(np.concatenate([np.zeros(3), step[3:]]))[:3, :3]
        assert rotation[0] == pytest.approx(turn @ pose[:3, :3], abs=3.0 * size**3)
        assert rotation[0] @ rotation[0].T == pytest.approx(np.eye(3), abs=1e-13)
        assert translation[0] == pytest.approx(pose[:3, 3] + step[:3])


def test_where_it_ends_scipy_finds_nothing_better(problem):
    views, *pose = problem
    fit = refine(views, *pose)
    assert (fit.chi2 <= linearise(views, *pose).chi2 + 1e-9).all()
    for i in range(5):
        one = views.take(np.array([i]))
        end = fit.rotation[i:i + 1], fit.translation_m[i:i + 1]
        theirs = least_squares(
            lambda step: residuals(one, *moved(*end, step[None]))[0, 6], np.zeros(6),
            x_scale='jac', xtol=1e-12, ftol=1e-12, gtol=1e-12)
        assert fit.chi2[i] == pytest.approx(2.0 * theirs.cost, rel=1e-4)
        distance2 = theirs.x @ fit.normal[i] @ theirs.x
        assert distance2 < 1e-3 * max(fit.chi2[i], 1.0)


def test_few_and_many_poses_take_the_same_path(problem):
    views, *pose = problem
    together = refine(views, *pose)
    for i in range(5):
        alone = refine(views.take(np.array([i])), *(part[i:i + 1] for part in pose))
        turn = together.rotation[i] @ alone.rotation[0].T
        difference = np.array([*(together.translation_m[i] - alone.translation_m[0]),
                               turn[2, 1], turn[0, 2], turn[1, 0]])
        assert difference @ alone.normal[0] @ difference < 1e-4 * max(alone.chi2[0], 1.0)
        assert alone.chi2[0] == pytest.approx(together.chi2[i], rel=1e-4)


def test_a_start_behind_the_camera_is_not_a_fit():
    views, _ = views_of(FACE_M, project(np.eye(4))[None], PINHOLE, None)
    fit = refine(views, np.eye(3)[None], np.array([[0.0, 0.0, -1.0]]))
    assert not np.isfinite(fit.chi2[0])
