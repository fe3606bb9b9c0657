"""Follow the face through a video, and know when that fails."""

from __future__ import annotations

from functools import partial
from typing import Callable
from typing import NamedTuple

from homography_servo.geometry.camera import Camera
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.tracking.follower import Follower
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.quality import Quality
from homography_servo.tracking.recognition import Recognition
from homography_servo.tracking.search import Search
from homography_servo.tracking.spline import ClosedSpline
from homography_servo.tracking.target import Target
from homography_servo.tracking.target import turns_of
from homography_servo.tracking.tracker_settings import POLARITIES
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

SEARCHING, TRACKING, COASTING, LOST = 'SEARCHING', 'TRACKING', 'COASTING', 'LOST'
REMEMBER_EVERY = 12  # pictures: what the face and its background look like changes slowly
DOUBT_EVERY = 2  # pictures: no more than one shows the background in place of the face
STAY_S = 3.0  # for which a face is kept to with a side that nothing shows
FARTHEST = 10.0  # times the size of the picture: what is said to be farther out is nonsense


class Track(NamedTuple):
    """What one picture told; corners only when they can be trusted."""

    state: str
    corners_px: np.ndarray | None  # (4, 2)
    covariance_px2: np.ndarray | None  # (8, 8) of u0, v0, u1, ...
    outline: Callable[[], np.ndarray] | None  # samples the contour (M, 2) [px]; seldom asked
    quality: Quality | None
    reason: str  # why there are no corners; empty when there are

    @property
    def contour_px(self) -> np.ndarray | None:
        """Give points (M, 2) of the contour, from the first corner on."""
        return None if self.outline is None else self.outline()


