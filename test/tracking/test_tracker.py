"""The tracker follows, admits what it cannot see, and comes back."""

from dataclasses import replace
import gc
import tracemalloc

import cv2
from face_views import BENT
from face_views import CAMERA
from face_views import FACE_M
from face_views import pose
from face_views import RATE_HZ
from face_views import Show
from face_views import swing
from face_views import told
from homography_servo.geometry.camera import Camera
from homography_servo.result import Rejected
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking.tracker import COASTING
from homography_servo.tracking.tracker import LOST
from homography_servo.tracking.tracker import SEARCHING
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker import TRACKING
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np
import pytest

WORLDS = {
    'plain': (SceneSettings(), 0.0, CAMERA, 0.04, 0.15),
    'print': (SceneSettings(print_contrast=100.0), 0.0, CAMERA, 0.05, 0.2),
    'clutter': (SceneSettings(clutter=1.0, texture_grey=5.0), 0.0, CAMERA, 0.08, 0.6),
    'light': (SceneSettings(gradient=0.5, flicker=0.1), 0.0, CAMERA, 0.05, 0.2),
    'soft': (SceneSettings(blur_px=2.0), 0.0, CAMERA, 0.08, 0.3),
    'bent': (SceneSettings(), 0.0, BENT, 0.05, 0.2),
    'box': (SceneSettings(shadow=0.5), 0.04, CAMERA, 0.15, 0.7),
}


@pytest.mark.parametrize('name', sorted(WORLDS))
def test_corners_are_followed_in_every_world(name):
    scene, height_m, camera, rms_px, most_px = WORLDS[name]
    show = Show(scene, height_m, camera)
    assert set(show.run(40)) == {TRACKING}
    errors = show.errors()
    assert np.sqrt(np.mean(errors ** 2)) < rms_px
    assert errors.max() < most_px


def test_print_does_not_make_up_for_corners_that_are_too_uncertain():
    show = Show(SceneSettings(print_contrast=100.0))
    assert set(show.run(40)) == {TRACKING}
    show.tracker.settings = replace(show.tracker.settings, max_corner_sigma_px=0.01)
    track = show.tracker.update(show.frame(40).image_grey, 40 / RATE_HZ)
    assert track.state == COASTING and 'uncertain' in track.reason


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('far_px', [2e4, 1e10, 1e200, np.inf, np.nan])
def test_corners_that_are_expected_out_of_this_world_are_ignored(far_px):
    show = Show(camera=BENT)
    show.tracker = Tracker(FACE_M, TrackerSettings(), BENT)
    nowhere = np.full((4, 2), far_px)
    nowhere[1:3] *= 1.1
    states = [show.tracker.update(show.frame(index).image_grey, index / RATE_HZ, nowhere).state
              for index in range(6)]
    assert states[-1] == TRACKING


@pytest.mark.parametrize('after_s, kept', [(2.9, True), (3.1, False)])
def test_a_face_that_stays_too_uncertain_is_kept_to_for_three_seconds(monkeypatch, after_s, kept):
    show = Show()
    show.run(10)
    follower = show.tracker._follower
    monkeypatch.setattr(follower, 'follow', lambda *_: Rejected('too uncertain'))
    monkeypatch.setattr(follower, 'stay', lambda stamp_s: True)
    blank = np.zeros((480, 640), np.uint8)
    for time_s in (9 / RATE_HZ + 1.0, 9 / RATE_HZ + after_s):
        assert show.tracker.update(blank, time_s).state == LOST
    assert follower.following is kept


def test_a_face_that_was_never_confirmed_is_not_kept_to(monkeypatch):
    show = Show()
    show.tracker = Tracker(FACE_M, TrackerSettings(), CAMERA)
    follower = show.tracker._follower
    assert show.run(1) == [SEARCHING] and follower.following
    monkeypatch.setattr(follower, 'follow', lambda *_: Rejected('too uncertain'))
    monkeypatch.setattr(follower, 'stay', lambda stamp_s: True)
    assert show.tracker.update(show.frame(1).image_grey, 1.0 / RATE_HZ).state == SEARCHING
    assert not follower.following


def test_twenty_pixels_per_picture_are_kept():
    def motion(index):  # about 20 px per picture at the fastest
        phase = 2.0 * np.pi * index / 40.0
        return pose(0.12 * np.sin(phase), 0.05 * np.cos(phase), turn=15.0 + 10.0 * np.sin(phase))
    show = Show(motion=motion)
    assert set(show.run(50)) == {TRACKING}
    assert show.errors().max() < 0.3


def test_a_box_that_turns_back_at_once_is_kept():
    show = Show(SceneSettings(noise_grey=5.0), 0.04, motion=lambda index: swing(
        index if index < 30 else 58 - index))  # the prediction is 6 px off at once
    assert set(show.run(45)) == {TRACKING}
    assert show.errors().max() < 1.0


