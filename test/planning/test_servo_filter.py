"""Averaging of looks: derivatives, honest covariance, immunity to the mirror."""

from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import exp_twist
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.arm_model import FreeBody
from homography_servo.planning.control import displacement
from homography_servo.planning.look_filter import look_from_pose
from homography_servo.planning.look_filter import LookFilter
from homography_servo.planning.look_filter import rays_of
from homography_servo.result import Rejected
import numpy as np
import pytest
from servo_setup import camera
from servo_setup import FOCAL_PX
from servo_setup import GOAL_RAD
from servo_setup import ROBOT
from servo_setup import START_RAD
from servo_setup import wrong_arm

POINTS, DEPTH = ROBOT.object_points_m, ROBOT.home_depth_m


def look_at(measured):
    return look_from_pose(*measured, POINTS, DEPTH)


def way(count):
    return np.linspace(START_RAD, GOAL_RAD, count)


def test_rays_change_as_their_jacobian_says():
    pose = displaced(np.eye(4), np.array([0.1, -0.05, -0.2, 0.3, -0.4, 0.5]))
    rays, jacobian = rays_of(pose, POINTS, DEPTH)
    for axis, unit in enumerate(1e-6 * np.eye(6)):
        ahead, _ = rays_of(displaced(pose, unit), POINTS, DEPTH)
        behind, _ = rays_of(displaced(pose, -unit), POINTS, DEPTH)
        assert (ahead - behind) / 2e-6 == pytest.approx(jacobian[:, axis], abs=1e-8)


@pytest.mark.parametrize('model, setpoint', [
    (wrong_arm(3), START_RAD),
    (FreeBody(displaced(np.eye(4), np.full(6, 0.1))), displaced(np.eye(4), np.full(6, 0.2))),
], ids=['arm', 'free'])
def test_pose_changes_with_the_errors_as_the_sensitivity_says(model, setpoint):
    _, sensitivity = model.expect(setpoint)
    for axis, unit in enumerate(1e-6 * np.eye(sensitivity.shape[1])):
        change = displacement(model.moved(-unit).pose(setpoint), model.moved(unit).pose(setpoint))
        assert change / 2e-6 == pytest.approx(sensitivity[:, axis], abs=1e-6)


def test_a_look_carries_the_information_of_its_pose():
    measured, covariance = camera(1)(ArmModel(ROBOT).pose(START_RAD))
    look = look_at((measured, covariance))
    _, jacobian = rays_of(measured, POINTS, DEPTH)
    information = jacobian.T @ np.linalg.solve(look.covariance, jacobian)
    assert np.linalg.inv(information) == pytest.approx(covariance, rel=1e-6, abs=1e-15)


@pytest.mark.parametrize('pose, covariance, word', [
    (np.full((4, 4), np.nan), np.eye(6), 'finite'),
    (np.eye(4), np.full((6, 6), np.inf), 'finite'),
    (np.eye(4), np.zeros((6, 6)), 'positive'),
    (displaced(np.eye(4), np.array([0, 0, -1.5, 0, 0, 0.0])), np.eye(6), 'front'),
])
def test_useless_measurements_are_refused(pose, covariance, word):
    look = look_at((pose, covariance))
    assert isinstance(look, Rejected) and word in look.reason


def test_averaging_along_the_path_beats_single_looks_in_depth_and_tilt():
    truth, errors, singles = wrong_arm(0), [], []
    for seed in range(20):
        measure, looks = camera(seed), LookFilter(ArmModel(ROBOT), POINTS, DEPTH)
        for joints_rad in way(31):
            measured = measure(truth.pose(joints_rad))
            looks.update(look_at(measured), joints_rad)
        errors.append(displacement(looks.pose(GOAL_RAD), truth.pose(GOAL_RAD)))
        singles.append(displacement(measured[0], truth.pose(GOAL_RAD)))
    ours, single = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (errors, singles))
    assert (ours[2:5] < 0.6 * single[2:5]).all()