class Tracker:
    """
    Tracks one rectangular face.

    The state begins as SEARCHING. It becomes TRACKING at once where somebody says
    where the face is (initial corners, or the arm before the face has ever been lost),
    else after a few good pictures in a row. A picture without a trustworthy
    measurement makes it COASTING, a few of them LOST; then the face is looked for
    near its last place and in the whole picture.

    Parameters
    ----------
    face_size_m : (float, float)
        Width and height of the face.
    settings : TrackerSettings
        How to find, follow and trust.
    camera : Camera or None
        Lens; None assumes one that does not bend.
    box_height_m : float
        How far the box reaches behind the face. Needs a camera to be of use.

    """

    def __init__(self, face_size_m: tuple[float, float],
                 settings: TrackerSettings = TrackerSettings(), camera: Camera | None = None,
                 box_height_m: float = 0.0) -> None:
        if len(face_size_m) != 2 or not (min(face_size_m) > 0.0 and box_height_m >= 0.0):
            raise ValueError('the face must have a size > 0 m and the box a height >= 0 m, '
                             f'got {face_size_m} and {box_height_m}')
        self.face_size_m = (float(face_size_m[0]), float(face_size_m[1]))
        self.box_height_m = box_height_m
        self._settings, self._plane = settings, Plane(camera)
        self._first_px = _first_place(settings)
        self._spline = ClosedSpline()
        self._last_px: np.ndarray | None = None
        self._follower = Follower(settings, self._plane, self.face_size_m, box_height_m)
        self.reset()

    @property
    def settings(self) -> TrackerSettings:
        """Give the settings in force; new ones act from the next picture."""
        return self._settings

    @settings.setter
    def settings(self, settings: TrackerSettings) -> None:
        self._settings = self._follower.settings = settings
        self._first_px = _first_place(settings)

    @property
    def camera(self) -> Camera | None:
        """Give the lens; a new one begins anew near the last place."""
        return self._plane.camera

    @camera.setter
    def camera(self, camera: Camera | None) -> None:
        last_px = self._follower.last_px
        self._plane = Plane(camera)
        self._follower = Follower(self._settings, self._plane, self.face_size_m,
                                  self.box_height_m)
        self._last_px = self._last_px if last_px is None else last_px

    @property
    def state(self) -> str:
        """Give the present state."""
        return self._state

    def reset(self) -> None:
        """Forget the object and look for it again."""
        self._state = SEARCHING
        self._follower = Follower(self._settings, self._plane, self.face_size_m,
                                  self.box_height_m)
        self._size: tuple[int, ...] | None = None
        self._last_px = None
        self._recognition = Recognition(turns_of(self.face_size_m))
        self._confirmed = self._missed = 0
        self._good_s = 0.0
        self._was_lost = False

    def interrupt(self) -> None:
        """Say that no pictures come; what is seen next must be confirmed first."""
        if self._state != SEARCHING:
            self._lose()

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
        given_px = self._given(predicted_corners_px)
        if not self._follower.following:
            return self._search(image, stamp_s, given_px)
        fit = self._follower.follow(image, stamp_s, given_px)
        if isinstance(fit, Rejected):
            return self._missing(fit, stamp_s)
        shown = self._plane.to_image_with_covariance(fit.corners, fit.covariance)
        if self._confirmed % DOUBT_EVERY == 0 and self._recognition.behind(image, shown[0]):
            return self._missing(Rejected('the face went on, and left the background where it '
                                          'was looked for'), stamp_s)
        return self._seen(image, fit, shown, stamp_s)

    def _checked(self, grey: np.ndarray) -> np.ndarray:
        if grey.ndim != 2 or grey.dtype != np.uint8 or not grey.size:
            raise ValueError(f'expected a (H, W) uint8 image, got {grey.shape} {grey.dtype}')
        if self._size not in (None, grey.shape):
            self.reset()
        if not self._plane.fits(grey.shape):
            self.camera = None  # calibrated for another size: better none than a wrong one
        self._size = grey.shape
        return np.ascontiguousarray(grey)

    def _given(self, predicted_px: np.ndarray | None) -> np.ndarray | None:
        """Give the corners that somebody expects."""
        if predicted_px is not None:
            predicted_px = np.asarray(predicted_px, float)
            if predicted_px.shape != (4, 2):
                raise ValueError(f'expected (4, 2) corners, got {predicted_px.shape}')
            if np.abs(predicted_px).max() < FARTHEST * max(required(self._size, 'picture')):
                return predicted_px
        return None if self._was_lost else self._first_px

    def _search(self, image: np.ndarray, stamp_s: float,
                given_px: np.ndarray | None) -> Track:
        """Look where the face may be, then everywhere."""
        goes_on = self._state in (TRACKING, COASTING)  # through another lens
        is_told = given_px is not None and not self._was_lost
        search = Search(image, self._follower, self._recognition, self._plane,
                        given_px if given_px is self._first_px else None)
        fit: SnakeFit | Rejected = Rejected('nobody says where the face is')
        for near_px, told in ((given_px, is_told), (self._last_px, False),
                              (self._first_px, True)):
            if near_px is not None and not fit:
                fit = search.near(near_px, told)
        sure = bool(fit) and (is_told or goes_on)
        if not fit and self._settings.find_face and not goes_on:
            # What hardly differs from the background may be missed by what is new alone.
            fit = search.anywhere(self._target(), self._last_px if given_px is None else given_px,
                                  self._missed % 2 == 0)
        if isinstance(fit, Rejected):
            return self._missing(Rejected(search.doubts[0]) if search.doubts else fit, stamp_s)
        self._confirmed = self._settings.confirming_frames - 1 if sure else 0
        return self._seen(image, fit, self._plane.to_image_with_covariance(
            fit.corners, fit.covariance), stamp_s)

    def _target(self) -> Target:
        settings = self._settings
        return Target(self.face_size_m, self.box_height_m, settings.nearest_m,
                      settings.farthest_m, POLARITIES[settings.polarity],
                      self._follower.blur_px)

    def _seen(self, image: np.ndarray, fit: SnakeFit, shown: tuple[np.ndarray, np.ndarray],
              stamp_s: float) -> Track:
        """Take in a fit that is trusted; `shown` are its corners and covariance in the image."""
        self._follower.accept(image, fit, stamp_s)
        self._confirmed += 1
        self._missed, self._good_s = 0, stamp_s
        if self._confirmed < self._settings.confirming_frames:
            return Track(self._state, None, None, None, fit.quality,
                         'found, not yet confirmed')
        self._state = TRACKING
        self._last_px, covariance_px2 = shown
        if (self._confirmed - self._settings.confirming_frames) % REMEMBER_EVERY == 0:
            self._recognition.remember(image, self._last_px,
                                       self._follower.silhouette_px(fit.corners),
                                       fit.judged.clear)
        return Track(TRACKING, self._last_px, covariance_px2,
                     partial(_contour, self._spline, self._plane, fit.corners), fit.quality, '')

    def _missing(self, why: Rejected, stamp_s: float) -> Track:
        self._missed += 1
        settings, since_s = self._settings, stamp_s - self._good_s
        stays = self._follower.stay(stamp_s)
        if self._state in (TRACKING, COASTING) and self._missed <= settings.coasting_frames \
                and since_s <= settings.coasting_s:
            self._state = COASTING
        else:
            self._lose(stays and since_s < STAY_S and self._state != SEARCHING)
        return Track(self._state, None, None, None, None, why.reason)

    def _lose(self, stays: bool = False) -> None:
        """Give the face up, or only its corners; one never confirmed is simply not found yet."""
        if self._state != SEARCHING:
            self._state, self._was_lost = LOST, True
        if not stays:
            self._follower.forget()
        self._confirmed = 0


def _contour(spline: ClosedSpline, plane: Plane, corners: np.ndarray) -> np.ndarray:
    """Sample the outline of a face with these corners of the plane [px]."""
    return plane.to_image(spline.outline(corners))


def _first_place(settings: TrackerSettings) -> np.ndarray | None:
    """Give the corners of the settings, where the face may come back after a loss."""
    if not settings.initial_corners_px:
        return None
    return np.reshape(settings.initial_corners_px, (4, 2))
