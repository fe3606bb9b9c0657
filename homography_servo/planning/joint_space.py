"""
Joint configurations that may be passed, and straight ways between them.

A configuration is free when it keeps the joint margins, is on the start's side of every
singularity (unless singularities may be passed), and shows the object to the camera as
the verdict demands it. A start or a taught goal that is beyond a limit may be left from
there: a way comes up to the limit once and then keeps it.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

from homography_servo.planning.feasibility import look
from homography_servo.planning.task import Task
from homography_servo.robot.kinematics import object_jacobian
import numpy as np

RESOLUTION_RAD = 0.05
SLACK = 1e-9
SPARES = (1.02, 1.4, 2.0)  # ask more than the verdict, which looks at other samples


class Values(NamedTuple):
    """What is asked of configurations, larger is better; numbers or arrays (N,)."""

    room_rad: Any
    border_px: Any
    facing_rad: Any  # negative
    conditioning: Any  # negative beyond a singularity

    def reach(self, limits: Values) -> np.ndarray:
        """Tell where all values are as large as the limits."""
        return np.all([value >= limit - SLACK for value, limit in zip(self, limits)], axis=0)


class JointSpace:
    """
    The free configurations of one planning task.

    On the way `spare` times as much is asked as the verdict does, which looks at other
    samples. With `through`, singularities do not count.
    """

    def __init__(self, task: Task, spare: float = SPARES[0], through: bool = False) -> None:
        self._task, self.through = task, through
        limits = task.settings
        self._sign = 1.0 if through else self._side(task.start_joints_rad[None])[1][0]
        self._asked = Values(limits.joint_margin_rad, limits.field_margin_px,
                             -np.radians(limits.facing_limit_deg), limits.conditioning_min)
        self._spared = Values(limits.joint_margin_rad * spare,
                              limits.field_margin_px * spare + 1.0,
                              -np.radians(limits.facing_limit_deg) / spare,
                              limits.conditioning_min * spare)
        start = self.values(task.start_joints_rad[None])
        found = self.values(task.goal_branches)
        self.limits = Values(*(min(limit, float(v[0])) for limit, v in zip(self._asked, start)))
        if task.goal_known and found.conditioning[0] > 0.0:
            self.limits = Values(*(min(limit, float(v[0]))
                                   for limit, v in zip(self.limits, found)))
        self.goals = task.goal_branches[found.reach(self.limits)]

    @property
    def suffix(self) -> str:
        """Tell in names of ways whether singularities are passed."""
        return ' through a singularity' if self.through else ''

    @cached_property
    def lower_rad(self) -> np.ndarray:
        """Lower limits with their margin."""
        lower_rad = self._task.arm.lower_rad + self._spared.room_rad
        return np.minimum(lower_rad, self._task.start_joints_rad)

    @cached_property
    def upper_rad(self) -> np.ndarray:
        """Upper limits with their margin."""
        upper_rad = self._task.arm.upper_rad - self._spared.room_rad
        return np.maximum(upper_rad, self._task.start_joints_rad)

    def free(self, joints_rad: np.ndarray) -> np.ndarray:
        """Tell which of (N, n) configurations may be passed."""
        return self.values(np.atleast_2d(joints_rad)).reach(self._spared)

    def fault(self, joints_rad: np.ndarray) -> str:
        """Say why a configuration (n,) may not be passed, empty if it may."""
        found = Values(*(float(v[0]) for v in self.values(joints_rad[None])))
        if found.reach(self.limits):
            return ''
        if found.conditioning < 0.0:
            return 'a singularity of the arm lies between here and there'
        if found.conditioning < self.limits.conditioning:
            return (f'it is near a singularity there (smallest singular value '
                    f'{found.conditioning:.4f}, {self.limits.conditioning:.4f} is needed)')
        if found.room_rad < self.limits.room_rad:
            robot = self._task.arm
            index = int(np.argmin(np.minimum(joints_rad - robot.lower_rad,
                                             robot.upper_rad - joints_rad)))
            return (f'{robot.joint_names[index]} is {np.degrees(found.room_rad):.1f} deg from '
                    f'its limit there ({np.degrees(self.limits.room_rad):.1f} deg are needed)')
        return 'the object is not well in view there'

    def open(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Tell whether the straight way from a, which may be beyond a limit, to b is free."""
        values = self.values(line(a, b))
        return bool(self._kept(values, Values(*(value[0] for value in values))).all())

    def along(self, joints_rad: np.ndarray, floor: Values) -> np.ndarray:
        """
        Tell how a way can be gone that begins as low as a floor.

        Parameters
        ----------
        joints_rad : (N, n) array
            Configurations one after the other.
        floor : Values
            What the way may not fall below before it has come up to the limits.

        Returns
        -------
        (N,) bool array
            Which of them may be passed.

        """
        return self._kept(self.values(joints_rad), floor)

    def _kept(self, values: Values, floor: Values) -> np.ndarray:
        kept = np.ones(len(values.room_rad), dtype=bool)
        for limits in (self._asked, self._spared):
            for value, limit, least in zip(values, limits, floor):
                come_up = np.logical_or.accumulate(value >= limit - SLACK)
                kept &= value >= np.where(come_up, limit, np.minimum(least, limit)) - SLACK
        return kept

    def values(self, joints_rad: np.ndarray) -> Values:
        """Measure configurations (N, n)."""
        task = self._task
        seen = look(task.poses_of(joints_rad), task.camera, task.object_points_m,
                    task.home_depth_m)
        room = np.minimum(joints_rad - task.arm.lower_rad, task.arm.upper_rad - joints_rad)
        return Values(room.min(axis=1), seen.border_px.min(axis=1), -seen.facing_rad,
                      self._off_singularity(joints_rad))

    def _off_singularity(self, joints_rad: np.ndarray) -> np.ndarray:
        if self.through:
            return np.full(len(joints_rad), np.inf)
        smallest, sign = self._side(joints_rad)
        return np.where(sign * self._sign < 0.0, -smallest, smallest)

    def _side(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        length_m = self._task.settings.conditioning_length_m
        jacobian = object_jacobian(self._task.arm, joints_rad)
        jacobian = jacobian * np.array([1.0 / length_m] * 3 + [1.0] * 3)[:, None]
        smallest = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
        square = jacobian.shape[-1] == 6
        return smallest, np.sign(np.linalg.det(jacobian)) if square else np.ones(len(jacobian))


def line(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sample the straight way from a to b, both ends counted."""
    count = max(int(np.ceil(np.abs(b - a).max() / RESOLUTION_RAD)), 1)
    return a + (b - a) * (np.arange(count + 1) / count)[:, None]
