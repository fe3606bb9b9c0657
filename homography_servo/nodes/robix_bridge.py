"""The node `robix_bridge`: a Robix arm behind a serial line."""

from __future__ import annotations

from dataclasses import dataclass
import sys
import time
from typing import Any, Callable

from homography_servo.errors import ConfigError
from homography_servo.errors import HardwareError
from homography_servo.errors import LinkError
from homography_servo.nodes.conversions import joint_state_msg
from homography_servo.nodes.conversions import seconds_from_duration
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.kit import COMMANDS
from homography_servo.nodes.kit import DEFAULT
from homography_servo.nodes.kit import ERROR
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import WARN
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.run import run_node
from homography_servo.nodes.transforms import fixed_frames
from homography_servo.nodes.transforms import Transforms
from homography_servo.places import load_named
from homography_servo.result import Rejected
from homography_servo.robot.arm import Arm
from homography_servo.robot.driver import ArmDriver
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.limits import joint_order
from homography_servo.robot.port import LogError
from homography_servo.robot.port import PortSettings
from homography_servo.robot.rivals import Rivals
from homography_servo.robot.rivals import Turns
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.trajectory import MOST_POINTS
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.trajectory import TrajectorySettings
from homography_servo.robot.urdf import urdf_text
from homography_servo.settings import flag
from homography_servo.settings import Settings
from homography_servo.settings import text
from rclpy.lifecycle import LifecycleNode
from rclpy.lifecycle import TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_msgs.msg import String
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

STATE_RATE_HZ = 50.0
TWO_COMMAND = 'two publishers command at the same time'


@dataclass(frozen=True)
class BridgeSettings(Settings):
    """The bridge itself."""

    robot_file: str = text('robix_rcs6.yaml', 'robot file: a path, or a name in config/robots',
                           read_only=True)
    autostart: bool = flag(True, 'configure and activate at once, without a lifecycle manager',
                           read_only=True)


