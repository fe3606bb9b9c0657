"""
Run an experiment through topics and services only, as a person at the lab would.

Everything waits for a condition with a time-out and ends in a sentence; nothing
here knows the other nodes from inside.
"""

from __future__ import annotations

import time
from typing import Any, Callable

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseArray
from geometry_msgs.msg import PoseStamped
from homography_servo.errors import ServoError
from homography_servo.nodes.conversions import joint_state_msg
from homography_servo.nodes.conversions import joints_from_state
from homography_servo.nodes.executor import executor_for
from homography_servo.nodes.kit import COMMANDS
from homography_servo.nodes.kit import DEFAULT
from homography_servo.nodes.kit import images_qos
from homography_servo.nodes.kit import LATCHED
from homography_servo.nodes.trial_log import TrialLog
from homography_servo.result import Rejected
import numpy as np
from rcl_interfaces.msg import Parameter
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import Header
from std_msgs.msg import String
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

IMAGES = images_qos(False)
TOPICS = (
    ('image', Image, IMAGES),
    ('camera_info', CameraInfo, IMAGES),
    ('object/corners', PolygonStamped, DEFAULT),
    ('object/contour', PolygonStamped, DEFAULT),
    ('object/true_pose', PoseStamped, DEFAULT),
    ('joint_states', JointState, DEFAULT),
    ('path/poses', PoseArray, LATCHED),
    ('path/image', Float64MultiArray, LATCHED),
    ('path/joint_trajectory', JointTrajectory, LATCHED),
    ('path/verdict', DiagnosticArray, LATCHED),
    ('visual_servo/state', String, LATCHED),
    ('visual_servo/progress', DiagnosticStatus, DEFAULT),
    ('snake_tracker/state', String, LATCHED),
    ('robix_bridge/state', String, LATCHED),
)


class TrialError(ServoError):
    """A step of the experiment did not come about."""


