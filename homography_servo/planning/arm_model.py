"""
Where a body is, as a model with unknown errors says it.

An arm's model is never exact: the robot stands a little elsewhere (left error L),
its joints have other zeros (dq), the box is held a little differently (right error
E). The object is then at ``L @ object_pose(q + dq) @ E``. These three errors hardly
change while the arm moves, which is what lets looks at different poses be averaged.
A body without an arm (`FreeBody`) executes commanded displacements and has only L.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import replace
from functools import cached_property
from typing import Protocol, TypeVar

from homography_servo.geometry.rigid import adjoint
from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import skew
from homography_servo.robot.chain import jacobian_of
from homography_servo.robot.chain import link_frames
from homography_servo.robot.robot_file import Robot
import numpy as np


@dataclass(frozen=True)
class Prior:
    """How wrong a model may be before the first look, one standard deviation."""

    placement_m: float = 0.03
    placement_rad: float = 0.08
    joint_rad: float = 0.02
    grip_m: float = 0.01
    grip_rad: float = 0.04


Body = TypeVar('Body', bound='BodyModel')


class BodyModel(Protocol):
    """Predicts the object from a setpoint; immutable, `moved` gives a corrected one."""

    def pose(self, setpoint: np.ndarray) -> np.ndarray: ...

    def expect(self, setpoint: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...

    def moved(self: Body, change: np.ndarray) -> Body: ...

    def error_of(self, slip: np.ndarray) -> np.ndarray: ...

    def variances(self, prior: Prior) -> np.ndarray: ...


def _left_sensitivity(position_m: np.ndarray) -> np.ndarray:
    """Give the object's twist for a twist of L: its origin moves by v + w x position."""
    left = np.eye(6)
    left[:3, 3:] = -skew(position_m)
    return left


@dataclass(frozen=True)
class FreeBody:
    """A body that executes commanded poses up to a constant error; setpoints are (4, 4)."""

    left: np.ndarray = field(default_factory=lambda: np.eye(4))

    def pose(self, setpoint: np.ndarray) -> np.ndarray:
        """Predict home_from_object."""
        return self.left @ setpoint

    def expect(self, setpoint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predict home_from_object and its (6, 6) twist per change of L."""
        pose = self.pose(setpoint)
        return pose, _left_sensitivity(pose[:3, 3])

    def moved(self, change: np.ndarray) -> FreeBody:
        """Correct L by a small twist."""
        return FreeBody(exp_twist(change) @ self.left)

    def error_of(self, slip: np.ndarray) -> np.ndarray:
        """Give the change of L that does what a small screw (6,) of the setpoint does."""
        return adjoint(self.left) @ slip

    def variances(self, prior: Prior) -> np.ndarray:
        """Give the (6,) variances before the first look: nothing is known."""
        return np.array([10.0] * 3 + [3.0] * 3) ** 2


@dataclass(frozen=True)
class ArmModel:
    """An arm from its file, corrected by L, dq and E; setpoints are joints [rad]."""

    robot: Robot
    left: np.ndarray = field(default_factory=lambda: np.eye(4))
    offset_rad: np.ndarray | float = 0.0
    right: np.ndarray = field(default_factory=lambda: np.eye(4))

    @property
    def corrected(self) -> Robot:
        """Give the robot as a file would describe it with the errors taken in."""
        offsets = np.broadcast_to(self.offset_rad, self.robot.count)
        joints = tuple(replace(joint, theta0_rad=joint.theta0_rad + float(offset))
                       for joint, offset in zip(self.robot.joints, offsets))
        return replace(self.robot, joints=joints,
                       home_from_base=self.left @ self.robot.home_from_base,
                       tool_from_object=self.robot.tool_from_object @ self.right)

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        return (self.left @ self.robot.home_from_base,
                self.robot.tool_from_object @ self.right)

    def pose(self, setpoint: np.ndarray) -> np.ndarray:
        """Predict home_from_object at joints (..., n)."""
        home_from_base, tool_from_object = self._ends
        frames = link_frames(self.robot, setpoint + self.offset_rad, home_from_base)
        return frames[..., -1, :, :] @ tool_from_object

    def posture(self, setpoint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Predict the object at joints (..., n), and how it moves with them.

        Returns
        -------
        (..., 4, 4) array, (..., 6, n) array
            home_from_object, and its twist in home axes per joint velocity.

        """
        home_from_base, tool_from_object = self._ends
        frames = link_frames(self.robot, setpoint + self.offset_rad, home_from_base)
        pose = frames[..., -1, :, :] @ tool_from_object
        return pose, jacobian_of(frames, pose)

    def expect(self, setpoint: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predict home_from_object and its (6, 12 + n) twist per change of (L, dq, E)."""
        pose, jacobian = self.posture(setpoint)
        right = np.zeros((6, 6))
        right[:3, :3] = right[3:, 3:] = pose[:3, :3]
        return pose, np.hstack([_left_sensitivity(pose[:3, 3]), jacobian, right])

    def moved(self, change: np.ndarray) -> ArmModel:
        """Correct (L, dq, E) by small changes, twists of L in home, of E in the object."""
        return replace(self, left=exp_twist(change[:6]) @ self.left,
                       offset_rad=self.offset_rad + change[6:-6],
                       right=self.right @ exp_twist(change[-6:]))

    def error_of(self, slip: np.ndarray) -> np.ndarray:
        """Give the change of (L, dq, E) that does what a change (n,) of the joints does."""
        return np.concatenate([np.zeros(6), slip, np.zeros(6)])

    def variances(self, prior: Prior) -> np.ndarray:
        """Give the (12 + n,) variances before the first look."""
        count = len(self.robot.joint_names)
        sigma = ([prior.placement_m] * 3 + [prior.placement_rad] * 3
                 + [prior.joint_rad] * count + [prior.grip_m] * 3 + [prior.grip_rad] * 3)
        return np.array(sigma) ** 2