class RobixBridge(NodeKit, LifecycleNode):
    """
    Drive a Robix arm through a serial line, and let nothing unsafe out.

    Takes `joint_trajectory` and `joint_commands`, gives `joint_states` at 50 Hz
    (commanded positions: the servos have no feedback). A software stop, not a safety
    function.
    """

    NAME = 'robix_bridge'
    SETTINGS = (BridgeSettings, PortSettings, DriverSettings, TrajectorySettings)
    EXAMPLE = 'ros2 run homography_servo robix_bridge --ros-args -p port:=/dev/ttyUSB0'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        self._robot = load_named(load_robot, self._settings[BridgeSettings].robot_file,
                                 self.NAME, 'robot_file')
        self._arm: Arm | None = None
        self._topics = Turns()
        self._shown_state = self._shown_problem = ''
        self._rivals = {'joint_trajectory': Rivals(), 'joint_commands': Rivals()}
        self._settings.on_change(self._on_parameters)
        self._make_interface()
        self.start_kit()
        if self._settings[BridgeSettings].autostart:
            self._open()
            self.trigger_configure()
            self.trigger_activate()

    def _make_interface(self) -> None:
        self._states = self.create_publisher(JointState, 'joint_states', DEFAULT)
        self._state = self.latched(String, '~/state')
        self._description = self.latched(String, 'robot_description')
        self._description.publish(String(data=urdf_text(self._robot)))
        self._transforms = Transforms(self, fixed_frames(self._robot))
        self.listen(JointTrajectory, 'joint_trajectory', self._on_trajectory, COMMANDS)
        self.listen(JointState, 'joint_commands', self._on_command, COMMANDS)
        self.serve(Trigger, '~/stop', self._on_stop)
        self.serve(Trigger, '~/reset', self._on_reset)
        self.serve(Trigger, '~/home', self._on_home)
        self.serve(SetBool, '~/power', self._on_power)
        self.serve(SetBool, '~/pause', self._on_pause)
        self.every(1.0 / STATE_RATE_HZ, self._publish)

    # --- life -------------------------------------------------------------------------

    @property
    def _driver(self) -> ArmDriver | None:
        arm = self._arm
        return arm.driver if arm else None

    def _open(self) -> None:
        """Open the port; HardwareError says why that fails."""
        if self._arm is not None:
            return
        try:
            self._arm = Arm(self._robot, *(self._settings[kind] for kind in (
                PortSettings, DriverSettings, TrajectorySettings)))
        except ValueError as error:
            raise ConfigError(self.NAME, 0, 'fake_faults', str(error)) from error
        except LogError as error:
            raise ConfigError(self.NAME, 0, 'session_log', str(error)) from error
        except LinkError as error:
            raise HardwareError(str(error)) from error

    def on_configure(self, state) -> TransitionCallbackReturn:
        """Open the port."""
        try:
            self._open()
        except (ConfigError, HardwareError) as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return super().on_configure(state)

    def on_activate(self, state) -> TransitionCallbackReturn:
        """Allow motion."""
        self._driver.active = True
        return super().on_activate(state)

    def on_deactivate(self, state) -> TransitionCallbackReturn:
        """Come to rest and allow no motion."""
        self._driver.deactivate(time.monotonic())
        return super().on_deactivate(state)

    def on_cleanup(self, state) -> TransitionCallbackReturn:
        """Release the port."""
        self._release()
        return super().on_cleanup(state)

    def on_shutdown(self, state) -> TransitionCallbackReturn:
        """Release the port."""
        self._release()
        return super().on_shutdown(state)

    def on_error(self, state) -> TransitionCallbackReturn:
        """Stop and release the port."""
        self._release()
        return super().on_error(state)

    def _release(self) -> None:
        arm, self._arm = self._arm, None
        if arm is not None:
            arm.close()

    def on_signal(self) -> None:
        """Stop a moving arm at once."""
        driver = self._driver
        if driver is not None:
            driver.active = False
            if not driver.resting:
                driver.stop_now('the bridge was told to end')

    def close(self) -> None:
        """Release the port."""
        self._release()

    def on_fault(self, error: Exception) -> None:
        """Stop the arm when this program fails."""
        if self._driver is not None:
            self._driver.stop_now(f'internal error: {error}')

    def _on_parameters(self) -> None:
        if self._driver is not None:
            self._driver.settings = self._settings[DriverSettings]
            self._driver.trajectory_settings = self._settings[TrajectorySettings]

    # --- commands ---------------------------------------------------------------------

    def _on_trajectory(self, msg: JointTrajectory, info: dict) -> None:
        if self._may_command('joint_trajectory', info):
            self._offer('joint_trajectory', self._run_trajectory, msg)

    def _on_command(self, msg: JointState, info: dict) -> None:
        if self._may_command('joint_commands', info):
            self._offer('joint_commands', self._run_command, msg)

    def _may_command(self, topic: str, info: dict) -> bool:
        """Find two publishers by the numbers of their messages."""
        now_s = time.monotonic()
        self.count(f'received_{topic}')
        if self._driver is None:
            self.reject(topic, 'the port is not open; configure the node first')
            return False
        number = int(info['publication_sequence_number'])
        if self._rivals[topic].meet(number, now_s) or self._topics.meet(topic, now_s):
            self.reject(topic, TWO_COMMAND)
            self._driver.hold(TWO_COMMAND, now_s, self._settings[DriverSettings].rival_hold_s)
            return False
        return True

    def _offer(self, topic: str, run: Callable, msg: Any) -> None:
        """Leave a command to the thread of the port: a flood must not delay a stop."""
        driver = self._driver

        def judged(now_s: float) -> None:
            try:
                problem = run(driver, msg, now_s)
            except Exception as error:  # data must never end the thread of the port
                self.failed(run, error)
                return
            if problem is not None:
                self.reject(topic, problem.reason)
        driver.offer(judged)
        self._arm.wake()

    def _run_trajectory(self, driver: ArmDriver, msg: JointTrajectory, now_s: float
                        ) -> Rejected | None:
        points = [TrajectoryPoint(seconds_from_duration(point.time_from_start),
                                  point.positions, point.velocities, point.accelerations,
                                  point.effort) for point in msg.points[:MOST_POINTS + 1]]
        return driver.command(msg.joint_names, points, now_s,
                              seconds_from_stamp(msg.header.stamp),
                              1e-9 * self.get_clock().now().nanoseconds)

    def _run_command(self, driver: ArmDriver, msg: JointState, now_s: float) -> Rejected | None:
        order = joint_order(driver.limits, msg.name)
        if isinstance(order, Rejected):
            return order
        if len(msg.position) != len(msg.name):
            return Rejected(f'{len(msg.name)} names but {len(msg.position)} positions')
        return driver.go([msg.position[index] for index in order], now_s)

    # --- services ---------------------------------------------------------------------

    def _on_stop(self, request: Trigger.Request) -> tuple[bool, str]:
        if self._driver is None:
            return False, 'the port is not open'
        sent = self._driver.stop_now('stopped by ~/stop')
        self._publish_state()
        return (True, 'stopped; call ~/reset to go on') if sent else \
            (False, 'the stop byte could not be sent: the robot is not connected')

    def _on_reset(self, request: Trigger.Request) -> tuple[bool, str]:
        return self._told(self._driver and self._driver.reset, 'reset; nothing moves by itself')

    def _on_home(self, request: Trigger.Request) -> tuple[bool, str]:
        return self._told(self._driver and self._driver.home, 'going home slowly',
                          time.monotonic())

    def _on_power(self, request: SetBool.Request) -> tuple[bool, str]:
        return self._told(self._driver and self._driver.power,
                          'power on' if request.data else 'power off', bool(request.data))

    def _on_pause(self, request: SetBool.Request) -> tuple[bool, str]:
        return self._told(self._driver and self._driver.pause,
                          'paused' if request.data else 'going on',
                          bool(request.data), time.monotonic())

    def _told(self, action, success: str, *args) -> tuple[bool, str]:
        if self._driver is None:
            return False, 'the port is not open; configure the node first'
        self._arm.wake()
        problem = action(*args)
        self._arm.wake()
        self._publish_state()
        return (True, success) if problem is None else (False, problem.reason)

    # --- what it says -----------------------------------------------------------------

    def _publish(self) -> None:
        self._publish_state()
        if self._driver is None:
            return
        arm = self._driver.snapshot(time.monotonic()).arm
        if arm is not None:
            header = Header(stamp=self.get_clock().now().to_msg(), frame_id='base_link')
            self._states.publish(joint_state_msg(self._robot.joint_names, arm.positions,
                                                 header, arm.velocities))
            self._transforms.send_arm(self._robot, arm.positions, header.stamp)

    def _publish_state(self) -> None:
        state = self._driver.state if self._driver else 'DISCONNECTED'
        if state != self._shown_state:
            self._shown_state = state
            self._state.publish(String(data=state))
            self.get_logger().info(state)
        problem = self._driver.problem if self._driver else ''
        if problem != self._shown_problem:
            self._shown_problem = problem
            self.get_logger().warning(problem or 'connected')

    def diagnose(self) -> list[Health]:
        """Tell how the link and the arm are."""
        if self._driver is None:
            return [Health('link', WARN, 'the port is not open')]
        driver = self._driver
        values = {'port': self._arm.url, 'device': driver.device,
                  'longest_turn_s': self._arm.take_longest_turn_s(), **driver.all_counts}
        level = OK if not driver.problem else ERROR
        state = driver.state
        bad = state.startswith(('HOLD', 'LATCHED', 'DISCONNECTED'))
        return [Health('link', level, driver.problem or 'connected', values),
                Health('arm', WARN if bad else OK, state)]


def main(args=None) -> int:
    """Run the node."""
    # The thread of the port must not wait 5 ms for the one that takes messages.
    sys.setswitchinterval(0.0005)
    return run_node(RobixBridge, args)
