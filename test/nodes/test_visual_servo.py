"""The visual_servo node among other processes: what it sends, says and refuses."""

from dataclasses import replace
import math
import signal
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
sys.path.insert(0, __file__.rsplit('/nodes/', 1)[0] + '/planning')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402,I100
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from diagnostic_msgs.msg import KeyValue  # noqa: E402
from geometry_msgs.msg import PolygonStamped  # noqa: E402
from geometry_msgs.msg import PoseArray  # noqa: E402
from geometry_msgs.msg import PoseWithCovarianceStamped  # noqa: E402
from homography_servo.experiments.servo_world import CubicMotion  # noqa: E402
from homography_servo.geometry.rigid import exp_twist  # noqa: E402
from homography_servo.geometry.rigid import pose_difference  # noqa: E402
from homography_servo.nodes.conversions import joint_state_msg  # noqa: E402
from homography_servo.nodes.conversions import pose_array_msg  # noqa: E402
from homography_servo.nodes.conversions import pose_covariance_msg  # noqa: E402
from homography_servo.nodes.conversions import seconds_from_duration  # noqa: E402
from homography_servo.nodes.kit import LATCHED  # noqa: E402
from homography_servo.planning.arm_model import ArmModel  # noqa: E402
from homography_servo.planning.command import Command  # noqa: E402
from homography_servo.robot.robot_file import load_robot  # noqa: E402
from homography_servo.robot.robot_file import save_robot  # noqa: E402
from rcl_interfaces.msg import Parameter  # noqa: E402
from rcl_interfaces.msg import ParameterType  # noqa: E402
from rcl_interfaces.msg import ParameterValue  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from sensor_msgs.msg import CameraInfo  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from servo_setup import camera  # noqa: E402
from servo_setup import ROBOT  # noqa: E402
from servo_setup import START_RAD  # noqa: E402
from servo_setup import straight_path  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402


class Rig:
    """An arm, a camera and a planner, played by the probe."""

    def __init__(self, probe) -> None:
        self.probe, self.truth, self.measure = probe, ArmModel(ROBOT), camera(0)
        self.see, self.feel, self.focal_px = True, True, None
        self.motion = CubicMotion(START_RAD)
        self.commands, self.stops_s = [], []
        self.states = probe.record(String, 'visual_servo/state', LATCHED)
        self.corners = probe.record(PolygonStamped, 'object/predicted_corners')
        probe.node.create_subscription(JointTrajectory, 'joint_trajectory', self._obey, 1)
        self._joints = probe.publisher(JointState, 'joint_states')
        self._pose = probe.publisher(PoseWithCovarianceStamped, 'object/pose')
        self._info = probe.publisher(CameraInfo, 'camera_info')
        self._path = probe.publisher(PoseArray, 'path/poses', LATCHED)
        self._verdict = probe.publisher(DiagnosticArray, 'path/verdict', LATCHED)
        probe.node.create_timer(0.02, self._tell_joints)
        probe.node.create_timer(1 / 30, self._tell_pose)
        probe.node.create_timer(0.1, self._tell_camera)

    def _obey(self, msg) -> None:
        now_s, stop = time.monotonic(), not msg.points
        if stop:
            self.stops_s.append(now_s)
            command = Command()
        else:
            assert list(msg.joint_names) == list(ROBOT.joint_names)
            command = Command(
                np.array([point.positions for point in msg.points]),
                np.array([seconds_from_duration(point.time_from_start) for point in msg.points]),
                np.array([point.velocities for point in msg.points]))
            self.commands.append(now_s)
        self.motion.go(command, now_s, ROBOT.acceleration_rad_s2)

    def _header(self) -> Header:
        return Header(stamp=self.probe.stamp(), frame_id='home')

    def _tell_joints(self) -> None:
        if self.feel:
            joints_rad = self.motion.at(time.monotonic())
            self._joints.publish(joint_state_msg(ROBOT.joint_names, joints_rad, self._header()))

    def _tell_pose(self) -> None:
        if self.see:
            pose, covariance = self.measure(self.truth.pose(self.motion.at(time.monotonic())))
            self._pose.publish(pose_covariance_msg(pose, covariance, self._header()))

    def _tell_camera(self) -> None:
        if self.focal_px is None:
            return
        k = [self.focal_px, 0.0, 319.5, 0.0, 800.0, 239.5, 0.0, 0.0, 1.0]
        self._info.publish(CameraInfo(header=self._header(), width=640, height=480, k=k,
                                      distortion_model='plumb_bob', d=[0.0] * 5))

    def tell_path(self, ok=True, sentence='all good', led=()) -> None:
        header = self._header()
        level = DiagnosticStatus.OK if ok else DiagnosticStatus.ERROR
        self._verdict.publish(DiagnosticArray(header=header, status=[
            DiagnosticStatus(level=level, name='path', message=sentence),
            *(DiagnosticStatus(values=[KeyValue(key='led', value=value)]) for value in led)]))
        path = straight_path(self.truth, 5, START_RAD, START_RAD + 0.05)
        self._path.publish(pose_array_msg(path if ok else [], header))

    @property
    def state(self) -> str:
        return self.states[-1].data if self.states else ''

    def call(self, name):
        return self.probe.call(Trigger, f'visual_servo/{name}')

    def start(self) -> None:
        self.focal_px = 800.0
        self.tell_path()
        self.probe.wait(lambda: self.call('start').success, 'the servo does not start')


