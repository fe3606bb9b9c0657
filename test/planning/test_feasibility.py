"""The verdict: every number against an independent one, every veto by its sentence."""

from dataclasses import replace
import time

from homography_servo.geometry.path import interpolate
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.rigid import exp_twist
from homography_servo.planning.checks import required
from homography_servo.planning.feasibility import check_path
from homography_servo.planning.feasibility import goal_fault
from homography_servo.planning.feasibility import look
from homography_servo.planning.follow import follow
from homography_servo.planning.settings import FeasibilitySettings
from homography_servo.robot.kinematics import object_pose
import numpy as np
from plan_setup import CAMERA
from plan_setup import GOAL_RAD
from plan_setup import POINTS_M
from plan_setup import postures
from plan_setup import ROBOT
from plan_setup import smallest
from plan_setup import START_RAD
import pytest

SETTINGS = FeasibilitySettings()
TRIAL = interpolate(object_pose(ROBOT, START_RAD), object_pose(ROBOT, GOAL_RAD), 31)


def judge(poses, start_rad=START_RAD, settings=SETTINGS, **changes):
    return check_path(poses, CAMERA, POINTS_M, ROBOT, start_rad, replace(settings, **changes))


def judge_view(poses, **changes):
    return check_path(np.asarray(poses), CAMERA, POINTS_M, settings=replace(SETTINGS, **changes))


def placed(x_m=0.0, y_m=0.0, z_m=0.0, tilt_rad=0.0):
    pose = exp_twist(np.array([0.0, 0.0, 0.0, tilt_rad, 0.0, 0.0]))
    pose[:3, 3] = x_m, y_m, z_m
    return pose


def test_the_trial_is_feasible_and_its_joints_are_those_of_the_chord():
    verdict = judge(TRIAL)
    degrees = np.degrees(verdict.joints_rad)
    assert verdict.ok and verdict.first_bad is None and not any(verdict.reasons)
    assert verdict.joints_rad[0] == pytest.approx(START_RAD, abs=1e-12)
    assert verdict.joints_rad[-1] == pytest.approx(GOAL_RAD, abs=2e-5)
    assert degrees[:, 0].min() == pytest.approx(-54.1, abs=0.05)
    assert degrees[:, 1].max() == pytest.approx(64.5, abs=0.05)
    assert degrees[:, 5].min() == pytest.approx(-25.7, abs=0.05)
    assert verdict.values.field_px.min() > 50.0


def test_joints_put_the_object_on_every_pose():
    reached = object_pose(ROBOT, judge(TRIAL).joints_rad)
    assert np.abs(reached - TRIAL).max() < 1e-4


@pytest.mark.parametrize('count', (2, 7, 31, 400))
def test_any_smooth_motion_of_the_joints_is_followed_as_it_was(count):
    ends = postures(12, 11)
    for start, goal in zip(ends[::2], ends[1::2]):
        goal = start + 0.3 * (goal - start)
        joints = start + np.linspace(0.0, 1.0, count)[:, None] * (goal - start)
        straight = start + np.linspace(0.0, 1.0, 400)[:, None] * (goal - start)
        if smallest(straight).min() < 0.03:
            continue
        followed = follow(ROBOT, object_pose(ROBOT, joints), start)
        assert followed.reached.all()
        assert np.abs(followed.joints_rad - joints).max() < 2e-3


def test_a_wrong_placement_of_the_robot_does_not_change_the_joints():
    shift = exp_twist(np.array([0.01, -0.01, 0.005, 0.03, -0.03, 0.05]))
    assert judge(shift @ TRIAL).joints_rad == pytest.approx(judge(TRIAL).joints_rad, abs=2e-4)


@pytest.mark.parametrize('goal, words', [
    (placed(), ''), (placed(x_m=0.34), 'from the border'), (placed(x_m=0.36), 'outside'),
    (placed(z_m=-1.5), 'behind'), (placed(tilt_rad=1.4), 'tilted 80.2 deg')])
def test_a_goal_must_keep_every_margin_even_when_a_start_need_not(goal, words):
    found = goal_fault(goal, CAMERA, POINTS_M, 1.0, SETTINGS)
    assert words in found and bool(found) == bool(words)


