"""A side that is hidden is where its covariance says, or nothing is said of it."""

import math
from types import SimpleNamespace

import cv2
from face_views import CAMERA
from face_views import FACE_M
from face_views import RATE_HZ
from face_views import SQUARE
from face_views import told
from homography_servo.experiments.tracker_cases import Motion
from homography_servo.experiments.tracker_cases import ROUND_TRIP
from homography_servo.result import Rejected
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking.doubts import contradicts
from homography_servo.tracking.doubts import surprise
from homography_servo.tracking.follower import Follower
from homography_servo.tracking.locate import Locator
from homography_servo.tracking.motion import Motion as MotionModel
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.tracker import LOST
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker import TRACKING
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np
import pytest

TILTED = Motion(tilt_deg=40.0)
SIDEWAYS = Motion(speed_px=10.0)
FAST = Motion(speed_px=13.0, slowness=0.4)
SHARP = [0.02] * 8  # deviations of well known corners [px]
AROUND_SQUARE = Prior(SQUARE, np.eye(8) / 0.3 ** 2)


class Hidden:
    """A side is hidden after a second: what a tracker says, and how far it is off."""

    def __init__(self, side, motion, hidden_s, seed=0, height_m=0.0):
        scene = Scene(CAMERA, FACE_M, height_m, SceneSettings(
            noise_grey=5.0, occluder='side', occluder_index=side, occluder_start_s=1.0,
            occluder_duration_s=hidden_s, shadow=0.5 if height_m else 0.0), seed)
        tracker = Tracker(FACE_M, told(scene.corners(motion.pose(0.0))), CAMERA, height_m)
        tracks, errors_px, squares = [], [], []
        for index in range(int((1.3 + hidden_s) * RATE_HZ)):
            time_s = index / RATE_HZ
            frame = scene.render(motion.pose(time_s), time_s, index)
            tracks.append(track := tracker.update(frame.image_grey, time_s))
            if track.corners_px is None:
                continue
            error = (track.corners_px - frame.true_corners_px).ravel()
            errors_px.append(error)
            squares.append(error @ np.linalg.solve(track.covariance_px2, error) / error.size)
        self.states, self.reasons = ({getattr(track, name) for track in tracks}
                                     for name in ('state', 'reason'))
        self.last = tracks[-1].state
        self.errors_px, self.squares = np.array(errors_px), np.array(squares)


@pytest.mark.parametrize('side, motion', [(2, TILTED), (2, SIDEWAYS), (1, Motion()), (3, FAST)])
def test_a_side_that_is_hidden_for_long_is_where_its_covariance_says(side, motion):
    hidden = Hidden(side, motion, 2.0)
    assert LOST not in hidden.states
    assert hidden.squares[30:].mean() < 1.2 and hidden.squares.max() < 6.0
    assert np.abs(hidden.errors_px).max() < 2.0
    others = hidden.errors_px[30:85].reshape(-1, 4, 2)[:, [side - 1, side - 2]]
    assert np.sqrt(np.mean(np.square(others))) < 0.05


@pytest.mark.parametrize('seed', range(4))
def test_what_is_too_uncertain_to_be_told_is_kept_to(seed):
    """Seen far from the front, three sides do not tell where the fourth is."""
    hidden = Hidden(1, TILTED, 2.0, seed)
    assert LOST in hidden.states
    assert any('uncertain' in reason for reason in hidden.reasons)
    assert hidden.squares.mean() < 1.2 and hidden.squares.max() < 6.0
    assert hidden.last == TRACKING and np.abs(hidden.errors_px[-1]).max() < 0.1


@pytest.mark.parametrize('side, motion', [(0, TILTED), (1, TILTED), (3, TILTED), (0, ROUND_TRIP),
                                          (1, ROUND_TRIP), (2, FAST)])
def test_the_side_of_a_box_that_is_hidden_is_not_taken_for_what_hides_it(side, motion):
    hidden = Hidden(side, motion, 20.0 / RATE_HZ, 1, height_m=0.04)
    assert np.abs(hidden.errors_px).max() < 5.0
    assert hidden.last == TRACKING and np.abs(hidden.errors_px[-1]).max() < 0.3


@pytest.mark.parametrize('seed', range(3))
def test_a_side_of_the_box_that_comes_into_view_meanwhile_does_not_drag_the_hidden_one(seed):
    hidden = Hidden(3, SIDEWAYS, 2.0, seed, height_m=0.04)
    assert np.abs(hidden.errors_px).max() < 5.0
    assert hidden.last == TRACKING and np.abs(hidden.errors_px[-1]).max() < 0.7


