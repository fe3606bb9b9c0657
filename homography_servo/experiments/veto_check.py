"""
An independent, exhaustive opinion on vetoes: a second search for a way.

A roadmap covers the joint space of an arm with random postures that keep every limit
and joins neighbours wherever the straight way between them keeps them too. Two
postures that hang on different parts of it cannot be joined by any path this dense a
search can find. It knows nothing of start, goal or planner. Where singularities
may not be passed, the determinant has to keep its sign from sample to sample, so that
none is stepped over.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.camera import Camera
from homography_servo.planning.feasibility import look
from homography_servo.planning.settings import PlannerSettings
from homography_servo.robot.kinematics import inverse
from homography_servo.robot.kinematics import object_jacobian
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

NODES = 12000
NEIGHBOURS = 8
HOOKS = 120  # nodes that a start or a goal is tried to be joined to
STEP_RAD = 0.05
_CHUNK = 20000


class Limits(NamedTuple):
    """What a posture must keep: larger is better for all."""

    room_rad: float
    border_px: float
    facing_rad: float  # negative
    conditioning: float


class Roadmap:
    """
    The free joint space of an arm before a camera.

    Parameters
    ----------
    robot : Robot
        The arm.
    camera : Camera
        What has to see the object.
    settings : PlannerSettings
        The limits of the verdict, and whether singularities may be passed.
    nodes : int
        Number of postures; more find narrower ways.
    seed : int
        Seed of the postures.

    """

    def __init__(self, robot: Robot, camera: Camera,
                 settings: PlannerSettings = PlannerSettings(), nodes: int = NODES,
                 seed: int = 0) -> None:
        self._robot, self._camera, self._settings = robot, camera, settings
        self._through = settings.pass_singularities
        self.limits = Limits(settings.joint_margin_rad, settings.field_margin_px,
                             -np.radians(settings.facing_limit_deg),
                             -np.inf if self._through else settings.conditioning_min)
        self.nodes = self._postures(nodes, np.random.default_rng(seed))
        self._tree = cKDTree(self.nodes)
        self.part = self._parts()

    def confirms(self, start_rad: np.ndarray, goal: np.ndarray) -> bool:
        """Tell whether no way leads from joints to any way of holding the object at a goal."""
        branches = inverse(self._robot, goal, start_rad)
        start_parts = self._hooked(start_rad, self._loosened(start_rad))
        for joints_rad in branches:
            if not self._free(joints_rad[None], self.limits)[0][0]:
                continue
            if start_parts & self._hooked(joints_rad, self.limits):
                return False
            if self._joined(start_rad[None], joints_rad[None], self._loosened(start_rad))[0]:
                return False
        return True

    def _loosened(self, start_rad: np.ndarray) -> Limits:
        """Allow a start that is itself beyond a limit to leave from there."""
        values = [float(v[0]) for v in self._values(start_rad[None])[:4]]
        return Limits(*(min(limit, value) for limit, value in zip(self.limits, values)))

    def _postures(self, count: int, rng: np.random.Generator) -> np.ndarray:
        found = np.zeros((0, self._robot.count))
        while len(found) < count:
            joints = rng.uniform(self._robot.lower_rad, self._robot.upper_rad,
                                 (_CHUNK, self._robot.count))
            found = np.concatenate([found, joints[self._free(joints, self.limits)[0]]])
        return found[:count]

    def _parts(self) -> np.ndarray:
        _, near = self._tree.query(self.nodes, NEIGHBOURS + 1)
        pairs = np.column_stack([np.repeat(near[:, 0], NEIGHBOURS), near[:, 1:].ravel()])
        pairs = np.unique(np.sort(pairs, axis=1), axis=0)
        joined = pairs[self._joined(self.nodes[pairs[:, 0]], self.nodes[pairs[:, 1]],
                                    self.limits)]
        links = coo_matrix((np.ones(len(joined)), (joined[:, 0], joined[:, 1])),
                           (len(self.nodes), len(self.nodes)))
        return connected_components(links, directed=False)[1]

    def _hooked(self, joints_rad: np.ndarray, limits: Limits) -> set[int]:
        """Find the parts of the roadmap that a posture can be joined to."""
        _, near = self._tree.query(joints_rad, HOOKS)
        start = np.broadcast_to(joints_rad, (HOOKS, len(joints_rad)))
        joined = self._joined(start, self.nodes[near], limits)
        return {int(part) for part in self.part[near[joined]]}

    def _joined(self, a: np.ndarray, b: np.ndarray, limits: Limits) -> np.ndarray:
        """Tell between which of (M, n) pairs the straight way is free."""
        counts = np.maximum(np.ceil(np.abs(b - a).max(axis=1) / STEP_RAD).astype(int), 1)
        good = np.ones(len(a), dtype=bool)
        for chunk in np.array_split(np.arange(len(a)), max(counts.sum() // _CHUNK, 1)):
            owner = np.repeat(chunk, counts[chunk] + 1)
            first = np.cumsum(counts[chunk] + 1) - (counts[chunk] + 1)
            share = (np.arange(len(owner)) - np.repeat(first, counts[chunk] + 1)) / counts[owner]
            joints = a[owner] + share[:, None] * (b - a)[owner]
            free, sign = self._free(joints, limits)
            flips = (sign[1:] * sign[:-1] < 0.0) & (owner[1:] == owner[:-1])
            good[owner[~free]] = False
            if not self._through:
                good[owner[1:][flips]] = False
        return good

    def _free(self, joints_rad: np.ndarray, limits: Limits) -> tuple[np.ndarray, np.ndarray]:
        *values, sign = self._values(joints_rad)
        free = np.ones(len(joints_rad), dtype=bool)
        for value, limit in zip(values, limits):
            free &= value >= limit - 1e-9
        return free, sign

    def _values(self, joints_rad: np.ndarray) -> tuple[np.ndarray, ...]:
        robot = self._robot
        seen = look(object_pose(robot, joints_rad), self._camera, robot.object_points_m,
                    robot.home_depth_m)
        room = np.minimum(joints_rad - robot.lower_rad, robot.upper_rad - joints_rad)
        scale = np.array([1.0 / self._settings.conditioning_length_m] * 3 + [1.0] * 3)
        jacobian = object_jacobian(robot, joints_rad) * scale[:, None]
        singular = np.linalg.svd(jacobian, compute_uv=False)
        return (room.min(axis=1), seen.border_px.min(axis=1), -seen.facing_rad,
                singular[:, -1], np.sign(np.linalg.det(jacobian)))