def test_a_jump_within_the_search_range_is_caught():
    show = Show(motion=lambda index: pose(0.02 if index > 5 else 0.0, turn=10.0))  # 21 px
    states = show.run(12)
    assert states.count(TRACKING) >= 9
    assert show.errors().max() < 0.3 and states[-1] == TRACKING


@pytest.mark.parametrize('kind, index', [('corner', 1), ('side', 2)])
def test_a_hidden_part_does_not_drag_the_rest(kind, index):
    scene = SceneSettings(occluder=kind, occluder_index=index, occluder_start_s=0.3,
                          occluder_duration_s=0.7)
    show = Show(scene)
    assert set(show.run(36)) == {TRACKING}
    hidden = {'corner': [1], 'side': [2, 3]}[kind]
    errors = np.delete(show.errors(), hidden, axis=1)
    assert np.sqrt(np.mean(errors[9:30] ** 2)) < 2.0 * np.sqrt(np.mean(errors[:9] ** 2))
    assert show.errors()[-3:].max() < 0.15


def test_a_vanished_face_is_coasting_at_once_lost_soon_and_confirmed_before_it_is_back():
    show = Show(SceneSettings(vanish_start_s=0.5, vanish_duration_s=0.4))
    states = show.run(45)
    gone = next(i for i, truth in enumerate(show.truths) if truth is None)
    back = next(i for i in range(gone, 45) if show.truths[i] is not None)
    assert states[:gone] == [TRACKING] * gone
    assert states[gone] == COASTING and LOST in states[gone:gone + 5]
    assert all(track.corners_px is None for track in show.tracks[gone:back + 4])
    assert states[back + 4:] == [TRACKING] * (45 - back - 4)
    assert show.errors().max() < 0.2


def test_an_empty_or_cluttered_world_without_the_face_is_never_tracked():
    scene = Scene(CAMERA, FACE_M, 0.04, SceneSettings(box_visible=False, texture_grey=5.0))
    tracker = Tracker(FACE_M, told([[260, 200], [370, 200], [370, 270], [260, 270]]), CAMERA,
                      0.04)
    for index in range(8):
        track = tracker.update(scene.render(None, 0.0, index).image_grey, index / RATE_HZ)
        assert (track.state, track.corners_px) == (SEARCHING, None)
        assert track.reason


def test_what_is_found_is_trusted_after_five_pictures():
    scene = Scene(CAMERA, FACE_M, 0.0, SceneSettings())
    tracker = Tracker(FACE_M, camera=CAMERA)
    states = [tracker.update(scene.render(pose(turn=8.0), 0.0, i).image_grey, i / RATE_HZ).state
              for i in range(6)]
    assert states == [SEARCHING] * 4 + [TRACKING] * 2


@pytest.mark.parametrize('turn', [0, 2])
def test_the_prediction_decides_which_corner_comes_first(turn):
    scene = Scene(CAMERA, FACE_M, 0.0, SceneSettings())
    frame = scene.render(pose(turn=5.0), 0.0, 0)
    wanted = np.roll(frame.true_corners_px, turn, axis=0)
    track = Tracker(FACE_M, camera=CAMERA).update(frame.image_grey, 0.0, wanted + 3.0)
    assert track.state == TRACKING
    assert np.abs(track.corners_px - wanted).max() < 0.2


def test_stated_covariance_fits_the_errors():
    show = Show(SceneSettings(noise_grey=5.0))
    show.run(60)
    pulls = [np.linalg.solve(np.linalg.cholesky(track.covariance_px2),
                             (track.corners_px - truth).ravel())
             for track, truth in zip(show.tracks, show.truths)]
    assert 0.6 < np.std(pulls) < 1.4


def test_a_box_behind_a_bent_lens_has_a_sound_covariance():
    show = Show(SceneSettings(noise_grey=5.0, shadow=0.5), 0.04, BENT, motion=lambda index: swing(
        2 * index, 35.0, 40.0))
    show.run(60)
    assert show.errors().max() < 1.0
    for track in show.tracks:
        if track.covariance_px2 is not None:
            assert np.linalg.eigvalsh(track.covariance_px2).min() > 0.0


