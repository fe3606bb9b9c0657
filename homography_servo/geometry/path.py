"""
Paths between two poses: the paper's interpolation, and other families behind one interface.

`interpolate` works in space. `interpolate_image` is the independent route in the
image: it knows homographies only, and its points agree with the projected path.
The paper's family is linear in alpha, beta, gamma, x, y and the divergence; depth
follows from the interpolated divergence, which is what makes both routes agree.
It is a screw motion only for special displacements; the family `screw` always is.
"""

from __future__ import annotations

import math
from typing import Callable

from homography_servo.geometry.camera_model import Camera
from homography_servo.geometry.decomposition import compose
from homography_servo.geometry.decomposition import DisplacementParameters
from homography_servo.geometry.decomposition import parameters_from_pose
from homography_servo.geometry.decomposition import pose_from_parameters
from homography_servo.geometry.homography import home_image
from homography_servo.geometry.homography import point_homographies
from homography_servo.geometry.rigid import exp_twist
from homography_servo.geometry.rigid import inverse
from homography_servo.geometry.rigid import rotation_angle
from homography_servo.geometry.rigid import rotation_log
from homography_servo.geometry.rigid import transform
from homography_servo.geometry.rigid import transform_points
from homography_servo.geometry.rigid import twist_about
from homography_servo.result import Rejected
import numpy as np

TURNS = ('shorter', 'positive', 'negative')
_TIE_RAD = 1e-9  # round-off of an angle: nearer to a tie or to no turn than this is one
_SAMPLES = 257  # where `choose_count` looks for the fastest part of a path
_MOST_POSES = 100_000


def interpolate(start: np.ndarray, goal: np.ndarray, count: int, home_depth_m: float = 1.0,
                family: str = 'paper', turn: str = 'shorter') -> np.ndarray | Rejected:
    """
    Interpolate between two poses in space.

    Parameters
    ----------
    start, goal : (4, 4) array
        ``home_from_object`` of both ends.
    count : int
        N >= 2 poses, both ends included.
    home_depth_m : float
        cZh; only the paper's family depends on it.
    family : str
        `paper`, `screw` or `straight`; see `FAMILIES`.
    turn : str
        `shorter`, or the direction of the turn about the optical axis: `positive` or
        `negative`. Half a turn has no shorter way and goes in the positive direction.

    Returns
    -------
    (N, 4, 4) array or Rejected
        Poses; rejected when an end is at or behind the focal plane.

    """
    start, goal = _pose(start, 'start'), _pose(goal, 'goal')
    if family not in FAMILIES:
        raise ValueError(f'family must be one of {", ".join(FAMILIES)}, got {family!r}')
    return FAMILIES[family](start, goal, _share(count), home_depth_m, _turn(turn))


def interpolate_parameters(start: DisplacementParameters, goal: DisplacementParameters,
                           count: int, turn: str = 'shorter') -> DisplacementParameters:
    """Interpolate the paper's six parameters linearly: arrays (N,) of each; section 3.2."""
    return _between(start, goal, _share(count), _turn(turn))


def interpolate_image(start: DisplacementParameters, goal: DisplacementParameters, count: int,
                      object_points_m: np.ndarray, home_depth_m: float = 1.0,
                      turn: str = 'shorter') -> np.ndarray:
    """
    Interpolate between two poses in the image, by homographies alone.

    Parameters
    ----------
    start, goal : DisplacementParameters
        As decomposed from the homographies of both ends.
    count : int
        N >= 2 poses, both ends included.
    object_points_m : (M, 3) array
        The object at the virtual home position.
    home_depth_m : float
        cZh.
    turn : str
        As for `interpolate`.

    Returns
    -------
    (N, M, 2) array
        s_m of eq. 23 with unit focal length; `Camera.project_rays` makes pixels of it.

    """
    homographies = point_homographies(compose(interpolate_parameters(start, goal, count, turn)),
                                      object_points_m, home_depth_m)
    home = home_image(object_points_m, home_depth_m)
    mapped = (homographies @ np.column_stack([home, np.ones(len(home))])[..., None])[..., 0]
    ahead = mapped[..., 2:] > 0.0
    return np.where(ahead, mapped[..., :2] / np.where(ahead, mapped[..., 2:], 1.0), np.inf)