@pytest.mark.parametrize('noise_px', (0.05, 0.3))
def test_covariance_is_honest_with_errors_drawn_from_the_prior(noise_px):
    rng, surprise = np.random.default_rng(5), []
    for seed in range(60):
        believed = ArmModel(ROBOT)
        looks = LookFilter(believed, POINTS, DEPTH, drift=0.0)
        sigma = np.sqrt(believed.variances(looks._prior))
        truth = believed.moved(0.5 * sigma * rng.normal(size=len(sigma)))
        measure = camera(seed, noise_px)
        for joints_rad in way(6):
            looks.update(look_at(measure(truth.pose(joints_rad))), joints_rad)
        error = displacement(looks.pose(GOAL_RAD), truth.pose(GOAL_RAD))
        surprise.append(error @ np.linalg.solve(looks.covariance(GOAL_RAD), error))
    assert 3.5 < np.mean(surprise) < 9.0  # chi-square with 6 degrees of freedom


def test_flips_to_the_mirror_pose_do_not_disturb():
    truth = FreeBody()
    setpoint = displaced(np.eye(4), np.array([0.0, 0.0, -0.2, 0.12, 0.0, 0.0]))
    mirror = displaced(np.eye(4), np.array([0.0, 0.0, -0.2, -0.12, 0.0, 0.0]))
    _, jacobian = rays_of(setpoint, POINTS, DEPTH)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * (0.3 / FOCAL_PX) ** 2
    clean, flipped = (LookFilter(FreeBody(), POINTS, DEPTH) for _ in range(2))
    for index in range(30):
        clean.update(look_at((truth.pose(setpoint), covariance)), setpoint)
        flips = index % 3 == 2
        flipped.update(look_at((mirror if flips else setpoint, covariance)), setpoint)
    shift = displacement(clean.pose(setpoint), flipped.pose(setpoint))
    assert np.linalg.norm(shift[3:]) < 0.4 * 2 * 0.12 / 3  # a plain mean moves by a third


def test_a_moved_camera_is_noticed_and_followed():
    looks, measure = LookFilter(ArmModel(ROBOT), POINTS, DEPTH), camera(2)
    before, after = wrong_arm(1), wrong_arm(2)
    for truth in [before] * 50 + [after] * 5:
        looks.update(look_at(measure(truth.pose(START_RAD))), START_RAD)
    error = displacement(looks.pose(START_RAD), after.pose(START_RAD))
    assert np.linalg.norm(error[:3]) < 3e-3 and np.linalg.norm(error[3:]) < 0.06


def test_a_slip_of_the_setpoint_is_an_error_of_the_model():
    rng = np.random.default_rng(3)
    arm = ArmModel(ROBOT).moved(0.05 * rng.normal(size=12 + len(START_RAD)))
    slip = 1e-5 * rng.normal(size=len(START_RAD))
    np.testing.assert_allclose(arm.moved(arm.error_of(slip)).pose(START_RAD),
                               arm.pose(START_RAD + slip), atol=1e-9)
    body, setpoint = FreeBody(wrong_arm(0).left), ArmModel(ROBOT).pose(START_RAD)
    np.testing.assert_allclose(body.moved(body.error_of(slip)).pose(setpoint),
                               body.pose(exp_twist(slip) @ setpoint), atol=1e-9)


def test_a_look_in_motion_says_little_along_the_motion():
    measure, slip = camera(4), np.zeros(len(START_RAD))
    slip[0] = 0.01
    still, moving = (LookFilter(ArmModel(ROBOT), POINTS, DEPTH) for _ in range(2))
    look = look_at(measure(ArmModel(ROBOT).pose(START_RAD)))
    still.update(look, START_RAD)
    moving.update(look, START_RAD, slip)
    along = ArmModel(ROBOT).posture(START_RAD)[1] @ slip
    added = moving.covariance(START_RAD) - still.covariance(START_RAD)
    assert added[:3, :3].trace() == pytest.approx(along[:3] @ along[:3], rel=0.2)