def test_distance_to_the_border_is_that_of_the_worst_projected_corner():
    poses = object_pose(ROBOT, postures(20, 3))
    for pose, found in zip(poses, judge_view(poses).values.field_px):
        x, y, z = (pose[:3, :3] @ POINTS_M.T).T.T + pose[:3, 3:] + [[0.0], [0.0], [1.0]]
        u, v = 800.0 * x / z + 319.5, 800.0 * y / z + 239.5
        assert found == pytest.approx(min(u.min(), v.min(), (639 - u).min(), (479 - v).min()))


@pytest.mark.parametrize('tilt_deg', (0.0, 20.0, 60.0, 100.0, 180.0))
def test_facing_is_the_angle_between_normal_and_sight(tilt_deg):
    verdict = judge_view([placed(tilt_rad=np.radians(tilt_deg))])
    assert np.degrees(verdict.values.facing_rad[0]) == pytest.approx(tilt_deg, abs=1e-4)
    assert verdict.ok == (tilt_deg < 75.0)


@pytest.mark.parametrize('bad, check, words', [
    (placed(x_m=0.34), 'field of view', 'from the border'),
    (placed(x_m=0.6), 'field of view', 'outside the image'),
    (placed(z_m=-1.2), 'field of view', 'behind the camera'),
    (placed(tilt_rad=1.4), 'facing', 'tilted 80.2 deg'),
    (placed(tilt_rad=2.0), 'facing', 'turns away')])
def test_a_view_that_is_bad_is_named_with_its_pose_and_number(bad, check, words):
    verdict = judge_view([placed(), placed(), bad, placed()])
    assert not verdict.ok and verdict.first_bad == 2 and verdict.check == check
    assert verdict.sentence.startswith('pose 3 of 4: ') and words in verdict.sentence
    assert [bool(reason) for reason in verdict.reasons] == [False, False, True, False]


def joint_line(change_rad, start=START_RAD, count=41):
    joints = start + np.linspace(0.0, 1.0, count)[:, None] * np.asarray(change_rad)
    return object_pose(ROBOT, joints), joints


def test_a_joint_beyond_its_limit_is_named_where_it_leaves_its_margin():
    poses, joints = joint_line([0.0, 0.0, 0.0, 0.0, 0.0, -np.radians(70.0)])
    verdict = judge(poses)
    room = joints[:, 5] - ROBOT.lower_rad[5]
    assert verdict.first_bad == int(np.argmax(room < SETTINGS.joint_margin_rad))
    assert verdict.check == 'joint limits' and 'joint6' in verdict.sentence
    assert verdict.values.joint_margin_rad[-1] == pytest.approx(np.radians(-10.0), abs=1e-4)


def test_an_unreachable_pose_ends_the_path_there():
    far = np.array([placed(x_m=x) @ TRIAL[0] for x in np.linspace(0.0, -0.4, 41)])
    verdict = judge(far, field_margin_px=0.0)
    missed = np.flatnonzero(~verdict.values.reached)
    assert len(missed) and (np.diff(missed) == 1).all() and missed[-1] == 40
    assert 'no inverse kinematics' in verdict.reasons[missed[0]]
    assert np.isfinite(verdict.joints_rad).all()


def test_a_stretched_elbow_cannot_be_passed():
    elbow = np.array([-0.2, 0.4, 0.17, -0.17, 0.0, -0.2])
    poses, joints = joint_line([0.4, -0.8, 0.0, 0.0, 0.0, 0.0], elbow, 81)
    assert judge_view(poses).ok
    verdict = judge(poses, elbow)
    assert not verdict.ok
    assert verdict.check in ('conditioning', 'inverse kinematics', 'joint step')
    assert smallest(joints[:verdict.first_bad]).min() > 0.6 * SETTINGS.conditioning_min