@pytest.fixture
def rig(probe, start_node):
    process = start_node('visual_servo')
    made = Rig(probe)
    made.process = process
    return made


def test_node_servoes_to_the_end_and_predicts_corners(rig):
    rig.probe.wait(lambda: rig.state == 'IDLE', 'no state')
    rig.start()
    rig.probe.wait(lambda: rig.state == 'DONE', f'not done: {rig.state}')
    goal = rig.truth.pose(START_RAD + 0.05)
    error = pose_difference(rig.truth.pose(rig.motion.at(time.monotonic())), goal)
    assert np.linalg.norm(error[:3]) < 2e-3 and np.linalg.norm(error[3:]) < np.radians(2.0)
    rig.probe.wait(lambda: len(rig.corners) > 5, 'no predicted corners')
    pose = rig.truth.pose(rig.motion.at(time.monotonic()))
    points = ROBOT.object_points_m @ pose[:3, :3].T + pose[:3, 3] + [0.0, 0.0, ROBOT.home_depth_m]
    expected = 800.0 * points[:, :2] / points[:, 2:] + [319.5, 239.5]
    seen = np.array([(p.x, p.y) for p in rig.corners[-1].polygon.points])
    assert np.abs(seen - expected).max() < 1.0


def test_refusals_have_a_sentence_and_nothing_moves(rig):
    rig.probe.spin_for(0.5)
    assert 'no path' in rig.call('start').message
    rig.tell_path()
    rig.probe.spin_for(0.3)
    assert 'camera_info' in rig.call('start').message
    rig.focal_px = 0.0
    rig.probe.spin_for(0.3)
    assert 'camera_info' in rig.call('start').message
    rig.focal_px = 800.0
    rig.tell_path(ok=False, sentence='pose 4: joint2 beyond its limit')
    rig.probe.spin_for(0.3)
    answer = rig.call('start')
    assert not answer.success and answer.message == 'pose 4: joint2 beyond its limit'
    assert not rig.commands and rig.state == 'IDLE'


@pytest.mark.parametrize('sense', ['see', 'feel'])
def test_loss_holds_within_the_time_and_goes_on(rig, sense):
    rig.start()
    rig.probe.wait(lambda: rig.commands, 'no motion')
    setattr(rig, sense, False)
    lost_s = time.monotonic()
    rig.probe.wait(lambda: rig.state.startswith('HOLD') and rig.stops_s, 'no hold')
    assert rig.stops_s[0] - lost_s < 0.40  # 0.25 s and a busy machine
    rig.probe.spin_for(0.5)
    assert not [at_s for at_s in rig.commands if at_s > rig.stops_s[0]]
    setattr(rig, sense, True)
    rig.probe.wait(lambda: rig.state == 'DONE', f'not done: {rig.state}')


def test_path_whose_leading_joints_are_missing_is_not_replaced_by_the_one_before(rig):
    rig.focal_px = 800.0
    rig.tell_path()
    rig.probe.spin_for(0.5)
    rig.tell_path(led=['false', 'true', 'true', 'false', 'false'])
    rig.probe.spin_for(0.3)
    answer = rig.call('start')
    assert not answer.success and 'path/joint_trajectory' in answer.message
    assert not rig.commands


