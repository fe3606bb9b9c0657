"""Where the box really is: the arm's joints, and what nobody knows about the arm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import inverse
from homography_servo.geometry.rigid import transform
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
from homography_servo.settings import reals
from homography_servo.settings import Settings
import numpy as np

SILENT_S = 0.5
EXTRAPOLATE_S = 0.05  # joint states come every 20 ms; older ones are held


@dataclass(frozen=True)
class ArmErrors(Settings):
    """By how much the real arm differs from the robot file that everybody believes."""

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

    def problem_with(self, robot: Robot) -> str | None:
        """Say why these errors do not fit an arm, or None."""
        given, needed = len(self.joint_zero_error_rad), len(robot.joint_names)
        if given in (0, needed):
            return None
        return f'joint_zero_error_rad must have {needed} items or none, got {given}'


def true_home_from_object(robot: Robot, joints_rad: np.ndarray, errors: ArmErrors) -> np.ndarray:
    """
    Give the true pose of the object.

    Parameters
    ----------
    robot : Robot
        The arm as it is believed to be.
    joints_rad : (n,) array
        The joints as the arm reports them.
    errors : ArmErrors
        What the reports and the robot file do not say.

    Returns
    -------
    (4, 4) array
        home_from_object.

    """
    problem = errors.problem_with(robot)
    if problem:
        raise ValueError(problem)
    if errors.joint_zero_error_rad:
        joints_rad = joints_rad + np.array(errors.joint_zero_error_rad)
    # The placement error turns about the base, not about the camera.
    home_from_foot = transform(np.eye(3), robot.home_from_base[:3, 3])
    shifted = _error(errors.placement_error_m, errors.placement_error_rad)
    placed = home_from_foot @ shifted @ inverse(home_from_foot)
    return placed @ object_pose(robot, joints_rad) @ _error(errors.grip_error_m,
                                                            errors.grip_error_rad)


@lru_cache(maxsize=16)
def _error(shift_m: tuple[float, ...], turn_rad: tuple[float, ...]) -> np.ndarray:
    """Make a (4, 4) transform of a shift and a rotation vector; empty means none."""
    error = exp_twist(np.array([0.0, 0.0, 0.0, *(turn_rad or (0.0,) * 3)]))
    error[:3, 3] = shift_m or (0.0,) * 3
    return error


class TrueArm:
    """
    The arm between its reports: moves on for a moment, then holds still.

    Times are seconds of one clock of the caller.
    """

    def __init__(self, robot: Robot, errors: ArmErrors = ArmErrors()) -> None:
        self.robot = robot
        self.errors = errors
        self._joints_rad: np.ndarray | None = None
        self._velocity_rad_s: np.ndarray = np.zeros(len(robot.joint_names))
        self._reported_s = 0.0

    @property
    def known(self) -> bool:
        """Tell whether the arm has ever reported."""
        return self._joints_rad is not None

    def report(self, joints_rad: np.ndarray, velocity_rad_s: np.ndarray | None,
               time_s: float) -> None:
        """Take joints (n,) and their velocity, which counts as zero where it is unusable."""
        self._velocity_rad_s = np.zeros(len(joints_rad))
        if velocity_rad_s is not None and np.isfinite(velocity_rad_s).all():
            self._velocity_rad_s = velocity_rad_s
        self._joints_rad, self._reported_s = joints_rad, time_s

    def known_until(self, time_s: float) -> float:
        """
        Give the last moment up to a time at which it is known where the arm is.

        On a busy machine reports come late. A picture made now of an arm as it was is a
        picture of then; an arm that has long been silent is taken to stand still.
        """
        silent_s = time_s - self._reported_s
        if self._joints_rad is None or silent_s > SILENT_S:
            return time_s
        return min(time_s, self._reported_s + EXTRAPOLATE_S)

    def home_from_object(self, time_s: float) -> np.ndarray | None:
        """Give the true pose (4, 4) at a time, None before the first report."""
        if self._joints_rad is None:
            return None
        ahead_s = min(max(time_s - self._reported_s, 0.0), EXTRAPOLATE_S)
        joints_rad = self._joints_rad + ahead_s * self._velocity_rad_s
        return true_home_from_object(self.robot, joints_rad, self.errors)

    def in_camera(self, home_from_object: np.ndarray | None) -> np.ndarray | None:
        """Give camera_from_object of home_from_object."""
        if home_from_object is None:
            return None
        camera_from_home = transform(np.eye(3), np.array([0.0, 0.0, self.robot.home_depth_m]))
        return camera_from_home @ home_from_object
