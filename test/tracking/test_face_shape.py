"""The angle and the ratio of a face's sides: their view, their slopes, their memory."""

import math

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.face import face_corners
from homography_servo.result import Rejected
from homography_servo.tracking.face_pose import pose_of_face
from homography_servo.tracking.face_shape import angle_and_ratio
from homography_servo.tracking.face_shape import FaceShape
from homography_servo.tracking.face_shape import LEAST_SIGMA_PX
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import SnakeFit
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

SIZE_M = (0.1, 0.06)
PLANE = Plane(Camera(800.0, 780.0, 319.5, 239.5, 640, 480))
NOISE_PX = 0.08


def view(angles, size_m=SIZE_M, place_m=(0.02, -0.05, 0.7)):
    """Give the rays of a rectangle's corners."""
    turn = Rotation.from_euler('xyz', angles, degrees=True).as_matrix()
    points_m = face_corners(*size_m) @ turn.T + place_m
    return points_m[:, :2] / points_m[:, 2:]


def fitted(prior, measured):
    """Give the best corners where prior and a measurement with noise are all there is."""
    own = np.eye(8) / NOISE_PX ** 2
    information = own + prior.information
    covariance = np.linalg.inv(information)
    corners = covariance @ (own @ measured.ravel() + prior.information @ prior.corners.ravel())
    return SnakeFit(corners.reshape(4, 2), covariance, information, None, None, None, None, 0.0)


@pytest.mark.parametrize('angles', [(0, 0, 0), (30, -20, 70), (-50, 10, 200), (5, 60, -130)])
def test_any_view_of_a_rectangle_has_its_angle_and_ratio(angles):
    cosine, ratio, *_ = angle_and_ratio(view(angles))
    assert (cosine, ratio) == pytest.approx((0.0, math.log(SIZE_M[0] / SIZE_M[1])), abs=1e-9)


def test_slopes_are_those_of_finite_differences():
    rays = view((25, -35, 40)) + np.random.default_rng(3).normal(0.0, 0.002, (4, 2))
    slopes, step = np.array(angle_and_ratio(rays)[2:]), 1e-6
    for column, move in enumerate(step * np.eye(8).reshape(8, 4, 2)):
        high, low = (np.array(angle_and_ratio(rays + sign * move)[:2]) for sign in (1, -1))
        assert slopes[:, column] == pytest.approx((high - low) / (2.0 * step), rel=1e-5, abs=1e-5)


@pytest.mark.parametrize('rays', [np.zeros((4, 2)), np.arange(8.0).reshape(4, 2),
                                  view((0, 0, 0))[::-1]])
def test_corners_on_a_line_or_turned_over_have_none(rays):
    assert isinstance(angle_and_ratio(rays), Rejected)
    assert FaceShape(SIZE_M, PLANE).prior(PLANE.from_rays(rays)) is None


def test_without_a_camera_every_shape_will_do():
    assert FaceShape(SIZE_M, Plane(None)).prior(PLANE.from_rays(view((0, 0, 0)))) is None


def test_prior_holds_the_shape_and_leaves_the_pose_free():
    true = PLANE.from_rays(view((20, -15, 30)))
    near = PLANE.from_rays(view((20.1, -15.1, 30.1), place_m=(0.0201, -0.0501, 0.7003)))
    prior = FaceShape(SIZE_M, PLANE).prior(true)
    assert prior.corners == pytest.approx(true, abs=1e-9)
    moved = (near - true).ravel()
    assert np.linalg.matrix_rank(prior.information, 1e-6) == 2
    shape_px = math.sqrt(moved @ prior.information @ moved / np.abs(prior.information).max())
    assert shape_px < 0.01 * np.linalg.norm(moved)


def test_corners_miss_the_shape_by_what_they_miss_a_view_of_the_face():
    rng, shape = np.random.default_rng(4), FaceShape(SIZE_M, PLANE)
    points_m = face_corners(*SIZE_M)
    assert shape.miss_px(PLANE.from_rays(view((0, 0, 0)))) == math.inf  # nobody has asked
    for angles in ((20, -15, 30), (-40, 25, 110)):
        expected = PLANE.from_rays(view(angles))
        shape.prior(expected)
        for corners in expected + rng.normal(0.0, 0.3, (5, 4, 2)):
            pose = pose_of_face(points_m, PLANE.rays(corners))
            missed_px = float(PLANE.rms_px(pose.miss))
            assert shape.miss_px(corners) == pytest.approx(missed_px, rel=0.1, abs=0.01)
    assert shape.miss_px(expected) < 1e-6


@pytest.mark.parametrize('error_m', [0.0, 0.002])
def test_wrong_size_is_learnt_and_then_helps(error_m):
    rng, shape, misses = np.random.default_rng(5), FaceShape(SIZE_M, PLANE), []
    for index in range(200):
        angles = (15.0 * math.sin(0.05 * index), 15.0 * math.cos(0.04 * index), 0.5 * index)
        true = PLANE.from_rays(view(angles, (SIZE_M[0] + error_m, SIZE_M[1])))
        fit = fitted(shape.prior(true + rng.normal(0.0, 0.2, (4, 2))),
                     true + rng.normal(0.0, NOISE_PX, (4, 2)))
        shape.learn(fit)
        misses.append(fit.corners - true)
    rms_px = np.sqrt(np.mean(np.square(misses[100:])))
    assert rms_px < 0.95 * NOISE_PX  # six unknowns instead of eight make 0.87


def test_a_shape_that_does_not_stay_is_not_believed():
    rng, shape, misses = np.random.default_rng(6), FaceShape(SIZE_M, PLANE), []
    for _ in range(200):
        true = PLANE.from_rays(view((10, 20, 0))) + rng.normal(0.0, 0.5, (4, 2))
        fit = fitted(shape.prior(true), true + rng.normal(0.0, NOISE_PX, (4, 2)))
        shape.learn(fit)
        misses.append(fit.corners - true)
    assert np.sqrt(np.mean(np.square(misses[100:]))) < 1.1 * NOISE_PX
    assert LEAST_SIGMA_PX < 0.1  # else the case above would be no contradiction


def test_forgetting_begins_with_the_known_size_again():
    true, shape = PLANE.from_rays(view((10, 20, 0), (0.105, 0.06))), FaceShape(SIZE_M, PLANE)
    first = shape.prior(true)
    for _ in range(20):
        shape.learn(fitted(shape.prior(true), true))
    assert np.abs(shape.prior(true).corners - true).max() \
        < 0.1 * np.abs(first.corners - true).max()
    shape.forget()
    assert shape.prior(true).corners == pytest.approx(first.corners)
