"""Which postures to look from: in view, one reachable from the other, telling the most."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

from homography_servo.geometry.camera import Camera
from homography_servo.planning.calibration_model import PlacementModel
from homography_servo.result import Rejected
from homography_servo.robot.chain import link_frames
from homography_servo.robot.robot_file import Robot
from homography_servo.settings import real
from homography_servo.settings import Settings
import numpy as np

_CANDIDATES = 3000
_TRIED = 150  # of the most telling ones, per posture
_BETWEEN = np.linspace(0.0, 1.0, 12)
# Believed before: 20 mm, 5 deg, joint zeros 1 deg; noise of a corner coordinate.
_POSITION_M, _ANGLE_RAD, _ZERO_RAD, _NOISE_PX = 0.02, math.radians(5.0), math.radians(1.0), 0.3


@dataclass(frozen=True)
class CalibrationPoseSettings(Settings):
    """What a posture must keep to, by the model that is still to be corrected."""

    calibration_field_margin_px: float = real(
        45.0, 0.0, 500.0, 'px', 'distance of all points from the border of the image; covers '
        'what placement and grip may be off')
    calibration_facing_deg: float = real(
        50.0, 5.0, 85.0, 'deg', 'largest angle between the face normal and the line of sight')
    calibration_joint_margin_rad: float = real(
        0.1, 0.0, 1.0, 'rad', 'distance that every joint keeps from its limits')
    calibration_height_m: float = real(
        0.03, -10.0, 10.0, 'm', 'least height over the base plane of every joint behind the '
        'first, and of the box')


class _Candidates(NamedTuple):
    joints_rad: np.ndarray  # (K, n)
    slopes: np.ndarray  # (K, 2 N, size) of the pixels, in units of their noise and the belief


def calibration_poses(robot: Robot, camera: Camera, count: int = 15, seed: int = 0,
                      start_rad: np.ndarray | None = None,
                      settings: CalibrationPoseSettings = CalibrationPoseSettings()
                      ) -> np.ndarray | Rejected:
    """
    Choose postures for a calibration.

    Each is the one that adds most to what the looks tell about placement, grip and joint
    zeros (the determinant of the information), among those that can be reached from the one
    before, all joints moving together, with the face in view all the way.

    Parameters
    ----------
    robot : Robot
        The arm as believed.
    camera : Camera
        The camera.
    count : int
        How many postures.
    seed : int
        Of the random postures to choose from; the same seed gives the same choice.
    start_rad : (n,) array, optional
        Where the arm is. When the face is in view there, the way to the first posture is
        checked too.
    settings : CalibrationPoseSettings
        What every posture keeps to.

    Returns
    -------
    (count, n) array or Rejected

    """
    if count < 1:
        raise ValueError(f'count must be 1 or above, got {count}')
    candidates = _candidates(robot, camera, seed, settings)
    if len(candidates.joints_rad) < count:
        return Rejected(f'only {len(candidates.joints_rad)} of {_CANDIDATES} random postures '
                        f'show the face to the camera, {count} are needed')
    if start_rad is not None and not _shown(robot, camera, np.atleast_2d(start_rad), settings)[0]:
        start_rad = None
    return _chosen(robot, camera, candidates, count, start_rad, settings)


def _candidates(robot: Robot, camera: Camera, seed: int, settings: CalibrationPoseSettings
                ) -> _Candidates:
    rng = np.random.default_rng(seed)
    margin = np.minimum(settings.calibration_joint_margin_rad,
                        0.4 * (robot.upper_rad - robot.lower_rad))
    joints = rng.uniform(robot.lower_rad + margin, robot.upper_rad - margin,
                         (_CANDIDATES, robot.count))
    joints = joints[_shown(robot, camera, joints, settings)]
    model = PlacementModel(robot, camera, joint_offsets=True)
    belief = [*[_POSITION_M] * 3, *[_ANGLE_RAD] * 3] * 2 + [_ZERO_RAD] * (model.size - 12)
    slopes = model.jacobian(np.zeros(model.size), joints) * belief / _NOISE_PX
    return _Candidates(joints, slopes)


def _shown(robot: Robot, camera: Camera, joints: np.ndarray, settings: CalibrationPoseSettings
           ) -> np.ndarray:
    """Tell which postures (K, n) show the face well and keep off the base plane."""
    points = PlacementModel(robot, camera).points_camera_m(np.zeros(12), joints)
    inside = camera.contains(camera.project(points),
                             settings.calibration_field_margin_px).all(axis=1)
    facing = _facing(robot, points, joints) > math.cos(
        math.radians(settings.calibration_facing_deg))
    frames = link_frames(robot, joints, np.eye(4))
    corners = frames[:, -1] @ robot.tool_from_object @ _box_points(robot)
    lowest = np.minimum(frames[:, 2:, 2, 3].min(axis=1), corners[:, 2].min(axis=1))
    return inside & facing & (lowest >= settings.calibration_height_m)


def _facing(robot: Robot, points: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Give the cosine between the line of sight and the face's normal, 1 in full view."""
    home_from_object = link_frames(robot, joints, robot.home_from_base)[:, -1] \
        @ robot.tool_from_object
    centre = home_from_object[:, :3, 3] + (0.0, 0.0, robot.home_depth_m)
    away = home_from_object[:, :3, 2]
    return np.einsum('ki,ki->k', away, centre) / np.linalg.norm(centre, axis=1)


