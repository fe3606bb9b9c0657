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

from homography_servo.geometry.rigid import displaced
from homography_servo.planning.checks import same_posture
from homography_servo.planning.checks import UNTRIED
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

    def lowered_to(self, found: Values) -> Values:
        """Give limits that allow what was found at one configuration."""
        return Values(*(min(limit, value) for limit, value in zip(self, found)))


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
        start = self._values_at(task.start_joints_rad)
        self.limits = self._asked.lowered_to(start)
        self._untried_room_rad = min(UNTRIED * self._asked.room_rad, start.room_rad)
        if task.goal_known:
            self.limits = self._lowered_to_goal(self._values_at(task.goal_branches[0]))
        usable = [not self.fault(joints_rad) for joints_rad in task.goal_branches]
        self.goals = task.goal_branches[np.array(usable, dtype=bool)]

    def _lowered_to_goal(self, taught: Values) -> Values:
        """Allow what was so when the goal was taught; its view is that of every posture there."""
        lowered = self.limits.lowered_to(taught)
        if taught.conditioning > 0.0:
            return lowered
        return self.limits._replace(border_px=lowered.border_px, facing_rad=lowered.facing_rad)

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
        found, limits = self._values_at(joints_rad), self._limits_at(joints_rad)
        if found.reach(limits):
            return ''
        if found.conditioning < 0.0:
            return 'a singularity of the arm lies between here and there'
        if found.conditioning < limits.conditioning:
            return (f'it is near a singularity there (smallest singular value '
                    f'{found.conditioning:.4f}, {limits.conditioning:.4f} is needed)')
        if found.room_rad < limits.room_rad:
            robot = self._task.arm
            index = int(np.argmin(np.minimum(joints_rad - robot.lower_rad,
                                             robot.upper_rad - joints_rad)))
            return (f'{robot.joint_names[index]} is {np.degrees(found.room_rad):.1f} deg from '
                    f'its limit there ({np.degrees(limits.room_rad):.1f} deg are needed)')
        return 'the object is not well in view there'

    def _limits_at(self, joints_rad: np.ndarray) -> Values:
        """Ask for more room in a posture in which the goal was not taught, as the verdict does."""
        taught_rad = self._task.goal_joints_rad
        if taught_rad is None or same_posture(joints_rad, taught_rad):
            return self.limits
        return self.limits._replace(room_rad=max(self.limits.room_rad, self._untried_room_rad))

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

    def _values_at(self, joints_rad: np.ndarray) -> Values:
        return Values(*(float(value[0]) for value in self.values(joints_rad[None])))

    def values(self, joints_rad: np.ndarray) -> Values:
        """Measure configurations (N, n)."""
        task = self._task
        border_px, facing_rad = self._seen(task.poses_of(joints_rad))
        room = np.minimum(joints_rad - task.arm.lower_rad, task.arm.upper_rad - joints_rad)
        return Values(room.min(axis=1), border_px, -facing_rad, self._off_singularity(joints_rad))

    def _seen(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Look at poses as they are near the start and as they are near the goal, the worse."""
        task = self._task
        views = [poses] if not task.goal_known else [poses, displaced(poses, task.goal_shift)]
        seen = [look(view, task.camera, task.object_points_m, task.home_depth_m)
                for view in views]
        return (np.min([view.border_px.min(axis=1) for view in seen], axis=0),
                np.max([view.facing_rad for view in seen], axis=0))

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