def test_contour_runs_through_the_corners():
    show = Show()
    show.run(2)
    track = show.tracks[-1]
    distance = np.linalg.norm(track.contour_px[:, None] - track.corners_px, axis=2)
    assert distance.min(axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_new_size_starts_anew_and_drops_a_camera_that_does_not_fit():
    show = Show()
    show.run(3)
    track = show.tracker.update(np.full((240, 320), 80, np.uint8), 1.0)
    assert track.state == SEARCHING and show.tracker.camera is None


def test_reset_and_interruption():
    show = Show()
    show.run(3)
    show.tracker.interrupt()
    assert show.tracker.state == LOST
    states = [show.tracker.update(show.frame(i).image_grey, i / RATE_HZ).state
              for i in range(3, 8)]
    assert states == [LOST] * 4 + [TRACKING]
    show.tracker.reset()
    assert show.tracker.state == SEARCHING


def test_settings_and_camera_may_change_while_tracking():
    show = Show()
    show.run(3)
    show.tracker.settings = replace(show.tracker.settings, edge_half_px=6)
    show.tracker.camera = Camera(801.0, 801.0, 319.5, 239.5, 640, 480)
    for index in range(3, 9):
        frame = show.frame(index)
        track = show.tracker.update(frame.image_grey, index / RATE_HZ)
    assert track.state == TRACKING
    assert np.abs(track.corners_px - frame.true_corners_px).max() < 0.2


def test_the_same_pictures_give_the_same_answer():
    first, second = Show(seed=4), Show(seed=4)
    first.run(6)
    second.run(6)
    assert np.array_equal(first.tracks[-1].corners_px, second.tracks[-1].corners_px)


def test_nothing_grows_over_many_pictures():
    show = Show(SceneSettings(noise_grey=5.0), 0.04)
    frames = [show.frame(index).image_grey for index in range(30)]
    tour = [*frames, *frames[-2:0:-1]]

    def track(first, last):
        for index in range(first, last):
            assert show.tracker.update(tour[index % len(tour)], index / RATE_HZ).corners_px \
                is not None
        gc.collect()
        return len(gc.get_objects())

    tracemalloc.start()
    try:
        objects, memory = track(0, 200), tracemalloc.get_traced_memory()[0]
        more_objects = track(200, 600) - objects
        more_memory = tracemalloc.get_traced_memory()[0] - memory
    finally:
        tracemalloc.stop()
    assert more_objects < 50
    assert more_memory < 200e3  # a few more blurs may have been tabulated


def test_misuse_is_refused_by_name():
    with pytest.raises(ValueError, match='size > 0 m'):
        Tracker((0.1, 0.0))
    tracker = Tracker(FACE_M)
    with pytest.raises(ValueError, match='uint8'):
        tracker.update(np.zeros((48, 64)), 0.0)
    with pytest.raises(ValueError, match=r'\(4, 2\)'):
        tracker.update(np.zeros((48, 64), np.uint8), 0.0, np.zeros((3, 2)))
    with pytest.raises(ValueError, match='polarity'):
        TrackerSettings(polarity='pink')


@pytest.mark.parametrize('spoil', [np.nan, np.inf])
def test_a_prediction_that_is_not_finite_is_left_out(spoil):
    show = Show()
    frame = show.frame(0)
    track = show.tracker.update(frame.image_grey, 0.0, np.full((4, 2), spoil))
    assert track.state == TRACKING


@pytest.mark.parametrize('image', [
    np.zeros((480, 640), np.uint8), np.full((480, 640), 255, np.uint8),
    np.random.default_rng(0).integers(0, 256, (480, 640)).astype(np.uint8),
    np.zeros((1, 1), np.uint8), np.zeros((3, 2000), np.uint8)])
def test_no_picture_raises_or_is_taken_for_the_face(image):
    tracker = Tracker(FACE_M, camera=CAMERA, box_height_m=0.04)
    for index in range(6):
        track = tracker.update(image, index / RATE_HZ, np.array(
            [[300.0, 200.0], [400.0, 200.0], [400.0, 260.0], [300.0, 260.0]]))
        assert track.corners_px is None and track.reason


def test_a_side_without_an_edge_follows_from_the_box():
    rng, tracks = np.random.default_rng(4), []
    frame = Scene(CAMERA, FACE_M, 0.04, SceneSettings()).render(
        pose(tilt_x=-30.0, tilt_y=-25.0, turn=12.0), 0.0, 0)
    truth = frame.true_corners_px
    first, second = truth[1:3]  # no side of the box shows there
    edge = second - first
    outwards = np.array([edge[1], -edge[0]])
    behind = np.array([first - 0.2 * edge, first - 0.1 * edge + 0.6 * outwards,
                       second + 0.3 * edge + 0.5 * outwards, second + 0.2 * edge])
    image = cv2.fillPoly(frame.image_grey.copy(), [np.rint(behind).astype(np.int32)], 203)
    tracker = Tracker(FACE_M, TrackerSettings(), CAMERA, 0.04)
    for index in range(20):
        noisy = np.clip(np.rint(image + rng.normal(0.0, 2.0, image.shape)), 0, 255)
        tracks.append(tracker.update(noisy.astype(np.uint8), index / RATE_HZ))
    assert {track.state for track in tracks[4:]} == {TRACKING}
    assert all(np.abs(track.corners_px - truth).max() < 1.5 for track in tracks[4:])
