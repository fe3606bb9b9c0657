"""
From corners to the pose of the object: the mirror chosen, the noise measured, looks averaged.

Pure code; time is an argument. The choice between the two minima of a plane follows the
arm's kinematics if the joints are known, else the previous pose, else the residual.
"""

from __future__ import annotations

from collections import deque
import math
from typing import NamedTuple

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.pose import PoseCandidate
from homography_servo.geometry.pose import PoseEstimate
from homography_servo.geometry.pose import Prior
from homography_servo.planning.observer_settings import ObserverSettings
from homography_servo.result import Rejected
import numpy as np

NOISE_LOOKS = 10  # looks that an estimate of the noise needs
NOISE_RANGE_PX = (0.01, 5.0)
MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, in standard deviations
SEARCH_PERIOD_S = 0.1  # in which the view has changed enough for another minimum to be born
REST_SIGMAS = 6.0  # one corner in 10,000 looks is further off by chance


class Look(NamedTuple):
    """Corners measured at one time."""

    corners_px: np.ndarray  # (M, 2)
    time_s: float
    covariance_px2: np.ndarray | None = None  # (2M, 2M), None where nobody says


class StillView(NamedTuple):
    """What several looks at an object at rest say together."""

    corners_px: np.ndarray  # (M, 2) their mean
    looks: int
    noise_px: float  # standard deviation of one coordinate in one look, NaN for one look
    covariance_px2: np.ndarray | None = None  # of the best look; what is common to all stays


