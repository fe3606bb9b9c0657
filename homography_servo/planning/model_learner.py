"""
What measured poses at known joints teach about the arm before a path is planned.

A goal that was taught with the arm standing there can always be reached, whatever the
robot file says. With the two looks that every plan has (at the goal, at the start)
the model is corrected to agree with both, so that a plan is not vetoed because the
robot stands a few millimetres elsewhere than believed.
"""

from __future__ import annotations

from typing import NamedTuple, Sequence

from homography_servo.geometry.rigid import pose_difference
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.arm_model import Prior
from homography_servo.planning.look_filter import Look
from homography_servo.planning.look_filter import look_from_pose
from homography_servo.planning.look_filter import LookFilter
from homography_servo.result import Rejected
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
import numpy as np

PASSES = 3
KEPT = 16


class KnownLook(NamedTuple):
    """A measured pose while the arm stood at known joints."""

    home_from_object: np.ndarray  # (4, 4)
    covariance: np.ndarray  # (6, 6)
    joints_rad: np.ndarray  # (n,)


def learned(robot: Robot, looks: Sequence[KnownLook], largest_m: float, largest_rad: float
            ) -> Robot:
    """
    Correct an arm by looks, unless they say that it is not this arm at all.

    Where a look is further from the belief than the given limits, the model stays as
    it is, so that the plan can say so.
    """
    learner = ModelLearner(robot)
    for look in looks:
        away = pose_difference(look.home_from_object, object_pose(robot, look.joints_rad))
        if np.linalg.norm(away[:3]) > largest_m or np.linalg.norm(away[3:]) > largest_rad:
            return robot
        learner.learn(*look)
    return learner.robot


class ModelLearner:
    """
    Correct the model of an arm by looks; `robot` is the corrected one.

    The latest look at each posture counts. All are fitted together, by passes that
    start from the result of the pass before.
    """

    def __init__(self, robot: Robot, prior: Prior = Prior()) -> None:
        self._points_m, self._home_depth_m = robot.object_points_m, robot.home_depth_m
        self._filter = LookFilter(ArmModel(robot), self._points_m, self._home_depth_m, prior,
                                  drift=0.0)
        self._looks: dict[tuple[float, ...], Look] = {}

    @property
    def robot(self) -> Robot:
        """Give the arm as the looks so far say it is."""
        self._filter.reset()
        for _ in range(PASSES):
            self._filter.forget()
            for joints_rad, look in self._looks.items():
                self._filter.update(look, np.array(joints_rad))
        return self._filter.model.corrected

    def learn(self, home_from_object: np.ndarray, covariance: np.ndarray,
              joints_rad: np.ndarray) -> None:
        """Take in a measured pose while the arm stands at joints; what is unusable is left."""
        look = look_from_pose(home_from_object, covariance, self._points_m, self._home_depth_m)
        if isinstance(look, Rejected):
            return
        posture = tuple(float(v) for v in joints_rad)
        self._looks.pop(posture, None)
        self._looks[posture] = look
        if len(self._looks) > KEPT:
            del self._looks[next(iter(self._looks))]
