"""
Record topics as they come, in a thread of its own, into a bag.

Subscribes to serialised messages: nothing is unpacked, and what is written is what was
sent. Whatever goes wrong here ends the recording only.
"""

from __future__ import annotations

import functools
import threading
import time
from typing import Any, Sequence

from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.experiments.bag import ANCHOR
from homography_servo.experiments.bag_writer import BagWriter
from homography_servo.experiments.bag_writer import Channel
from homography_servo.nodes.executor import executor_for
from homography_servo.nodes.kit import COMMANDS
from homography_servo.nodes.kit import DEFAULT
from homography_servo.nodes.kit import LATCHED
from homography_servo.nodes.trial_log import ENDED
from rclpy.node import Node
from rclpy.qos import HistoryPolicy
from rclpy.qos import QoSProfile
from rosbags.interfaces import Qos
from rosbags.interfaces import QosDurability
from rosbags.interfaces import QosHistory
from rosbags.interfaces import QosLiveliness
from rosbags.interfaces import QosReliability
from rosbags.interfaces import QosTime
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

ALSO_RECORDED = (  # not needed for the report, but for looking at what happened
    (ANCHOR, String, DEFAULT),
    ('object/pose', PoseWithCovarianceStamped, DEFAULT),
    ('object/pose_candidates', PoseArray, DEFAULT),
    ('object/predicted_corners', PolygonStamped, DEFAULT),
    ('object/true_corners', PolygonStamped, DEFAULT),
    ('joint_trajectory', JointTrajectory, COMMANDS),
    ('joint_commands', JointState, COMMANDS),
    ('path/markers', MarkerArray, LATCHED),
    ('robot_description', String, LATCHED),
)
LAST_WORD_S, SETTLE_S = 2.0, 0.2
LONGEST_WAIT_NS = 10**10
_WORD = ENDED.encode()


class Recorder:
    """
    Takes what comes on some topics and hands it to a `BagWriter`.

    Parameters
    ----------
    bag : BagWriter
        Where to; closed by `close`.
    topics : sequence of (name, message type, QoS)
        What to subscribe to.
    context : rclpy context, optional
        The default one unless given.

    """

    def __init__(self, bag: BagWriter, topics: Sequence[tuple[str, type, QoSProfile]],
                 context: Any = None) -> None:
        self._bag = bag
        self._channels: dict[str, Channel] = {}
        self._ended, self._closing = threading.Event(), threading.Event()
        # Receipt times must not jump when somebody sets the clock.
        self._offset_ns = time.time_ns() - time.monotonic_ns()
        self.node = Node('servo_trial_recorder', context=context, start_parameter_services=False)
        for topic, kind, qos in topics:
            self.node.create_subscription(
                kind, topic, functools.partial(self._take, topic, kind, qos), qos, raw=True)
        self._executor = executor_for(self.node)
        self._thread = threading.Thread(target=self._spin, name='recorder', daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        until_s = float('inf')
        while time.monotonic() < until_s:
            self._executor.spin_once(timeout_sec=0.05)
            if self._closing.is_set() and until_s == float('inf'):
                until_s = time.monotonic() + SETTLE_S  # for what has come already

    def _take(self, topic: str, kind: type, qos: QoSProfile, data: bytes,
              info: dict[str, int]) -> None:
        # Messages of different topics that came before we looked keep their order.
        waited_ns = time.time_ns() - info['received_timestamp']
        time_ns = self._offset_ns + time.monotonic_ns() \
            - (waited_ns if 0 <= waited_ns < LONGEST_WAIT_NS else 0)
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._channel(topic, kind, qos)
        self._bag.put(channel, time_ns, data)
        if topic == ANCHOR and _WORD in data[:32]:
            self._ended.set()

    def _channel(self, topic: str, kind: type, qos: QoSProfile) -> Channel:
        name = self.node.resolve_topic_name(topic)
        offered = [info.qos_profile for info in self.node.get_publishers_info_by_topic(name)]
        profiles = dict.fromkeys(recorded_qos(item, qos.depth) for item in offered or [qos])
        return Channel(name, type_name(kind), tuple(profiles))

    def close(self, timeout_s: float = LAST_WORD_S) -> str:
        """Wait for the end of the trial to be recorded, finish, and say how it went."""
        self._ended.wait(0.0 if self._bag.stopped else timeout_s)
        self._closing.set()
        self._thread.join(SETTLE_S + timeout_s)
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        return self._bag.close()


def type_name(kind: type) -> str:
    """Give the full name of a message type, such as ``std_msgs/msg/String``."""
    package = kind.__module__.partition('.')[0]
    return f'{package}/msg/{kind.__name__}'


def recorded_qos(profile: QoSProfile, depth: int) -> Qos:
    """
    Give a quality of service as bags keep it.

    The middleware does not tell history and depth of others; then our own depth stands.
    """
    known = profile.history in (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL)
    return Qos(
        history=QosHistory(int(profile.history)) if known else QosHistory.KEEP_LAST,
        depth=(profile.depth if known else 0) or depth,
        reliability=QosReliability(int(profile.reliability)),
        durability=QosDurability(int(profile.durability)),
        deadline=_qos_time(profile.deadline), lifespan=_qos_time(profile.lifespan),
        liveliness=QosLiveliness(int(profile.liveliness)),
        liveliness_lease_duration=_qos_time(profile.liveliness_lease_duration),
        avoid_ros_namespace_conventions=bool(profile.avoid_ros_namespace_conventions))


def _qos_time(duration: Any) -> QosTime:
    return QosTime(*divmod(int(duration.nanoseconds), 10**9))
