"""The rendered picture has its edges where the truth says."""

from dataclasses import replace

import cv2
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np
import pytest
from scene_views import BENT
from scene_views import CAMERA
from scene_views import CLEAN
from scene_views import FACE_M
from scene_views import pose
from scene_views import random_pose
from scipy.stats import norm


def edge_offset_px(image: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    """
    Measure how far an edge lies inside of the line through two corners.

    The grey levels summed along a normal tell how far the bright side reaches.
    """
    along = (second - first) / np.linalg.norm(second - first)
    inwards = np.array([-along[1], along[0]])
    reach = np.arange(-8.0, 8.0, 0.05) + 0.025
    middles = first + np.linspace(0.25, 0.75, 200)[:, None] * (second - first)
    points = middles[:, None] + reach[:, None] * inwards
    levels = cv2.remap(image, points[..., 0].astype(np.float32),
                       points[..., 1].astype(np.float32), cv2.INTER_LINEAR)
    bright = (levels - 50.0) / 150.0
    return 8.0 - float(bright.sum(axis=1).mean() * 0.05)


def test_edges_lie_on_the_analytic_lines_to_a_hundredth_of_a_pixel():
    scene, rng = Scene(CAMERA, FACE_M, 0.0, CLEAN), np.random.default_rng(5)
    offsets = []
    for _ in range(40):
        camera_from_object = random_pose(rng)
        image, corners_px = scene.clean(camera_from_object), scene.corners(camera_from_object)
        offsets += [edge_offset_px(image.astype(np.float32), corners_px[i],
                                   corners_px[(i + 1) % 4]) for i in range(4)]
    assert np.abs(np.mean(offsets)) < 0.003
    assert np.abs(offsets).max() < 0.01


@pytest.mark.parametrize('blur_px', [0.0, 0.8, 2.0])
@pytest.mark.parametrize('camera', [CAMERA, BENT], ids=['straight', 'bent'])
def test_blur_keeps_area_and_centroid(camera, blur_px):
    settings = replace(CLEAN, blur_px=blur_px)
    camera_from_object = pose(0.05, -0.03, 0.7, 20.0, -15.0, 33.0)
    sharp = Scene(camera, FACE_M, 0.0, CLEAN).clean(camera_from_object).astype(float) - 50.0
    soft = Scene(camera, FACE_M, 0.0, settings).clean(camera_from_object).astype(float) - 50.0
    assert soft.sum() == pytest.approx(sharp.sum(), rel=1e-4)
    for axis in (0, 1):
        weights = np.indices(sharp.shape)[axis]
        assert (soft * weights).sum() / soft.sum() == pytest.approx(
            (sharp * weights).sum() / sharp.sum(), abs=2e-3)


def test_true_corners_are_the_projected_corners():
    scene = Scene(BENT, FACE_M, 0.04)
    camera_from_object = random_pose(np.random.default_rng(8))
    points_m = np.array([[-0.05, -0.03, 0], [0.05, -0.03, 0], [0.05, 0.03, 0], [-0.05, 0.03, 0]])
    in_camera = points_m @ camera_from_object[:3, :3].T + camera_from_object[:3, 3]
    frame = scene.render(camera_from_object)
    assert frame.true_corners_px == pytest.approx(BENT.project(in_camera), abs=1e-9)


def test_pictures_repeat_with_seed_and_index_and_differ_otherwise():
    camera_from_object = pose()
    first = Scene(CAMERA, FACE_M, 0.04, seed=4).render(camera_from_object, 0.5, 7).image_grey
    again = Scene(CAMERA, FACE_M, 0.04, seed=4).render(camera_from_object, 0.5, 7).image_grey
    assert np.array_equal(first, again)
    for seed, index in ((5, 7), (4, 8)):
        other = Scene(CAMERA, FACE_M, 0.04, seed=seed).render(camera_from_object, 0.5, index)
        assert not np.array_equal(first, other.image_grey)


@pytest.mark.parametrize('camera', [CAMERA, BENT], ids=['straight', 'bent'])
def test_without_noise_a_picture_is_the_rounded_clean_one(camera):
    settings = SceneSettings(noise_grey=0.0, shadow=0.5, clutter=0.5, gradient=0.3, flicker=0.2,
                             print_contrast=80.0, occluder='side')
    scene, rng = Scene(camera, FACE_M, 0.04, settings), np.random.default_rng(2)
    for time_s in (0.31, 1.7):
        camera_from_object = random_pose(rng)
        picture = scene.render(camera_from_object, time_s).image_grey
        clean = np.clip(scene.clean(camera_from_object, time_s), 0.0, 255.0)
        assert np.abs(picture - clean.astype(float)).max() < 0.5 + 1e-3


def test_noise_has_the_strength_that_was_asked_for():
    for sigma in (0.0, 3.0, 10.0):
        scene = Scene(CAMERA, FACE_M, 0.0, SceneSettings(noise_grey=sigma))
        noise = scene.render(None).image_grey.astype(float) - scene.clean(None)
        assert noise.std() == pytest.approx(np.hypot(sigma, 0.29), abs=0.3)
        assert abs(noise.mean()) < 0.5


def test_sides_appear_when_the_box_is_tilted_and_hide_behind_the_face():
    scene = Scene(CAMERA, FACE_M, 0.04)
    faces = {tilt: {outline.face for outline in scene.layers(pose(tilt_y=tilt)).faces}
             for tilt in (-40.0, 0.0, 40.0)}
    assert faces[0.0] == {0} and len(faces[40.0]) == 2 and len(faces[-40.0]) == 2
    assert faces[40.0] != faces[-40.0]


def test_a_vanished_box_leaves_only_the_background():
    settings = SceneSettings(vanish_start_s=1.0, vanish_duration_s=0.5)
    scene = Scene(CAMERA, FACE_M, 0.04, settings)
    assert scene.render(pose(), 0.9).true_corners_px is not None
    gone = scene.render(pose(), 1.2)
    assert gone.true_corners_px is None and gone.true_camera_from_object is None
    assert gone.image_grey.max() < 130
    assert scene.render(pose(), 1.6).true_corners_px is not None


@pytest.mark.parametrize('occluder', ['corner', 'side', 'sweep'])
def test_occluders_cover_the_face_while_they_are_there(occluder):
    settings = SceneSettings(occluder=occluder, occluder_start_s=1.0, occluder_duration_s=1.0)
    scene = Scene(CAMERA, FACE_M, 0.0, settings)
    bright = [np.count_nonzero(scene.clean(pose(), time_s) > 150) for time_s in (0.5, 1.5, 2.5)]
    assert bright[1] < bright[0] - 200 and bright[2] == bright[0]


def test_a_pose_behind_or_outside_shows_the_background():
    scene = Scene(CAMERA, FACE_M, 0.04)
    background = scene.clean(None)
    for away in (pose(z=-0.5), pose(x=5.0), pose(z=0.001)):
        picture = scene.clean(away)
        assert np.isfinite(picture).all()
        if away[2, 3] != 0.001:
            assert np.array_equal(picture, background)


@pytest.mark.parametrize('blur_px', [0.4, 0.6, 1.0, 2.0])
def test_blurred_edges_have_the_profile_of_a_gaussian_lens(blur_px):
    """A pixel collects the Gaussian-blurred step over its own width, wherever it lies."""
    scene = Scene(CAMERA, (0.3, 0.2), 0.0, replace(CLEAN, blur_px=blur_px))
    columns = np.arange(CAMERA.width)
    for shift_px in np.linspace(0.0, 1.0, 11):
        camera_from_object = pose(shift_px * 0.75 / CAMERA.fx)
        edge_px = scene.corners(camera_from_object)[0, 0]
        row = scene.clean(camera_from_object)[CAMERA.height // 2]
        near = np.abs(columns - edge_px) < 9.0
        ends = columns[near][:, None] - edge_px + (-0.5, 0.5)
        collected = ends * norm.cdf(ends / blur_px) + blur_px * norm.pdf(ends / blur_px)
        expected = 50.0 + 150.0 * np.diff(collected, axis=1)[:, 0]
        assert row[near] == pytest.approx(expected, abs=0.015 * 150.0)
