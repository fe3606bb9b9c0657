"""Run this package's plan and servo on bodies that fly freely."""

from __future__ import annotations

from homography_servo.experiments.servo_outcome import CONVERGED_M
from homography_servo.experiments.servo_outcome import CONVERGED_RAD
from homography_servo.experiments.servo_outcome import error_of
from homography_servo.experiments.servo_outcome import lengths
from homography_servo.experiments.servo_outcome import Outcome
from homography_servo.experiments.servo_pairs import corners_px
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.path import interpolate
from homography_servo.geometry.pose import estimate_pose
from homography_servo.planning.free_flight import FreeServo
from homography_servo.planning.free_flight import MirrorFilters
from homography_servo.planning.look_filter import Look
from homography_servo.planning.planner import plan
from homography_servo.planning.settings import PlannerSettings
from homography_servo.result import Rejected
import numpy as np

START_LOOKS = 5
FIRST_TRIES = 20


class FreeWorld:
    """A body that carries out displacements exactly, and a camera with corner noise."""

    def __init__(self, camera: Camera, points_m: np.ndarray, home_depth_m: float,
                 start: np.ndarray, noise_px: float, seed: int) -> None:
        self.camera, self.points_m, self.home_depth_m = camera, points_m, home_depth_m
        self.noise_px = noise_px
        self.setpoint = np.eye(4)
        self.trace = [np.array(start)]
        self._start = np.array(start)
        self._rng = np.random.default_rng(seed)

    def seen_px(self) -> np.ndarray:
        """Measure corners (N, 2)."""
        seen_px = corners_px(self.camera, self.points_m, self.trace[-1], self.home_depth_m)
        return seen_px + self.noise_px * self._rng.normal(size=seen_px.shape)

    def look(self) -> Look:
        """Measure rays and their covariance."""
        sigma = max(self.noise_px, 1e-3) / np.array([self.camera.fx, self.camera.fy])
        return Look(self.camera.rays(self.seen_px()).ravel(),
                    np.diag(np.tile(sigma ** 2, len(self.points_m))))

    def go(self, setpoint: np.ndarray) -> None:
        """Carry out a displacement since the start, commanded in home."""
        self.setpoint = setpoint
        self.trace.append(self._start @ setpoint)


def run_free_pair(world: FreeWorld, goal: np.ndarray, looks: int) -> Outcome:
    """Plan and servo a body; the whole way is in ``world.trace``."""
    filters = _begin(world)
    if isinstance(filters, Rejected):
        return Outcome(False, vetoed=True, why=filters.reason)
    settings = PlannerSettings(home_depth_m=world.home_depth_m)

    def path_from(pose: np.ndarray) -> np.ndarray | Rejected:
        planned = plan(pose, goal, world.camera, settings=settings,
                       object_points_m=world.points_m)
        if isinstance(planned, Rejected) or planned.ok:
            return planned if isinstance(planned, Rejected) else planned.poses
        return Rejected(planned.sentence)

    path = path_from(filters.leader.pose(world.setpoint))
    if isinstance(path, Rejected):
        return Outcome(False, vetoed=True, why=path.reason)

    def replan(pose: np.ndarray) -> np.ndarray:
        again = path_from(pose)  # a start that is believed wrongly may have no path: go straight
        return interpolate(pose, goal, settings.poses, world.home_depth_m) \
            if isinstance(again, Rejected) else again
    servo, steps = FreeServo(filters, path, replan), 0
    for _ in range(looks):
        steps += not servo.at_goal
        world.go(servo.step(world.look(), world.setpoint))
    return _outcome(world, goal, steps)


def _begin(world: FreeWorld) -> MirrorFilters | Rejected:
    for _ in range(FIRST_TRIES):
        first = estimate_pose(world.points_m, world.seen_px(), world.camera, world.home_depth_m,
                              max(world.noise_px, 1e-3) ** 2)
        if not isinstance(first, Rejected):
            break
    else:
        return first
    filters = MirrorFilters(world.points_m, world.home_depth_m)
    filters.begin(np.array([c.home_from_object for c in first.candidates]),
                  np.array([c.covariance for c in first.candidates]), world.setpoint)
    for _ in range(START_LOOKS):
        filters.update(world.look(), world.setpoint)
    return filters


def _outcome(world: FreeWorld, goal: np.ndarray, steps: int) -> Outcome:
    poses = np.array(world.trace)
    seen_px = corners_px(world.camera, world.points_m, poses, world.home_depth_m)
    inside = world.camera.contains(seen_px).all()
    error_m, error_rad = error_of(poses[-1], goal)
    path, turn = lengths(poses[:steps + 1])
    return Outcome(bool(error_m < CONVERGED_M and error_rad < CONVERGED_RAD),
                   left_image=not inside, path_over_straight=path, rotation_over_minimum=turn,
                   iterations=steps, error_m=error_m, error_rad=error_rad)