class Observer:
    """
    Estimates poses from corners.

    Parameters
    ----------
    object_points_m : (M, 3) array
        The points whose images arrive, in the same order.
    home_depth_m : float
        Distance of the home frame from the camera.
    sigma_px : float
        Noise of a coordinate until it has been measured, and what no tracker knows of.
    settings : ObserverSettings
        Everything else.

    """

    def __init__(self, object_points_m: np.ndarray, home_depth_m: float, sigma_px: float,
                 settings: ObserverSettings = ObserverSettings()) -> None:
        self.object_points_m = np.asarray(object_points_m, dtype=float)
        self.home_depth_m = home_depth_m
        self.sigma_px = sigma_px
        self.settings = settings
        self._looks: deque[Look] = deque()
        self._measured_px: float | None = None
        self._noise_stale = False  # a look has come since it was measured
        self._last: tuple[np.ndarray, float] | None = None
        self._minima: tuple[PoseCandidate, ...] = ()  # of the last look
        self._searched_s = -math.inf  # when all of them were searched for

    @property
    def noise_px(self) -> float:
        """Give the standard deviation of a coordinate that covariances are based on."""
        self._measure_noise()
        measured = self._measured_px if self.settings.measure_noise else None
        return self.sigma_px if measured is None else measured

    def forget(self) -> None:
        """Forget all looks and the last pose."""
        self.lose_sight()
        self._last, self._minima = None, ()

    def lose_sight(self) -> None:
        """Start averaging anew: the object may be elsewhere when it is seen again."""
        self._measure_noise()
        self._looks.clear()

    def see(self, corners_px: np.ndarray, camera: Camera, time_s: float,
            arm_pose: np.ndarray | None = None,
            covariance_px2: np.ndarray | None = None) -> PoseEstimate | Rejected:
        """
        Take in one look.

        Parameters
        ----------
        corners_px : (M, 2) array
            Where the points are seen.
        camera : Camera
            What saw them.
        time_s : float
            By a clock that never jumps.
        arm_pose : (4, 4) array, optional
            ``home_from_object`` by the joints, if they are known now.
        covariance_px2 : (2M, 2M) array, optional
            Of the corners, where the tracker tells it; ``sigma_px`` comes on top.

        Returns
        -------
        PoseEstimate or Rejected

        """
        if covariance_px2 is not None:
            # A tracker tells of noise; edges that are not what they seem come on top.
            covariance_px2 = covariance_px2 + self.sigma_px**2 * np.eye(len(covariance_px2))
        fresh = 0.0 <= time_s - self._searched_s < SEARCH_PERIOD_S
        estimate = self.pose_of(corners_px, camera, self._prior(time_s, arm_pose),
                                covariance_px2=covariance_px2, near=self._minima if fresh else ())
        if isinstance(estimate, Rejected):
            self._minima = ()
            self.lose_sight()
            return estimate
        self._searched_s = self._searched_s if fresh and self._minima else time_s
        self._minima = estimate.candidates
        self._looks.append(Look(np.array(corners_px, dtype=float), time_s, covariance_px2))
        while len(self._looks) > self.settings.looks_max:
            self._looks.popleft()
        self._last = (estimate.home_from_object, time_s)
        self._noise_stale = True
        return estimate

    def pose_of(self, corners_px: np.ndarray, camera: Camera, prior: Prior | None = None,
                looks: int = 1, covariance_px2: np.ndarray | None = None,
                near: tuple[PoseCandidate, ...] = ()) -> PoseEstimate | Rejected:
        """Estimate a pose from the mean corners of some looks, without remembering it."""
        corners_px = np.asarray(corners_px, dtype=float)
        if corners_px.shape != (len(self.object_points_m), 2):
            return Rejected(f'{len(self.object_points_m)} corners are needed, '
                            f'{len(corners_px)} came')
        estimate = estimate_pose(
            self.object_points_m, corners_px, camera, home_depth_m=self.home_depth_m,
            covariance_px2=self.noise_px**2 / looks if covariance_px2 is None
            else covariance_px2, prior=prior, near=near)
        if isinstance(estimate, Rejected):
            return estimate
        misfit_px = estimate.candidates[0].residual_px
        if misfit_px > self.settings.fit_limit_px:
            return Rejected(f'the corners fit no pose of the object better than '
                            f'{misfit_px:.1f} px: wrong order, wrong size, or not the object')
        return estimate

    def still_view(self, now_s: float) -> StillView | Rejected:
        """Average the latest looks during which nothing moved."""
        if not self._looks:
            return Rejected('the object is not seen')
        age_s = now_s - self._looks[-1].time_s
        if age_s > self.settings.look_age_s:
            return Rejected(f'the object has not been seen for {age_s:.1f} s')
        return self._trailing_rest()

    def view_pose(self, view: StillView, camera: Camera, now_s: float,
                  arm_pose: np.ndarray | None = None) -> PoseEstimate | Rejected:
        """Estimate the pose of a view, choosing the minimum as always."""
        return self.pose_of(view.corners_px, camera, self._prior(now_s, arm_pose), view.looks,
                            view.covariance_px2)

    def _trailing_rest(self) -> StillView:
        looks = np.array([look.corners_px for look in self._looks])[::-1]
        centre = np.cumsum(looks, axis=0) / np.arange(1, len(looks) + 1)[:, None, None]
        drift_px = np.linalg.norm(looks[1:] - centre[:-1], axis=2).max(axis=1)
        limit_px = max(self.settings.still_px, REST_SIGMAS * self.noise_px)
        moved = np.flatnonzero(drift_px > limit_px)
        rest = looks[:int(moved[0]) + 1] if len(moved) else looks
        count = len(rest)
        noise = float(np.sqrt(rest.var(axis=0, ddof=1).mean())) if count > 1 else float('nan')
        return _weighted([*self._looks][:-count - 1:-1], noise)

    def _measure_noise(self) -> None:
        """Take second differences, which even motion does not spoil, and their median."""
        if not self._noise_stale or len(self._looks) < NOISE_LOOKS:
            return
        self._noise_stale = False
        bends = np.diff([look.corners_px for look in self._looks], n=2, axis=0)
        noise = float(np.median(np.abs(bends))) / (MEDIAN_OF_NORMAL * math.sqrt(6.0))
        self._measured_px = min(max(noise, NOISE_RANGE_PX[0]), NOISE_RANGE_PX[1])

    def _prior(self, time_s: float, arm_pose: np.ndarray | None) -> Prior | None:
        settings = self.settings
        if arm_pose is not None:
            return _prior(arm_pose, settings.arm_sigma_m, settings.arm_sigma_rad)
        if self._last is None or time_s - self._last[1] > settings.memory_s:
            return None
        age_s = max(time_s - self._last[1], 0.02)
        return _prior(self._last[0], 0.005 + settings.motion_m_s * age_s,
                      0.05 + settings.motion_rad_s * age_s)


def _weighted(looks: list[Look], noise_px: float) -> StillView:
    """Average looks, the better known ones with more weight."""
    corners_px = np.array([look.corners_px for look in looks])
    known = [look.covariance_px2 for look in looks if look.covariance_px2 is not None]
    if len(known) < len(looks):
        return StillView(corners_px.mean(axis=0), len(looks), noise_px)
    variances = np.array([np.trace(covariance) for covariance in known])
    mean = np.average(corners_px, axis=0, weights=1.0 / variances)
    return StillView(mean, len(looks), noise_px, known[int(variances.argmin())])


def _prior(pose: np.ndarray, sigma_m: float, sigma_rad: float) -> Prior:
    return Prior(pose, np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3))
