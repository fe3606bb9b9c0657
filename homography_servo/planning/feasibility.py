"""
The verdict of a path: every pose against every limit, before anything moves.

All checks work on the whole path at once. The robot is optional: without one, only
what the camera would see is checked.
"""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
from homography_servo.planning.checks import BEHIND_PX
from homography_servo.planning.checks import check_agreement
from homography_servo.planning.checks import check_facing
from homography_servo.planning.checks import check_field
from homography_servo.planning.checks import check_mirror
from homography_servo.planning.checks import judge_joints
from homography_servo.planning.checks import Seen
from homography_servo.planning.follow import arm_poses
from homography_servo.planning.follow import follow
from homography_servo.planning.follow import Followed
from homography_servo.planning.mirror import predicted_ambiguity
from homography_servo.planning.settings import FeasibilitySettings
from homography_servo.planning.verdict import Check
from homography_servo.planning.verdict import PoseValues
from homography_servo.planning.verdict import Verdict
from homography_servo.result import required
from homography_servo.robot.robot_file import Robot
import numpy as np

NEAREST_M = 1e-3


def look(poses: np.ndarray, camera: Camera, object_points_m: np.ndarray,
         home_depth_m: float) -> Seen:
    """Project the object's points at (N, 4, 4) poses ``home_from_object``."""
    turn, place = poses[:, :3, :3], poses[:, :3, 3] + (0.0, 0.0, home_depth_m)
    points = object_points_m @ np.swapaxes(turn, 1, 2) + place[:, None, :]
    front = points[..., 2] > NEAREST_M
    safe = np.where(front[..., None], points, (0.0, 0.0, 1.0))
    points_px = camera.project(safe)
    far = np.array([camera.width - 1.0, camera.height - 1.0]) - points_px
    border_px = np.where(front, np.minimum(points_px, far).min(axis=-1), BEHIND_PX)
    away = (turn[:, :, 2] * place).sum(axis=1) / np.linalg.norm(place, axis=1)
    return Seen(points_px, border_px, np.arccos(np.clip(away, -1.0, 1.0)))


def check_path(poses: np.ndarray, camera: Camera, object_points_m: np.ndarray,
               robot: Robot | None = None, start_joints_rad: np.ndarray | None = None,
               settings: FeasibilitySettings = FeasibilitySettings(),
               leading_joints_rad: np.ndarray | None = None,
               goal_joints_rad: np.ndarray | None = None) -> Verdict:
    """
    Judge a path.

    Parameters
    ----------
    poses : (N, 4, 4) array
        ``home_from_object`` along the path, N at least 1.
    camera : Camera
        What looks at it.
    object_points_m : (M, 3) array
        Points that have to stay in view, in the frame of the object.
    robot : Robot, optional
        The arm; None leaves out everything about joints.
    start_joints_rad : (n,) array, optional
        Joints at the first pose; needed with a robot.
    settings : FeasibilitySettings
        The limits.
    leading_joints_rad : (N, n) array, optional
        Joints along the path where it was planned in joint space; they lead through
        singularities. By default joints are found by following the poses.
    goal_joints_rad : (n,) array, optional
        Where the arm stood when the goal was taught: the end of the path may be as near
        to limits as it was there, as the beginning may be as near as the start.

    Returns
    -------
    Verdict
        With the numbers of every pose and the first that is bad.

    """
    poses = _checked(poses, robot, start_joints_rad)
    depth_m = settings.home_depth_m if robot is None else robot.home_depth_m
    checks, values = _view(poses, camera, object_points_m, depth_m, settings,
                           goal_joints_rad is not None)
    joints_rad, note = None, ''
    if robot is not None:
        start = required(start_joints_rad, 'joints at the first pose')
        believed = arm_poses(robot, poses, start)
        followed = follow(
            robot, believed, start,
            (settings.reach_tolerance_m, settings.reach_tolerance_rad)
        ) if leading_joints_rad is None else _as_led(leading_joints_rad, poses)
        values, more = judge_joints(robot, followed, values, settings,
                                    leading_joints_rad is not None, goal_joints_rad)
        checks += [check_agreement(poses, believed, settings), *more]
        joints_rad, note = followed.joints_rad, _arm_note(robot, values)
    return _conclude(checks, values, joints_rad, note)


