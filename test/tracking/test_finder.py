"""The face is found without being told where it is."""

import math
from types import SimpleNamespace

import cv2
from face_views import BENT
from face_views import CAMERA
from face_views import FACE_M
from face_views import pose
from homography_servo.result import Rejected
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking import finder
from homography_servo.tracking.detection.edge_search import EdgeSearch
from homography_servo.tracking.detection.edge_search import QUICK
from homography_servo.tracking.detection.edge_search import SURE_ODDS
from homography_servo.tracking.detection.region_quads import list_quads
from homography_servo.tracking.finder import find_face
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.target import Target
import numpy as np
import pytest

TARGET = Target(FACE_M, 0.04, 0.15, 1.5, 0, 0.6)
PLANE = Plane(CAMERA)


def random_pose(rng):
    return pose(*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.55, 1.0), *rng.uniform(-30, 30, 2),
                rng.uniform(-60, 60))


def found_share(settings, count, plane=PLANE, seed=0, random_pose=random_pose):
    """Look at random views; corners must come in the right order."""
    rng, found = np.random.default_rng(seed), 0
    for number in range(count):
        scene = Scene(CAMERA, FACE_M, 0.04, settings, seed + number)
        frame = scene.render(random_pose(rng), 0.0, number)
        face = find_face(frame.image_grey, TARGET, plane)
        if not isinstance(face, Rejected):
            found += np.abs(face.fit.corners - frame.true_corners_px).max() < 3.0
    return found / count


def test_the_face_is_found_in_an_empty_world():
    assert found_share(SceneSettings(shadow=0.4), 15) == 1.0


def test_the_face_is_found_among_other_things():
    assert found_share(SceneSettings(clutter=1.0), 40) >= 0.9


def test_what_is_found_is_weighed_against_what_is_elsewhere():
    frame = Scene(CAMERA, FACE_M, 0.04, SceneSettings()).render(pose(tilt_x=25.0), 0.0, 0)
    edges = EdgeSearch(frame.image_grey, TARGET, PLANE)
    found = edges.best(QUICK)
    corners = found.fit.corners
    assert found.merit > SURE_ODDS
    assert edges.odds_elsewhere(corners) < found.merit
    assert edges.odds_elsewhere(corners + 50.0) == found.merit


@pytest.mark.parametrize('here, elsewhere, taken', [
    (SURE_ODDS, -math.inf, True), (SURE_ODDS, 3.0 * SURE_ODDS, False),
    (-SURE_ODDS, -math.inf, False)],
    ids=['likely', 'another thing is likelier', 'unlikely'])
def test_what_regions_show_is_weighed_with_the_edges(monkeypatch, here, elsewhere, taken):
    shown = finder.find_by_regions(
        Scene(CAMERA, FACE_M, 0.04, SceneSettings()).render(pose(tilt_x=25.0)).image_grey,
        TARGET, PLANE)
    doubtful = shown._replace(merit=0.5 * (finder.LEAST_SCORE + finder.CONVINCING))
    monkeypatch.setattr(finder, 'find_by_regions', lambda *_: doubtful)
    monkeypatch.setattr(finder, 'EdgeSearch', lambda *_: SimpleNamespace(
        best=lambda effort: Rejected('nothing'), odds=lambda corners: here,
        odds_elsewhere=lambda corners: elsewhere))
    face = find_face(np.zeros((480, 640), np.uint8), TARGET, PLANE)
    assert isinstance(face, Rejected) != taken


def frontal_pose(rng):
    return pose(*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.55, 1.0), *rng.uniform(-3, 3, 2),
                rng.uniform(-60, 60))


def test_a_face_seen_from_the_front_is_found_among_other_things():
    assert found_share(SceneSettings(clutter=1.0), 40, seed=5, random_pose=frontal_pose) >= 0.9


def steep_pose(rng):
    tilt = rng.permutation([rng.uniform(45, 55) * rng.choice([-1, 1]), rng.uniform(-10, 10)])
    return pose(*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.7, 1.0), *tilt, rng.uniform(-60, 60))


def test_a_printed_face_is_found_by_the_side_of_its_box():
    """The side is blank and taken for the face, which the print breaks up."""
    settings = SceneSettings(print_contrast=100.0, noise_grey=5.0)
    assert found_share(settings, 30, seed=91, random_pose=steep_pose) >= 0.93


def test_a_camera_nobody_calibrated_will_do():
    assert found_share(SceneSettings(), 10, Plane(None)) >= 0.9


@pytest.mark.parametrize('turn', [-80.0, -20.0, 0.0, 45.0, 80.0])
def test_without_a_hint_the_turn_nearest_to_zero_is_taken(turn):
    frame = Scene(CAMERA, FACE_M, 0.0, SceneSettings()).render(pose(turn=turn), 0.0, 0)
    face = find_face(frame.image_grey, TARGET._replace(box_height_m=0.0), PLANE)
    assert np.abs(face.fit.corners - frame.true_corners_px).max() < 0.3


