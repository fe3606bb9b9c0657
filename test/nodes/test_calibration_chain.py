"""`~/calibrate` through everything: rendered images, tracker, planner, servo and arm."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from homography_servo.geometry.rigid import exp_twist  # noqa: E402,I100
from homography_servo.geometry.rigid import inverse  # noqa: E402
from homography_servo.geometry.rigid import pose_difference  # noqa: E402
from homography_servo.nodes.conversions import joint_state_msg  # noqa: E402
from homography_servo.nodes.kit import LATCHED  # noqa: E402
from homography_servo.places import find_config  # noqa: E402
from homography_servo.robot.robot_file import load_robot  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

ROBOT = load_robot(find_config('robix_rcs6.yaml'))
VIEW_DEG = (-20.0, 40.0, 10.0, -10.0, 0.0, -20.0)
OFF_M, OFF_RAD = (0.012, -0.010, 0.012), (0.05, -0.05, 0.05)  # 20 mm and 5 deg


def true_placement():
    """Give home_from_base as the camera shows it: shifted, and turned about the base."""
    error = exp_twist(np.array([0.0, 0.0, 0.0, *OFF_RAD]))
    error[:3, 3] = OFF_M
    foot = np.eye(4)
    foot[:3, 3] = ROBOT.home_from_base[:3, 3]
    return foot @ error @ inverse(foot) @ ROBOT.home_from_base


def test_a_wrong_placement_is_found_and_written(start_node, probe, tmp_path):
    written = tmp_path / 'arm.yaml'
    start_node('camera_sim', placement_error_m=OFF_M, placement_error_rad=OFF_RAD)
    start_node('snake_tracker')
    start_node('path_planner')
    start_node('visual_servo', calibration_file=str(written), calibration_postures=12)
    start_node('robix_bridge')
    joints = probe.record(JointState, 'joint_states')
    states = {name: probe.record(String, f'{name}/state', LATCHED)
              for name in ('snake_tracker', 'robix_bridge')}
    probe.wait(lambda: joints and all(states.values())
               and states['robix_bridge'][-1].data == 'IDLE', 'the arm is not ready')
    target = np.radians(VIEW_DEG)
    probe.publisher(JointState, 'joint_commands', 1).publish(
        joint_state_msg(ROBOT.joint_names, target, Header()))
    probe.wait(lambda: np.abs(np.array(joints[-1].position) - target).max() < 0.01,
               'the arm does not come')
    probe.wait(lambda: states['snake_tracker'][-1].data == 'TRACKING', 'the face is not seen')
    answers = []

    def calibrated():  # refused until enough looks have come
        probe.spin_for(0.5)
        answers.append(probe.call(Trigger, 'visual_servo/calibrate', timeout_s=180.0,
                                  again_s=math.inf))
        return answers[-1] if answers[-1].success or len(answers) > 10 else None
    answer = probe.wait(calibrated, 'it refuses', 200.0)
    assert answer.success, [answer.message for answer in answers]
    assert 'residual' in answer.message and str(written) in answer.message
    found = load_robot(written)
    for true, after in ((true_placement(), found.home_from_base),
                        (ROBOT.tool_from_object, found.tool_from_object)):  # that was right
        off = pose_difference(true, after)
        assert np.linalg.norm(off[:3]) < 1e-3
        assert math.degrees(np.linalg.norm(off[3:])) < 0.5