def test_a_large_step_between_poses_is_a_jump():
    poses, _ = joint_line([0.6, 0.0, 0.0, 0.0, 0.0, 0.0], count=2)
    values = judge(poses, joint_step_rad=0.7).values
    assert values.joint_step_rad[0] == pytest.approx(0.6, abs=1e-3)
    verdict = judge(poses, joint_step_rad=0.5)
    assert verdict.check == 'joint step' and 'joint1' in verdict.sentence


def test_a_start_in_the_margin_may_leave_it_but_not_go_deeper():
    edge = START_RAD.copy()
    edge[5] = ROBOT.lower_rad[5] + 0.02
    out, _ = joint_line([0.0] * 5 + [0.3], edge)
    deeper, _ = joint_line([0.0] * 5 + [-0.015], edge)
    assert judge(out, edge).ok
    assert judge(deeper, edge).check == 'joint limits'
    beyond = edge.copy()
    beyond[5] = ROBOT.lower_rad[5] - 0.02
    assert judge(joint_line([0.0] * 5 + [0.3], beyond)[0], beyond).first_bad == 0


def test_after_the_limit_was_kept_once_it_holds():
    values = np.array([3.0, 2.9, 5.0, 11.0, 9.0, 12.0])
    assert (values >= required(values, 10.0, 0.0)).tolist() == [True, False, True, True, False,
                                                                True]


def test_a_taught_goal_may_be_as_near_to_a_limit_as_it_was():
    values = np.array([12.0, 11.0, 6.0, 5.0])
    assert (values >= required(values, 10.0, 0.0)).tolist() == [True, True, False, False]
    assert (values >= required(values, 10.0, 0.0, 5.0)).all()
    assert (values >= required(values, 10.0, 0.0, 5.5)).tolist() == [True, True, True, False]
    dip = np.array([12.0, 6.0, 11.0, 5.0])
    assert (dip >= required(dip, 10.0, 0.0, 5.0)).tolist() == [True, False, True, True]


def test_camera_and_arm_that_disagree_are_told():
    half_turn = placed()
    half_turn[:2, :2] *= -1.0
    verdict = judge(TRIAL @ half_turn)
    assert verdict.first_bad == 0 and 'wrong corner order' in verdict.sentence


def test_predicted_ambiguity_is_twice_the_share_of_wrong_minima():
    rng = np.random.default_rng(8)
    poses = np.array([placed(tilt_rad=np.radians(t)) for t in (50.0, 22.0, 14.0, 8.0)])
    predicted = judge_view(poses, corner_sigma_px=0.3).values.ambiguity
    seen = look(poses, CAMERA, POINTS_M, 1.0).points_px
    for pose, corners, expected in zip(poses, seen, predicted):
        wrong = 0
        for _ in range(150):
            noisy = corners + rng.normal(0.0, 0.3, corners.shape)
            found = estimate_pose(POINTS_M, noisy, CAMERA, covariance_px2=0.09)
            wrong += found.home_from_object[1, 2] * pose[1, 2] < 0.0
        assert 2.0 * wrong / 150 == pytest.approx(expected, abs=0.15)
    assert predicted[-1] > 0.3 and predicted[0] < 0.01
    assert judge_view(poses, corner_sigma_px=0.3, ambiguity_max=0.2).check == 'mirror'


@pytest.mark.parametrize('count, bound_s', [(31, 0.010), (1000, 0.150)])
def test_the_verdict_is_quick(count, bound_s):
    poses = interpolate(TRIAL[0], TRIAL[-1], count)
    times_s = []
    for _ in range(15):
        began_s = time.process_time()
        judge(poses)
        times_s.append(time.process_time() - began_s)
    assert min(times_s) < bound_s


@pytest.mark.parametrize('poses, start, words', [
    (np.zeros((0, 4, 4)), START_RAD, r'\(N, 4, 4\)'),
    (np.eye(4), START_RAD, r'\(N, 4, 4\)'),
    (np.full((2, 4, 4), np.nan), START_RAD, 'finite'),
    (TRIAL, START_RAD[:5], r'\(6,\)'),
    (TRIAL, None, r'\(6,\)')])
def test_misuse_is_an_error_that_names_what_was_expected(poses, start, words):
    with pytest.raises(ValueError, match=words):
        judge(poses, start)
