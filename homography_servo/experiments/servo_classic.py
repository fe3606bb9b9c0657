"""Run classical laws on many pairs at once, with the same noise and the same worlds."""

from __future__ import annotations

from typing import NamedTuple, Sequence

from homography_servo.experiments.servo_laws import Law
from homography_servo.experiments.servo_outcome import CONVERGED_M
from homography_servo.experiments.servo_outcome import CONVERGED_RAD
from homography_servo.experiments.servo_outcome import error_of
from homography_servo.experiments.servo_outcome import JUMP_RAD
from homography_servo.experiments.servo_outcome import lengths
from homography_servo.experiments.servo_outcome import Outcome
from homography_servo.experiments.servo_pairs import CAMERA
from homography_servo.experiments.servo_pairs import corners_px
from homography_servo.experiments.servo_pairs import Crowd
from homography_servo.experiments.servo_pairs import RobotPair
from homography_servo.experiments.servo_pairs import World
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.pose_batch import estimate_poses
from homography_servo.geometry.pose_batch import PoseStack
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import pose_difference
from homography_servo.robot.kinematics import object_jacobian
from homography_servo.robot.robot_file import Robot
import numpy as np

GAIN = 0.15  # share of the error per iteration
ITERATIONS = 250
NEVER_M = 50.0


class Target(NamedTuple):
    """What all runs know of their goals, as the believed camera saw them."""

    camera_from_object: np.ndarray  # (M, 4, 4)
    rays: np.ndarray  # (M, 2N)