def square_fit(sigma_px, moved_px=0.0):
    """Fit a square whose corners are known so well; the last one has moved to the right."""
    corners = SQUARE.copy()
    corners[3, 0] += moved_px
    variance = np.square(sigma_px)
    return SnakeFit(corners, np.diag(variance), np.diag(1.0 / variance), None, None, None, None,
                    0.0)


def test_the_shape_tells_a_corner_once_and_not_from_picture_to_picture():
    pictures = square_fit([0.02] * 6 + [3.0] * 2)
    shape = Prior(SQUARE, np.eye(8) / 0.5 ** 2)
    together = pictures.information + shape.information
    fit = pictures._replace(covariance=np.linalg.inv(together), information=together, shape=shape)
    assert np.allclose(fit.told_by_pictures, pictures.covariance)
    alone = fit._replace(information=shape.information)  # pictures that tell nothing
    assert np.array_equal(alone.told_by_pictures, fit.covariance)
    assert np.array_equal(fit._replace(shape=None).told_by_pictures, fit.covariance)


def test_a_fit_must_agree_with_an_uncertain_one_within_what_that_leaves_open():
    vague = square_fit([0.02] * 6 + [2.0] * 2)
    assert not contradicts(square_fit(SHARP, 10.0), vague)
    assert contradicts(square_fit(SHARP, 15.0), vague)


@pytest.mark.parametrize('moved_px, share, doubted',
                         [(1.5, 0.2, False), (3.0, 0.2, True), (3.0, 0.5, False)])
def test_only_a_side_that_is_seen_can_be_far_from_where_it_was_expected(moved_px, share, doubted):
    fit = square_fit(SHARP, moved_px)._replace(quality=SimpleNamespace(least_side_share=share))
    doubt = surprise(fit, AROUND_SQUARE, TrackerSettings(), True)
    assert ('not seen' in doubt) is doubted and bool(doubt) is doubted


@pytest.mark.parametrize('moved_px, vague_px, found', [
    (3.0, None, True), (15.0, None, False), (3.0, 2.0, True), (3.0, 0.3, False)])
def test_a_face_that_may_have_gone_is_of_the_same_shape_and_not_excluded(monkeypatch, moved_px,
                                                                         vague_px, found):
    fit = square_fit(SHARP, moved_px)._replace(quality=SimpleNamespace(least_side_share=1.0))
    follower = Follower(TrackerSettings(), Plane(CAMERA), FACE_M, 0.0)
    follower._motion = motion = MotionModel()
    motion.measured(SQUARE, 0.02 ** 2 * np.eye(8), 0.0)

    vague = None if vague_px is None else square_fit([0.02] * 6 + [vague_px] * 2)._replace(
        quality=SimpleNamespace(clear=False))

    def fine(image, prior):
        follower._vague = vague
        return Rejected('not here, or not sure')

    monkeypatch.setattr(follower, '_fine', fine)
    monkeypatch.setattr(follower, '_near', lambda image, prior, looks: fit)
    followed = follower.follow(np.zeros((480, 640), np.uint8), 1.0 / RATE_HZ, SQUARE)
    assert bool(followed) is found
    assert follower.stay(1.0 / RATE_HZ) is (vague is not None and not found)


@pytest.mark.parametrize('miss_px, accepted, doubted', [
    (0.45, 1, False), (0.55, 1, True), (math.inf, 1, True), (0.45, 4, True)])
def test_what_is_hidden_in_part_and_of_another_shape_is_compared_with_the_face(
        monkeypatch, miss_px, accepted, doubted):
    quality = SimpleNamespace(contrast=100.0, inlier_share=0.8, enough_sides=True, clear=False,
                              least_side_share=0.5)
    follower = Follower(TrackerSettings(), Plane(CAMERA), FACE_M, 0.0)
    follower._accepted = accepted
    monkeypatch.setattr(follower._shape, 'miss_px', lambda corners: miss_px)
    monkeypatch.setattr(follower._face, 'doubt', lambda corners, settings: 'no view of the face')
    fit = square_fit(SHARP)._replace(quality=quality)
    trusted = follower._trusted(np.zeros((480, 640), np.uint8), fit, AROUND_SQUARE)
    assert isinstance(trusted, Rejected) is doubted


def test_the_face_is_beside_only_where_it_looks_clearly_more_alike():
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.uniform(0.0, 255.0, (260, 300)).astype(np.uint8), (0, 0), 4.0)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    locator = Locator()
    locator.remember(image, SQUARE)
    assert locator.beside(image, SQUARE + [6.0, 0.0])
    assert not locator.beside(image, SQUARE + [3.0, 0.0])
    ghost = cv2.addWeighted(image, 0.52, np.roll(image, 6, axis=1), 0.48, 0.0)
    assert not locator.beside(ghost, SQUARE) and not locator.beside(ghost, SQUARE + [6.0, 0.0])
