"""Calibration of placement and grip: truth found again, and nonsense refused with a reason."""

import dataclasses
from functools import lru_cache

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import pose_difference
from homography_servo.places import find_config
from homography_servo.planning.calibration import calibrate
from homography_servo.planning.calibration import Calibration
from homography_servo.planning.calibration import calibration_poses
from homography_servo.planning.calibration import CalibrationPoseSettings
from homography_servo.planning.calibration import CalibrationSettings
from homography_servo.planning.calibration_model import PlacementModel
from homography_servo.planning.calibration_start import placement_from_poses
from homography_servo.result import Rejected
from homography_servo.robot.kinematics import forward
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.robot_file import save_robot
from homography_servo.robot.servo_units import from_units
from homography_servo.robot.servo_units import to_units
import numpy as np
import pytest

ROBOT = load_robot(find_config('robix_rcs6.yaml'))
CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
LENS = Camera(820.0, 815.0, 325.0, 236.0, 640, 480, 'plumb_bob', (-0.2, 0.05, 1e-3, -5e-4, 0.0))
DEG = np.pi / 180


@lru_cache(maxsize=None)
def postures(count=12, seed=0):
    chosen = calibration_poses(ROBOT, CAMERA, count, seed)
    assert not isinstance(chosen, Rejected), chosen
    return chosen


def unit(values):
    return values / np.linalg.norm(values)


def truth(seed, position_m=0.02, angle_rad=5 * DEG, zeros_rad=0.0):
    """Put the arm and the box elsewhere than believed, by so much in a random direction."""
    rng = np.random.default_rng(seed)
    change = np.concatenate([
        position_m * unit(rng.normal(size=3)), angle_rad * unit(rng.normal(size=3)),
        0.25 * position_m * unit(rng.normal(size=3)), 0.4 * angle_rad * unit(rng.normal(size=3)),
        zeros_rad * rng.choice([-1.0, 1.0], 4)])
    return PlacementModel(ROBOT, CAMERA, joint_offsets=True).changed(change)


def looks(robot, joints, noise_px, seed=0, camera=CAMERA):
    pixels = PlacementModel(robot, camera).points_px(np.zeros(12), joints)
    return pixels + noise_px * np.random.default_rng(seed).normal(size=pixels.shape)


def errors(found, true):
    placed = pose_difference(found.home_from_base, true.home_from_base)
    held = pose_difference(found.tool_from_object, true.tool_from_object)
    return [np.linalg.norm(part) for part in (placed[:3], placed[3:], held[:3], held[3:])]


# --- the solver ------------------------------------------------------------------------

@pytest.mark.parametrize('noise_px', [0.1, 0.3])
@pytest.mark.parametrize('zeros_rad', [0.0, 2 * DEG], ids=['zeros good', 'zeros off'])
def test_twelve_looks_find_placement_within_a_millimetre(noise_px, zeros_rad):
    for seed in range(5):
        true = truth(seed, zeros_rad=zeros_rad)
        found = calibrate(ROBOT, CAMERA, postures(), looks(true, postures(), noise_px, seed))
        assert isinstance(found, Calibration), found
        placed_m, placed_rad, held_m, held_rad = errors(found, true)
        assert placed_m < 1e-3 and placed_rad < 0.5 * DEG
        assert held_m < 1e-3 and held_rad < 0.5 * DEG
        assert found.residual_px == pytest.approx(noise_px, rel=0.35)
        assert found.residual_m < 0.4e-3
        assert found.joint_offsets_rad.any() == (zeros_rad > 0.0)
        moved = pose_difference(object_pose(found.robot, postures()),
                                object_pose(true, postures()))
        assert np.abs(moved[:, :3]).max() < 1e-3 and np.abs(moved[:, 3:]).max() < 0.5 * DEG


def test_without_noise_the_truth_is_met_exactly():
    true = truth(1, zeros_rad=1 * DEG)
    found = calibrate(ROBOT, CAMERA, postures(), looks(true, postures(), 0.0),
                      CalibrationSettings(joint_zeros='on'))
    assert max(errors(found, true)) < 1e-6
    assert found.residual_px < 1e-4


def test_covariance_is_what_repetition_shows():
    true, spread = truth(2), []
    settings = CalibrationSettings(joint_zeros='off')
    for seed in range(30):
        found = calibrate(true, CAMERA, postures(), looks(true, postures(), 0.2, seed), settings)
        spread.append(np.concatenate([
            pose_difference(found.home_from_base, true.home_from_base),
            pose_difference(found.tool_from_object, true.tool_from_object)]))
    ratio = np.std(spread, axis=0) / np.sqrt(np.diag(found.covariance))
    assert np.all((ratio > 0.6) & (ratio < 1.6))
    assert np.abs(np.mean(spread, axis=0)
                  / np.sqrt(np.diag(found.covariance) / 30)).max() < 4.5


