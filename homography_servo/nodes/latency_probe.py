"""
Watch the chain from image to command from outside, and time every step.

Stamps are those of the images, carried through by every node, so the age of a
message when it arrives here is the latency of the chain up to it, and one hop more.
"""

from __future__ import annotations

from bisect import bisect_left
from bisect import bisect_right
import struct
import time
from typing import Any, Callable

from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.nodes.kit import images_qos
from sensor_msgs.msg import CameraInfo
from trajectory_msgs.msg import JointTrajectory

SOONER_S = 0.001  # by which the bridge may hear a command before the probe does
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
        self.ages_s: dict[str, list[float]] = {'image_hop': [], 'corners': [], 'pose': []}
        self.looks: list[tuple[float, float]] = []
        self.commands_s: list[float] = []
        self.recording = False
        self._steady_from_wall_s = time.monotonic() - time.time()
        # An onlooker must not be waited for, and takes no message apart but for its stamp.
        for step, kind, topic in (('image_hop', CameraInfo, 'camera_info'),
                                  ('corners', PolygonStamped, 'object/corners'),
                                  ('pose', PoseWithCovarianceStamped, 'object/pose')):
            node.create_subscription(kind, topic, self._timed(step), images_qos(False), raw=True)
        node.create_subscription(JointTrajectory, 'joint_trajectory', self._on_command,
                                 images_qos(False))

    def _timed(self, step: str) -> Callable[[bytes], None]:
        def take(serialized: bytes) -> None:
            if not self.recording:
                return
            stamp_s = _stamp_s(serialized)
            self.ages_s[step].append(time.time() - stamp_s)
            if step == 'pose':
                self.looks.append((time.monotonic(), stamp_s + self._steady_from_wall_s))
        return take

    def _on_command(self, msg: JointTrajectory) -> None:
        if self.recording and msg.points:
            self.commands_s.append(time.monotonic())

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
