"""
Joint configurations that may be passed, and the search for a way through them.

A configuration is free when it keeps the joint margins, is on the start's side of every
singularity (unless singularities may be passed), and shows the object to the camera as
the verdict demands it. The search is a pair of trees that grow towards each other
(RRT-Connect), then shortcuts.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

from homography_servo.planning.feasibility import look
from homography_servo.planning.task import Task
from homography_servo.robot.kinematics import object_jacobian
import numpy as np

RESOLUTION_RAD = 0.05
STRIDE_RAD = 0.4
SHORTCUTS = 60
SPARES = (1.02, 1.4, 2.0)  # ask more than the verdict, which looks at other samples


class Values(NamedTuple):
    """What is asked of configurations, larger is better; numbers or arrays (N,)."""

    room_rad: Any
    border_px: Any
    facing_rad: Any  # negative
    conditioning: Any  # negative beyond a singularity

    def reach(self, limits: Values) -> np.ndarray:
        """Tell where all values are as large as the limits."""
        return np.all([value >= limit - 1e-9 for value, limit in zip(self, limits)], axis=0)


class JointSpace:
    """
    The free configurations of one planning task.

    On the way `spare` times as much is asked as the verdict does, which looks at other
    samples, but never more than start and goals have. With `through`, singularities
    do not count.
    """

    def __init__(self, task: Task, spare: float = SPARES[0], through: bool = False) -> None:
        self._task, self.through = task, through
        limits = task.settings
        self._sign = 1.0 if through else self._side(task.start_joints_rad[None])[1][0]
        asked = Values(limits.joint_margin_rad, limits.field_margin_px,
                       -np.radians(limits.facing_limit_deg), limits.conditioning_min)
        start = self.values(task.start_joints_rad[None])
        found = self.values(task.goal_branches)
        self.limits = Values(*(min(limit, float(v[0])) for limit, v in zip(asked, start)))
        if task.goal_known and found.conditioning[0] > 0.0:
            self.limits = Values(*(min(limit, float(v[0]))
                                   for limit, v in zip(self.limits, found)))
        good = found.reach(self.limits)
        self.goals = task.goal_branches[good]
        more = Values(limits.joint_margin_rad * spare, limits.field_margin_px * spare + 1.0,
                      -np.radians(limits.facing_limit_deg) / spare,
                      limits.conditioning_min * spare)
        self._passing = Values(*(
            min(limit, float(v[0]), float(np.min(g[good], initial=np.inf)))
            for limit, v, g in zip(more, start, found)))

    @property
    def suffix(self) -> str:
        """Tell in names of ways whether singularities are passed."""
        return ' through a singularity' if self.through else ''

    @cached_property
    def lower_rad(self) -> np.ndarray:
        """Lower limits with their margin."""
        lower_rad = self._task.arm.lower_rad + self._passing.room_rad
        return np.minimum(lower_rad, self._task.start_joints_rad)

    @cached_property
    def upper_rad(self) -> np.ndarray:
        """Upper limits with their margin."""
        upper_rad = self._task.arm.upper_rad - self._passing.room_rad
        return np.maximum(upper_rad, self._task.start_joints_rad)

    def free(self, joints_rad: np.ndarray) -> np.ndarray:
        """Tell which of (N, n) configurations may be passed."""
        return self.values(np.atleast_2d(joints_rad)).reach(self._passing)

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
        """Tell whether the straight way from a to b is free."""
        return bool(self.free(self.line(a, b)).all())

    @staticmethod
    def line(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Sample the straight way from a to b, without a, with b."""
        count = max(int(np.ceil(np.abs(b - a).max() / RESOLUTION_RAD)), 1)
        return a + (b - a) * (np.arange(1, count + 1) / count)[:, None]

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


class _Tree:
    """Configurations and where each came from."""

    def __init__(self, root: np.ndarray) -> None:
        self.nodes, self.parents = [root], [-1]

    def nearest(self, target: np.ndarray) -> int:
        return int(np.argmin(np.square(np.array(self.nodes) - target).sum(axis=1)))

    def add(self, node: np.ndarray, parent: int) -> int:
        self.nodes.append(node)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def way(self, index: int) -> list[np.ndarray]:
        found = []
        while index >= 0:
            found.append(self.nodes[index])
            index = self.parents[index]
        return found[::-1]


def search(space: JointSpace, start: np.ndarray, goals: np.ndarray, tries: int,
           rng: np.random.Generator) -> np.ndarray | None:
    """
    Find a way through free configurations.

    Parameters
    ----------
    space : JointSpace
        What is free.
    start : (n,) array
        Where the way begins; counts as free.
    goals : (K, n) array
        Any of these will do; all free.
    tries : int
        How many configurations may be tried.
    rng : numpy Generator
        Makes the search repeatable.

    Returns
    -------
    (M, n) array or None
        Corners of the way, None when none was found.

    """
    trees = [_Tree(start), _Tree(goals[0])]
    for goal in goals[1:]:
        trees[1].add(goal, -1)
    for attempt in range(tries):
        here, there = trees if attempt % 2 == 0 else trees[::-1]
        sample = rng.uniform(space.lower_rad, space.upper_rad)
        new = _extend(space, here, sample, STRIDE_RAD)
        if new is None:
            continue
        met = _extend(space, there, here.nodes[new], np.inf)
        if met is not None and np.array_equal(there.nodes[met], here.nodes[new]):
            ways = here.way(new), there.way(met)
            forth, back = ways if here is trees[0] else ways[::-1]
            return np.array(forth + back[::-1][1:])
    return None


def _extend(space: JointSpace, tree: _Tree, target: np.ndarray, stride: float) -> int | None:
    """Grow a tree towards a target as far as the way is free, at most one stride."""
    nearest = tree.nearest(target)
    origin = tree.nodes[nearest]
    distance = np.abs(target - origin).max()
    if distance > stride:
        target = origin + (target - origin) * (stride / distance)
    line = space.line(origin, target)
    free = space.free(line)
    reach = len(line) if free.all() else int(np.argmin(free))
    return None if reach == 0 else tree.add(target if reach == len(line) else line[reach - 1],
                                            nearest)


def shortened(space: JointSpace, way: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Replace detours between any two points of a way by straight lines where they are free."""
    for _ in range(SHORTCUTS if len(way) > 2 else 0):
        at = np.sort(rng.uniform(0.0, len(way) - 1.0, 2))
        i, j = int(at[0]), int(at[1])
        if i == j:
            continue
        a = way[i] + (way[i + 1] - way[i]) * (at[0] - i)
        b = way[j] + (way[j + 1] - way[j]) * (at[1] - j)
        if space.open(a, b):
            way = np.concatenate([way[:i + 1], [a, b], way[j + 1:]])
    return way


def spread(way: np.ndarray, count: int) -> np.ndarray:
    """Place configurations along a way, the same largest joint motion apart."""
    step = np.abs(np.diff(way, axis=0)).max(axis=1)
    at = np.concatenate([[0.0], np.cumsum(step)])
    if at[-1] <= 0.0:
        return np.repeat(way[:1], count, axis=0)
    keep = np.concatenate([[True], step > 0.0])
    where = np.linspace(0.0, at[-1], count)
    placed = np.column_stack([np.interp(where, at[keep], column) for column in way[keep].T])
    placed[-1] = way[-1]
    return placed
