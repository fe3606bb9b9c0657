"""Random starts and goals for the servo benchmark, and worlds that differ from the belief."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
from typing import Sequence

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import transform
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.feasibility import look
from homography_servo.robot.robot_file import Robot
import numpy as np
from scipy.spatial.transform import Rotation

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
JOINT_MARGIN_RAD = 0.1
BORDER_PX = 20.0
FACING_RAD = np.radians(60.0)


@dataclass(frozen=True, eq=False)
class World:
    """What is true: the arm from commanded joints to the object, and the camera."""

    arm: ArmModel
    camera: Camera

    def corners_px(self, home_from_object: np.ndarray) -> np.ndarray:
        """Project the object's points (..., N, 2)."""
        return corners_px(self.camera, self.arm.robot.object_points_m, home_from_object,
                          self.arm.robot.home_depth_m)


class Crowd:
    """
    Many worlds of one arm, looked at all at once.

    Parameters
    ----------
    worlds : sequence of World
        M of them.

    """

    def __init__(self, worlds: Sequence[World]) -> None:
        arms = [world.arm for world in worlds]
        self._robot = arms[0].robot
        self._arm = ArmModel(
            self._robot, np.array([arm.left for arm in arms]),
            np.array([np.broadcast_to(arm.offset_rad, self._robot.count) for arm in arms]),
            np.array([arm.right for arm in arms]))
        self._seen_by = {camera: np.array([world.camera == camera for world in worlds])
                         for camera in {world.camera for world in worlds}}

    def pose(self, joints_rad: np.ndarray) -> np.ndarray:
        """Give home_from_object (M, 4, 4) for joints (M, n), one row for each world."""
        return self._arm.pose(joints_rad)

    def see(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project the object's points (M, N, 2); tell which worlds see all of them."""
        seen_px = np.empty((len(poses), len(self._robot.object_points_m), 2))
        inside = np.empty(len(poses), dtype=bool)
        for camera, own in self._seen_by.items():
            seen_px[own] = corners_px(camera, self._robot.object_points_m, poses[own],
                                      self._robot.home_depth_m)
            inside[own] = camera.contains(seen_px[own]).all(axis=-1)
        return seen_px, inside


@dataclass(frozen=True, eq=False)
class RobotPair:
    """Commanded joints at start and goal."""

    start_rad: np.ndarray
    goal_rad: np.ndarray
    seed: int


def corners_px(camera: Camera, points_m: np.ndarray, poses: np.ndarray, home_depth_m: float
               ) -> np.ndarray:
    """Project points at poses (..., 4, 4) to (..., N, 2)."""
    points = points_m @ np.swapaxes(poses[..., :3, :3], -1, -2) + poses[..., None, :3, 3]
    return camera.project(points + (0.0, 0.0, home_depth_m))


def exact_world(robot: Robot) -> World:
    """Give a world that is as believed."""
    return World(ArmModel(robot), CAMERA)


def wrong_world(robot: Robot, pair: RobotPair) -> World:
    """
    Give a world in which every model is wrong.

    The robot stands 10 mm and 3 deg elsewhere, the object is held 5 mm and 2 deg off,
    all joint zeros are 2 deg off to either side, the focal length is 2 % off; directions
    and signs are drawn until start and goal are well in view in that world, too.
    """
    rng = np.random.default_rng([pair.seed, 77])
    while True:
        world = _wrong_world(robot, rng)
        ends = world.arm.pose(np.array([pair.start_rad, pair.goal_rad]))
        if visible(world.camera, ends, robot.object_points_m, robot.home_depth_m).all():
            return world


def _wrong_world(robot: Robot, rng: np.random.Generator) -> World:
    arm = ArmModel(robot, exp_twist(_twist(rng, 0.010, np.radians(3.0))),
                   np.radians(2.0) * rng.choice([-1.0, 1.0], robot.count),
                   exp_twist(_twist(rng, 0.005, np.radians(2.0))))
    factor = 1.0 + rng.choice([-0.02, 0.02])
    return World(arm, replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy))


def _twist(rng: np.random.Generator, length_m: float, angle_rad: float) -> np.ndarray:
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.concatenate([length_m * directions[0], angle_rad * directions[1]])


def random_pairs(robot: Robot, count: int, seed: int) -> list[RobotPair]:
    """
    Draw pairs of reachable, visible poses, uniformly in joint space.

    Joints keep 0.1 rad from their limits, corners 20 px from the border, the face is
    within 60 deg of the line of sight; no other condition.
    """
    rng = np.random.default_rng(seed)
    good: list[np.ndarray] = []
    while len(good) < 2 * count:
        joints = rng.uniform(robot.lower_rad + JOINT_MARGIN_RAD,
                             robot.upper_rad - JOINT_MARGIN_RAD, (4096, robot.count))
        good.extend(joints[visible(CAMERA, ArmModel(robot).pose(joints), robot.object_points_m,
                                   robot.home_depth_m)])
    return [RobotPair(good[2 * i], good[2 * i + 1], seed * 100_003 + i) for i in range(count)]


def visible(camera: Camera, poses: np.ndarray, points_m: np.ndarray, home_depth_m: float
            ) -> np.ndarray:
    """Tell at which poses (M, 4, 4) the face is well in view."""
    seen = look(poses, camera, points_m, home_depth_m)
    return (seen.border_px.min(axis=1) >= BORDER_PX) & (seen.facing_rad <= FACING_RAD)


def free_poses(points_m: np.ndarray, count: int, seed: int, home_depth_m: float = 1.0
               ) -> np.ndarray:
    """Draw (count, 4, 4) visible poses: depth 0.5-1.2 m, tilt to 60 deg, any turn."""
    rng = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < count:
        depth = rng.uniform(0.5, 1.2, 1024)
        centre = rng.uniform((0.0, 0.0), (CAMERA.width - 1.0, CAMERA.height - 1.0), (1024, 2))
        rays = CAMERA.rays(centre)
        place = np.column_stack([rays * depth[:, None], depth - home_depth_m])
        axis = rng.uniform(-np.pi, np.pi, 1024)
        tilt = rng.uniform(0.0, FACING_RAD, 1024)
        tilts = Rotation.from_rotvec(np.column_stack(
            [tilt * np.cos(axis), tilt * np.sin(axis), np.zeros(1024)]))
        turns = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, (1024, 1)) * [[0.0, 0.0, 1.0]])
        poses = transform((tilts * turns).as_matrix(), place)
        found.extend(poses[visible(CAMERA, poses, points_m, home_depth_m)])
    return np.array(found[:count])
