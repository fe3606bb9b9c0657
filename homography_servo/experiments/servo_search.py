"""
A search for a way, made to check vetoes: nothing of the planner is used in it.

Two trees grow towards each other in joint space (RRT-connect; Kuffner and LaValle,
2000), from the start and from every posture that holds the object at the goal. A
posture is allowed under the rules of the verdict: joint margin, corners inside the
image, face towards the camera, and on the start's side of every singularity. What it
finds would be a path that can be servoed; when it finds none with its large budget,
the veto counts as confirmed.
"""

from __future__ import annotations

from homography_servo.experiments.servo_pairs import CAMERA
from homography_servo.experiments.servo_pairs import corners_px
from homography_servo.planning.settings import FeasibilitySettings
from homography_servo.robot.kinematics import inverse
from homography_servo.robot.kinematics import object_jacobian
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
import numpy as np

STRIDE_RAD = 0.3
CHECK_RAD = 0.04
BUDGET = 4000  # nodes of both trees
INVERSE_SEEDS = 5


class Rules:
    """Which postures are allowed on the way from a start."""

    def __init__(self, robot: Robot, start_rad: np.ndarray,
                 limits: FeasibilitySettings = FeasibilitySettings()) -> None:
        self.robot, self._limits = robot, limits
        self._sign = np.sign(self._determinant(start_rad[None])[1])[0]

    def allow(self, joints_rad: np.ndarray) -> np.ndarray:
        """Judge postures (K, n)."""
        robot, limits = self.robot, self._limits
        room = np.minimum(joints_rad - robot.lower_rad, robot.upper_rad - joints_rad)
        good = room.min(axis=1) >= limits.joint_margin_rad
        poses = object_pose(robot, joints_rad)
        place = poses[:, :3, 3] + (0.0, 0.0, robot.home_depth_m)
        cosine = (poses[:, :3, 2] * place).sum(axis=1) / np.linalg.norm(place, axis=1)
        good &= cosine >= np.cos(np.radians(limits.facing_limit_deg))
        good &= place[:, 2] > 0.2
        seen = corners_px(CAMERA, robot.object_points_m, poses, robot.home_depth_m)
        good &= CAMERA.contains(seen, limits.field_margin_px).all(axis=-1)
        smallest, determinant = self._determinant(joints_rad)
        return good & (smallest >= limits.conditioning_min) & (determinant * self._sign > 0.0)

    def _determinant(self, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale = np.array([1.0 / self._limits.conditioning_length_m] * 3 + [1.0] * 3)
        jacobian = object_jacobian(self.robot, joints_rad) * scale[:, None]
        return np.linalg.svd(jacobian, compute_uv=False)[:, -1], np.linalg.det(jacobian)

    def free_way(self, from_rad: np.ndarray, to_rad: np.ndarray) -> bool:
        """Judge the straight line in joint space between two postures, ends included."""
        count = max(2, int(np.ceil(np.abs(to_rad - from_rad).max() / CHECK_RAD)) + 1)
        return bool(self.allow(np.linspace(from_rad, to_rad, count)).all())


class Tree:
    """Postures that are connected to its roots."""

    def __init__(self, roots_rad: np.ndarray) -> None:
        self.nodes_rad = np.array(roots_rad, dtype=float)

    def grow(self, target_rad: np.ndarray, rules: Rules) -> np.ndarray | None:
        """Take one stride from the nearest node; None when the way is blocked."""
        nearest = self.nodes_rad[np.argmin(np.abs(self.nodes_rad - target_rad).sum(axis=1))]
        way = target_rad - nearest
        reach = np.abs(way).max()
        node = target_rad if reach <= STRIDE_RAD else nearest + way * (STRIDE_RAD / reach)
        if not rules.free_way(nearest, node):
            return None
        self.nodes_rad = np.vstack([self.nodes_rad, node])
        return node

    def connect(self, target_rad: np.ndarray, rules: Rules) -> bool:
        """Stride on until the target is reached or the way is blocked."""
        while (node := self.grow(target_rad, rules)) is not None:
            if np.array_equal(node, target_rad):
                return True
        return False


def postures(robot: Robot, home_from_object: np.ndarray, near_rad: np.ndarray) -> np.ndarray:
    """Collect all joint vectors (K, n) that hold the object at a pose, from several seeds."""
    found = [inverse(robot, home_from_object, near_rad, seed) for seed in range(INVERSE_SEEDS)]
    return np.concatenate(found) if any(len(part) for part in found) else np.zeros((0, 6))


def way_exists(robot: Robot, start_rad: np.ndarray, goal_rad: np.ndarray, seed: int,
               budget: int = BUDGET) -> bool:
    """Search for an allowed way from a posture to the pose of the object at another."""
    rules, rng = Rules(robot, start_rad), np.random.default_rng(seed)
    goals = np.vstack([postures(robot, object_pose(robot, goal_rad), goal_rad), goal_rad])
    goals = goals[rules.allow(goals)]
    if not len(goals) or not rules.allow(start_rad[None]).all():
        return False
    trees = [Tree(start_rad[None]), Tree(goals)]
    tries = 0
    while sum(len(tree.nodes_rad) for tree in trees) < budget and tries < 4 * budget:
        tries += 1
        node = trees[0].grow(rng.uniform(robot.lower_rad, robot.upper_rad), rules)
        if node is not None and trees[1].connect(node, rules):
            return True
        trees.reverse()
    return False
