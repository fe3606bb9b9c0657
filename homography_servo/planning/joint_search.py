"""
The search for a way through free joint configurations.

Two trees grow towards each other (RRT-Connect; Kuffner and LaValle, 2000,
doi:10.1109/ROBOT.2000.844730), then detours are cut short.
"""

from __future__ import annotations

from homography_servo.planning.joint_space import JointSpace
from homography_servo.planning.joint_space import line
from homography_servo.planning.joint_space import Values
import numpy as np

STRIDE_RAD = 0.4
SHORTCUTS = 60


class _Tree:
    """Configurations and where each came from; roots (K, n) may be beyond limits."""

    def __init__(self, space: JointSpace, roots: np.ndarray) -> None:
        self.nodes, self.parents = list(roots), [-1] * len(roots)
        self.floor = Values(*(value.min() for value in space.values(roots)))

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
        Where the way begins; may be beyond limits.
    goals : (K, n) array
        Any of these will do; they may be beyond limits, too.
    tries : int
        How many configurations may be tried.
    rng : numpy Generator
        Makes the search repeatable.

    Returns
    -------
    (M, n) array or None
        Corners of the way, None when none was found.

    """
    trees = [_Tree(space, start[None]), _Tree(space, goals)]
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
    way = line(origin, target)
    free = space.along(way, tree.floor)
    reach = len(way) if free.all() else int(np.argmin(free))
    if reach <= 1:
        return None
    return tree.add(target if reach == len(way) else way[reach - 1], nearest)


def shortened(space: JointSpace, way: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Replace detours between any two points of a way by straight lines where they are free."""
    for _ in range(SHORTCUTS if len(way) > 2 else 0):
        at = np.sort(rng.uniform(0.0, len(way) - 1.0, 2))
        i, j = int(at[0]), int(at[1])
        if i == j:
            continue
        a = way[i] + (way[i + 1] - way[i]) * (at[0] - i)
        b = way[j] + (way[j + 1] - way[j]) * (at[1] - j)
        if space.open(a, b) or space.open(b, a):
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
