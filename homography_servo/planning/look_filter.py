"""
Average looks over time and along the path: what the camera saw corrects the model.

One look at a small plane is weak in depth and tilt, but an arm's relative motion is
accurate. So the filter does not average poses, it estimates the slowly varying error
of the model (`arm_model`) from all looks, each at its own setpoint: an iterated
extended Kalman filter over that error. Two things make it fit for planes:

- A measured pose is turned back into the corners (rays) that it explains, and those
  are the measurement. Both mirror poses of a plane explain nearly the same corners,
  so a flip in the measured pose does not disturb the filter; and the information of
  a look is taken at the filter's estimate, not at the noisy pose of one look.
- The error is allowed to drift in proportion to the motion between looks, and when
  looks contradict it the whole object may have moved, so that a wrong model, a pushed
  camera or late images are followed without spoiling what is known of the joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, NamedTuple

from homography_servo.geometry.rigid import skew
from homography_servo.planning.arm_model import Body
from homography_servo.planning.arm_model import Prior
from homography_servo.planning.control import displacement
from homography_servo.result import Rejected
import numpy as np
from scipy.linalg import lapack

_YZX, _ZXY = [1, 2, 0], [2, 0, 1]
ITERATIONS = 3
LARGE_CHANGE = 5e-3  # m or rad: the next iteration starts from new derivatives
WIDEN_ABOVE = 4.0  # mean squared surprise: twice the expected deviation
DOUBT_ABOVE = 25.0
LARGEST = 1e6  # m, m^2 or rad^2; what is said to be so far or so unsure was not seen
ARM_LENGTH_M = 0.3  # a rotation and a translation of the object compare by this length


@dataclass(frozen=True)
class Look:
    """Rays (x/z, y/z) of the object points, stacked to (2N,), and their covariance."""

    rays: np.ndarray
    covariance: np.ndarray


def rays_of(home_from_object: np.ndarray, points_m: np.ndarray, home_depth_m: float
            ) -> tuple[np.ndarray, np.ndarray]:
    """
    Project object points to unit focal length.

    Parameters
    ----------
    home_from_object : (4, 4) array
        Pose of the object.
    points_m : (N, 3) array
        Points of the object.
    home_depth_m : float
        Depth of home in front of the camera.

    Returns
    -------
    (2N,) array, (2N, 6) array
        The rays, and their change per twist of the object (home axes, linear first).

    """
    arms = points_m @ home_from_object[:3, :3].T
    x, y, z = (arms + home_from_object[:3, 3]).T
    z = z + home_depth_m
    rays = np.stack([x / z, y / z], axis=-1)
    jacobian = np.zeros((len(points_m), 2, 6))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0 / z
    jacobian[:, :, 2] = -rays / z[:, None]
    # What a turn does is the cross product of arm and row; numpy's own is slow for few.
    linear, arm = jacobian[:, :, :3], arms[:, None, :]
    jacobian[:, :, 3:] = arm[..., _YZX] * linear[..., _ZXY] - arm[..., _ZXY] * linear[..., _YZX]
    return rays.ravel(), jacobian.reshape(-1, 6)


def look_from_pose(home_from_object: np.ndarray, covariance: np.ndarray, points_m: np.ndarray,
                   home_depth_m: float) -> Look | Rejected:
    """
    Turn a measured pose back into the rays that it explains.

    The pose holds no knowledge about the residual, the part of the rays that no
    motion explains; there the noise is taken to be as large as elsewhere.
    """
    if not (np.isfinite(home_from_object).all() and np.isfinite(covariance).all()):
        return Rejected('the measured pose or its covariance is not finite')
    if max(np.abs(home_from_object).max(), np.abs(covariance).max()) > LARGEST:
        return Rejected('the measured pose or its covariance is too large to tell anything')
    if lapack.dpotrf(0.5 * (covariance + covariance.T))[1]:
        return Rejected('the covariance of the measured pose is not positive')
    if home_from_object[2, 3] + home_depth_m <= 0.05:
        return Rejected('the measured object is not in front of the camera')
    rays, jacobian = rays_of(home_from_object, points_m, home_depth_m)
    spread = jacobian @ covariance @ jacobian.T
    blind = np.eye(len(rays)) - jacobian @ np.linalg.solve(jacobian.T @ jacobian, jacobian.T)
    return Look(rays, spread + np.trace(spread) / 6.0 * blind)


def _weigh(spread: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, float] | None:
    """
    Solve a system with a covariance, and give the logarithm of its determinant.

    None where rounding has left nothing that is positive definite.
    """
    factor, solution, indefinite = lapack.dposv(spread, right)
    if indefinite:
        return None
    return solution, 2.0 * float(np.log(factor.diagonal()).sum())


class _Expected(NamedTuple):
    """What a look should show, and how that changes."""

    rays: np.ndarray  # (2N,)
    by_error: np.ndarray  # (2N, size) per change of the model's error
    by_twist: np.ndarray  # (2N, 6) per twist of the object
    pose: np.ndarray  # (4, 4)


class LookFilter(Generic[Body]):
    """
    The model's error and how well it is known.

    Parameters
    ----------
    model : BodyModel
        The believed model, without error.
    points_m : (N, 3) array
        Points of the object.
    home_depth_m : float
        Depth of home in front of the camera.
    prior : Prior
        How wrong the model may be.
    drift : float
        Share of the motion between two looks by which the error may change.

    """

    def __init__(self, model: Body, points_m: np.ndarray, home_depth_m: float,
                 prior: Prior = Prior(), drift: float = 0.01) -> None:
        self._believed, self._prior, self._drift = model, prior, drift
        self._points_m, self._home_depth_m = np.asarray(points_m, dtype=float), home_depth_m
        self.reset()

    def reset(self) -> None:
        """Forget all looks and the model that they made."""
        self.model: Body = self._believed
        self.forget()

    def forget(self) -> None:
        """Forget how well the model is known, and keep it."""
        self._covariance = np.diag(self.model.variances(self._prior))
        self._last_setpoint: np.ndarray | None = None
        self._doubted = False
        self.looks = 0
        self.misfit = 0.0  # minus twice the log-likelihood of all looks, up to a constant
        self.surprise = 0.0  # squared innovation over its expectation; about 1 when all is well

    def begin(self, model: Body, setpoint: np.ndarray, covariance: np.ndarray) -> None:
        """Start from a model whose pose at a setpoint has this (6, 6) covariance; left error."""
        self.reset()
        self.model, self.looks = model, 1
        left = np.linalg.inv(model.expect(setpoint)[1][:, :6])
        self._covariance[:6, :6] = left @ covariance @ left.T
        self._last_setpoint = np.array(setpoint, dtype=float)

    def pose(self, setpoint: np.ndarray) -> np.ndarray:
        """Give home_from_object at a setpoint as the looks so far say it."""
        return self.model.pose(setpoint)

    def covariance(self, setpoint: np.ndarray) -> np.ndarray:
        """Give the (6, 6) covariance of `pose` at a setpoint, home axes, linear first."""
        _, sensitivity = self.model.expect(setpoint)
        return sensitivity @ self._covariance @ sensitivity.T

    @property
    def agrees(self) -> bool:
        """Tell whether the last look said what the looks before let expect."""
        return self.surprise <= WIDEN_ABOVE and not self._doubted

    def update(self, look: Look, setpoint: np.ndarray, slip: np.ndarray | None = None) -> bool:
        """
        Take in one look at the object while the model was at a setpoint.

        A look that contradicts all before it is left out once; when the next one
        does so too, it is followed.

        Parameters
        ----------
        look : Look
            What was seen.
        setpoint : array
            Where the model was then.
        slip : (n,) array, optional
            One standard deviation of the setpoint, where it errs along one direction only:
            that of a motion seen a little earlier or later.

        Returns
        -------
        bool
            Whether the look was taken.

        """
        expected = self._expect(self.model, setpoint)
        if slip is not None:
            shift = expected.by_error @ self.model.error_of(slip)
            look = Look(look.rays, look.covariance + np.outer(shift, shift))
        self._drift_to(setpoint, expected.pose)
        taken = self._believes(look, expected) and self._correct(look, setpoint, expected)
        self.looks += taken
        return taken

    def _correct(self, look: Look, setpoint: np.ndarray, expected: _Expected) -> bool:
        change, model = np.zeros(len(self._covariance)), self.model
        for iteration in range(ITERATIONS):
            if iteration:
                expected = self._expect(model, setpoint)
            by_error = expected.by_error
            innovation = look.rays - expected.rays + by_error @ change
            cross = by_error @ self._covariance
            weighed = _weigh(cross @ by_error.T + look.covariance, cross)
            if weighed is None:
                return False
            gain = weighed[0].T
            step = gain @ innovation - change
            change = change + step
            model = self.model.moved(change)
            if np.abs(step).max() < LARGE_CHANGE:
                break
        keep = np.eye(len(gain)) - gain @ by_error
        # Joseph's form stays positive when looks are far sharper than the prior.
        self._covariance = (keep @ self._covariance @ keep.T
                            + gain @ look.covariance @ gain.T)
        self.model = model
        return True

    def _expect(self, model: Body, setpoint: np.ndarray) -> _Expected:
        pose, sensitivity = model.expect(setpoint)
        rays, by_twist = rays_of(pose, self._points_m, self._home_depth_m)
        return _Expected(rays, by_twist @ sensitivity, by_twist, pose)

    def _drift_to(self, setpoint: np.ndarray, pose: np.ndarray) -> None:
        if self._last_setpoint is not None and self._drift > 0.0:
            motion = displacement(self.pose(self._last_setpoint), pose)
            moved_m, turned_rad = np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:])
            size_m = self._drift * (moved_m + ARM_LENGTH_M * turned_rad)
            self._loosen(np.array([size_m] * 3 + [size_m / ARM_LENGTH_M] * 3), pose)
        self._last_setpoint = np.array(setpoint, dtype=float)

    def _believes(self, look: Look, expected: _Expected) -> bool:
        innovation, by_error = look.rays - expected.rays, expected.by_error
        spread = by_error @ self._covariance @ by_error.T + look.covariance
        weighed = _weigh(spread, innovation)
        if weighed is None:
            return False
        solution, log_det = weighed
        squared = float(innovation @ solution)
        self.surprise = squared / len(innovation)
        self.misfit += squared + log_det
        doubted, self._doubted = self._doubted, False
        if self.surprise <= WIDEN_ABOVE or not self.looks:
            return True
        if self.surprise > DOUBT_ABOVE and not doubted:
            self._doubted = True
            return False
        moved, *_ = np.linalg.lstsq(expected.by_twist, innovation, rcond=None)
        self._loosen(np.abs(moved), expected.pose)
        return True

    def _loosen(self, sigma: np.ndarray, pose: np.ndarray) -> None:
        """Let the object be elsewhere by this much (6,); joints and grip stay as known."""
        left = np.eye(6)  # the change of L for a twist of the object
        left[:3, 3:] = skew(pose[:3, 3])
        self._covariance[:6, :6] += (left * sigma ** 2) @ left.T