def _box_points(robot: Robot) -> np.ndarray:
    """Give all corners of the box (4, 8) as columns with 1 below."""
    half_w, half_h = 0.5 * robot.face_size_m[0], 0.5 * robot.face_size_m[1]
    return np.array([[x, y, z, 1.0] for x in (-half_w, half_w) for y in (-half_h, half_h)
                     for z in (0.0, robot.box_height_m)]).T


def _chosen(robot: Robot, camera: Camera, candidates: _Candidates, count: int,
            start_rad: np.ndarray | None, settings: CalibrationPoseSettings
            ) -> np.ndarray | Rejected:
    information = np.eye(candidates.slopes.shape[-1])
    left = np.ones(len(candidates.joints_rad), dtype=bool)
    chosen: list[np.ndarray] = []
    for _ in range(count):
        gain = np.where(left, _gain(candidates.slopes, information), -np.inf)
        best = np.argsort(-gain, kind='stable')[:_TRIED]
        best = best[np.isfinite(gain[best])]
        here = chosen[-1] if chosen else start_rad
        ways = best if here is None else best[_in_view_between(
            robot, camera, here, candidates.joints_rad[best], settings)]
        if len(ways) == 0:
            return Rejected(f'after {len(chosen)} postures none of the others can be reached '
                            'with the face in view')
        slopes = candidates.slopes[ways[0]]
        information = information + slopes.T @ slopes
        left[ways[0]] = False
        chosen.append(candidates.joints_rad[ways[0]])
    return np.array(chosen)


def _gain(slopes: np.ndarray, information: np.ndarray) -> np.ndarray:
    """Give by how much each look raises the logarithm of the determinant."""
    spread = np.linalg.inv(information)
    seen = np.eye(slopes.shape[1]) + slopes @ spread @ np.swapaxes(slopes, 1, 2)
    return np.linalg.slogdet(seen)[1]


def _in_view_between(robot: Robot, camera: Camera, here: np.ndarray, there: np.ndarray,
                     settings: CalibrationPoseSettings) -> np.ndarray:
    """Tell to which postures (K, n) the face stays in view, all joints moving together."""
    ways = here + _BETWEEN[:, None] * (there - here)[:, None]
    shown = _shown(robot, camera, ways.reshape(-1, robot.count), settings)
    return np.all(shown.reshape(len(there), -1), axis=1)
