"""Put the messages that make up a planned path together."""

from __future__ import annotations

from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseArray
from homography_servo.nodes.conversions import transforms_from_poses
from homography_servo.planning.joint_lead import JointLead
from homography_servo.result import Rejected
import numpy as np
from trajectory_msgs.msg import JointTrajectory

UNLED = ('the path needs the joints planned for this arm to lead it, and they have not come on '
         'path/joint_trajectory')


class PlannedPath(NamedTuple):
    """A path as it has come; without poses where its messages make none."""

    poses: np.ndarray  # (N, 4, 4) home_from_object
    feasible: bool
    sentence: str  # the verdict, or why it cannot be used
    lead: JointLead = JointLead()
    broken: bool = False  # the messages say what cannot be
    waits: bool = False  # its joints have not come yet


class PathInbox:
    """
    Give a path only together with its own verdict: both carry the same stamp.

    Parameters
    ----------
    joint_names : tuple of str
        Of the arm that is to follow it.

    """

    def __init__(self, joint_names: tuple[str, ...]) -> None:
        self.poses: PoseArray | None = None
        self.verdict: DiagnosticArray | None = None
        self.joints: JointTrajectory | None = None
        self._joint_names = joint_names

    def path(self) -> PlannedPath | None:
        """Give what has come, once; one that waits for its joints as often as it is asked."""
        poses, verdict = self.poses, self.verdict
        if poses is None or verdict is None or poses.header.stamp != verdict.header.stamp:
            return None
        lead = lead_from(verdict, self.joints, self._joint_names)
        if lead is None:
            return _useless(UNLED)._replace(waits=True)
        self.poses = self.verdict = None
        path = transforms_from_poses(poses)
        if isinstance(path, Rejected):
            return _useless(path.reason)._replace(broken=True)
        if not verdict.status:
            return PlannedPath(path, False, 'the verdict of the path is empty')
        whole = verdict.status[0]
        return PlannedPath(path, whole.level != DiagnosticStatus.ERROR, whole.message, lead)


def _useless(reason: str) -> PlannedPath:
    return PlannedPath(np.zeros((0, 4, 4)), False, reason)


def lead_from(verdict: DiagnosticArray, plan: JointTrajectory | None,
              joint_names: tuple[str, ...]) -> JointLead | None:
    """
    Read where the planned joints lead through a singularity, and those joints.

    None as long as they are needed and have not come.
    """
    led = np.array([any(pair.key == 'led' and pair.value == 'true' for pair in status.values)
                    for status in verdict.status[1:]], dtype=bool)
    if not led.any():
        return JointLead()
    if plan is None or plan.header.stamp != verdict.header.stamp \
            or len(plan.points) != len(led) or tuple(plan.joint_names) != joint_names:
        return None
    return JointLead(np.array([point.positions for point in plan.points]), led)
