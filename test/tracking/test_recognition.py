"""The face is known again after it was lost, and nothing else is taken for it."""

from face_views import CAMERA
from face_views import FACE_M
from face_views import pose
from face_views import RATE_HZ
from face_views import swing
from face_views import told
from homography_servo.geometry.camera import Camera
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking.background import Background
from homography_servo.tracking.looks import Looks
from homography_servo.tracking.recognition import Recognition
from homography_servo.tracking.tracker import COASTING
from homography_servo.tracking.tracker import LOST
from homography_servo.tracking.tracker import SEARCHING
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker import TRACKING
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np
import pytest

FIRST, SECOND = (np.array([[u, 100.0], [u + 100.0, 102.0], [u + 98.0, 162.0], [u, 160.0]])
                 for u in (100.0, 400.0))


def picture(*quads, background=80, level=200, noise=2.0, light=1.0, seed=0):
    """Draw faces of one colour."""
    image = np.full((480, 640), float(background))
    for quad in quads:
        low, high = np.rint(quad.min(axis=0)).astype(int), np.rint(quad.max(axis=0)).astype(int)
        image[low[1]:high[1], low[0]:high[0]] = level
    image = light * image + np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def turned(image):
    """Turn a picture upside down."""
    return np.ascontiguousarray(image[::-1, ::-1])


# What was there before.


def test_what_was_there_while_the_face_was_elsewhere_is_background():
    background = Background()
    background.remember(picture(FIRST, SECOND), FIRST)
    assert background.shows(picture(SECOND, seed=1), SECOND)


@pytest.mark.parametrize('light', [0.8, 1.2])
def test_light_does_not_hide_what_was_there(light):
    background = Background()
    background.remember(picture(FIRST, SECOND), FIRST)
    assert background.shows(picture(SECOND, seed=1, light=light), SECOND)


def test_what_came_later_is_not_background_nor_is_the_face_in_its_place():
    background = Background()
    assert not background.shows(picture(FIRST), FIRST)
    background.remember(picture(FIRST), FIRST)
    assert not background.shows(picture(FIRST, seed=1), FIRST)
    assert not background.shows(picture(SECOND, seed=1), SECOND)
    assert not background.shows(picture(FIRST + (40.0, 0.0), seed=1), FIRST + (40.0, 0.0))


def test_what_the_face_covered_is_known_once_it_has_gone_on():
    background = Background()
    background.remember(picture(FIRST), FIRST)
    thing = picture(FIRST, level=150, seed=1)
    assert not background.shows(thing, FIRST)
    background.remember(picture(FIRST, level=150), SECOND)
    assert background.shows(thing, FIRST)


@pytest.mark.parametrize('light', [0.6, 1.0, 1.5])
def test_light_is_told_from_what_is_bright(light):
    """The face itself, and a bright thing that comes in, make no light."""
    background = Background()
    background.remember(picture(FIRST, level=250, background=40), FIRST)
    much = np.array([[50.0, 50.0], [350.0, 50.0], [350.0, 400.0], [50.0, 400.0]])
    now = picture(much, level=250, background=40, light=light, seed=1)
    assert background.light(now) == pytest.approx(light, rel=0.1)


def test_a_place_at_the_edge_of_the_picture_or_beyond_is_no_trouble():
    background = Background()
    for shift in ((-150.0, -130.0), (-2000.0, 0.0), (500.0, 350.0)):
        background.remember(picture(), FIRST + shift)
        assert not background.shows(picture(seed=1), FIRST + shift)


# How the face looks.


def printed(seed=0):
    """Show a face with print: picture and corners."""
    scene = Scene(CAMERA, FACE_M, 0.0, SceneSettings(print_contrast=100.0), seed)
    frame = scene.render(pose(turn=10.0), 0.0, 0)
    return frame.image_grey, frame.true_corners_px


def test_a_face_is_known_by_its_print():
    image, corners = printed()
    looks = Looks()
    assert looks.doubt(image, corners, (0, 2)) == ''
    looks.remember(image, corners)
    assert looks.doubt(image, corners, (0, 2)) == ''
    assert 'look like the face' in looks.doubt(printed(1)[0], corners, (0, 2))
    assert 'look like the face' in looks.doubt(picture(FIRST), FIRST, (0, 2))


@pytest.mark.parametrize('turns', [(0, 2), (0, 1, 2, 3)])
def test_print_tells_which_corner_is_the_first(turns):
    image, corners = printed()
    looks = Looks()
    assert looks.best_turn(image, corners, turns) == 0
    looks.remember(image, corners)
    for turn in turns:
        assert looks.best_turn(image, np.roll(corners, turn, axis=0), turns) == turn


