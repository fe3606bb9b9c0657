"""
Where the robot stands and how it holds the box, from looks at known joints.

All looks are explained at once: placement, grip and (where the looks ask for them) joint
zeros are those that bring the corners where they were seen, by least squares in pixels.
The start is what the robot file believes, or a linear solution that needs no belief,
whichever ends lower. Looks that do not fit the others are left out and counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
import math
from typing import NamedTuple

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.pose import Prior
from homography_servo.planning.calibration_model import PlacementModel
from homography_servo.planning.calibration_poses import calibration_poses
from homography_servo.planning.calibration_poses import CalibrationPoseSettings
from homography_servo.planning.calibration_start import placement_from_poses
from homography_servo.result import Rejected
from homography_servo.robot.kinematics import forward
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole
import numpy as np
from scipy.optimize import least_squares

__all__ = ['calibrate', 'Calibration', 'calibration_poses', 'CalibrationPoseSettings',
           'CalibrationSettings']

# What is believed before: 0.1 m and 20 deg, only to choose between mirrored poses.
_BELIEF = np.diag([0.1**2] * 3 + [math.radians(20.0)**2] * 3)
_ROBUST_PX = 1.0
_OUTLIER_FACTOR = 4.0
_OUTLIER_SHARE = 0.25
_LEAST_NOISE_PX = 0.02
_HARMLESS_PX = 0.3  # a look that is off by less moves nothing by as much as is allowed


@dataclass(frozen=True)
class CalibrationSettings(Settings):
    """When a calibration is good enough to be used."""

    calibration_views: int = whole(
        12, 4, 1000, '', 'looks that a calibration needs at least')
    calibration_residual_px: float = real(
        2.0, 0.01, 100.0, 'px', 'largest residual (root mean square) of a calibration')
    calibration_sigma_m: float = real(
        0.003, 1e-6, 1.0, 'm', 'largest standard deviation of a position it may leave')
    calibration_sigma_rad: float = real(
        0.02, 1e-6, 1.0, 'rad', 'largest standard deviation of an angle it may leave')
    joint_zeros: str = text(
        'auto', 'whether joint zeros are calibrated too; auto when the looks ask for it',
        ('auto', 'on', 'off'))


class Calibration(NamedTuple):
    """A calibrated robot, and how good it is."""

    robot: Robot
    joint_offsets_rad: np.ndarray  # (n,), in the robot's theta0 already
    residual_px: float  # root mean square over coordinates of the looks used
    residual_m: float  # the same at the distance of the object
    covariance: np.ndarray  # of PlacementModel's change: home_from_base, tool_from_object, ...
    condition: float  # of the scaled problem: below 1e3 all is well told apart
    left_out: tuple[int, ...]  # looks that did not fit the others
    sentence: str

    @property
    def home_from_base(self) -> np.ndarray:
        """Where the robot stands."""
        return self.robot.home_from_base

    @property
    def tool_from_object(self) -> np.ndarray:
        """How it holds the box."""
        return self.robot.tool_from_object


class _Fit(NamedTuple):
    model: PlacementModel
    change: np.ndarray
    residuals_px: np.ndarray  # (K, N, 2)

    @property
    def cost(self) -> float:
        return float(np.abs(self.residuals_px).clip(max=20.0).sum())


def calibrate(robot: Robot, camera: Camera, joints_rad: np.ndarray, corners_px: np.ndarray,
              settings: CalibrationSettings = CalibrationSettings()) -> Calibration | Rejected:
    """
    Calibrate placement and grip.

    Parameters
    ----------
    robot : Robot
        Geometry, and what is believed of placement and grip.
    camera : Camera
        Taken as exact.
    joints_rad : (K, n) array
        Joints at each look.
    corners_px : (K, N, 2) array
        The object's points at each look, N = 4 for the face.
    settings : CalibrationSettings
        What is good enough.

    Returns
    -------
    Calibration or Rejected
        With the reason: too few looks, looks that tell too little, or a residual that shows a
        wrong arm model, camera or object.

    """
    joints, corners = _checked(robot, joints_rad, corners_px)
    if len(joints) < settings.calibration_views:
        return Rejected(f'{len(joints)} looks are too few for a calibration, '
                        f'{settings.calibration_views} are needed')
    best = _first_fit(robot, camera, joints, corners)
    used = _fitting_looks(best)
    if used.sum() < settings.calibration_views:
        return Rejected(f'{int((~used).sum())} of {len(used)} looks do not fit the others, '
                        f'residual {_rms(best.residuals_px):.2f} px')
    best = _with_zeros(best, joints[used], corners[used], settings.joint_zeros)
    return _judged(best, joints[used], used, settings)


def _checked(robot: Robot, joints_rad: np.ndarray, corners_px: np.ndarray
             ) -> tuple[np.ndarray, np.ndarray]:
    joints, corners = np.asarray(joints_rad, dtype=float), np.asarray(corners_px, dtype=float)
    if joints.ndim != 2 or joints.shape[1] != robot.count:
        raise ValueError(f'joints_rad must have shape (K, {robot.count}), got {joints.shape}')
    expected = (len(joints), len(robot.object_points_m), 2)
    if corners.shape != expected:
        raise ValueError(f'corners_px must have shape {expected}, got {corners.shape}')
    if not (np.isfinite(joints).all() and np.isfinite(corners).all()):
        raise ValueError('joints_rad and corners_px must be finite')
    return joints, corners


def _first_fit(robot: Robot, camera: Camera, joints: np.ndarray, corners: np.ndarray) -> _Fit:
    """Fit from what is believed; where that explains little, from linear solutions too."""
    fits = [_fitted(PlacementModel(robot, camera), joints, corners, loss='soft_l1')]
    if np.median(np.abs(fits[0].residuals_px)) < _ROBUST_PX:
        return fits[0]
    for believed in (True, False):
        linear = _linear(robot, camera, joints, corners, believed)
        if not isinstance(linear, Rejected):
            start = replace(robot, home_from_base=linear[0], tool_from_object=linear[1])
            fits.append(_fitted(PlacementModel(start, camera), joints, corners, loss='soft_l1'))
    return min(fits, key=lambda fit: fit.cost)


def _linear(robot: Robot, camera: Camera, joints: np.ndarray, corners: np.ndarray,
            believed: bool) -> tuple[np.ndarray, np.ndarray] | Rejected:
    expected, looks, poses = object_pose(robot, joints), [], []
    for index in range(len(joints)):
        prior = Prior(expected[index], _BELIEF) if believed else None
        pose = estimate_pose(robot.object_points_m, corners[index], camera, robot.home_depth_m,
                             prior=prior)
        if not isinstance(pose, Rejected):
            looks.append(index)
            poses.append(pose.home_from_object)
    return placement_from_poses(forward(robot, joints[looks]), np.array(poses).reshape(-1, 4, 4))


def _fitted(model: PlacementModel, joints: np.ndarray, corners: np.ndarray,
            loss: str = 'linear') -> _Fit:
    def residuals(change: np.ndarray) -> np.ndarray:
        return (model.points_px(change, joints) - corners).ravel()

    def slopes(change: np.ndarray) -> np.ndarray:
        return model.jacobian(change, joints).reshape(-1, model.size)
    solved = least_squares(residuals, np.zeros(model.size), slopes, x_scale='jac', loss=loss,
                           f_scale=_ROBUST_PX, max_nfev=60)
    return _Fit(model, solved.x, residuals(solved.x).reshape(corners.shape))


def _rms(residuals_px: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residuals_px**2)))


def _fitting_looks(fit: _Fit) -> np.ndarray:
    """Tell which looks fit like the others do; at most a quarter may not."""
    per_look = np.sqrt(np.mean(fit.residuals_px**2, axis=(1, 2)))
    largest = max(_OUTLIER_FACTOR * float(np.median(per_look)), _HARMLESS_PX)
    allowed = int(_OUTLIER_SHARE * len(per_look))
    worst = np.argsort(per_look)[len(per_look) - allowed:]
    used = np.ones(len(per_look), dtype=bool)
    used[worst[per_look[worst] > largest]] = False
    return used


def _with_zeros(fit: _Fit, joints: np.ndarray, corners: np.ndarray, choice: str) -> _Fit:
    """Refine on the looks that fit, with joint zeros when they explain much more."""
    start = fit.model.changed(fit.change)
    fixed = _fitted(PlacementModel(start, fit.model.camera), joints, corners)
    if choice == 'off' or start.count < 3:
        return fixed
    free = _fitted(PlacementModel(start, fit.model.camera, joint_offsets=True), joints, corners)
    return free if choice == 'on' or _criterion(free) < _criterion(fixed) else fixed


def _criterion(fit: _Fit) -> float:
    """Weigh residuals against the number of unknowns (Schwarz, 1978)."""
    count = fit.residuals_px.size
    noise = max(_rms(fit.residuals_px), _LEAST_NOISE_PX)
    return 2.0 * count * math.log(noise) + fit.model.size * math.log(count)


def _judged(fit: _Fit, joints: np.ndarray, used: np.ndarray, settings: CalibrationSettings
            ) -> Calibration | Rejected:
    known = _knowledge(fit, joints)
    if isinstance(known, Rejected):
        return known
    covariance, condition = known
    problem = _problem(fit, covariance, settings)
    if problem is not None:
        return problem
    camera, residual_px = fit.model.camera, _rms(fit.residuals_px)
    depth_m = float(fit.model.points_camera_m(fit.change, joints)[..., 2].mean())
    residual_m = residual_px * depth_m / math.sqrt(camera.fx * camera.fy)
    offsets = fit.model.offsets_rad(fit.change)
    return Calibration(fit.model.changed(fit.change), offsets, residual_px, residual_m,
                       covariance, condition, tuple(np.flatnonzero(~used).tolist()),
                       _sentence(residual_px, residual_m, covariance, offsets, used))


def _knowledge(fit: _Fit, joints: np.ndarray) -> tuple[np.ndarray, float] | Rejected:
    """Give the covariance of the change, by the noise that the residuals show, and condition."""
    free = fit.residuals_px.size - fit.model.size
    if free <= 0:
        return Rejected(f'{len(joints)} looks are too few for {fit.model.size} unknowns')
    slopes = fit.model.jacobian(fit.change, joints).reshape(-1, fit.model.size)
    scale = np.linalg.norm(slopes, axis=0)
    if np.any(scale == 0.0):
        return Rejected('the looks do not depend on all that is to be calibrated')
    noise_px = max(math.sqrt(float(np.sum(fit.residuals_px**2)) / free), _LEAST_NOISE_PX)
    _, sizes, right = np.linalg.svd(slopes / scale, full_matrices=False)
    spread = right.T / np.maximum(sizes, 1e-12) / scale[:, None]
    return noise_px**2 * spread @ spread.T, float(sizes[0] / max(sizes[-1], 1e-300))


def _problem(fit: _Fit, covariance: np.ndarray, settings: CalibrationSettings) -> Rejected | None:
    residual_px = _rms(fit.residuals_px)
    if residual_px > settings.calibration_residual_px:
        return Rejected(f'residual {residual_px:.2f} px, {settings.calibration_residual_px:g} px '
                        'are allowed: the arm model, the camera or the object is not as believed')
    sigma = np.sqrt(np.diag(covariance))
    for first, what in ((0, 'where the robot stands'), (6, 'how the box is held')):
        position_m, angle_rad = sigma[first:first + 3].max(), sigma[first + 3:first + 6].max()
        if position_m > settings.calibration_sigma_m:
            return Rejected(f'the looks leave {what} uncertain by {1e3 * position_m:.1f} mm: '
                            'joints must turn further and about more axes')
        if angle_rad > settings.calibration_sigma_rad:
            return Rejected(f'the looks leave {what} uncertain by '
                            f'{math.degrees(angle_rad):.1f} deg: joints must turn further')
    return None


def _sentence(residual_px: float, residual_m: float, covariance: np.ndarray,
              offsets: np.ndarray, used: np.ndarray) -> str:
    sigma = np.sqrt(np.diag(covariance))
    words = f'residual {residual_px:.2f} px ({1e3 * residual_m:.2f} mm) over {int(used.sum())} ' \
            f'looks; placement known to {1e3 * sigma[:3].max():.2f} mm and ' \
            f'{math.degrees(sigma[3:6].max()):.2f} deg'
    if offsets.any():
        degrees = ', '.join(f'{math.degrees(value):.2f}' for value in offsets)
        words += f'; joint zeros off by {degrees} deg'
    if not used.all():
        words += f'; {int((~used).sum())} looks left out'
    return words
