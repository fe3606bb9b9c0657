"""What moves and what stands in the rendered world: occluders, clutter, print, light, shadow."""

from dataclasses import replace

from homography_servo.simulation.occluders import box_present
from homography_servo.simulation.occluders import in_window
from homography_servo.simulation.occluders import occluder_polygon
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.simulation.surfaces import NoiseStore
import numpy as np
import pytest
from scene_views import BENT
from scene_views import CAMERA
from scene_views import CLEAN
from scene_views import FACE_M
from scene_views import pose

CORNERS_PX = np.array([[200.0, 200.0], [300.0, 200.0], [300.0, 260.0], [200.0, 260.0]])


@pytest.mark.parametrize('time_s, once, again', [
    (0.9, False, False), (1.0, True, True), (1.4, True, True), (1.5, False, False),
    (3.2, False, True), (3.6, False, False), (5.0, False, True)])
def test_windows_open_once_or_every_period(time_s, once, again):
    assert in_window(time_s, 1.0, 0.5) is once
    assert in_window(time_s, 1.0, 0.5, 2.0) is again


def test_a_window_that_never_begins_never_opens():
    assert not any(in_window(time_s, -1.0, 5.0) for time_s in (-1.0, 0.0, 3.0))
    assert box_present(SceneSettings(), 5.0)
    assert not box_present(SceneSettings(box_visible=False), 5.0)


@pytest.mark.parametrize('index', range(4))
def test_the_corner_occluder_covers_its_corner_and_no_other(index):
    settings = SceneSettings(occluder='corner', occluder_index=index, occluder_start_s=0.0)
    polygon = occluder_polygon(settings, CORNERS_PX, 640, 0.5)
    distance = np.linalg.norm(CORNERS_PX - polygon.mean(axis=0), axis=1)
    radius = np.linalg.norm(polygon - polygon.mean(axis=0), axis=1).max()
    assert [d < radius for d in distance] == [i == index for i in range(4)]


def test_what_is_covered_takes_the_level_of_the_occluder_and_the_rest_stays():
    settings = replace(CLEAN, occluder='side', occluder_index=1, occluder_start_s=0.0,
                       occluder_level=130.0)
    before = Scene(CAMERA, FACE_M, 0.04, CLEAN).clean(pose())
    after = Scene(CAMERA, FACE_M, 0.04, settings).clean(pose(), 0.1)
    changed = before != after
    assert changed.any() and np.median(after[changed]) == 130.0
    assert (after[~changed] == before[~changed]).all()


def test_clutter_grows_with_its_amount_and_stands_still():
    counts = []
    for amount in (0.0, 0.3, 1.0):
        scene = Scene(CAMERA, FACE_M, 0.0, replace(CLEAN, clutter=amount), seed=2)
        counts.append(np.count_nonzero(scene.clean(None) != CLEAN.background_level))
        assert np.array_equal(scene.clean(None, 0.0), scene.clean(None, 9.0))
    assert counts[0] == 0 and 0 < counts[1] < counts[2]


def test_texture_has_the_strength_that_was_asked_for():
    scene = Scene(CAMERA, FACE_M, 0.0, replace(CLEAN, texture_grey=8.0, background_level=120.0))
    assert scene.clean(None).std() == pytest.approx(8.0, rel=0.02)


@pytest.mark.parametrize('camera', [CAMERA, BENT], ids=['straight', 'bent'])
def test_print_moves_with_the_face_and_leaves_its_margin_and_outline(camera):
    blank = Scene(camera, FACE_M, 0.0, CLEAN)
    printed = Scene(camera, FACE_M, 0.0, replace(CLEAN, print_contrast=120.0), seed=3)
    for view in (pose(turn=10.0), pose(0.1, 0.05, 0.9, 20.0, -20.0, 100.0)):
        difference = blank.clean(view) - printed.clean(view)
        rows, columns = np.nonzero(difference > 1.0)
        assert len(rows) > 200 and difference.min() > -1e-3
        # Where on the face does it lie? Through the plane's homography, in face units.
        rays = camera.rays(np.column_stack([columns, rows]).astype(float))
        plane = view[:3, [0, 1, 3]]
        on_face = np.linalg.solve(plane, np.column_stack([rays, np.ones(len(rays))]).T)
        on_face = (on_face[:2] / on_face[2]).T / np.array(FACE_M)
        assert np.abs(on_face).max() < 0.47


def test_the_gradient_is_one_in_the_middle_and_grows_along_its_direction():
    settings = replace(CLEAN, gradient=0.4, gradient_direction_rad=0.0)
    light = Scene(CAMERA, FACE_M, 0.0, settings).clean(None) / CLEAN.background_level
    assert light[:, 319:321].mean() == pytest.approx(1.0, abs=1e-6)
    assert light[0, -1] - light[0, 0] == pytest.approx(0.4, abs=0.002)
    assert np.allclose(light, light[:1])


def test_flicker_scales_the_whole_picture_and_comes_back():
    scene = Scene(CAMERA, FACE_M, 0.0, replace(CLEAN, flicker=0.2, flicker_hz=5.0))
    still = scene.clean(pose(), 0.0)
    assert np.allclose(scene.clean(pose(), 0.05), 1.2 * still, rtol=1e-5)
    assert np.allclose(scene.clean(pose(), 0.2), still, rtol=1e-5)


def test_the_shadow_darkens_only_the_background_beside_the_box():
    plain = Scene(CAMERA, FACE_M, 0.04, CLEAN).clean(pose(turn=20.0))
    shaded = Scene(CAMERA, FACE_M, 0.04, replace(CLEAN, shadow=0.6)).clean(pose(turn=20.0))
    darker = shaded < plain - 1.0
    assert darker.any() and shaded[darker].min() >= 0.39 * CLEAN.background_level
    assert (plain[darker] < CLEAN.face_level - 1.0).all()
    assert np.array_equal(shaded[plain == CLEAN.face_level], plain[plain == CLEAN.face_level])
    # The light falls to the right and down.
    rows, columns = np.nonzero(darker)
    assert columns.mean() > CAMERA.cx and rows.mean() > CAMERA.cy


def test_noise_is_unit_white_and_differs_from_frame_to_frame():
    store = NoiseStore(64, 48, np.random.default_rng(1))
    frames = np.array([store.frame(np.random.default_rng([1, i])) for i in range(200)])
    assert frames.std() == pytest.approx(1.0, abs=0.01) and abs(frames.mean()) < 0.01
    flat = frames.reshape(200, -1)
    between = np.corrcoef(flat[:40]) - np.eye(40)
    assert np.abs(between).max() < 6.0 / np.sqrt(flat.shape[1])
    beside = (frames[..., 1:] * frames[..., :-1]).mean()
    assert abs(beside) < 0.01


def test_bad_settings_are_named():
    with pytest.raises(ValueError, match='noise_grey must be in'):
        SceneSettings(noise_grey=-1.0)
    with pytest.raises(ValueError, match='occluder must be one of none, corner'):
        SceneSettings(occluder='fog')
    with pytest.raises(ValueError, match='side_levels must have 4 items'):
        SceneSettings(side_levels=(1.0, 2.0))
