"""Planned joints lead the servo through a singularity, and only there."""

from homography_servo.experiments.servo_pairs import CAMERA
from homography_servo.experiments.servo_pairs import exact_world
from homography_servo.experiments.servo_pairs import RobotPair
from homography_servo.experiments.servo_pairs import wrong_world
from homography_servo.experiments.servo_runs import run_pair
from homography_servo.planning.joint_lead import JointLead
from homography_servo.planning.planner import plan
from homography_servo.robot.kinematics import object_pose
import numpy as np
from plan_setup import ROBOT
import pytest

# The elbow has to go from one side to the other: at the goal no posture of the start's side.
ELBOW = RobotPair(np.radians([73.0, -64.0, -18.0, 47.0, 22.0, -64.0]),
                  np.radians([-15.0, 17.0, 31.0, -8.0, -43.0, 69.0]), 5)
JOINTS = np.arange(10.0).reshape(5, 2) * 0.01


def test_the_plan_leads_at_and_right_behind_a_singularity():
    lead = JointLead(JOINTS, np.array([False, True, True, False, False]))
    assert lead.needed
    assert [lead.leads(k) for k in range(5)] == [False, True, True, True, False]
    assert [lead.passes(k) for k in range(5)] == [False, True, True, False, False]


def test_the_last_pose_is_always_met_by_looking():
    lead = JointLead(JOINTS, np.ones(5, dtype=bool))
    assert lead.leads(4) and not lead.passes(4)


def test_targets_keep_how_the_joints_differ_from_the_plan():
    lead = JointLead(JOINTS, np.array([False, True, False, False, False]))
    assert lead.note(0, JOINTS[0] + 0.05)
    assert lead.target(1) == pytest.approx(JOINTS[1] + 0.05)
    assert lead.arrived(1, JOINTS[1] + 0.051) and not lead.arrived(1, JOINTS[1])
    assert not lead.note(0, JOINTS[0] + 1.0)  # another posture altogether


def test_without_a_singularity_nothing_is_led():
    for lead in (JointLead(), JointLead(JOINTS, np.zeros(5, dtype=bool))):
        assert not (lead.needed or lead.leads(1) or lead.passes(1))
        assert lead.note(0, np.ones(2))


def test_joints_and_flags_must_be_as_many():
    with pytest.raises(ValueError, match='5 and 4'):
        JointLead(JOINTS, np.zeros(4, dtype=bool))


@pytest.mark.parametrize('world', ('exact', 'wrong'))
def test_the_servo_passes_a_singularity_and_meets_the_goal(world):
    ends = [object_pose(ROBOT, joints) for joints in (ELBOW.start_rad, ELBOW.goal_rad)]
    found = plan(*ends, CAMERA, ROBOT, ELBOW.start_rad)
    assert found.ok and 'through a singularity' in found.family
    truth = exact_world(ROBOT) if world == 'exact' else wrong_world(ROBOT, ELBOW)
    outcome = run_pair(truth, ELBOW, 0.1, lambda *_: False)
    assert outcome.converged, outcome.why
    assert not (outcome.left_image or outcome.limit_broken or outcome.jumped)
