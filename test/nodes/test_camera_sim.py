"""The simulated camera as a process: pictures, truth, timing, errors of the arm."""

import math

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseStamped
from homography_servo.geometry.camera import load_camera
from homography_servo.geometry.face import face_corners
from homography_servo.nodes.conversions import camera_from_info
from homography_servo.nodes.conversions import grey_from_image
from homography_servo.nodes.conversions import joint_state_msg
from homography_servo.nodes.conversions import points_from_polygon
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.conversions import transform_from_pose
from homography_servo.nodes.kit import images_qos
from homography_servo.places import find_config
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

ROBOT = load_robot(find_config('robix_rcs6.yaml'))
CAMERA = load_camera(find_config('sim_640x480.yaml'))
JOINTS_RAD = np.radians([-20.0, 40.0, 10.0, -10.0, 0.0, -20.0])


class Watcher:
    """Records what the camera publishes and moves the arm."""

    def __init__(self, probe, node):
        self.probe = probe
        self.node = node
        self.images = probe.record(Image, 'image', images_qos(True))
        self.infos = probe.record(CameraInfo, 'camera_info', images_qos(True))
        self.poses = probe.record(PoseStamped, 'object/true_pose')
        self.corners = probe.record(PolygonStamped, 'object/true_corners')
        self._joints = probe.publisher(JointState, 'joint_states')

    def report(self, joints_rad=JOINTS_RAD, names=ROBOT.joint_names):
        """Report joints."""
        self._joints.publish(joint_state_msg(names, joints_rad,
                                             Header(stamp=self.probe.stamp())))

    def until(self, expected_px):
        """Wait until the true corners are where they should be and give their message."""
        def there():
            self.report()
            self.probe.spin_for(0.05)
            return self.corners and len(self.corners[-1].polygon.points) == 4 and np.allclose(
                points_from_polygon(self.corners[-1]), expected_px, rtol=0.0, atol=2e-3)
        self.probe.wait(there, 'the true corners never are where they should be', 15.0)
        return self.corners[-1]

    def with_header(self, messages, header):
        """Wait for the message with the same header."""
        return self.probe.wait(lambda: [m for m in messages if m.header == header],
                               'a message is missing')[0]

    def set(self, name, kind, value):
        """Set a parameter and give the answer."""
        setting = ParameterValue(type=kind)
        setattr(setting, {ParameterType.PARAMETER_DOUBLE: 'double_value',
                          ParameterType.PARAMETER_DOUBLE_ARRAY: 'double_array_value',
                          ParameterType.PARAMETER_BOOL: 'bool_value'}[kind], value)
        return self.probe.call(SetParameters, 'camera_sim/set_parameters', SetParameters.Request(
            parameters=[Parameter(name=name, value=setting)])).results[0]


@pytest.fixture
def watch(start_node, probe):
    """Give a function that starts the camera and gives its watcher; it must end in peace."""
    started = []

    def start(**parameters):
        started.append(start_node('camera_sim', reliable_images=True, **parameters))
        return Watcher(probe, started[-1])

    yield start
    for node in started:
        assert node.stop() == 0, node.output
        assert 'Traceback' not in node.output


def projected(home_from_object, camera=CAMERA):
    """Project the corners of the face."""
    points_m = face_corners(*ROBOT.face_size_m) @ home_from_object[:3, :3].T \
        + home_from_object[:3, 3] + (0.0, 0.0, ROBOT.home_depth_m)
    return camera.project(points_m)


def test_without_joint_states_the_background_is_shown(watch):
    watcher = watch(noise_grey=0.0)
    watcher.probe.wait(lambda: len(watcher.images) > 3 and watcher.corners, 'no images')
    assert grey_from_image(watcher.images[-1]).max() < 130
    assert not watcher.corners[-1].polygon.points and not watcher.poses


def test_truth_is_that_of_the_kinematics_and_of_the_picture(watch):
    watcher = watch(noise_grey=0.0)
    believed = object_pose(ROBOT, JOINTS_RAD)
    corners = watcher.until(projected(believed))
    image = watcher.with_header(watcher.images, corners.header)
    assert corners.header.frame_id == 'camera_optical'
    assert (image.encoding, image.width, image.height) == ('mono8', 640, 480)
    pose = watcher.probe.wait(lambda: [m for m in watcher.poses
                                       if m.header.stamp == corners.header.stamp], 'no pose')[0]
    assert pose.header.frame_id == 'home'
    assert transform_from_pose(pose.pose) == pytest.approx(believed, abs=1e-9)
    bright = np.argwhere(grey_from_image(image) > 180)[:, ::-1]
    assert bright.mean(axis=0) == pytest.approx(
        points_from_polygon(corners).mean(axis=0), abs=1.0)


def test_camera_info_goes_with_every_image_and_tells_what_is_believed(watch):
    watcher = watch(focal_error=0.1)
    centre = np.array([CAMERA.cx, CAMERA.cy])
    believed = projected(object_pose(ROBOT, JOINTS_RAD))
    corners = watcher.until(centre + 1.1 * (believed - centre))
    watcher.with_header(watcher.images, corners.header)
    assert camera_from_info(watcher.with_header(watcher.infos, corners.header)) == CAMERA


