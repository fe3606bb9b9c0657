"""
Frames on ``/tf`` and ``/tf_static``, where tf2_msgs is installed; nothing elsewhere.

The tree is that of the URDF (`robot.urdf`), so a robot_state_publisher is not needed
and, where one runs, says the same.
"""

from __future__ import annotations

from typing import Any, Iterable, NamedTuple

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Transform
from geometry_msgs.msg import TransformStamped
from homography_servo.nodes.conversions import pose_msg
from homography_servo.robot.chain import after_turn
from homography_servo.robot.robot_model import Robot
import numpy as np
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

_MOVING = QoSProfile(depth=100)
_FIXED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Frame(NamedTuple):
    """A frame, the frame it hangs on, and (4, 4) parent_from_child."""

    parent: str
    child: str
    parent_from_child: np.ndarray


def camera_frames(home_depth_m: float) -> list[Frame]:
    """Give the virtual home frame, in front of the camera."""
    camera_from_home = np.eye(4)
    camera_from_home[2, 3] = home_depth_m
    return [Frame('camera_optical', 'home', camera_from_home)]


def fixed_frames(robot: Robot) -> list[Frame]:
    """Give the frames that do not move: home, base, flange, and the box in the gripper."""
    return [*camera_frames(robot.home_depth_m),
            Frame('home', 'base_link', robot.home_from_base),
            Frame(_links(robot)[-1], 'tool0', after_turn(robot.joints[-1])),
            Frame('tool0', 'box', robot.tool_from_object)]


def arm_frames(robot: Robot, joints_rad: np.ndarray) -> list[Frame]:
    """Give one frame for each joint, as the URDF has it: behind the turn of the joint."""
    links, before, frames = _links(robot), np.eye(4), []
    for index, (joint, angle_rad) in enumerate(zip(robot.joints, joints_rad)):
        cos, sin = np.cos(joint.theta0_rad + angle_rad), np.sin(joint.theta0_rad + angle_rad)
        turn = np.eye(4)
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
        frames.append(Frame(links[index], links[index + 1], before @ turn))
        before = after_turn(joint)
    return frames


def _links(robot: Robot) -> list[str]:
    return ['base_link', *(f'{joint.name}_link' for joint in robot.joints)]


class Transforms:
    """Sends frames; does nothing, and costs nothing, where tf2_msgs cannot be imported."""

    def __init__(self, node: Any, fixed: Iterable[Frame] = ()) -> None:
        try:
            from tf2_msgs.msg import TFMessage  # not among the wheels of the package index
        except ImportError:
            self._kind = None
            return
        self._kind = TFMessage
        self._moving = node.create_publisher(TFMessage, '/tf', _MOVING)
        self._fixed = node.create_publisher(TFMessage, '/tf_static', _FIXED)
        self._fixed.publish(self._message(fixed, node.get_clock().now().to_msg()))

    def send(self, frames: Iterable[Frame], stamp: Time) -> None:
        """Send frames that move."""
        if self._kind is not None:
            self._moving.publish(self._message(frames, stamp))

    def send_arm(self, robot: Robot, joints_rad: np.ndarray, stamp: Time) -> None:
        """Send the frames of an arm."""
        if self._kind is not None:
            self.send(arm_frames(robot, joints_rad), stamp)

    def _message(self, frames: Iterable[Frame], stamp: Time) -> Any:
        return self._kind(transforms=[_transform_msg(frame, stamp) for frame in frames])


def _transform_msg(frame: Frame, stamp: Time) -> TransformStamped:
    pose, transform = pose_msg(frame.parent_from_child), Transform()
    place = transform.translation
    place.x, place.y, place.z = pose.position.x, pose.position.y, pose.position.z
    transform.rotation = pose.orientation
    return TransformStamped(header=Header(stamp=stamp, frame_id=frame.parent),
                            child_frame_id=frame.child, transform=transform)
