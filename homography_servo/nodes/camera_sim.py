"""The simulated camera as a ROS node: the arm's joints in, pictures of the box out."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from dataclasses import replace
import time

from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseStamped
from homography_servo.errors import ConfigError
from homography_servo.geometry.camera import load_camera
from homography_servo.geometry.rigid import exp_twist
from homography_servo.nodes.conversions import camera_info_msg
from homography_servo.nodes.conversions import image_msg
from homography_servo.nodes.conversions import joints_from_state
from homography_servo.nodes.conversions import polygon_msg
from homography_servo.nodes.conversions import pose_stamped_msg
from homography_servo.nodes.conversions import velocity_from_state
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import images_qos
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import WARN
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.run import run_node
from homography_servo.places import find_config
from homography_servo.result import Rejected
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import reals
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

EXTRAPOLATE_S = 0.05


@dataclass(frozen=True)
class CameraSimSettings(Settings):
    """
    Camera, arm, timing, and by how much the real arm differs from the believed one.

    The errors are what the rest of the program does not know: it believes the robot
    and camera files.
    """

    robot_file: str = text('robix_rcs6.yaml', 'the arm that holds the box', read_only=True)
    camera_file: str = text('sim_640x480.yaml', 'the camera, in camera_info format',
                            read_only=True)
    rate_hz: float = real(30.0, 1.0, 240.0, 'Hz', 'pictures per second', read_only=True)
    reliable_images: bool = flag(False, 'send every image until it is received',
                                 read_only=True)
    seed: int = whole(1, 0, 2**31 - 1, '', 'seed of noise, clutter and dropped pictures',
                      read_only=True)
    delay_s: float = real(0.0, 0.0, 5.0, 's', 'time from exposure to publication')
    drop_share: float = real(0.0, 0.0, 1.0, '', 'share of pictures that are lost')
    placement_error_m: tuple[float, ...] = reals(
        (0.0, 0.0, 0.0), 'm', 'how far the robot stands from where it is believed, home axes',
        length=3, low=-1.0, high=1.0)
    placement_error_rad: tuple[float, ...] = reals(
        (0.0, 0.0, 0.0), 'rad', 'how far the robot is turned from where it is believed, as a '
        'rotation vector about the base, home axes', length=3, low=-3.2, high=3.2)
    grip_error_m: tuple[float, ...] = reals(
        (0.0, 0.0, 0.0), 'm', 'how far the box sits from where it is believed, object axes',
        length=3, low=-1.0, high=1.0)
    grip_error_rad: tuple[float, ...] = reals(
        (0.0, 0.0, 0.0), 'rad', 'how far the box is turned in the hand, rotation vector, '
        'object axes', length=3, low=-3.2, high=3.2)
    joint_zero_error_rad: tuple[float, ...] = reals(
        (), 'rad', 'true minus believed joint angle, one per joint', low=-1.0, high=1.0)
    focal_error: float = real(0.0, -0.5, 0.5, '', 'true focal length over the believed one, '
                              'minus 1')


def true_home_from_object(robot, joints_rad: np.ndarray, settings: CameraSimSettings):
    """Give where the box really is (4, 4), with all errors of the settings."""
    if len(settings.joint_zero_error_rad) == len(joints_rad):
        joints_rad = joints_rad + settings.joint_zero_error_rad
    believed = object_pose(robot, joints_rad)
    # The placement error turns about the base, not about the camera.
    base = np.eye(4)
    base[:3, 3] = robot.home_from_base[:3, 3]
    placed = base @ _error(settings.placement_error_m, settings.placement_error_rad) \
        @ np.linalg.inv(base)
    return placed @ believed @ _error(settings.grip_error_m, settings.grip_error_rad)


def _error(shift_m: tuple[float, ...], turn_rad: tuple[float, ...]) -> np.ndarray:
    """Make a (4, 4) transform of a shift and a rotation vector; empty means none."""
    error = exp_twist(np.array([0.0, 0.0, 0.0, *(turn_rad or (0.0,) * 3)]))
    error[:3, 3] = shift_m or (0.0,) * 3
    return error


class CameraSim(NodeKit, Node):
    """
    Render what the fixed camera would see of the box held by the arm.

    Shows the background alone until joint_states have come.
    """

    NAME = 'camera_sim'
    SETTINGS = (CameraSimSettings, SceneSettings)
    EXAMPLE = 'ros2 run homography_servo camera_sim --ros-args -p noise_grey:=5.0'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        self._settings.on_change(self._build)
        settings = self._settings[CameraSimSettings]
        self._robot = _load(load_robot, 'robot_file', settings.robot_file)
        self._camera = _load(load_camera, 'camera_file', settings.camera_file)
        self._index, self._began_s = 0, time.monotonic()
        self._joints_rad: np.ndarray | None = None
        self._velocity_rad_s: np.ndarray | None = None
        self._joints_s = 0.0
        self._waiting: deque = deque()
        self._drops = np.random.default_rng([settings.seed, 9])
        self._build()
        self._publish_to(images_qos(settings.reliable_images))
        self.listen(JointState, 'joint_states', self._on_joints)
        self.every(1.0 / settings.rate_hz, self._expose)
        self.start_kit()

    def _publish_to(self, qos) -> None:
        self._image = self.create_publisher(Image, 'image', qos)
        self._info = self.create_publisher(CameraInfo, 'camera_info', qos)
        self._true_pose = self.create_publisher(PoseStamped, 'object/true_pose', 10)
        self._true_corners = self.create_publisher(PolygonStamped, 'object/true_corners', 10)

    def _build(self) -> None:
        """Make the scene anew, as the settings now say."""
        settings, robot = self._settings[CameraSimSettings], self._robot
        true_camera = replace(self._camera, fx=self._camera.fx * (1.0 + settings.focal_error),
                              fy=self._camera.fy * (1.0 + settings.focal_error))
        self._scene = Scene(true_camera, robot.face_size_m, robot.box_height_m,
                            self._settings[SceneSettings], settings.seed)

    def _on_joints(self, msg: JointState) -> None:
        joints_rad = joints_from_state(msg, self._robot.joint_names)
        if isinstance(joints_rad, Rejected):
            self.reject('joint_states', joints_rad.reason)
            return
        velocity = velocity_from_state(msg, self._robot.joint_names)
        usable = velocity is not None and np.isfinite(velocity).all()
        self._joints_rad, self._joints_s = joints_rad, time.monotonic()
        self._velocity_rad_s = velocity if usable else np.zeros(len(joints_rad))

    def _pose_now(self) -> np.ndarray | None:
        """Give the true home_from_object at the moment of exposure."""
        if self._joints_rad is None:
            return None
        ahead_s = min(time.monotonic() - self._joints_s, EXTRAPOLATE_S)
        joints_rad = self._joints_rad + ahead_s * self._velocity_rad_s
        return true_home_from_object(self._robot, joints_rad, self._settings[CameraSimSettings])

    def _expose(self) -> None:
        settings = self._settings[CameraSimSettings]
        stamp, now_s = self.get_clock().now().to_msg(), time.monotonic()
        home_from_object = self._pose_now()
        self._index += 1
        if self._drops.uniform() < settings.drop_share:
            self.count('dropped')
        else:
            frame = self._render(home_from_object, now_s - self._began_s)
            self._waiting.append((now_s + settings.delay_s, stamp, frame, home_from_object))
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            self._send(*self._waiting.popleft()[1:])

    def _render(self, home_from_object: np.ndarray | None, time_s: float):
        camera_from_object = None
        if home_from_object is not None:
            camera_from_object = home_from_object.copy()
            camera_from_object[2, 3] += self._robot.home_depth_m
        return self._scene.render(camera_from_object, time_s, self._index)

    def _send(self, stamp, frame, home_from_object: np.ndarray | None) -> None:
        header = Header(stamp=stamp, frame_id='camera_optical')
        self._image.publish(image_msg(frame.image_grey, header))
        self._info.publish(camera_info_msg(self._camera, header))
        self.count('images')
        self._true_corners.publish(polygon_msg(frame.true_corners_px, header))
        if home_from_object is not None and frame.true_corners_px is not None:
            self._true_pose.publish(pose_stamped_msg(
                home_from_object, Header(stamp=stamp, frame_id='home')))

    def diagnose(self) -> list[Health]:
        """Tell whether the arm is known and how many pictures went out."""
        arm = self._joints_rad is not None
        return [Health('camera', OK if arm else WARN,
                       'rendering' if arm else 'no joint_states yet: background only',
                       {'images': self.counts['images'], 'dropped': self.counts['dropped']})]


def _load(loader, key: str, name: str):
    try:
        return loader(find_config(name))
    except FileNotFoundError as error:
        raise ConfigError(CameraSim.NAME, 0, key, str(error)) from error


def main(args=None) -> int:
    """Run the simulated camera."""
    return run_node(CameraSim, args)


if __name__ == '__main__':
    raise SystemExit(main())