def choose_count(start: np.ndarray, goal: np.ndarray, home_depth_m: float = 1.0,
                 family: str = 'paper', turn: str = 'shorter', max_step_m: float = math.inf,
                 max_step_rad: float = math.inf, max_step_px: float = math.inf,
                 camera: Camera | None = None, object_points_m: np.ndarray | None = None
                 ) -> int | Rejected:
    """
    Choose the smallest N whose steps all stay within limits.

    Parameters
    ----------
    start, goal, home_depth_m, family, turn
        As for `interpolate`.
    max_step_m, max_step_rad : float
        Largest step of the object's origin and of its orientation.
    max_step_px : float
        Largest step of any of the points in the image; needs the next two.
    camera : Camera, optional
        The camera.
    object_points_m : (M, 3) array, optional
        The points.

    Returns
    -------
    int or Rejected
        N >= 2.

    """
    limits = np.array([max_step_m, max_step_rad, max_step_px])
    if not (limits > 0.0).all() or np.isinf(limits).all():
        raise ValueError(f'at least one limit of the steps is needed, all > 0, got {limits}')
    if math.isfinite(max_step_px) and (camera is None or object_points_m is None):
        raise ValueError('max_step_px needs camera and object_points_m')

    def excess(count: int) -> float | Rejected:
        poses = interpolate(start, goal, count, home_depth_m, family, turn)
        if isinstance(poses, Rejected):
            return poses
        steps = [*_steps(poses), 0.0]
        if math.isfinite(max_step_px) and camera is not None and object_points_m is not None:
            steps[2] = _image_step(poses, camera, object_points_m, home_depth_m)
        return float(np.max(steps / limits))

    sampled = excess(_SAMPLES)
    if isinstance(sampled, Rejected):
        return sampled
    if not sampled * _SAMPLES < _MOST_POSES:
        return Rejected('the path leaves what the camera can see, or needs more than '
                        f'{_MOST_POSES} poses')
    count = max(2, 1 + math.ceil(sampled * (_SAMPLES - 1) * (1.0 - 1e-9)))

    def fits(count: int) -> bool:
        found = excess(count)  # rejected for its ends alone, so never after the first time
        return isinstance(found, Rejected) or found <= 1.0 + 1e-9

    while count > 2 and fits(count - 1):
        count -= 1
    while not fits(count):
        count += 1
    return count


def _paper(start: np.ndarray, goal: np.ndarray, share: np.ndarray, home_depth_m: float,
           turn: str) -> np.ndarray | Rejected:
    first, last = (parameters_from_pose(pose, home_depth_m) for pose in (start, goal))
    if isinstance(first, Rejected):
        return first
    if isinstance(last, Rejected):
        return last
    return pose_from_parameters(_between(first, last, share, turn), home_depth_m)


def _screw(start: np.ndarray, goal: np.ndarray, share: np.ndarray, home_depth_m: float,
           turn: str) -> np.ndarray:
    """Follow the geodesic of SE(3)."""
    motion = goal @ inverse(start)
    twist = twist_about(_rotation_vector(motion, turn), motion[:3, 3])
    return exp_twist(share[:, None] * twist) @ start


def _straight(start: np.ndarray, goal: np.ndarray, share: np.ndarray, home_depth_m: float,
              turn: str) -> np.ndarray:
    """Move the origin on a line and turn about a fixed axis (slerp)."""
    vector = _rotation_vector(goal @ inverse(start), turn)
    turning = np.concatenate([np.zeros((len(share), 3)), share[:, None] * vector], axis=1)
    rotation = exp_twist(turning)[:, :3, :3] @ start[:3, :3]
    return transform(rotation, start[:3, 3] + share[:, None] * (goal[:3, 3] - start[:3, 3]))


