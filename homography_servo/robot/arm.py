"""Everything between a robot file and a moving arm, opened and closed as one."""

from __future__ import annotations

import time

from homography_servo.errors import LinkError
from homography_servo.robot.arm_thread import ArmThread
from homography_servo.robot.driver import ArmDriver
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.link import Link
from homography_servo.robot.port import Port
from homography_servo.robot.port import PortSettings
from homography_servo.robot.robot_model import Robot
from homography_servo.robot.trajectory import TrajectorySettings

LEAST_SERVOS = 6  # of the emulated robot
FAREWELL_S = 0.2  # that the end may take while the device answers


class Arm:
    """
    A port, a driver, and the thread that owns the port.

    Parameters
    ----------
    robot : Robot
        The arm.
    port, driver, trajectory : PortSettings, DriverSettings, TrajectorySettings
        Where it is and how it is driven.

    Raises
    ------
    LinkError
        When the port cannot be opened; the sentence says what to do.
    ValueError
        When a fault of the emulated robot is none.

    """

    def __init__(self, robot: Robot, port: PortSettings, driver: DriverSettings,
                 trajectory: TrajectorySettings) -> None:
        servos = max(LEAST_SERVOS, *(joint.channel for joint in robot.joints))
        self._port = Port(port, driver.baud, servos, driver.tick_s)
        # A device that has not forgotten the run before must not see its numbers again.
        first_seq = time.monotonic_ns() // 1000 % 60000 + 1
        link = Link(self._port.open, driver.baud, first_seq)
        self.driver = ArmDriver(robot, link, driver, trajectory)
        try:
            link.open_now()
        except LinkError:
            self._port.close()
            raise
        self._thread = ArmThread(self.driver)
        self._thread.start()

    @property
    def url(self) -> str:
        """Give the name of the port."""
        return self._port.url

    def wake(self) -> None:
        """Have the driver's next turn now."""
        self._thread.wake()

    def take_longest_turn_s(self) -> float:
        """Give the longest turn since the last call."""
        longest_s, self._thread.longest_turn_s = self._thread.longest_turn_s, 0.0
        return longest_s

    def close(self) -> None:
        """Stop a moving arm, end the thread, release the port."""
        self.driver.active = False
        self.driver.quit(time.monotonic(), FAREWELL_S)
        self._thread.stop()
        self._port.close()
