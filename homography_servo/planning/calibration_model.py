"""Where the corners should be seen, as a function of what a calibration may change."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import transform_points
from homography_servo.robot.kinematics import forward
from homography_servo.robot.robot_file import Robot
import numpy as np

BEHIND_PX = 1e4  # for points behind the camera: far from any image, and finite
_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class PlacementModel:
    """
    The views of an arm whose placement, grip and joint zeros may be a little off.

    A change is a vector: difference of home_from_base (6), of tool_from_object (6), both as
    `homography_servo.geometry.rigid.displaced` takes them, then the joint offsets [rad].

    Parameters
    ----------
    robot : Robot
        What is believed.
    camera : Camera
        Taken as exact.
    joint_offsets : bool
        Joint zeros may be off too, those between the first and the last joint: a first or
        last joint that is off cannot be told from a turned placement or grip.

    """

    robot: Robot
    camera: Camera
    joint_offsets: bool = False

    @property
    def size(self) -> int:
        """Length of the vector of changes."""
        return 12 + (max(self.robot.count - 2, 0) if self.joint_offsets else 0)

    def offsets_rad(self, change: np.ndarray) -> np.ndarray:
        """Give the joint offsets (n,) of a change."""
        offsets = np.zeros(self.robot.count)
        if self.size > 12:
            offsets[1:-1] = change[12:]
        return offsets

    def changed(self, change: np.ndarray) -> Robot:
        """Build the robot that a change describes."""
        offsets = self.offsets_rad(change)
        joints = tuple(replace(joint, theta0_rad=joint.theta0_rad + float(offset))
                       for joint, offset in zip(self.robot.joints, offsets))
        return replace(self.robot, joints=joints,
                       home_from_base=displaced(self.robot.home_from_base, change[:6]),
                       tool_from_object=displaced(self.robot.tool_from_object, change[6:12]))

    def points_camera_m(self, change: np.ndarray, joints_rad: np.ndarray) -> np.ndarray:
        """Give the object's points (K, N, 3) in the camera's frame for joints (K, n)."""
        home_from_base = displaced(self.robot.home_from_base, change[:6])
        tool_from_object = displaced(self.robot.tool_from_object, change[6:12])
        base_from_tool = forward(self.robot, joints_rad + self.offsets_rad(change))
        home_from_object = home_from_base @ base_from_tool @ tool_from_object
        points = transform_points(home_from_object, self.robot.object_points_m)
        return points + (0.0, 0.0, self.robot.home_depth_m)

    def points_px(self, change: np.ndarray, joints_rad: np.ndarray) -> np.ndarray:
        """Give the pixels (K, N, 2) for joints (K, n)."""
        pixels = self.camera.project(self.points_camera_m(change, joints_rad))
        return np.where(np.isfinite(pixels), pixels, BEHIND_PX)

    def jacobian(self, change: np.ndarray, joints_rad: np.ndarray) -> np.ndarray:
        """Differentiate the pixels by the change: (K, 2 N, size), central differences."""
        columns = []
        for index in range(self.size):
            step = np.zeros(self.size)
            step[index] = _STEP
            ahead = self.points_px(change + step, joints_rad)
            behind = self.points_px(change - step, joints_rad)
            slope = (ahead - behind) / (2.0 * _STEP)
            columns.append(slope.reshape(len(slope), slope.shape[1] * 2))
        return np.stack(columns, axis=-1)
