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
from typing import Protocol

from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import skew
from homography_servo.robot.kinematics import object_jacobian
from homography_servo.robot.kinematics import object_pose
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


class BodyModel(Protocol):
    """Predicts the object from a setpoint; immutable, `moved` gives a corrected one."""

    def pose(self, setpoint: np.ndarray) -> np.ndarray: ...

    def sensitivity(self, setpoint: np.ndarray) -> np.ndarray: ...

    def moved(self, change: np.ndarray) -> BodyModel: ...

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

    def sensitivity(self, setpoint: np.ndarray) -> np.ndarray:
        """Give the (6, 6) object twist per change of L."""
        return _left_sensitivity(self.pose(setpoint)[:3, 3])

    def moved(self, change: np.ndarray) -> FreeBody:
        """Correct L by a small twist."""
        return FreeBody(exp_twist(change) @ self.left)

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

    def pose(self, setpoint: np.ndarray) -> np.ndarray:
        """Predict home_from_object at joints (..., n)."""
        return self.left @ object_pose(self.robot, setpoint + self.offset_rad) @ self.right

    def jacobian(self, setpoint: np.ndarray) -> np.ndarray:
        """Give the (6, n) twist of the object, home axes, per joint velocity."""
        joints_rad = setpoint + self.offset_rad
        believed = object_jacobian(self.robot, joints_rad)
        reach = object_pose(self.robot, joints_rad)[:3, :3] @ self.right[:3, 3]
        turn = self.left[:3, :3]
        linear = believed[:3] - skew(reach) @ believed[3:]
        return np.vstack([turn @ linear, turn @ believed[3:]])

    def sensitivity(self, setpoint: np.ndarray) -> np.ndarray:
        """Give the (6, 12 + n) object twist per change of (L, dq, E)."""
        home_from_object = self.pose(setpoint)
        right = np.zeros((6, 6))
        right[:3, :3] = right[3:, 3:] = home_from_object[:3, :3]
        return np.hstack([_left_sensitivity(home_from_object[:3, 3]),
                          self.jacobian(setpoint), right])

    def moved(self, change: np.ndarray) -> ArmModel:
        """Correct (L, dq, E) by small changes, twists of L in home, of E in the object."""
        return replace(self, left=exp_twist(change[:6]) @ self.left,
                       offset_rad=self.offset_rad + change[6:-6],
                       right=self.right @ exp_twist(change[-6:]))

    def variances(self, prior: Prior) -> np.ndarray:
        """Give the (12 + n,) variances before the first look."""
        count = len(self.robot.joint_names)
        sigma = ([prior.placement_m] * 3 + [prior.placement_rad] * 3
                 + [prior.joint_rad] * count + [prior.grip_m] * 3 + [prior.grip_rad] * 3)
        return np.array(sigma) ** 2