class TrialClient:
    """
    The operator: waits, asks, commands, and logs.

    Parameters
    ----------
    alive : callable
        Gives a sentence when there is no point in waiting on (a launcher that has
        ended), else None.

    """

    def __init__(self, alive: Callable[[], str | None] = lambda: None) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.log = TrialLog()
        self._alive = alive
        self.node = Node('servo_trial')
        self._executor = executor_for(self.node)
        self._heard = {
            topic: self.node.create_subscription(kind, topic, self._feeder(topic), qos)
            for topic, kind, qos in TOPICS}
        self._events = self.node.create_publisher(String, '~/events', DEFAULT)
        self._commands = self.node.create_publisher(JointState, 'joint_commands', COMMANDS)
        self._services: dict[str, Any] = {}

    def _feeder(self, topic: str) -> Callable[[Any], None]:
        return lambda msg: self.log.feed(topic, msg, time.monotonic())

    def stop_hearing(self, *topics: str) -> None:
        """Listen to topics no longer, to take no time from what is measured."""
        for topic in topics:
            self.node.destroy_subscription(self._heard.pop(topic))

    def state(self, node: str) -> str:
        """Give the last state that a node has announced, empty before any."""
        msg = self.log.latest.get(f'{node}/state')
        return '' if msg is None else msg.data

    def spin_once(self, timeout_s: float = 0.1) -> None:
        """Take what has come; ends the trial when it cannot go on."""
        self._executor.spin_once(timeout_sec=timeout_s)
        trouble = self._alive()
        if trouble:
            raise TrialError(trouble)

    def settle(self, duration_s: float = 0.3) -> None:
        """Take what is still on its way, such as the last words of a run."""
        until_s = time.monotonic() + duration_s
        while time.monotonic() < until_s:
            self._executor.spin_once(timeout_sec=0.05)

    def wait(self, condition: Callable[[], Any], timeout_s: float, sentence: str) -> Any:
        """Wait until a condition holds and give its value."""
        until_s = time.monotonic() + timeout_s
        while True:
            value = condition()
            if value:
                return value
            if time.monotonic() > until_s:
                raise TrialError(f'{sentence} (waited {timeout_s:.0f} s)')
            self.spin_once()

    def event(self, text: str) -> None:
        """Mark a moment, for the log and for recordings."""
        msg = String(data=text)
        self._events.publish(msg)
        self.log.feed('servo_trial/events', msg, time.monotonic())

    def call(self, kind: type, name: str, request: Any, timeout_s: float = 15.0) -> Any:
        """Call a service and give its answer."""
        if name not in self._services:
            self._services[name] = self.node.create_client(kind, name)
            self._met(name, timeout_s)
            self.settle()  # an answer to somebody not yet known there is dropped
        client = self._met(name, timeout_s)
        future = client.call_async(request)
        self.wait(future.done, timeout_s, f'service {name} did not answer')
        return future.result()

    def _met(self, name: str, timeout_s: float) -> Any:
        client = self._services[name]
        self.wait(client.service_is_ready, timeout_s, f'service {name} did not appear')
        return client

    def trigger(self, name: str, timeout_s: float = 15.0) -> str:
        """Call a Trigger service; a refusal ends the trial with its sentence."""
        answer = self.call(Trigger, name, Trigger.Request(), timeout_s)
        if not answer.success:
            raise TrialError(f'{name} refused: {answer.message}')
        return answer.message

    def trigger_patiently(self, name: str, timeout_s: float = 10.0) -> str:
        """Call a Trigger service until it agrees; the last refusal ends the trial."""
        until_s = time.monotonic() + timeout_s
        while True:
            try:
                return self.trigger(name)
            except TrialError:
                if time.monotonic() > until_s or self._alive():
                    raise
            self.fresh('object/corners', timeout_s, 'the tracker sends no corners')

    def switch(self, name: str, on: bool) -> str:
        """Call a SetBool service; a refusal ends the trial with its sentence."""
        answer = self.call(SetBool, name, SetBool.Request(data=on))
        if not answer.success:
            raise TrialError(f'{name} refused: {answer.message}')
        return answer.message

    def set_parameter(self, node: str, name: str, value: int) -> None:
        """Set a whole-number parameter of a node."""
        parameter = Parameter(name=name, value=ParameterValue(
            type=ParameterType.PARAMETER_INTEGER, integer_value=value))
        answer = self.call(SetParameters, f'{node}/set_parameters',
                           SetParameters.Request(parameters=[parameter]))
        if not answer.results[0].successful:
            raise TrialError(f'{node} refused {name} = {value}: {answer.results[0].reason}')

    def joints(self, names: list[str]) -> np.ndarray | None:
        """Give the last joint positions."""
        msg = self.log.latest.get('joint_states')
        joints_rad = None if msg is None else joints_from_state(msg, names)
        return None if isinstance(joints_rad, Rejected) else joints_rad

    def joint_names(self) -> list[str]:
        """Wait for the arm and give the names of its joints."""
        msg = self.wait(lambda: self.log.latest.get('joint_states'), 30.0,
                        'no joint_states: is the bridge running?')
        return list(msg.name)

    def drive(self, joints_rad: np.ndarray, timeout_s: float = 30.0) -> None:
        """Command joint positions and wait until the arm stands there."""
        names = self.joint_names()
        if len(names) != len(joints_rad):
            raise TrialError(f'the arm has {len(names)} joints, {len(joints_rad)} were given')
        self.wait(lambda: self._commands.get_subscription_count() > 0, 15.0,
                  'nobody listens to joint_commands')
        header = Header(stamp=self.node.get_clock().now().to_msg())
        self._commands.publish(joint_state_msg(names, joints_rad, header))
        self.wait(lambda: self._stands_at(names, joints_rad), timeout_s,
                  f'the arm did not reach its joints; bridge: {self.state("robix_bridge")}')

    def _stands_at(self, names: list[str], joints_rad: np.ndarray) -> bool:
        state = self.state('robix_bridge')
        if state.startswith(('LATCHED', 'DISCONNECTED')):
            raise TrialError(f'the bridge does not move the arm: {state}')
        now_rad = self.joints(names)
        return now_rad is not None and state == 'IDLE' and \
            float(np.max(np.abs(now_rad - joints_rad))) < 0.01

    def fresh(self, topic: str, timeout_s: float, sentence: str) -> Any:
        """Wait for a message that comes after now."""
        before = self.log.latest.get(topic)
        return self.wait(lambda: self.log.latest.get(topic) is not before, timeout_s, sentence)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        rclpy.try_shutdown()
