"""Poses that the arm does not reach: left out on the way, named at the end."""

from homography_servo.geometry.rigid import displaced
from homography_servo.planning.control import displacement
from homography_servo.planning.joint_lead import JointLead
from homography_servo.planning.servo_state import DONE
from homography_servo.planning.servo_state import FAILED
from homography_servo.robot.kinematics import object_pose
import numpy as np
import pytest
from servo_setup import ROBOT
from servo_setup import world

COUNT = 17
EXCESS_M = 0.008
# The elbow, joint 2, on either side of being stretched out.
ELBOWS_DEG = (20.0, -20.0)


def ends(elbow_deg):
    start = np.radians([-20.0, elbow_deg, 10.0, -10.0, 0.0, -20.0])
    return start, start + [0.3, 0.0, 0.0, 0.0, 0.0, 0.0]


def bulging_path(elbow_deg):
    """Go out beyond what the stretched arm reaches, and back; poses and joints of one side."""
    start, goal = ends(elbow_deg)
    stretched = 0.5 * (start + goal)
    stretched[1] = 0.0
    outward = object_pose(ROBOT, stretched)[:3, 3] - ROBOT.home_from_base[:3, 3]
    outward *= EXCESS_M / np.linalg.norm(outward)
    joints = np.linspace(start, goal, COUNT)
    bulge = np.sin(np.linspace(0.0, np.pi, COUNT))
    joints[:, 1] *= 1.0 - 0.98 * bulge
    poses = object_pose(ROBOT, joints)
    poses[:, :3, 3] += np.maximum(bulge - 0.8, 0.0)[:, None] / 0.2 * outward
    return poses, JointLead(joints, np.zeros(COUNT, dtype=bool))


def run_along(poses, lead, elbow_deg):
    run = world()
    run._motion.__init__(ends(elbow_deg)[0])
    run.servo.set_path(poses, True, '', lead)
    run.finish()
    return run


@pytest.mark.parametrize('elbow_deg', ELBOWS_DEG)
def test_pose_beyond_the_reach_is_left_out_and_the_elbow_stays_on_its_side(elbow_deg):
    poses, lead = bulging_path(elbow_deg)
    run = run_along(poses, lead, elbow_deg)
    assert run.servo.state == DONE, run.servo.state_text
    assert run.servo.passed_over > 0
    left = displacement(run.true_pose, poses[-1])
    assert np.linalg.norm(left[:3]) < 2e-3 and np.linalg.norm(left[3:]) < np.radians(2.0)
    assert run.joints_at(run.now_s) == pytest.approx(ends(elbow_deg)[1], abs=0.05)


@pytest.mark.parametrize('elbow_deg', ELBOWS_DEG)
def test_goal_beyond_the_reach_fails_and_says_so(elbow_deg):
    poses, lead = bulging_path(elbow_deg)
    run = run_along(poses[:COUNT // 2 + 1], lead, elbow_deg)
    assert run.servo.state == FAILED
    assert 'is beyond what the arm reaches' in run.servo.reason


def test_a_bulge_within_reach_is_followed_pose_by_pose():
    poses, lead = bulging_path(20.0)
    inside = displaced(poses, np.array([-0.01, 0.0, 0.0, 0.0, 0.0, 0.0]))
    run = run_along(inside, lead, 20.0)
    assert run.servo.state == DONE and run.servo.passed_over == 0