def test_path_that_came_on_the_way_without_its_joints_is_not_replaced_either(rig):
    rig.start()
    rig.probe.wait(lambda: rig.commands, 'no motion')
    rig.tell_path(led=['false', 'true', 'true', 'false', 'false'])
    rig.probe.spin_for(0.3)
    assert rig.call('stop').success
    rig.probe.wait(lambda: rig.state == 'IDLE', 'not stopped')
    sent = len(rig.commands)
    answer = rig.call('start')
    assert not answer.success and 'path/joint_trajectory' in answer.message
    rig.probe.spin_for(0.2)
    assert len(rig.commands) == sent


def test_stop_ends_a_calibration_and_both_callers_are_answered(rig):
    rig.focal_px = 800.0
    rig.probe.spin_for(0.5)
    client = rig.probe.node.create_client(Trigger, 'visual_servo/calibrate')
    rig.probe.wait(client.service_is_ready, 'no service')
    calibrated = client.call_async(Trigger.Request())
    rig.probe.wait(lambda: rig.commands, f'no motion: {rig.state}')
    assert rig.call('stop').message == 'calibration stopped'
    rig.probe.wait(calibrated.done, 'no answer')
    assert not calibrated.result().success
    assert calibrated.result().message == 'stopped by the operator'
    rig.probe.wait(lambda: rig.stops_s and rig.state == 'IDLE', f'not stopped: {rig.state}')
    rig.start()
    rig.probe.wait(lambda: rig.state == 'DONE', f'not done: {rig.state}')


def test_pause_stop_and_rubbish(rig):
    rig.start()
    rig.probe.wait(lambda: rig.commands, 'no motion')
    assert rig.probe.call(SetBool, 'visual_servo/pause', SetBool.Request(data=True)).success
    rig.probe.wait(lambda: rig.state == 'HOLD: paused by the operator', 'no pause')
    rig._joints.publish(JointState(name=['joint1'], position=[float('nan')]))
    rig._pose.publish(PoseWithCovarianceStamped())
    rig._path.publish(PoseArray())
    rig.probe.call(SetBool, 'visual_servo/pause', SetBool.Request(data=False))
    rig.probe.wait(lambda: rig.state in ('MOVING', 'LOOKING', 'DONE'), 'does not go on')
    assert rig.call('stop').success
    rig.probe.wait(lambda: rig.state == 'IDLE', 'not stopped')


def test_what_the_filter_is_made_with_cannot_be_set_later(rig):
    for name in ('drift', 'joint_sigma_deg'):
        parameter = Parameter(name=name, value=ParameterValue(
            type=ParameterType.PARAMETER_DOUBLE, double_value=0.5))
        answer = rig.probe.call(SetParameters, 'visual_servo/set_parameters',
                                SetParameters.Request(parameters=[parameter]))
        assert not answer.results[0].successful, name


def test_ctrl_c_on_the_way_stops_the_arm_and_exits_cleanly(rig):
    rig.start()
    rig.probe.wait(lambda: rig.commands, 'no motion')
    rig.process.signal(signal.SIGINT)
    rig.probe.wait(lambda: rig.stops_s, 'no stop')
    assert rig.process.wait() == 0
    rig.probe.spin_for(0.2)
    assert not [at_s for at_s in rig.commands if at_s > rig.stops_s[0]]  # the last word
    assert 'Traceback' not in rig.process.output


def test_calibration_finds_where_the_robot_stands_and_writes_the_file(probe, start_node,
                                                                      tmp_path):
    fast = replace(ROBOT, joints=tuple(
        replace(joint, velocity_rad_s=30.0, acceleration_rad_s2=300.0)
        for joint in ROBOT.joints))
    believed, found = tmp_path / 'believed.yaml', tmp_path / 'found.yaml'
    save_robot(believed, fast)
    start_node('visual_servo', robot_file=believed, calibration_file=found,
               calibration_looks=4, corner_speed_px_s=9000.0)
    rig = Rig(probe)
    rig.truth = ArmModel(ROBOT, exp_twist(np.array([0.01, -0.01, 0.012, 0.03, -0.05, 0.04])))
    assert 'camera_info' in rig.call('calibrate').message
    rig.focal_px = 800.0
    probe.spin_for(0.5)
    answer = probe.call(Trigger, 'visual_servo/calibrate', timeout_s=60.0,
                        again_s=math.inf)
    assert answer.success and 'px' in answer.message and 'mm' in answer.message
    error = pose_difference(load_robot(found).home_from_base,
                            rig.truth.corrected.home_from_base)
    assert np.linalg.norm(error[:3]) < 1e-3
    assert np.linalg.norm(error[3:]) < np.radians(0.5)
    probe.wait(lambda: rig.state == 'DONE', f'not done: {rig.state}')
