"""Follow the face through a video, and know when that fails."""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.camera import Camera
from homography_servo.result import Rejected
from homography_servo.tracking.box import BoxSides
from homography_servo.tracking.finder import find_face
from homography_servo.tracking.finder import Target
from homography_servo.tracking.motion import Motion
from homography_servo.tracking.motion import shape_prior
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.snake import Look
from homography_servo.tracking.snake import Prior
from homography_servo.tracking.snake import Quality
from homography_servo.tracking.snake import quality_of
from homography_servo.tracking.snake import SnakeFit
from homography_servo.tracking.spline import ClosedSpline
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

SEARCHING, TRACKING, COASTING, LOST = 'SEARCHING', 'TRACKING', 'COASTING', 'LOST'
POLARITIES = {'any': 0, 'bright': 1, 'dark': -1}
WIDE = (Look(4.0, 16, 3, 3, 3, 0.5, 1.0, 2.0), Look(2.0, 8, 3, 3, 2, 0.25, 0.5, 1.0))
GIVEN_SHAPE_SIGMA_PX = 4.0  # of corners that a person or the arm gives


class Track(NamedTuple):
    """What one picture told; corners only when they can be trusted."""

    state: str
    corners_px: np.ndarray | None  # (4, 2)
    covariance_px2: np.ndarray | None  # (8, 8) of u0, v0, u1, ...
    contour_px: np.ndarray | None  # (M, 2)
    quality: Quality | None
    reason: str  # why there are no corners; empty when there are


