"""The move that is under way: where it leads, when it is due, whether it is done."""

from __future__ import annotations

import math

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.command import Command
from homography_servo.planning.control import corner_travel
from homography_servo.planning.control import limit_step
from homography_servo.planning.control import move_time
from homography_servo.planning.control import Step
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_watch import Watch
from homography_servo.result import required
from homography_servo.robot.robot_file import Robot
import numpy as np

ARRIVED_RAD = 1.2e-3  # a little over one unit of a hobby servo
SHORTEST_MOVE_S = 0.04
SHORT_S = 0.2
OVERDUE_S = 1.0


class Moves:
    """
    Make moves from where the joints are, and follow them by joint states.

    Parameters
    ----------
    robot : Robot
        Limits.
    watch : Watch
        Where the joints are, and the focal length.

    """

    def __init__(self, robot: Robot, watch: Watch) -> None:
        self._robot, self._watch = robot, watch
        self.target_rad: np.ndarray | None = None
        self._left_rad: np.ndarray | None = None  # where the joints were at the last command
        self.due_s = -math.inf  # when it ends
        self._due_unset_s = -math.inf  # the same by stamps, were no clock set

    @property
    def goal_rad(self) -> np.ndarray:
        """Give `target_rad`; ValueError before the first move."""
        return required(self.target_rad, 'move')

    @property
    def due_stamp_s(self) -> float:
        """Give when it ends by the stamps of joint states."""
        return self._due_unset_s + self._watch.joints.clock_set_s

    @property
    def length_rad(self) -> float:
        """Give the largest joint motion of the last move."""
        return 0.0 if self._left_rad is None else \
            float(np.abs(self.goal_rad - self._left_rad).max())

    @property
    def arrived(self) -> bool:
        """Tell whether the joints stand at the target, and had the time to get there."""
        joints = self._watch.joints
        near = np.abs(joints.known_rad - self.goal_rad).max() < ARRIVED_RAD
        return bool(joints.still and near and joints.latest_stamp_s >= self.due_stamp_s)

    @property
    def began(self) -> bool:
        """Tell whether the joints have left the start of the move."""
        left_rad = required(self._left_rad, 'move')
        return bool(np.abs(self._watch.joints.known_rad - left_rad).max() > ARRIVED_RAD)

    def stopped_short(self, now_s: float) -> bool:
        """Tell whether the joints went and stand, after their time, but elsewhere."""
        return self._watch.joints.still and self.began and now_s > self.due_s + SHORT_S

    def overdue(self, now_s: float) -> bool:
        """Tell whether the joints should have arrived long ago."""
        return now_s > self.due_s + OVERDUE_S

    def step_to(self, model: ArmModel, wanted_rad: np.ndarray, settings: ServoSettings) -> Step:
        """Shorten the way to wanted joints to what limits and tracker allow."""
        here_rad = self._watch.joints.known_rad
        step = limit_step(self._robot, here_rad, wanted_rad, settings.servo_margin_rad,
                          settings.move_max_rad)
        travel_px = self._travel_px(model, step.joints_rad)
        if travel_px <= settings.corner_move_px:
            return step
        share = settings.corner_move_px / travel_px
        return Step(here_rad + share * (step.joints_rad - here_rad), share * step.share,
                    step.limited_by or 'step')

    def go(self, model: ArmModel, target_rad: np.ndarray, settings: ServoSettings, now_s: float
           ) -> Command:
        """Give the command to joints, in the shortest time that arm and tracker can follow."""
        way_rad = target_rad - self._watch.joints.known_rad
        time_s = max(SHORTEST_MOVE_S, move_time(self._robot, way_rad) / settings.speed_share,
                     self._travel_px(model, target_rad) / settings.corner_speed_px_s)
        return self.follow(Command.to(target_rad, time_s), now_s)

    def follow(self, command: Command, now_s: float) -> Command:
        """Note a command that is sent now."""
        joints = self._watch.joints
        self._left_rad, self.target_rad = joints.latest_rad, command.joints_rad
        self.due_s = now_s + command.time_s
        self._due_unset_s = joints.latest_stamp_s + command.time_s - joints.clock_set_s
        return command

    def _travel_px(self, model: ArmModel, target_rad: np.ndarray) -> float:
        return required(self._watch.focal_px, 'camera') * corner_travel(
            model, self._watch.joints.known_rad, target_rad, self._robot.object_points_m,
            self._robot.home_depth_m)
