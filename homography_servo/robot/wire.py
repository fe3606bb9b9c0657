"""
An arm's joints on the servos of a device: which servo, which numbers, which lines.

The device is told the arm's limits too, so that it refuses what this program should
never send: a second line of defence.
"""

from __future__ import annotations

import math
from typing import Sequence

from homography_servo.errors import LinkError
from homography_servo.robot.protocol import goto_text
from homography_servo.robot.protocol import MAX_LINE
from homography_servo.robot.protocol import TAIL
from homography_servo.robot.robot_model import Robot
from homography_servo.robot.servo_units import acceleration_units_s2
from homography_servo.robot.servo_units import from_units
from homography_servo.robot.servo_units import to_units
from homography_servo.robot.servo_units import unit_range
from homography_servo.robot.servo_units import velocity_units_s
from homography_servo.robot.session import BITS_PER_BYTE
import numpy as np

FASTEST_HZ = 50.0
LEAST_GAP_S = 0.005  # a quarter of the usual tick of the device
BURST = 3  # targets that may go out early, if fewer went before
LINE_SHARE = 0.7  # of the line's bytes per second that periodic traffic may take
# To the device and back, six servos, the longest numbers.
TARGET_BYTES = (53, 33)  # !goto; OK and STOPPED
QUESTION_BYTES = (16, 54)  # ?pos; POS
OK_BYTES = 14
MOST_JOINTS = 16
_ROOM = MAX_LINE - TAIL - 6  # characters of a line without number and CRC


def rate_for(baud: int) -> float:
    """Give how often per second both targets and positions can pass a line."""
    longest = max(target + question for target, question in zip(TARGET_BYTES, QUESTION_BYTES))
    return min(FASTEST_HZ, _free_bytes_s(baud) / longest)


class LineBudget:
    """
    When a target may follow another without filling the line.

    One may follow as soon as the last one is through and answered, but on average only as
    often as the line can bear it, with positions asked for as ever.

    Parameters
    ----------
    baud : int
        Speed of the line.

    """

    def __init__(self, baud: int) -> None:
        gaps_s = [target / (_free_bytes_s(baud) - question * rate_for(baud))
                  for target, question in zip(TARGET_BYTES, QUESTION_BYTES)]
        self.mean_s = max(LEAST_GAP_S, *gaps_s)
        self.least_s = max(LEAST_GAP_S, (TARGET_BYTES[0] + OK_BYTES) * BITS_PER_BYTE / baud)
        self._sent_s = self._spent_until_s = -math.inf

    def next_s(self) -> float:
        """Give the earliest time of the next target."""
        return max(self._sent_s + self.least_s, self._spent_until_s - BURST * self.mean_s)

    def sent(self, now_s: float) -> None:
        """Take note that a target goes out."""
        self._sent_s = now_s
        self._spent_until_s = max(self._spent_until_s, now_s) + self.mean_s


def _free_bytes_s(baud: int) -> float:
    return LINE_SHARE * baud / BITS_PER_BYTE


class ServoWire:
    """
    The mapping between an arm and a device.

    Parameters
    ----------
    robot : Robot
        The arm.
    servos : int
        How many servos the device has.
    tick_s : float
        Its interpolator tick.

    Raises
    ------
    LinkError
        When the device has too few servos for the arm, or a line is too short for it.

    """

    def __init__(self, robot: Robot, servos: int, tick_s: float) -> None:
        highest = max(joint.channel for joint in robot.joints)
        if highest > servos:
            raise LinkError(f'the robot file uses servo {highest}, the device has {servos}')
        if len(robot.joints) > MOST_JOINTS:
            raise LinkError(f'{len(robot.joints)} joints do not fit into one line')
        self.robot = robot
        self.tick_s = tick_s
        self._index = np.array([joint.channel - 1 for joint in robot.joints])
        self.speed_units_s = velocity_units_s(robot)
        # Whole numbers per tick, rounded down; never below what the device can be told.
        self._maxspd = np.maximum(np.floor(self.speed_units_s * tick_s), 1).astype(int)
        self._accel = np.maximum(np.floor(acceleration_units_s2(robot) * tick_s ** 2),
                                 1).astype(int)
        self._all = [0] * servos

    def heard(self, positions: Sequence[int]) -> np.ndarray | None:
        """Take a POS; give servo units in joint order, None where the count is wrong."""
        if len(positions) != len(self._all):
            return None
        self._all = list(positions)
        return np.array(positions)[self._index]

    def joints(self, units: np.ndarray) -> np.ndarray:
        """Give joint angles of servo units."""
        return from_units(self.robot, units)

    def units(self, joints_rad: np.ndarray, margin_rad: float) -> np.ndarray:
        """Give servo units of joint angles; never outside the limits because of rounding."""
        return to_units(self.robot, joints_rad, margin_rad)

    def goto(self, units: np.ndarray) -> str:
        """Write a target; servos that are no joint of the arm stay where they are."""
        everything = list(self._all)
        for index, value in zip(self._index, units):
            everything[index] = int(value)
        return goto_text(everything)

    def move(self, units: np.ndarray) -> str:
        """Write a coordinated move of all joints."""
        return 'move ' + ','.join(f'{index + 1} to {int(value)}'
                                  for index, value in zip(self._index, units))

    def pace(self, way_units: np.ndarray, time_s: float) -> np.ndarray:
        """Give maxspd of every joint so that a move by so much takes about so long."""
        lead = int(np.argmax(np.abs(way_units) / self.speed_units_s))
        way, accel = abs(float(way_units[lead])), self._accel[lead] / self.tick_s ** 2
        # duration = way / v + v / accel for equal ramps up and down
        root = math.sqrt(max((accel * time_s) ** 2 - 4.0 * accel * way, 0.0))
        speed = 2.0 * way / (time_s + root / accel) if way else 0.0
        share = speed / self.speed_units_s[lead]
        wanted = np.rint(share * self.speed_units_s * self.tick_s).astype(int)
        return np.clip(wanted, 1, self._maxspd)

    @property
    def full_pace(self) -> np.ndarray:
        """Largest maxspd of every joint."""
        return self._maxspd

    def maxspd(self, values: np.ndarray) -> list[str]:
        """Write speeds of all joints."""
        return self._joined([f'maxspd {index + 1} {int(value)}'
                             for index, value in zip(self._index, values)])

    def ask_power(self) -> str:
        """Ask whether the servos have power; all are switched together."""
        return f'?prop {self._index[0] + 1} power'

    def setup(self) -> list[str]:
        """Write the limits of the arm, as script lines."""
        low, high = unit_range(self.robot)
        commands = []
        for index, lowest, highest, accel in zip(self._index, low, high, self._accel):
            servo = index + 1
            commands += [f'minpos {servo} default', f'maxpos {servo} default',
                         f'initpos {servo} default', f'minpos {servo} {lowest}',
                         f'maxpos {servo} {highest}', f'accdec {servo} {accel}']
        home = self.units(np.clip(np.zeros(self.robot.count), self.robot.lower_rad,
                                  self.robot.upper_rad), 0.0)
        commands += [f'initpos {index + 1} {value}' for index, value in zip(self._index, home)]
        return self._joined(commands) + self.maxspd(self._maxspd)

    def _joined(self, commands: list[str]) -> list[str]:
        lines = ['']
        for command in commands:
            if len(lines[-1]) + len(command) + 1 > _ROOM:
                lines.append('')
            lines[-1] += (';' if lines[-1] else '') + command
        return lines