def test_a_bent_lens_and_whole_servo_units_do_not_matter():
    joints = from_units(ROBOT, to_units(ROBOT, postures(16)))
    true = truth(3)
    found = calibrate(ROBOT, LENS, joints, looks(true, joints, 0.2, camera=LENS))
    placed_m, placed_rad, _, _ = errors(found, true)
    assert placed_m < 1e-3 and placed_rad < 0.5 * DEG


def test_a_belief_that_is_far_off_does_not_matter():
    true = truth(4)
    far = np.concatenate([[0.3, -0.2, 0.1], 120 * DEG * unit(np.array([1.0, 2.0, -1.0]))])
    lost = dataclasses.replace(ROBOT, home_from_base=displaced(true.home_from_base, far),
                               tool_from_object=displaced(true.tool_from_object, far[::-1] * 0.5))
    found = calibrate(lost, CAMERA, postures(16), looks(true, postures(16), 0.1))
    assert isinstance(found, Calibration), found
    placed_m, placed_rad, _, _ = errors(found, true)
    assert placed_m < 1e-3 and placed_rad < 0.5 * DEG


def test_looks_with_wrong_corners_are_left_out():
    true, joints = truth(5), postures(16)
    corners = looks(true, joints, 0.2)
    corners[3] = corners[3][[2, 3, 0, 1]]
    corners[11] += 30.0
    found = calibrate(ROBOT, CAMERA, joints, corners)
    assert found.left_out == (3, 11)
    assert '2 looks left out' in found.sentence
    assert max(errors(found, true)[:1]) < 1e-3


def test_a_look_that_is_a_little_off_among_very_good_ones_is_used():
    true, joints = truth(5), postures()
    corners = looks(true, joints, 0.02)
    corners[7] += 0.15
    found = calibrate(ROBOT, CAMERA, joints, corners)
    assert isinstance(found, Calibration), found
    assert found.left_out == () and max(errors(found, true)[:1]) < 1e-3
    corners[7] += 2.0
    refused = calibrate(ROBOT, CAMERA, joints, corners)
    assert isinstance(refused, Rejected) and '1 of 12 looks' in refused.reason


def test_too_many_wrong_looks_are_refused():
    joints = postures(16)
    corners = looks(truth(5), joints, 0.2)
    corners[::2] = corners[::2][:, [2, 3, 0, 1]]
    refused = calibrate(ROBOT, CAMERA, joints, corners)
    assert isinstance(refused, Rejected) and 'px' in refused.reason


def test_an_arm_that_is_not_the_one_of_the_file_is_refused():
    longer = [dataclasses.replace(joint, a_m=1.3 * joint.a_m) for joint in ROBOT.joints]
    other = dataclasses.replace(ROBOT, joints=tuple(longer))
    refused = calibrate(ROBOT, CAMERA, postures(16), looks(other, postures(16), 0.1))
    assert isinstance(refused, Rejected) and 'not as believed' in refused.reason


def test_too_few_looks_are_refused():
    refused = calibrate(ROBOT, CAMERA, postures()[:7], looks(ROBOT, postures()[:7], 0.1))
    assert refused == Rejected('7 looks are too few for a calibration, 12 are needed')
    assert isinstance(calibrate(ROBOT, CAMERA, np.zeros((0, 6)), np.zeros((0, 4, 2))), Rejected)


@pytest.mark.parametrize('joint', [None, 0, 5])
def test_looks_that_tell_nothing_are_refused(joint):
    joints = np.tile(postures()[0], (14, 1))
    if joint is not None:
        joints[:, joint] += np.linspace(-0.3, 0.3, 14)
    refused = calibrate(ROBOT, CAMERA, joints, looks(ROBOT, joints, 0.2))
    assert isinstance(refused, Rejected) and 'uncertain by' in refused.reason


def test_wrong_shapes_are_mistakes():
    joints, corners = postures(), looks(ROBOT, postures(), 0.1)
    with pytest.raises(ValueError, match=r'joints_rad must have shape \(K, 6\)'):
        calibrate(ROBOT, CAMERA, joints[:, :5], corners)
    with pytest.raises(ValueError, match=r'corners_px must have shape \(12, 4, 2\)'):
        calibrate(ROBOT, CAMERA, joints, corners[:11])
    corners[2, 1, 0] = np.nan
    with pytest.raises(ValueError, match='finite'):
        calibrate(ROBOT, CAMERA, joints, corners)