@pytest.mark.parametrize('roll', [0, 1, 2, 3])
def test_a_hint_decides_the_turn_as_far_as_the_proportions_allow(roll):
    frame = Scene(CAMERA, FACE_M, 0.0, SceneSettings()).render(pose(turn=30.0), 0.0, 0)
    hint = np.roll(frame.true_corners_px, roll, axis=0)
    face = find_face(frame.image_grey, TARGET._replace(box_height_m=0.0), PLANE, hint)
    order = [0, 2] if roll % 2 else [roll]
    assert min(np.abs(face.fit.corners - np.roll(frame.true_corners_px, turn, axis=0)).max()
               for turn in order) < 0.3


def test_a_square_out_of_proportion_or_out_of_reach_is_not_the_face():
    image = np.full((480, 640), 80, np.uint8)
    image[100:300, 100:300] = 200
    assert isinstance(find_face(image, TARGET._replace(box_height_m=0.0), PLANE), Rejected)
    frame = Scene(CAMERA, FACE_M, 0.0, SceneSettings()).render(pose(turn=5.0), 0.0, 0)
    near = TARGET._replace(box_height_m=0.0, nearest_m=1.0)
    assert isinstance(find_face(frame.image_grey, near, PLANE), Rejected)


def test_quadrilaterals_come_clockwise_and_once():
    frame = Scene(CAMERA, FACE_M, 0.0, SceneSettings()).render(pose(turn=5.0), 0.0, 0)
    quads = list_quads(frame.image_grey, 500.0)
    edge = np.roll(quads, -1, axis=1) - quads
    after = np.roll(edge, -1, axis=1)
    assert (edge[..., 0] * after[..., 1] - edge[..., 1] * after[..., 0] > 0.0).all()
    assert min(np.abs(np.roll(quad, roll, axis=0) - frame.true_corners_px).max()
               for quad in quads for roll in range(4)) < 4.0
    assert list_quads(np.zeros((480, 640), np.uint8), 500.0).shape == (0, 4, 2)


def test_a_side_before_something_as_bright_follows_from_the_others():
    frame = Scene(CAMERA, FACE_M, 0.0, SceneSettings()).render(
        pose(tilt_x=-35.0, tilt_y=20.0, turn=12.0), 0.0, 0)
    first, second = frame.true_corners_px[1:3]
    middle, edge = 0.5 * (first + second), second - first
    outwards = np.array([edge[1], -edge[0]])
    behind = np.array([middle - 0.2 * edge, middle - 0.2 * edge + 0.8 * outwards,
                       middle + 0.3 * edge + 0.6 * outwards, middle + 0.2 * edge])
    image = frame.image_grey.copy()
    cv2.fillPoly(image, [np.rint(behind).astype(np.int32)], 200)
    face = find_face(image, TARGET._replace(box_height_m=0.0), PLANE)
    assert np.abs(face.fit.corners - frame.true_corners_px).max() < 2.0


@pytest.mark.parametrize('settings, least', [
    (SceneSettings(noise_grey=10.0), 1.0), (SceneSettings(gradient=0.5), 1.0),
    (SceneSettings(face_level=40.0, background_level=150.0), 0.9),
    (SceneSettings(blur_px=2.0), 1.0), (SceneSettings(print_contrast=100.0), 1.0)],
    ids=['noise', 'gradient', 'dark face', 'blur', 'print'])
def test_the_face_is_found_whatever_it_looks_like(settings, least):
    assert found_share(settings, 10) >= least


@pytest.mark.parametrize('polarity, found', [(1, True), (-1, False)])
def test_polarity_is_heeded(polarity, found):
    frame = Scene(CAMERA, FACE_M, 0.04, SceneSettings()).render(pose(tilt_x=20.0), 0.0, 0)
    face = find_face(frame.image_grey, TARGET._replace(polarity=polarity), PLANE)
    assert isinstance(face, Rejected) != found


def test_a_lens_that_bends_does_not_hide_the_face():
    scene = Scene(BENT, FACE_M, 0.04, SceneSettings())
    frame = scene.render(pose(x=0.2, y=0.12, tilt_x=25.0, tilt_y=15.0), 0.0, 0)
    plane = Plane(BENT)
    face = find_face(frame.image_grey, TARGET, plane)
    assert np.abs(plane.to_image(face.fit.corners) - frame.true_corners_px).max() < 1.0


@pytest.mark.parametrize('shape', [(480, 640), (8, 8), (1, 1), (17, 40)])
def test_an_image_without_edges_has_no_face(shape):
    for plane in (PLANE, Plane(None)):
        assert isinstance(find_face(np.full(shape, 90, np.uint8), TARGET, plane), Rejected)


def test_noise_alone_is_no_face():
    image = np.random.default_rng(3).integers(0, 256, (480, 640), np.uint8)
    assert isinstance(find_face(image, TARGET, PLANE), Rejected)
