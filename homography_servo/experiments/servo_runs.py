"""Run this package's plan and servo on pairs, with corner noise instead of images."""

from __future__ import annotations

from typing import Any, Callable

from homography_servo.experiments.servo_outcome import CONVERGED_M
from homography_servo.experiments.servo_outcome import CONVERGED_RAD
from homography_servo.experiments.servo_outcome import error_of
from homography_servo.experiments.servo_outcome import JUMP_RAD
from homography_servo.experiments.servo_outcome import lengths
from homography_servo.experiments.servo_outcome import Outcome
from homography_servo.experiments.servo_pairs import CAMERA
from homography_servo.experiments.servo_pairs import RobotPair
from homography_servo.experiments.servo_pairs import World
from homography_servo.experiments.servo_world import ServoWorld
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.pose import PoseEstimate
from homography_servo.geometry.pose import Prior
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.joint_lead import JointLead
from homography_servo.planning.model_learner import KnownLook
from homography_servo.planning.model_learner import learned
from homography_servo.planning.observer_settings import ObserverSettings
from homography_servo.planning.planner import Plan
from homography_servo.planning.planner import plan
from homography_servo.planning.servo import Servo
from homography_servo.planning.settings import FeasibilitySettings
from homography_servo.result import Rejected
import numpy as np

START_LOOKS = 10
LONGEST_S = 240.0

# Says whether an independent search in a world agrees that there is no way.
Confirm = Callable[[World, RobotPair], bool]


class Eye:
    """The believed camera looking at a world: corners with noise, poses from them."""

    def __init__(self, world: World, noise_px: float, seed: int) -> None:
        self._world, self._noise_px = world, noise_px
        self._rng = np.random.default_rng(seed)
        self._believed = ArmModel(world.arm.robot)

    def pose(self, true_pose: np.ndarray, joints_rad: np.ndarray, looks: int | None = 1
             ) -> PoseEstimate | Rejected:
        """Measure, averaging some looks; None looks without noise."""
        robot, settings = self._world.arm.robot, ObserverSettings()
        seen_px = self._world.corners_px(true_pose)
        sigma_px = self._noise_px / np.sqrt(looks or np.inf)
        seen_px = seen_px + sigma_px * self._rng.normal(size=seen_px.shape)
        prior = Prior(self._believed.pose(joints_rad), np.diag(
            [settings.arm_sigma_m ** 2] * 3 + [settings.arm_sigma_rad ** 2] * 3))
        return estimate_pose(robot.object_points_m, seen_px, CAMERA, robot.home_depth_m,
                             max(sigma_px, 1e-3) ** 2, prior)


def plan_for(world: World, pair: RobotPair, eye: Eye) -> Plan | Rejected:
    """Teach the goal where the arm stands there, look at the start, plan: as operators do."""
    goal = eye.pose(world.arm.pose(pair.goal_rad), pair.goal_rad, None)
    start = eye.pose(world.arm.pose(pair.start_rad), pair.start_rad, START_LOOKS)
    looks, limits = [], FeasibilitySettings()
    for seen, joints_rad in ((start, pair.start_rad), (goal, pair.goal_rad)):
        if isinstance(seen, Rejected):
            return seen
        looks.append(KnownLook(seen.home_from_object, seen.covariance, joints_rad))
    robot = learned(world.arm.robot, looks, limits.disagreement_max_m,
                    limits.disagreement_max_rad)
    return plan(start.home_from_object, goal.home_from_object, CAMERA, robot,
                pair.start_rad, goal_joints_rad=pair.goal_rad)


def run_pair(world: World, pair: RobotPair, noise_px: float, confirm: Confirm) -> Outcome:
    """Plan and servo one pair; a veto is put to the independent search."""
    eye = Eye(world, noise_px, pair.seed)
    planned = plan_for(world, pair, eye)
    if isinstance(planned, Rejected):
        return Outcome(False, vetoed=True, confirmed=confirm(world, pair), why=planned.reason)
    if not planned.ok:
        return Outcome(False, vetoed=True, confirmed=confirm(world, pair),
                       why=planned.sentence)
    servo = Servo(world.arm.robot)
    servo.set_focal(CAMERA.fx)
    lead = JointLead() if planned.joints_rad is None else JointLead(
        planned.joints_rad, planned.verdict.values.led)
    servo.set_path(planned.poses, True, planned.sentence, lead)
    run = _world(servo, world, pair, eye)
    _stand_at_goal_then_at_start(run, pair)
    run.finish(LONGEST_S)
    return _outcome(run, world, pair, servo)


def _world(servo: Servo, world: World, pair: RobotPair, eye: Eye) -> ServoWorld:
    run = ServoWorld(servo, world.arm, pair.goal_rad, lambda pose: None)

    def measure(true_pose: np.ndarray) -> Any:
        seen = eye.pose(true_pose, run.joints_at(run.now_s))
        return None if isinstance(seen, Rejected) else (seen.home_from_object, seen.covariance)
    run.measure = measure
    return run


def _stand_at_goal_then_at_start(run: ServoWorld, pair: RobotPair) -> None:
    """Let the servo see the arm where the goal was taught, then drive it to the start."""
    run.run(0.5)
    run.drive(pair.start_rad)
    run.trace.clear()


def _outcome(run: ServoWorld, world: World, pair: RobotPair, servo: Servo) -> Outcome:
    robot = world.arm.robot
    goal = world.arm.pose(pair.goal_rad)
    poses = np.array([pose for pose, _ in run.trace])
    targets = np.array([pair.start_rad] + [command.joints_rad for _, command in run.commands
                                           if command.joints_rad is not None])
    went = np.concatenate([targets, [joints for _, joints in run.trace]])
    broken = (went < robot.lower_rad - 1e-9) | (went > robot.upper_rad + 1e-9)
    inside = world.camera.contains(world.corners_px(poses))
    error_m, error_rad = error_of(poses[-1], goal)
    converged = servo.state == 'DONE' and error_m < CONVERGED_M and error_rad < CONVERGED_RAD
    return Outcome(
        converged, left_image=not inside.all(), limit_broken=bool(broken.any()),
        jumped=bool(np.abs(np.diff(targets, axis=0)).max(initial=0.0) > JUMP_RAD),
        path_over_straight=lengths(poses)[0], rotation_over_minimum=lengths(poses)[1],
        iterations=len(targets) - 1, error_m=error_m, error_rad=error_rad,
        why='' if converged else f'{servo.state_text}; {1e3 * error_m:.1f} mm and '
        f'{np.degrees(error_rad):.1f} deg away')