class Gaze:
    """The believed camera looks at many objects at once and follows each one's minimum."""

    def __init__(self, camera: Camera, points_m: np.ndarray, home_depth_m: float,
                 noise_px: float, seed: int) -> None:
        self._camera, self._points_m, self._depth_m = camera, points_m, home_depth_m
        self._noise_px, self._rng = noise_px, np.random.default_rng(seed)
        self._last: np.ndarray | None = None

    def start_at(self, poses: np.ndarray) -> None:
        """Tell roughly where the objects are, so that the first minimum is the right one."""
        self._last = np.array(poses)

    def measure(self, seen_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Add noise to corners (M, N, 2); give rays (M, 2N) and poses (M, 4, 4) in home."""
        seen_px = seen_px + self._noise_px * self._rng.normal(size=seen_px.shape)
        stack = estimate_poses(self._points_m, seen_px, self._camera, self._depth_m,
                               max(self._noise_px, 1e-3) ** 2)
        poses = self._nearest(stack)
        self._last = poses
        return self._camera.rays(seen_px).reshape(len(seen_px), -1), poses

    def _nearest(self, stack: PoseStack) -> np.ndarray:
        if self._last is None:
            poses = stack.home_from_object[:, 0]
            lost = stack.minima == 0
            return np.where(lost[:, None, None], np.eye(4), poses)
        poses = np.where((stack.minima > 0)[:, None, None, None], stack.home_from_object,
                         self._last[:, None])
        away = pose_difference(poses, np.broadcast_to(self._last[:, None], poses.shape))
        choice = np.argmin(np.linalg.norm(away[..., 3:], axis=-1), axis=1)
        return poses[np.arange(len(poses)), choice]


def in_camera(poses: np.ndarray, home_depth_m: float) -> np.ndarray:
    """Carry poses (M, 4, 4) from home over to the camera."""
    moved = np.array(poses)
    moved[:, 2, 3] += home_depth_m
    return moved


def run_on_robot(law: Law, robot: Robot, worlds: Sequence[World], pairs: Sequence[RobotPair],
                 noise_px: float, seed: int) -> list[Outcome]:
    """Servo all pairs with a law through the believed Jacobian; no law looks at limits."""
    crowd, joints = Crowd(worlds), np.array([pair.start_rad for pair in pairs])
    goals = crowd.pose(np.array([pair.goal_rad for pair in pairs]))
    gaze = Gaze(CAMERA, robot.object_points_m, robot.home_depth_m, noise_px, seed)
    target = _target(gaze, robot.home_depth_m, crowd.see(goals)[0], goals)
    gaze.start_at(crowd.pose(joints))
    state = _Runs(len(pairs))
    for _ in range(ITERATIONS):
        poses = crowd.pose(joints)
        seen_px, inside = crowd.see(poses)
        broken = ((joints < robot.lower_rad) | (joints > robot.upper_rad)).any(axis=1)
        state.note(poses, inside, broken)
        rays, measured = gaze.measure(seen_px)
        twist = GAIN * law(in_camera(measured, robot.home_depth_m), target.camera_from_object,
                           rays, target.rays, robot.object_points_m)
        step = np.einsum('mij,mj->mi', np.linalg.pinv(object_jacobian(robot, joints)), twist)
        state.jumped |= (np.abs(step).max(axis=1) > JUMP_RAD) & state.running
        state.running &= ~state.jumped
        joints = np.where(state.running[:, None], joints + step, joints)
    return state.outcomes(goals)


def run_free(law: Law, camera: Camera, points_m: np.ndarray, home_depth_m: float,
             starts: np.ndarray, goals: np.ndarray, noise_px: float, seed: int,
             iterations: int = ITERATIONS) -> tuple[list[Outcome], np.ndarray]:
    """Servo free bodies; also give their true poses in all iterations (K, M, 4, 4)."""
    gaze = Gaze(camera, points_m, home_depth_m, noise_px, seed)
    goals_px = corners_px(camera, points_m, goals, home_depth_m)
    target = Target(in_camera(goals, home_depth_m), camera.rays(goals_px).reshape(len(goals), -1))
    poses, state = np.array(starts), _Runs(len(starts))
    for _ in range(iterations):
        seen_px = corners_px(camera, points_m, poses, home_depth_m)
        inside = camera.contains(seen_px).all(axis=-1)
        inside &= (poses[:, 2, 3] + home_depth_m > 0.02) & (poses[:, 2, 3] < NEVER_M)
        state.note(poses, inside, np.zeros(len(poses), dtype=bool))
        rays, measured = gaze.measure(np.where(np.isfinite(seen_px), seen_px, 0.0))
        twist = GAIN * law(in_camera(measured, home_depth_m), target.camera_from_object,
                           rays, target.rays, points_m)
        twist = np.where(state.running[:, None] & np.isfinite(twist), twist, 0.0)
        poses = displaced(poses, twist)
    return state.outcomes(goals), np.array(state.trace)


def _target(gaze: Gaze, home_depth_m: float, goals_px: np.ndarray, goals: np.ndarray) -> Target:
    noise, gaze._noise_px = gaze._noise_px, 0.0  # goals are taught without noise, for all laws
    gaze.start_at(goals)
    rays, poses = gaze.measure(goals_px)
    gaze._noise_px = noise
    return Target(in_camera(poses, home_depth_m), rays)


class _Runs:
    """What happened to many runs; one that leaves the image or jumps has ended."""

    def __init__(self, count: int) -> None:
        self.running = np.ones(count, dtype=bool)
        self.left, self.broken, self.jumped = (np.zeros(count, dtype=bool) for _ in range(3))
        self.trace: list[np.ndarray] = []

    def note(self, poses: np.ndarray, inside: np.ndarray, broken: np.ndarray) -> None:
        """Take in where all are now."""
        self.left |= ~inside & self.running
        self.broken |= broken & self.running
        self.running &= inside
        self.trace.append(poses)

    def outcomes(self, goals: np.ndarray) -> list[Outcome]:
        """Judge every run."""
        trace = np.array(self.trace)
        return [self._outcome(index, trace[:, index], goal) for index, goal in enumerate(goals)]

    def _outcome(self, index: int, way: np.ndarray, goal: np.ndarray) -> Outcome:
        errors = pose_difference(way, np.broadcast_to(goal, way.shape))
        near = (np.linalg.norm(errors[:, :3], axis=1) < CONVERGED_M) \
            & (np.linalg.norm(errors[:, 3:], axis=1) < CONVERGED_RAD)
        error_m, error_rad = error_of(way[-1], goal)
        first = int(np.argmax(near)) if near.any() else len(way)
        path, turn = lengths(way[:first + 1]) if first else (np.nan, np.nan)
        good = bool(near[-1] and not (self.left[index] or self.broken[index]
                                      or self.jumped[index]))
        return Outcome(good, bool(self.left[index]), bool(self.broken[index]),
                       bool(self.jumped[index]), path_over_straight=path,
                       rotation_over_minimum=turn, iterations=first,
                       error_m=error_m, error_rad=error_rad)