Family = Callable[[np.ndarray, np.ndarray, np.ndarray, float, str], 'np.ndarray | Rejected']
FAMILIES: dict[str, Family] = {'paper': _paper, 'screw': _screw, 'straight': _straight}


def _between(start: DisplacementParameters, goal: DisplacementParameters, share: np.ndarray,
             turn: str) -> DisplacementParameters:
    first, last = np.array(start, float), np.array(goal, float)
    if first.shape != (6,) or last.shape != (6,) or not np.isfinite([first, last]).all():
        raise ValueError(f'both ends must be six finite parameters, got {start} and {goal}')
    last[2] = first[2] + _way(last[2] - first[2], turn)
    return DisplacementParameters(*(first[:, None] * (1.0 - share) + last[:, None] * share))


def _way(angle_rad: float, turn: str) -> float:
    """Take the turn in the direction wanted: half a turn is positive unless told otherwise."""
    shorter = angle_rad - 2.0 * math.pi * round(angle_rad / (2.0 * math.pi))
    if turn == 'shorter':
        return shorter + 2.0 * math.pi if shorter < _TIE_RAD - math.pi else shorter
    if turn == 'positive':
        return shorter + 2.0 * math.pi if shorter < -_TIE_RAD else shorter
    return shorter - 2.0 * math.pi if shorter > _TIE_RAD else shorter


def _rotation_vector(motion: np.ndarray, turn: str) -> np.ndarray:
    """Give the rotation vector (3,) whose turn about the optical axis is as wanted."""
    vector = rotation_log(motion[:3, :3])
    angle_rad = float(np.linalg.norm(vector))
    if angle_rad <= _TIE_RAD:
        return vector
    axis = vector / angle_rad
    # Where the axis has no part along z, the next of y and x decides.
    leading = next((axis[i] for i in (2, 1, 0) if abs(axis[i]) > _TIE_RAD))
    return axis * math.copysign(1.0, leading) * _way(math.copysign(angle_rad, leading), turn)


def _steps(poses: np.ndarray) -> tuple[float, float]:
    """Measure the largest step in translation [m] and rotation [rad]."""
    turns = poses[1:, :3, :3] @ poses[:-1, :3, :3].swapaxes(-1, -2)
    shifts_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=-1)
    return float(shifts_m.max()), float(np.max(rotation_angle(turns)))


def _image_step(poses: np.ndarray, camera: Camera, object_points_m: np.ndarray,
                home_depth_m: float) -> float:
    points_m = transform_points(poses, object_points_m) + (0.0, 0.0, home_depth_m)
    pixels = camera.project(points_m)
    if not np.isfinite(pixels).all():
        return math.inf
    return float(np.linalg.norm(np.diff(pixels, axis=0), axis=-1).max())


def _share(count: int) -> np.ndarray:
    if isinstance(count, bool) or int(count) != count or count < 2:
        raise ValueError(f'count must be a whole number >= 2, got {count!r}')
    return np.linspace(0.0, 1.0, int(count))


def _turn(turn: str) -> str:
    if turn not in TURNS:
        raise ValueError(f'turn must be one of {", ".join(TURNS)}, got {turn!r}')
    return turn


def _pose(pose: np.ndarray, name: str) -> np.ndarray:
    pose = np.asarray(pose, float)
    if pose.shape != (4, 4):
        raise ValueError(f'{name} must have shape (4, 4), got {pose.shape}')
    rotation = pose[:3, :3]
    if not (np.isfinite(pose).all() and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
            and np.linalg.det(rotation) > 0.0):
        raise ValueError(f'{name} must be a finite rigid transform, got {pose.tolist()}')
    return pose