def test_a_face_of_one_colour_is_not_one_with_print_nor_much_darker():
    looks = Looks()
    looks.remember(picture(FIRST), FIRST)
    assert looks.doubt(picture(SECOND, level=150), SECOND, (0, 2)) == ''
    assert 'grey level 1' in looks.doubt(picture(SECOND, level=110), SECOND, (0, 2))
    assert looks.doubt(picture(SECOND, level=110), SECOND, (0, 2), light=0.6) == ''
    image, corners = printed()
    assert 'one colour' in looks.doubt(image, corners, (0, 2))
    assert looks.best_turn(image, corners, (0, 2)) == 0


@pytest.mark.parametrize('spot', [(40.0, 20.0), (8.0, 50.0)])
def test_what_lay_on_a_face_of_one_colour_is_not_its_print(spot):
    corner = FIRST[0] + (30.0, 5.0)
    thing = np.array([corner, corner + (spot[0], 0.0), corner + spot, corner + (0.0, spot[1])])
    covered = np.minimum(picture(FIRST, seed=1), picture(thing, background=255, level=30))
    looks = Looks()
    looks.remember(covered, FIRST)
    assert looks.doubt(picture(SECOND), SECOND, (0, 2)) == ''
    assert looks.doubt(covered, FIRST, (0, 2)) == ''
    assert looks.best_turn(picture(SECOND), SECOND, (2, 0)) == 2
    assert 'grey level' in looks.doubt(picture(SECOND, level=100), SECOND, (0, 2))


def test_looks_that_are_older_than_the_background_are_seen_in_its_light():
    recognition = Recognition((0, 2))
    recognition.remember(picture(FIRST), FIRST, FIRST, clear=True)
    for light in np.linspace(1.0, 0.4, 20):
        recognition.remember(picture(FIRST, light=light), FIRST, FIRST, clear=False)
    assert recognition.doubt(picture(SECOND, light=0.4), SECOND) == ''
    assert 'grey level' in recognition.doubt(picture(SECOND, level=90, light=0.4), SECOND)


# The tracker with both.


def lost_in(scene, seed, height_m=0.0, tracked=60, gone=24, back=8):
    """Take the face away for a while: the tracker's answers meanwhile and afterwards."""
    away_s = tracked / RATE_HZ
    world = Scene(CAMERA, FACE_M, height_m, SceneSettings(
        vanish_start_s=away_s, vanish_duration_s=gone / RATE_HZ, **scene), seed)
    tracker = Tracker(FACE_M, told(world.corners(swing(0))), CAMERA, height_m)
    tracks, errors = [], []
    for index in range(tracked + gone + back):
        frame = world.render(swing(index), index / RATE_HZ, index)
        tracks.append(tracker.update(frame.image_grey, index / RATE_HZ))
        if tracks[-1].corners_px is not None and frame.true_corners_px is not None:
            errors.append(np.abs(tracks[-1].corners_px - frame.true_corners_px).max())
    assert tracks[tracked - 1].state == TRACKING
    assert max(errors) < 1.5
    return tracks[tracked:tracked + gone], tracks[tracked + gone:]


@pytest.mark.parametrize('scene, height_m', [
    ({}, 0.0), ({'print_contrast': 100.0}, 0.0), ({'shadow': 0.5}, 0.04)],
    ids=['blank', 'print', 'box'])
@pytest.mark.parametrize('seed', [2, 3, 4])
def test_nothing_in_the_background_is_taken_for_a_face_that_was_taken_away(scene, height_m, seed):
    gone, back = lost_in({'clutter': 1.0, **scene}, seed, height_m)
    assert [track.corners_px for track in gone] == [None] * len(gone)
    assert {track.state for track in gone[4:]} == {LOST}
    assert all(track.reason for track in gone)
    assert back[-1].state == TRACKING


class Stage:
    """Shows a tracker one picture after the other."""

    def __init__(self, tracker):
        self.tracker, self._index = tracker, 0

    def show(self, image, times=1):
        """Show the same picture for a while; give the last answer."""
        for _ in range(times):
            track = self.tracker.update(image, self._index / RATE_HZ)
            self._index += 1
        return track


def test_a_printed_face_that_was_turned_meanwhile_begins_with_its_own_corner():
    image, corners = printed()
    stage = Stage(Tracker(FACE_M, told(corners), CAMERA))
    assert stage.show(image, 3).state == TRACKING
    assert stage.show(np.full_like(image, 80), 6).state == LOST
    track = stage.show(turned(image), 5)
    assert np.abs(track.corners_px - ((639.0, 479.0) - corners)).max() < 0.5


def test_another_object_is_refused_in_plain_words_until_a_reset():
    image, corners = printed()
    stage = Stage(Tracker(FACE_M, told(corners), CAMERA))
    stage.show(image, 3)
    stage.show(np.full_like(image, 80), 6)
    track = stage.show(printed(1)[0], 10)
    assert track.state == LOST
    assert 'does not look like the face did' in track.reason and 'reset' in track.reason
    stage.tracker.reset()
    assert stage.show(printed(1)[0], 5).state == TRACKING