class Tracker:
    """
    Tracks one rectangular face.

    Parameters
    ----------
    face_size_m : (float, float)
        Width and height of the face.
    settings : TrackerSettings
        How to find, follow and trust.
    camera : Camera or None
        Lens; None assumes none that bends.
    box_height_m : float
        How far the box reaches behind the face.
    home_depth_m : float
        Not needed for tracking; kept with the description of the object.

    """

    def __init__(self, face_size_m: tuple[float, float],
                 settings: TrackerSettings = TrackerSettings(), camera: Camera | None = None,
                 box_height_m: float = 0.0, home_depth_m: float = 1.0) -> None:
        if not (min(face_size_m) > 0.0 and box_height_m >= 0.0):
            raise ValueError('the face must have a size > 0 m and the box a height >= 0 m, '
                             f'got {face_size_m} and {box_height_m}')
        self.face_size_m = tuple(face_size_m)
        self.settings = settings
        self._plane = Plane(camera)
        self.box_height_m = box_height_m
        self.home_depth_m = home_depth_m
        self._spline = ClosedSpline()
        self.reset()

    @property
    def camera(self) -> Camera | None:
        """Give the lens."""
        return self._plane.camera

    @camera.setter
    def camera(self, camera: Camera | None) -> None:
        self._plane = Plane(camera)
        self._box = self._sides()

    def _sides(self) -> BoxSides | None:
        """Describe the sides of the box, which can be predicted with a known lens only."""
        if self.box_height_m > 0.0 and self.camera is not None:
            return BoxSides(self.face_size_m, self.box_height_m, self._plane)
        return None

    @property
    def state(self) -> str:
        """Give the present state."""
        return self._state

    def reset(self) -> None:
        """Forget the object and look for it again."""
        self._state = SEARCHING
        self._motion: Motion | None = None
        self._box = self._sides()
        self._size: tuple[int, ...] | None = None
        self._confirmed = 0  # good frames since the face was found
        self._missed = 0
        self._good_s = 0.0
        self._known_place = len(self.settings.initial_corners_px) == 8

    def interrupt(self) -> None:
        """Say that no pictures come; what is seen next must be confirmed first."""
        self._state = SEARCHING if self._state == SEARCHING else LOST
        self._confirmed = 0

    def update(self, grey: np.ndarray, stamp_s: float,
               predicted_corners_px: np.ndarray | None = None) -> Track:
        """
        Look at the next picture.

        Parameters
        ----------
        grey : (H, W) uint8 array
            The picture.
        stamp_s : float
            When it was taken.
        predicted_corners_px : (4, 2) array or None
            Where the arm says the corners are.

        Returns
        -------
        Track

        """
        image = self._checked(grey)
        if self._size not in (None, image.shape):
            self.reset()
        if not self._plane.fits(image.shape):
            self._plane = Plane(None)
        self._size = image.shape
        if self._motion is None:
            return self._search(image, stamp_s, predicted_corners_px)
        fit = self._follow(image, stamp_s, predicted_corners_px)
        return self._missing(fit, stamp_s) if isinstance(fit, Rejected) \
            else self._seen(fit, stamp_s)

    def _checked(self, grey: np.ndarray) -> np.ndarray:
        if grey.ndim != 2 or grey.dtype != np.uint8 or not grey.size:
            raise ValueError(f'expected a (H, W) uint8 image, got {grey.shape} {grey.dtype}')
        return np.ascontiguousarray(grey)

    def _search(self, image: np.ndarray, stamp_s: float,
                predicted_px: np.ndarray | None) -> Track:
        fit: SnakeFit | Rejected = Rejected('nobody says where the face is')
        given = self._given(predicted_px)
        if given is not None:
            fit = self._fit_near(image, shape_prior(given, GIVEN_SHAPE_SIGMA_PX))
        if not fit and self.settings.find_face:
            found = find_face(image, self._target(), self._plane, self._given(predicted_px))
            fit = found if isinstance(found, Rejected) else found.fit
        if isinstance(fit, Rejected):
            return Track(self._state, None, None, None, None, fit.reason)
        self._motion = Motion()
        self._confirmed = self.settings.confirming_frames if self._known_place else 0
        return self._seen(fit, stamp_s)

    def _target(self) -> Target:
        settings = self.settings
        return Target(self.face_size_m, self.box_height_m, settings.nearest_m,
                      settings.farthest_m, POLARITIES[settings.polarity], settings.edge_blur_px)

    def _given(self, predicted_px: np.ndarray | None) -> np.ndarray | None:
        if predicted_px is not None:
            return self._plane.from_image(np.asarray(predicted_px, float))
        if self.settings.initial_corners_px:
            return self._plane.from_image(np.reshape(self.settings.initial_corners_px, (4, 2)))
        return None

    def _follow(self, image: np.ndarray, stamp_s: float,
                predicted_px: np.ndarray | None) -> SnakeFit | Rejected:
        prior = self._motion.predict(stamp_s)
        fit = self._fit_fine(image, prior)
        if not fit:
            fit = self._fit_near(image, prior)
        if not fit and predicted_px is not None:
            fit = self._fit_near(image, shape_prior(self._given(predicted_px),
                                                    GIVEN_SHAPE_SIGMA_PX))
        return fit

    def _fit_near(self, image: np.ndarray, prior: Prior) -> SnakeFit | Rejected:
        polarity = POLARITIES[self.settings.polarity]
        for look in WIDE:
            wide = fit_snake(image, prior.corners, look, self._plane, prior, polarity)
            if isinstance(wide, Rejected):
                return wide
            prior = Prior(wide.corners, prior.information)
        return self._fit_fine(image, prior)

    def _fit_fine(self, image: np.ndarray, prior: Prior) -> SnakeFit | Rejected:
        settings = self.settings
        look = Look(settings.edge_blur_px, settings.edge_half_px)
        strips = None if self._box is None else self._box.strips(prior.corners)
        fit = fit_snake(image, prior.corners, look, self._plane, prior,
                        POLARITIES[settings.polarity], strips)
        if isinstance(fit, Rejected):
            return fit
        if self._box is not None:
            self._box.learn(fit.edges, fit.weight, strips, look.half)
        doubt = self._doubt(fit)
        return fit if doubt is None else doubt

    def _doubt(self, fit: SnakeFit) -> Rejected | None:
        """Give the reason not to trust a fit, or None."""
        settings, quality = self.settings, quality_of(fit)
        sigma_px = float(np.sqrt(np.diag(fit.covariance).max()))
        if abs(quality.contrast) < settings.min_contrast:
            return Rejected(f'the contrast of the edges is {quality.contrast:.0f} grey levels')
        if quality.inlier_share < settings.min_inlier_share:
            return Rejected(f'only {quality.inlier_share:.0%} of the lines agree')
        if np.sum(quality.side_share > 0.4) < 3:
            return Rejected('fewer than three sides are visible')
        if sigma_px > settings.max_corner_sigma_px:
            return Rejected(f'a corner is uncertain by {sigma_px:.2f} px')
        return None

    def _seen(self, fit: SnakeFit, stamp_s: float) -> Track:
        self._motion.measured(fit.corners, stamp_s)
        self._confirmed += 1
        self._missed, self._good_s = 0, stamp_s
        if self._confirmed < self.settings.confirming_frames:
            self._state = SEARCHING if self._state == SEARCHING else LOST
            return Track(self._state, None, None, None, quality_of(fit), 'found, not yet confirmed')
        self._state = TRACKING
        contour = self._plane.to_image(self._spline.curve(self._spline.control(fit.corners)))
        covariance = self._plane.covariance_to_image(fit.corners, fit.covariance)
        return Track(TRACKING, self._plane.to_image(fit.corners), covariance, contour,
                     quality_of(fit), '')

    def _missing(self, why: Rejected, stamp_s: float) -> Track:
        self._missed += 1
        coasting = self._state in (TRACKING, COASTING) \
            and self._missed <= self.settings.coasting_frames \
            and stamp_s - self._good_s <= self.settings.coasting_s
        if coasting:
            self._state = COASTING
        else:
            was_tracking = self._state in (TRACKING, COASTING, LOST)
            self._state, self._motion = LOST if was_tracking else SEARCHING, None
            self._known_place = False
        return Track(self._state, None, None, None, None, why.reason)
