"""
Watch the chain from image to command from outside, and time every step.

Stamps are those of the images, carried through by every node, so the age of a
message when it arrives in this process is the latency of the chain up to it, and one hop
more. The middleware notes when each message came; it is taken when all is over, for an
onlooker that wakes up for every message would slow down what it looks at.
"""

from __future__ import annotations

from bisect import bisect_left
from bisect import bisect_right
import struct
import time
from typing import Any

from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.nodes.quiet import make_quiet
from homography_servo.nodes.quiet import waiting_messages
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import CameraInfo
from trajectory_msgs.msg import JointTrajectory

SOONER_S = 0.0005  # by which the bridge may hear a command before the probe does
# Half a minute at the highest rate; an onlooker must not be waited for either.
ALL_OF_A_RUN = QoSProfile(depth=4000, reliability=ReliabilityPolicy.BEST_EFFORT)
_ENCAPSULATION = 4  # bytes before the first field of a serialized message


def _stamp_s(serialized: bytes) -> float:
    """Read the stamp of a message that begins with its header."""
    order = '<' if serialized[1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(order + 'iI', serialized, _ENCAPSULATION)
    return seconds + 1e-9 * nanoseconds


class LatencyProbe:
    """
    Ages of messages, and when commands came.

    ``ages_s`` maps each step to the ages of its messages; ``commands_s`` and
    ``looks`` hold arrival times on the steady clock, the latter with image stamps.
    Nothing is known of what arrives outside of `begin` and `end`.

    Parameters
    ----------
    node : Node
        Listens.
    pose_after_s : float
        How long after a command the pose behind it may arrive: in one process it is
        published right after the command.

    """

    def __init__(self, node: Any, pose_after_s: float = 0.0) -> None:
        self._pose_after_s = pose_after_s
        self.ages_s: dict[str, list[float]] = {}
        self.looks: list[tuple[float, float]] = []
        self.commands_s: list[float] = []
        self._steady_from_wall_s = time.monotonic() - time.time()
        self._heard = {step: node.create_subscription(kind, topic, lambda _: None, ALL_OF_A_RUN,
                                                      raw=step != 'command')
                       for step, kind, topic in (
                           ('image_hop', CameraInfo, 'camera_info'),
                           ('corners', PolygonStamped, 'object/corners'),
                           ('pose', PoseWithCovarianceStamped, 'object/pose'),
                           ('command', JointTrajectory, 'joint_trajectory'))}
        for subscription in self._heard.values():
            make_quiet(subscription)

    def begin(self) -> None:
        """Forget what has come so far."""
        for subscription in self._heard.values():
            for _ in waiting_messages(subscription):
                pass

    def end(self) -> None:
        """Take what has come since the beginning."""
        came = {step: [(msg, 1e-9 * info['received_timestamp'])
                       for msg, info in waiting_messages(subscription)]
                for step, subscription in self._heard.items()}
        self.commands_s = [time_s + self._steady_from_wall_s
                           for msg, time_s in came.pop('command') if msg.points]
        self.ages_s = {step: [time_s - _stamp_s(msg) for msg, time_s in pairs]
                       for step, pairs in came.items()}
        self.looks = [(time_s + self._steady_from_wall_s,
                       _stamp_s(msg) + self._steady_from_wall_s) for msg, time_s in came['pose']]

    def command_ages_s(self) -> list[float]:
        """Give the age of the image behind each command when the command arrived."""
        return [time_s - stamp_s for time_s, stamp_s in self._stamped_commands()]

    def wire_ages_s(self, sent_s: list[float]) -> list[float]:
        """
        Give the age of the image behind each first target on the wire after a command.

        Parameters
        ----------
        sent_s : list of float
            Steady times at which targets went out, ascending.

        """
        commands = self._stamped_commands()
        arrivals = [time_s - SOONER_S for time_s, _ in commands]
        firsts = {bisect_left(sent_s, arrival_s) for arrival_s in arrivals}
        return [sent_s[index] - commands[bisect_right(arrivals, sent_s[index]) - 1][1]
                for index in sorted(firsts) if index < len(sent_s)]

    def _stamped_commands(self) -> list[tuple[float, float]]:
        """Give when each command arrived, and the stamp of the newest image behind it."""
        arrivals = [arrival_s - self._pose_after_s for arrival_s, _ in self.looks]
        found = []
        for time_s in self.commands_s:
            index = bisect_right(arrivals, time_s) - 1
            if index >= 0:
                found.append((time_s, self.looks[index][1]))
        return found
