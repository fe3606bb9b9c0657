"""
Watch the chain from image to command from outside, and time every step.

Stamps are those of the images, carried through by every node, so the age of a
message when it arrives here is the latency of the chain up to it, and one hop more.
"""

from __future__ import annotations

from bisect import bisect_left
from bisect import bisect_right
import time
from typing import Any, Callable

from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.kit import COMMANDS
from homography_servo.nodes.kit import DEFAULT
from homography_servo.nodes.kit import images_qos
from sensor_msgs.msg import CameraInfo
from trajectory_msgs.msg import JointTrajectory

SOONER_S = 0.001  # by which the bridge may hear a command before the probe does


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
        node.create_subscription(CameraInfo, 'camera_info', self._timed('image_hop'),
                                 images_qos(False))
        node.create_subscription(PolygonStamped, 'object/corners', self._timed('corners'), DEFAULT)
        node.create_subscription(PoseWithCovarianceStamped, 'object/pose', self._on_pose, DEFAULT)
        node.create_subscription(JointTrajectory, 'joint_trajectory', self._on_command, COMMANDS)

    def _timed(self, step: str) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            if self.recording:
                self.ages_s[step].append(time.time() - seconds_from_stamp(msg.header.stamp))
        return take

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        self._timed('pose')(msg)
        if self.recording:
            stamp_s = seconds_from_stamp(msg.header.stamp)
            self.looks.append((time.monotonic(), stamp_s + self._steady_from_wall_s))

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