def test_the_calibrated_robot_survives_its_file(tmp_path):
    true = truth(6, zeros_rad=1.5 * DEG)
    found = calibrate(ROBOT, CAMERA, postures(), looks(true, postures(), 0.1))
    save_robot(tmp_path / 'calibrated.yaml', found.robot, found.sentence)
    again = load_robot(tmp_path / 'calibrated.yaml')
    np.testing.assert_allclose(object_pose(again, postures()),
                               object_pose(found.robot, postures()), atol=1e-9)


def test_slopes_are_differences_of_the_model():
    model = PlacementModel(truth(7), LENS, joint_offsets=True)
    rng = np.random.default_rng(8)
    change = 0.01 * rng.normal(size=model.size)
    step = 1e-4 * rng.normal(size=model.size)
    moved = (model.points_px(change + step, postures())
             - model.points_px(change - step, postures())).reshape(12, -1) / 2
    np.testing.assert_allclose(model.jacobian(change, postures()) @ step, moved, atol=1e-4)
    joints = postures()
    np.testing.assert_allclose(
        model.points_px(change, joints),
        PlacementModel(model.changed(change), LENS).points_px(np.zeros(12), joints), atol=1e-9)


# --- the linear start ------------------------------------------------------------------

def test_linear_start_is_exact_for_exact_poses():
    for seed in range(20):
        true = truth(seed, 0.5, 2.5)
        solved = placement_from_poses(forward(true, postures()), object_pose(true, postures()))
        np.testing.assert_allclose(solved[0], true.home_from_base, atol=1e-8)
        np.testing.assert_allclose(solved[1], true.tool_from_object, atol=1e-8)


def test_linear_start_says_what_is_missing():
    joints = np.tile(postures()[0], (5, 1))
    joints[:, 0] += np.linspace(0, 0.5, 5)
    refused = placement_from_poses(forward(ROBOT, joints), object_pose(ROBOT, joints))
    assert refused == Rejected('the poses turn about one axis only')
    assert 'too few' in placement_from_poses(np.zeros((2, 4, 4)), np.zeros((2, 4, 4))).reason


# --- the postures ----------------------------------------------------------------------

@pytest.mark.parametrize('seed', [0, 1, 2])
def test_postures_stay_in_view_though_the_arm_stands_elsewhere(seed):
    chosen = calibration_poses(ROBOT, CAMERA, 15, seed)
    settings = CalibrationPoseSettings()
    margin = settings.calibration_joint_margin_rad
    assert np.all((chosen >= ROBOT.lower_rad + margin) & (chosen <= ROBOT.upper_rad - margin))
    share = np.linspace(0, 1, 40)[:, None, None]
    ways = (chosen[:-1] + share * np.diff(chosen, axis=0)).reshape(-1, 6)
    for shift in range(4):
        true = truth(100 * seed + shift)
        pixels = PlacementModel(true, CAMERA).points_px(np.zeros(12), ways)
        assert CAMERA.contains(pixels).all()
    believed = PlacementModel(ROBOT, CAMERA).points_px(np.zeros(12), chosen)
    assert CAMERA.contains(believed, settings.calibration_field_margin_px).all()
    normal = object_pose(ROBOT, ways)[:, 2, 2]
    assert np.all(normal > 0.3)  # never from the side or from behind
    assert forward(ROBOT, ways)[:, 2, 3].min() > 0.0


def test_postures_are_reproducible_and_differ_by_seed():
    again = calibration_poses(ROBOT, CAMERA, 12, 0)
    np.testing.assert_array_equal(again, postures())
    assert not np.array_equal(calibration_poses(ROBOT, CAMERA, 12, 1), again)


def test_the_way_from_where_the_arm_is_counts():
    start = np.array([-50, 40, 10, -10, 0, -20]) * DEG
    chosen = calibration_poses(ROBOT, CAMERA, 12, 0, start_rad=start)
    ways = start + np.linspace(0, 1, 30)[:, None] * (chosen[0] - start)
    pixels = PlacementModel(ROBOT, CAMERA).points_px(np.zeros(12), ways)
    assert CAMERA.contains(pixels, 20.0).all()
    hidden = ROBOT.upper_rad  # not in view: any first posture will do
    assert len(calibration_poses(ROBOT, CAMERA, 12, 0, start_rad=hidden)) == 12


def test_a_camera_that_looks_elsewhere_has_no_postures():
    away = dataclasses.replace(ROBOT, home_from_base=displaced(
        ROBOT.home_from_base, np.array([3.0, 0, 0, 0, 0, 0])))
    refused = calibration_poses(away, CAMERA, 12)
    assert isinstance(refused, Rejected) and 'show the face to the camera' in refused.reason
    with pytest.raises(ValueError, match='count must be 1 or above'):
        calibration_poses(ROBOT, CAMERA, 0)