def _as_led(joints_rad: np.ndarray, poses: np.ndarray) -> Followed:
    if len(joints_rad) != len(poses):
        raise ValueError(f'leading_joints_rad must have {len(poses)} rows, got {len(joints_rad)}')
    return Followed(np.asarray(joints_rad, dtype=float), np.ones(len(poses), dtype=bool), 0.0, 0.0)


def goal_fault(goal: np.ndarray, camera: Camera, object_points_m: np.ndarray,
               home_depth_m: float, settings: FeasibilitySettings,
               goal_known: bool = False) -> str:
    """Say why the camera could not see the object at a goal (4, 4), empty if it can."""
    poses = _checked(np.asarray(goal, dtype=float)[None], None, None)
    seen = look(poses, camera, np.asarray(object_points_m, dtype=float), home_depth_m)
    border_px = 0.0 if goal_known else settings.field_margin_px
    limit_rad = np.pi / 2 if goal_known else float(np.radians(settings.facing_limit_deg))
    checks = (check_field(seen, settings, border_px), check_facing(seen, settings, limit_rad))
    return next((check.sentences[0] for check in checks if check.sentences), '')


def _view(poses: np.ndarray, camera: Camera, object_points_m: np.ndarray, depth_m: float,
          settings: FeasibilitySettings, goal_known: bool) -> tuple[list[Check], PoseValues]:
    points = np.asarray(object_points_m, dtype=float)
    seen = look(poses, camera, points, depth_m)
    ambiguity = predicted_ambiguity(poses, seen.points_px, camera, points, depth_m,
                                    settings.corner_sigma_px)
    checks = [check_field(seen, settings, goal_known=goal_known),
              check_facing(seen, settings, goal_known=goal_known),
              check_mirror(ambiguity, settings, goal_known)]
    blank = np.full(len(poses), np.nan)
    return checks, PoseValues(
        seen.border_px.min(axis=1), seen.facing_rad, np.zeros(len(poses), dtype=bool), blank,
        np.zeros(len(poses), dtype=int), blank, np.zeros(len(poses), dtype=bool), blank,
        ambiguity)


def _checked(poses: np.ndarray, robot: Robot | None, start: np.ndarray | None) -> np.ndarray:
    poses = np.asarray(poses, dtype=float)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or len(poses) == 0:
        raise ValueError(f'poses must have shape (N, 4, 4) with N >= 1, got {poses.shape}')
    if not np.isfinite(poses).all():
        raise ValueError('poses must be finite')
    shape = () if start is None else np.shape(start)
    if robot is not None and shape != (len(robot.joint_names),):
        raise ValueError(f'start_joints_rad must have shape ({len(robot.joint_names)},), '
                         f'got {shape}')
    return poses


def _arm_note(robot: Robot, values: PoseValues) -> str:
    k = int(np.argmin(values.joint_margin_rad))
    name = robot.joint_names[values.joint_index[k]]
    note = (f', {name} comes within {np.degrees(values.joint_margin_rad[k]):.1f} deg of its '
            f'limit at pose {k + 1}, smallest singular value {values.conditioning.min():.3f}')
    led = np.flatnonzero(values.led) + 1
    if not len(led):
        return note
    return note + (f'; near a singularity of the arm the planned joints lead ({len(led)} poses '
                   f'between {led[0]} and {led[-1]})')


def _conclude(checks: list[Check], values: PoseValues, joints_rad: np.ndarray | None,
              note: str) -> Verdict:
    count = len(values.field_px)
    bad = [int(np.argmin(c.good)) if not c.good.all() else count for c in checks]
    first = min(bad)
    reasons = tuple('; '.join(c.sentences[k] for c in checks if k in c.sentences)
                    for k in range(count))
    if first == count:
        at = int(np.argmin(values.field_px))
        sentence = (f'all {count} poses are feasible: corners stay {values.field_px[at]:.0f} px '
                    f'inside the image, the face within '
                    f'{np.degrees(values.facing_rad.max()):.0f} deg of the line of sight{note}')
        return Verdict(True, sentence, None, values, reasons, joints_rad)
    failed = checks[bad.index(first)]
    sentence = f'pose {first + 1} of {count}: {failed.sentences[first]} ({failed.name})'
    return Verdict(False, sentence, first, values, reasons, joints_rad, failed.name)
