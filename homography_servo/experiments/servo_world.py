"""
A world without images for the servo: an arm, a camera, messages that take time.

The servo under test gets exactly what its node would hand to it: joint states at
50 Hz, measured poses of frames at a rate and with a delay. What is simulated is
ideal otherwise: commands arrive after a fixed delay and are carried out as cubics in
time, joints are rounded to servo units. Faults are switched on by attributes.
"""

from __future__ import annotations

from copy import copy
import heapq
import math
from typing import Any, Callable

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.command import Command
from homography_servo.planning.control import move_time
from homography_servo.planning.servo import Servo
from homography_servo.robot.robot_file import Robot
import numpy as np

JOINT_PERIOD_S = 0.02
TICK_S = 0.02
CLEARLY_MOVING_RAD = 0.005  # in 40 ms: no servo can take this for rest

# A measurement: home_from_object and its (6, 6) covariance, or None when nothing is seen.
Measure = Callable[[np.ndarray], Any]


class CubicMotion:
    """The joints of an arm: cubics from where and how fast they are through points."""

    def __init__(self, joints_rad: np.ndarray) -> None:
        joints = np.array(joints_rad, dtype=float)
        self._before: CubicMotion | None = None
        self._start_s = 0.0
        self._times_s = np.array([0.0, 1e-3])
        self._points = np.array([joints, joints])
        self._speeds = np.zeros_like(self._points)

    def at(self, time_s: float) -> np.ndarray:
        """Give the joints at a time."""
        return self._both(time_s)[0]

    def _both(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        if time_s < self._start_s and self._before is not None:
            return self._before._both(time_s)
        time_s = max(time_s - self._start_s, 0.0)
        if time_s >= self._times_s[-1]:
            return self._points[-1], np.zeros(self._points.shape[1])
        k = min(int(np.searchsorted(self._times_s, time_s, 'right')), len(self._times_s) - 1)
        span = self._times_s[k] - self._times_s[k - 1]
        u = (time_s - self._times_s[k - 1]) / span
        way = self._points[k] - self._points[k - 1]
        v0, v1 = self._speeds[k - 1] * span, self._speeds[k] * span
        a, b = v0 + v1 - 2.0 * way, 3.0 * way - 2.0 * v0 - v1
        return (self._points[k - 1] + u * (v0 + u * (b + u * a)),
                (v0 + u * (2.0 * b + 3.0 * u * a)) / span)

    def go(self, command: Command, time_s: float, decel_rad_s2: np.ndarray) -> None:
        """Take a command; a stop brakes with the joints' deceleration."""
        here, speed = self._both(time_s)
        self._before = copy(self)  # what was so until now
        self._before._before = None
        if command.joints_rad is None:
            span = max(float((np.abs(speed) / decel_rad_s2).max()), 1e-3)
            command = Command.to(here + 0.5 * speed * span, span)
        self._start_s = time_s
        self._times_s = np.append(0.0, command.times_s)
        self._points = np.vstack([here, command.points_rad])
        self._speeds = np.vstack([speed, command.velocities_rad_s])


class ServoWorld:
    """
    Run a servo against a true arm that differs from the believed one.

    Parameters
    ----------
    servo : Servo
        What is tested.
    truth : ArmModel
        The true arm, from commanded joints to the object.
    joints_rad : (n,) array
        Commanded joints at the start.
    measure : callable
        From the true pose of the object to ``(home_from_object, covariance)`` or None;
        asked only while the arm stands, unless `measure_moving`.
    frame_hz, delay_s : float
        Rate of frames, and time from exposure to the servo.

    """

    def __init__(self, servo: Servo, truth: ArmModel, joints_rad: np.ndarray, measure: Measure,
                 frame_hz: float = 30.0, delay_s: float = 0.015,
                 command_delay_s: float = 0.005) -> None:
        self.servo, self.truth, self.robot = servo, truth, truth.robot
        self.measure, self.measure_moving = measure, False
        self.see, self.feel, self.obey = True, True, True
        self.now_s, self.stamp_offset_s = 100.0, 1e6
        self.lag_s = 0.0  # by which images are older than their stamps say
        self.commands: list[tuple[float, Command]] = []
        self.states: list[tuple[float, str]] = []
        self.trace: list[tuple[np.ndarray, np.ndarray]] = []  # true pose, joints, per frame
        self._motion = CubicMotion(joints_rad)
        self._command_delay_s, self._delay_s = command_delay_s, delay_s
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = 0
        for period_s, happen in ((JOINT_PERIOD_S, self._joint_state), (TICK_S, lambda: None),
                                 (1.0 / frame_hz, self._frame)):
            self._every(period_s, happen)

    def joints_at(self, time_s: float) -> np.ndarray:
        """Give the commanded, interpolated joints, rounded as servos do."""
        return rounded(self.robot, self._motion.at(time_s))

    @property
    def true_pose(self) -> np.ndarray:
        """Give the true home_from_object now."""
        return self.truth.pose(self.joints_at(self.now_s))

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Let time pass, or until something is so."""
        end_s = self.now_s + seconds
        while self._events[0][0] <= end_s and not until():
            self.now_s, _, happen = heapq.heappop(self._events)
            happen()
            self._tick()
        if not until():
            self.now_s = end_s

    def finish(self, seconds: float = 120.0) -> None:
        """Start the servo and run until it has ended."""
        self.run(0.4)
        answer = self.servo.start(self.now_s)
        if not answer:
            raise ValueError(f'the servo does not start: {answer}')
        self.run(seconds, lambda: not self.servo.active)

    def drive(self, joints_rad: np.ndarray) -> None:
        """Move the arm from outside, as an operator does, and wait until it stands there."""
        way = joints_rad - self._motion.at(self.now_s)
        time_s = move_time(self.robot, way)
        self._motion.go(Command.to(joints_rad, time_s), self.now_s, self.robot.acceleration_rad_s2)
        self.run(time_s + 0.1)

    def _at(self, time_s: float, happen: Callable[[], None]) -> None:
        self._order += 1
        heapq.heappush(self._events, (time_s, self._order, happen))

    def _every(self, period_s: float, happen: Callable[[], None]) -> None:
        def again() -> None:
            happen()
            self._at(self.now_s + period_s, again)
        self._at(self.now_s + period_s * (0.1 + 0.8 * math.modf(1.0 / period_s * 0.37)[0]), again)

    def _tick(self) -> None:
        command = self.servo.tick(self.now_s)
        text = self.servo.state_text
        if not self.states or self.states[-1][1] != text:
            self.states.append((self.now_s, text))
        if command is None:
            return
        self.commands.append((self.now_s, command))
        if self.obey:
            self._at(self.now_s + self._command_delay_s, lambda: self._motion.go(
                command, self.now_s, self.robot.acceleration_rad_s2))

    def _joint_state(self) -> None:
        if self.feel:
            self.servo.add_joints(self.joints_at(self.now_s),
                                  self.now_s + self.stamp_offset_s, self.now_s)

    def _frame(self) -> None:
        true_pose = self.truth.pose(self.joints_at(self.now_s - self.lag_s))
        stamp_s = self.now_s + self.stamp_offset_s
        self.trace.append((true_pose, self.joints_at(self.now_s)))
        if not self.see:
            return
        before, after = (self._motion.at(self.now_s - self.lag_s + d) for d in (-0.02, 0.02))
        moving = bool(np.abs(after - before).max() > CLEARLY_MOVING_RAD)
        seen = self.measure(true_pose) if self.measure_moving or not moving \
            else (true_pose, 1e-6 * np.eye(6))
        if seen is not None:
            self._at(self.now_s + self._delay_s,
                     lambda: self.servo.add_look(*seen, stamp_s, self.now_s))


def rounded(robot: Robot, joints_rad: np.ndarray) -> np.ndarray:
    """Round joints to whole servo units."""
    units = robot.zero_units + robot.units_per_rad * joints_rad
    return (np.round(units) - robot.zero_units) / robot.units_per_rad