def test_errors_of_the_arm_move_the_truth_and_can_be_changed_while_running(watch):
    watcher = watch(placement_error_m=[0.01, -0.02, 0.03], placement_error_rad=[0.0, 0.0, 0.1])
    believed = object_pose(ROBOT, JOINTS_RAD)
    cos, sin = math.cos(0.1), math.sin(0.1)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    foot = ROBOT.home_from_base[:3, 3]
    true = np.eye(4)
    true[:3, :3] = turn @ believed[:3, :3]
    true[:3, 3] = foot + turn @ (believed[:3, 3] - foot) + (0.01, -0.02, 0.03)
    watcher.until(projected(true))
    for name in ('placement_error_m', 'placement_error_rad'):
        assert watcher.set(name, ParameterType.PARAMETER_DOUBLE_ARRAY, [0.0] * 3).successful
    assert watcher.set('joint_zero_error_rad', ParameterType.PARAMETER_DOUBLE_ARRAY,
                       [0.05, 0.0, 0.0, 0.0, 0.0, 0.0]).successful
    watcher.until(projected(object_pose(ROBOT, JOINTS_RAD + [0.05, 0.0, 0.0, 0.0, 0.0, 0.0])))


def test_a_delay_keeps_the_stamp_of_the_exposure(watch):
    watcher = watch(delay_s=0.3, encoding='bgr8')
    ages_s = []
    for _ in range(20):
        before = len(watcher.images)
        watcher.probe.wait(lambda: len(watcher.images) > before, 'no images')
        now_s = seconds_from_stamp(watcher.probe.stamp())
        ages_s.append(now_s - seconds_from_stamp(watcher.images[-1].header.stamp))
    assert 0.3 <= min(ages_s) < 0.4 and watcher.images[-1].encoding == 'bgr8'
    stamps_s = [seconds_from_stamp(image.header.stamp) for image in watcher.images]
    assert stamps_s == sorted(stamps_s)


def test_the_share_that_was_asked_for_is_dropped(watch):
    watcher = watch(rate_hz=60.0, drop_share=0.5)
    heard = watcher.probe.record(DiagnosticArray, '/diagnostics')

    def counted():
        values = [{item.key: item.value for item in status.values} for message in heard
                  for status in message.status if status.name == 'camera_sim: camera']
        return values and int(values[-1]['images']) + int(values[-1]['dropped']) > 100 \
            and values[-1]
    numbers = watcher.probe.wait(counted, 'fewer than 100 pictures counted')
    images, dropped = int(numbers['images']), int(numbers['dropped'])
    assert 0.3 < dropped / (images + dropped) < 0.7  # four standard deviations
    watcher.probe.wait(lambda: len(watcher.images) >= 10, 'what is not dropped must come')


def test_the_box_can_be_taken_away_and_bad_settings_are_refused(watch):
    watcher = watch()
    watcher.until(projected(object_pose(ROBOT, JOINTS_RAD)))
    assert watcher.set('box_visible', ParameterType.PARAMETER_BOOL, False).successful
    watcher.probe.wait(lambda: not watcher.corners[-1].polygon.points, 'the box stays')
    assert not watcher.set('noise_grey', ParameterType.PARAMETER_DOUBLE, -1.0).successful


def test_bad_joint_states_are_left_out_and_the_order_of_names_is_free(watch):
    watcher = watch()
    expected = projected(object_pose(ROBOT, JOINTS_RAD))
    watcher.until(expected)
    for joints_rad, names in (([math.nan] * 6, ROBOT.joint_names), (JOINTS_RAD, ['a'] * 6),
                              (JOINTS_RAD[:3], ROBOT.joint_names)):
        watcher.report(joints_rad, names)
    watcher.probe.wait(lambda: 'joint_states ignored' in watcher.node.output, 'no complaint')
    watcher.probe.spin_for(0.2)
    assert points_from_polygon(watcher.corners[-1]) == pytest.approx(expected, abs=2e-3)
    moved, order = JOINTS_RAD + 0.05, [3, 0, 5, 1, 2, 4]
    watcher.report(moved[order], [ROBOT.joint_names[i] for i in order])
    watcher.probe.wait(lambda: np.allclose(
        points_from_polygon(watcher.corners[-1]), projected(object_pose(ROBOT, moved)),
        rtol=0.0, atol=2e-3), 'the joints in another order are not taken')


@pytest.mark.parametrize('parameters, words', [
    ({'camera_file': 'no_such.yaml'}, ['camera_file', 'no_such.yaml']),
    ({'robot_file': 'no_such.yaml'}, ['robot_file', 'no_such.yaml']),
    ({'joint_zero_error_rad': [0.1, 0.2]}, ['joint_zero_error_rad', '6', '2'])])
def test_bad_configuration_ends_with_code_2(start_node, parameters, words):
    node = start_node('camera_sim', **parameters)
    assert node.wait() == 2
    assert all(word in node.output for word in words) and 'Traceback' not in node.output