def test_a_face_that_rested_while_it_was_covered_is_back_at_once():
    image, corners = printed()
    stage = Stage(Tracker(FACE_M, told(corners), CAMERA))
    stage.show(image, 40)
    stage.show(np.full_like(image, 80), 6)
    assert stage.show(image, 5).state == TRACKING


def test_a_face_that_comes_back_into_other_light_is_known():
    stage = Stage(Tracker(FACE_M, told(FIRST), None))
    assert stage.show(picture(FIRST), 3).state == TRACKING
    stage.show(picture(), 6)
    assert stage.show(picture(SECOND, light=0.7), 5).state == TRACKING


def test_a_person_who_says_where_the_face_is_means_nothing_else():
    stage = Stage(Tracker(FACE_M, told(FIRST), None))
    track = stage.show(picture(SECOND), 8)
    assert track.state == SEARCHING and 'away from initial_corners_px' in track.reason
    assert Stage(Tracker(FACE_M)).show(picture(SECOND), 5).state == TRACKING
    assert Stage(Tracker(FACE_M, told(FIRST))).show(picture(FIRST + 20.0), 5).state == TRACKING


@pytest.mark.parametrize('rest', range(4))
def test_a_twin_of_the_face_that_stays_behind_is_noticed_while_tracking(rest):
    """The face comes to rest before a thing like it, and is gone from one picture to the next."""
    stage = Stage(Tracker(FACE_M, told(FIRST), None))
    for shift in (*np.linspace(0.0, 300.0, 61), *[300.0] * rest):
        twin, face = picture(SECOND), picture(FIRST + (shift, 0.0), level=230)
        track = stage.show(np.maximum(twin, face))
        assert track.state == TRACKING
    states = [stage.show(picture(SECOND)).state for _ in range(8)]
    assert states.count(TRACKING) <= 1
    assert states[-1] == LOST


@pytest.mark.parametrize('light', [0.5, 1.0, 2.0])
def test_a_large_face_before_something_dark_is_known_again(light):
    """The pixels that it covers and uncovers say nothing of the light."""
    large = np.array([[150.0, 120.0], [450.0, 120.0], [450.0, 300.0], [150.0, 300.0]])
    stage = Stage(Tracker(FACE_M, told(large), None))
    assert stage.show(picture(large, background=30, level=120), 30).state == TRACKING
    assert stage.show(picture(background=30), 6).state == LOST
    back = picture(large + 20.0, background=30, level=120, light=light, seed=1)
    assert stage.show(back, 8).state == TRACKING


def test_a_camera_that_changes_does_not_hide_that_the_face_has_gone():
    image, corners = printed()
    stage = Stage(Tracker(FACE_M, told(corners), CAMERA))
    stage.show(image, 10)
    stage.tracker.camera = Camera(801.0, 801.0, 319.5, 239.5, 640, 480)
    states = [stage.show(np.full_like(image, 80)).state for _ in range(6)]
    assert states == [COASTING] * 3 + [LOST] * 3
    assert stage.show(image, 5).state == TRACKING


def test_a_camera_that_changes_does_not_interrupt_what_is_tracked():
    image, corners = printed()
    tracker = Tracker(FACE_M, TrackerSettings(), CAMERA)
    stage = Stage(tracker)
    assert stage.show(image, 5).state == TRACKING
    tracker.camera = Camera(801.0, 801.0, 319.5, 239.5, 640, 480)
    track = stage.show(image)
    assert track.state == TRACKING
    assert np.abs(track.corners_px - corners).max() < 0.3


def test_after_a_change_of_camera_the_face_is_not_found_elsewhere_without_a_loss():
    stage = Stage(Tracker(FACE_M))
    assert stage.show(picture(FIRST), 10).state == TRACKING
    stage.tracker.camera = CAMERA
    assert [stage.show(picture(SECOND)).state for _ in range(4)] == [COASTING] * 3 + [LOST]
    assert stage.show(picture(SECOND), 5).state == TRACKING


def random_pose(rng):
    """Place the box somewhere in view, tilted and turned."""
    return pose(rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), rng.uniform(0.6, 0.9),
                *rng.uniform(-45.0, 45.0, 2), rng.uniform(-80.0, 80.0))


def test_a_box_that_was_turned_meanwhile_is_measured_well_at_once():
    rng = np.random.default_rng(1)
    for seed in range(16):
        world = Scene(CAMERA, FACE_M, 0.04, SceneSettings(shadow=0.5), seed)
        before, after = (world.render(random_pose(rng), 0.0, index) for index in range(2))
        stage = Stage(Tracker(FACE_M, told(before.true_corners_px, confirming_frames=1), CAMERA,
                              0.04))
        assert stage.show(before.image_grey, 20).state == TRACKING
        assert stage.show(world.render(None).image_grey, 6).state == LOST
        track = stage.show(after.image_grey)
        assert track.state == TRACKING
        errors = [np.abs(np.roll(track.corners_px, turn, axis=0) - after.true_corners_px).max()
                  for turn in (0, 2)]  # a blank face looks the same after half a turn
        assert min(errors) < 0.5, seed
