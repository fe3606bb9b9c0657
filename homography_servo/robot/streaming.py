"""Targets for the servos along a trajectory: whole numbers, and never two too far apart."""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.robot.governor import StepRoom
from homography_servo.robot.robot_model import Robot
from homography_servo.robot.servo_units import from_units
from homography_servo.robot.servo_units import to_units
from homography_servo.robot.servo_units import unit_range
from homography_servo.robot.servo_units import velocity_units_s
from homography_servo.robot.trajectory import State
from homography_servo.robot.trajectory import Trajectory
import numpy as np

_HALVINGS = 7
# A process that slept goes on from where it was, it does not jump after the clock.
_LONGEST_STEP_S = 0.1


class Target(NamedTuple):
    """What to send now."""

    units: np.ndarray  # (n,) int, in joint order
    joints_rad: np.ndarray  # (n,) before rounding
    late_s: float  # how far the motion is behind its own times
    done: bool  # the trajectory has ended, or there is none


class TargetStream:
    """
    Walk along trajectories, one target a step.

    A target is where the servos shall be one period after it is sent, when the next one
    comes: so a new trajectory shows in its first target.

    The speed between any two targets is kept below the velocity limits as it will be on the
    wire: after rounding and by the times at which they are sent. Where the trajectory wants
    more, because steps come late or rounding adds up, it is followed later: all joints wait
    together. How much later is in each target (`late_s`).

    Parameters
    ----------
    robot : Robot
        Limits and servo mapping.
    units : (n,) array of int
        Where the servos are told to be now.
    now_s : float
        The time of any steady clock.
    margin_rad : float
        Margin of the limits at which rounding goes inwards.
    period_s, shortest_s : float
        Usual and shortest time between two steps.

    """

    def __init__(self, robot: Robot, units: np.ndarray, now_s: float, margin_rad: float = 0.0,
                 period_s: float = 0.02, shortest_s: float = 0.02) -> None:
        self._robot = robot
        self._margin_rad = margin_rad
        self._period_s = period_s
        self._room = StepRoom(velocity_units_s(robot), shortest_s, now_s)
        self._range = unit_range(robot, margin_rad)
        self.restart(units, now_s)

    def restart(self, units: np.ndarray, now_s: float) -> None:
        """Stand still where the servos are told to be, as after a stop of the device."""
        self._units = np.array(units, dtype=int)
        self._room.start(now_s)
        self._now_s = float(now_s)
        self._trajectory: Trajectory | None = None
        self._joints = from_units(self._robot, self._units)
        self._path_s = self._late_s = 0.0

    @property
    def state(self) -> State:
        """Positions and velocities of the last target, before rounding: where a stop starts."""
        return self._state(self._period_s)

    def state_at(self, now_s: float) -> State:
        """
        Give positions and velocities commanded now: where a new trajectory starts.

        That is between two targets. A trajectory that began at the last one would stand
        still from then until now: commands that come faster than steps would stop the arm.
        """
        return self._state(min(max(now_s - self._now_s, 0.0), self._period_s))

    def _state(self, ahead_s: float) -> State:
        if self._trajectory is None:
            return State(self._joints, np.zeros(self._robot.count))
        sample = self._trajectory.sample(self._path_s + ahead_s)
        return State(sample.positions, sample.velocities)

    @property
    def trajectory(self) -> Trajectory | None:
        """Give what is followed now, if anything."""
        return self._trajectory

    def follow(self, trajectory: Trajectory, now_s: float) -> None:
        """Replace what is followed; the trajectory starts at the `state_at` of now."""
        self._trajectory = trajectory
        self._path_s = self._late_s = 0.0
        self._now_s = float(now_s)

    def step(self, now_s: float) -> Target:
        """Give the target for a time, which must not run backwards."""
        passed_s = max(now_s - self._now_s, 0.0)
        self._now_s = max(float(now_s), self._now_s)
        if self._trajectory is None:
            self._room.took(np.zeros(self._robot.count), self._now_s)
            return self._target()
        units, advance_s = self._reachable(self._trajectory, min(passed_s, _LONGEST_STEP_S))
        self._room.took(units - self._units, self._now_s)
        self._units = units
        self._path_s += advance_s
        self._late_s += passed_s - advance_s
        aim_s = self._path_s + self._period_s
        self._joints = self._trajectory.sample(aim_s).positions
        if aim_s >= self._trajectory.duration_s:
            self._trajectory, self._path_s = None, 0.0
        return self._target()

    def _target(self) -> Target:
        return Target(self._units.copy(), self._joints, self._late_s, self._trajectory is None)

    def _reachable(self, trajectory: Trajectory, passed_s: float) -> tuple[np.ndarray, float]:
        """Find the largest advance along the path, up to the time passed, that keeps speed."""
        units = self._units_at(trajectory, passed_s)
        if self._slow_enough(units):
            return units, passed_s
        low_s, high_s, best = 0.0, passed_s, self._towards(self._units_at(trajectory, 0.0))
        for _ in range(_HALVINGS):
            middle_s = 0.5 * (low_s + high_s)
            units = self._units_at(trajectory, middle_s)
            if self._slow_enough(units):
                low_s, best = middle_s, units
            else:
                high_s = middle_s
        return best, low_s

    def _units_at(self, trajectory: Trajectory, advance_s: float) -> np.ndarray:
        joints = trajectory.sample(self._path_s + advance_s + self._period_s).positions
        units = to_units(self._robot, joints, self._margin_rad)
        # A trajectory keeps the limits; a servo that started outside them may only come back.
        return np.clip(units, np.minimum(self._range.low, self._units),
                       np.maximum(self._range.high, self._units))

    def _slow_enough(self, units: np.ndarray) -> bool:
        return bool(np.all(np.abs(units - self._units) <= self._allowed()))

    def _towards(self, units: np.ndarray) -> np.ndarray:
        """Go as far towards a target as the speed allows, all joints by the same share."""
        way = units - self._units
        share = np.min(self._allowed() / np.maximum(np.abs(way), 1))
        return self._units + np.trunc(min(share, 1.0) * way).astype(int)

    def _allowed(self) -> np.ndarray:
        """Give the largest step (n,) that each servo may make now."""
        return self._room.at(self._now_s) + 1e-9
