"""The simulated camera as a ROS node: the arm's joints in, pictures of the box out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from dataclasses import fields
from dataclasses import replace
import time
from typing import NamedTuple

from builtin_interfaces.msg import Time
import cv2
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseStamped
from homography_servo.errors import ConfigError
from homography_servo.geometry.camera import load_camera
from homography_servo.nodes.conversions import camera_info_msg
from homography_servo.nodes.conversions import image_msg
from homography_servo.nodes.conversions import joints_from_state
from homography_servo.nodes.conversions import polygon_msg
from homography_servo.nodes.conversions import pose_stamped_msg
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.conversions import velocity_from_state
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import images_qos
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import WARN
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.run import run_node
from homography_servo.places import load_named
from homography_servo.result import Rejected
from homography_servo.robot.robot_file import load_robot
from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.simulation.true_arm import ArmErrors
from homography_servo.simulation.true_arm import SILENT_S
from homography_servo.simulation.true_arm import TrueArm
import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

SEND_PERIOD_S = 0.002  # how often delayed pictures are looked at
# A picture is begun this long before the moment that it shows: soon after the last one, when
# nobody else works on an image yet.
RENDER_AHEAD_S, RENDER_AHEAD_SHARE = 0.0065, 0.8  # at most, and of the time between two
SHORTEST_S = 1e-4  # between two moments of exposure
MOST_WAITING = 2000


@dataclass(frozen=True)
class CameraSimSettings(Settings):
    """Camera, arm, and the time that pictures take."""

    robot_file: str = text('robix_rcs6.yaml', 'the arm that holds the box', read_only=True)
    camera_file: str = text('sim_640x480.yaml', 'the camera, in camera_info format',
                            read_only=True)
    rate_hz: float = real(30.0, 1.0, 240.0, 'Hz', 'pictures per second', read_only=True)
    encoding: str = text('mono8', 'encoding of the images', choices=('mono8', 'bgr8'),
                         read_only=True)
    reliable_images: bool = flag(False, 'send every image until it is received',
                                 read_only=True)
    seed: int = whole(1, 0, 2**31 - 1, '', 'seed of noise, clutter and dropped pictures',
                      read_only=True)
    delay_s: float = real(0.0, 0.0, 5.0, 's', 'time from exposure to publication')
    drop_share: float = real(0.0, 0.0, 1.0, '', 'share of pictures that are lost')
    focal_error: float = real(0.0, -0.5, 0.5, '', 'true focal length over the believed one, '
                              'minus 1')


class Shot(NamedTuple):
    """A picture that was taken and is not yet sent."""

    due_s: float
    stamp: Time
    scene_s: float
    index: int
    home_from_object: np.ndarray | None


class CameraSim(NodeKit, Node):
    """
    Render what the fixed camera would see of the box held by the arm.

    Shows the background alone until joint_states have come.
    """

    NAME = 'camera_sim'
    SETTINGS = (CameraSimSettings, ArmErrors, SceneSettings)
    CARRIES_IMAGES = True
    EXAMPLE = 'ros2 run homography_servo camera_sim --ros-args -p noise_grey:=5.0'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        settings = self._settings[CameraSimSettings]
        self._arm = TrueArm(load_named(load_robot, settings.robot_file, self.NAME, 'robot_file'))
        self._camera = load_named(load_camera, settings.camera_file, self.NAME, 'camera_file')
        problem = self._settings[ArmErrors].problem_with(self._arm.robot)
        if problem:
            raise ConfigError(self.NAME, 0, '', problem)
        self._info_msg = camera_info_msg(self._camera, Header())
        self._ahead_s = min(RENDER_AHEAD_S, RENDER_AHEAD_SHARE / settings.rate_hz)
        self._index, self._began_s, self._last_moment_s = 0, time.monotonic(), 0.0
        self._waiting: deque[Shot] = deque(maxlen=MOST_WAITING)
        self._sender = None
        self._drops = np.random.default_rng([settings.seed, 9])
        self._built: tuple = ()
        self._build()
        self.add_on_set_parameters_callback(self._check_errors)
        self._settings.on_change(self._build)
        self._publish_to(images_qos(settings.reliable_images))
        self.listen(JointState, 'joint_states', self._on_joints)
        self.every(1.0 / settings.rate_hz, self._expose)
        self.start_kit()

    def _publish_to(self, qos) -> None:
        self._image = self.create_publisher(Image, 'image', qos)
        self._info = self.create_publisher(CameraInfo, 'camera_info', qos)
        self._true_pose = self.create_publisher(PoseStamped, 'object/true_pose', 10)
        self._true_corners = self.create_publisher(PolygonStamped, 'object/true_corners', 10)

    def _check_errors(self, parameters) -> SetParametersResult:
        """Refuse errors of joints that this robot does not have."""
        known = {item.name for item in fields(ArmErrors)}
        news = {item.name: item.value or () for item in parameters if item.name in known}
        try:
            problem = replace(self._settings[ArmErrors], **news).problem_with(self._arm.robot)
        except (ValueError, TypeError) as error:
            problem = str(error)
        return SetParametersResult(successful=not problem, reason=problem or '')

    def _build(self) -> None:
        """Follow the settings; the scene is made anew only if they say so of it."""
        settings, robot = self._settings[CameraSimSettings], self._arm.robot
        self._arm.errors = self._settings[ArmErrors]
        wanted = (self._settings[SceneSettings], settings.focal_error)
        if wanted != self._built:  # takes a quarter of a second
            scale = 1.0 + settings.focal_error
            true_camera = replace(self._camera, fx=self._camera.fx * scale,
                                  fy=self._camera.fy * scale)
            self._scene = Scene(true_camera, robot.face_size_m, robot.box_height_m,
                                self._settings[SceneSettings], settings.seed)
            self._built = wanted
        if settings.delay_s > 0.0 and self._sender is None:
            self._sender = self.every(SEND_PERIOD_S, self._send_due)

    def _on_joints(self, msg: JointState) -> None:
        names = self._arm.robot.joint_names
        joints_rad = joints_from_state(msg, names)
        if isinstance(joints_rad, Rejected):
            self.reject('joint_states', joints_rad.reason)
            return
        now_ns = self.get_clock().now().nanoseconds
        age_s = 1e-9 * now_ns - seconds_from_stamp(msg.header.stamp)
        age_s = age_s if 0.0 <= age_s < SILENT_S else 0.0  # no stamp, or another clock's
        self._arm.report(joints_rad, velocity_from_state(msg, names), time.monotonic() - age_s)

    def _expose(self) -> None:
        """Freeze a moment a little ahead; its picture is rendered just before it is sent."""
        settings = self._settings[CameraSimSettings]
        now, now_s = self.get_clock().now(), time.monotonic()
        moment_s = max(self._arm.known_until(now_s + self._ahead_s),
                       self._last_moment_s + SHORTEST_S)
        self._last_moment_s = moment_s
        stamp = (now + Duration(seconds=moment_s - now_s)).to_msg()
        self._index += 1
        if self._drops.uniform() < settings.drop_share:
            self.count('dropped')
            return
        self._waiting.append(Shot(moment_s + settings.delay_s, stamp, moment_s - self._began_s,
                                  self._index, self._arm.home_from_object(moment_s)))
        self._send_due()

    def _send_due(self) -> None:
        while self._waiting and self._waiting[0].due_s <= time.monotonic() + self._ahead_s:
            self._send(self._waiting.popleft())

    def _send(self, shot: Shot) -> None:
        frame = self._scene.render(self._arm.in_camera(shot.home_from_object), shot.scene_s,
                                   shot.index)
        pixels = frame.image_grey
        if self._settings[CameraSimSettings].encoding == 'bgr8':
            pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
        header = Header(stamp=shot.stamp, frame_id='camera_optical')
        msg = image_msg(pixels, header)
        time.sleep(max(0.0, shot.due_s - time.monotonic()))  # rendering takes no time of its own
        self._image.publish(msg)
        self._info_msg.header = header
        self._info.publish(self._info_msg)
        if self._true_corners.get_subscription_count():
            self._true_corners.publish(polygon_msg(frame.true_corners_px, header))
        if frame.true_corners_px is not None and self._true_pose.get_subscription_count():
            self._true_pose.publish(pose_stamped_msg(
                shot.home_from_object, Header(stamp=shot.stamp, frame_id='home')))
        self.count('images')

    def diagnose(self) -> list[Health]:
        """Tell whether the arm is known and how many pictures went out."""
        known = self._arm.known
        return [Health('camera', OK if known else WARN,
                       'rendering' if known else 'no joint_states yet: background only',
                       {'images': self.counts['images'], 'dropped': self.counts['dropped']})]


def main(args=None) -> int:
    """Run the simulated camera."""
    return run_node(CameraSim, args)


if __name__ == '__main__':
    raise SystemExit(main())
