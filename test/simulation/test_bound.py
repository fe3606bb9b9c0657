"""The bound of the corners is the information that the pictures really hold."""

from dataclasses import replace

from homography_servo.result import Rejected
from homography_servo.simulation.bound import corner_bound
from homography_servo.simulation.bound import corner_slopes
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np
import pytest
from scene_views import BENT
from scene_views import CAMERA
from scene_views import FACE_M
from scene_views import pose
from scipy.spatial.transform import Rotation

VIEW = pose(0.04, -0.02, 0.75, 15.0, -10.0, 25.0)


def region_of(scene, camera_from_object):
    """Give the part of the picture that `corner_slopes` speaks of."""
    return scene.region(scene.layers(camera_from_object).points_px).slices


@pytest.mark.parametrize('camera', [CAMERA, BENT], ids=['straight', 'bent'])
def test_slopes_predict_how_the_picture_changes_when_the_face_moves(camera):
    scene = Scene(camera, FACE_M, 0.0, SceneSettings())
    slopes = corner_slopes(scene, VIEW)
    for axis in range(6):
        step = np.eye(4)
        if axis < 3:
            step[axis, 3] = 2e-5
        else:
            step[:3, :3] = Rotation.from_rotvec(1e-3 * np.eye(3)[axis - 3]).as_matrix()
        ahead, behind = VIEW @ step, VIEW @ np.linalg.inv(step)
        corners_px = (scene.corners(ahead) - scene.corners(behind)).ravel()
        change = (scene.clean(ahead).astype(float) - scene.clean(behind))[region_of(scene, VIEW)]
        predicted = np.tensordot(corners_px, slopes, 1)
        assert np.linalg.norm(change - predicted) < 0.02 * np.linalg.norm(change)


def test_the_best_estimator_has_the_covariance_of_the_bound():
    """Linear in the small noise, maximum likelihood meets the bound; chi square says so."""
    scene = Scene(CAMERA, FACE_M, 0.04, SceneSettings(noise_grey=4.0, gradient=0.3))
    slopes = corner_slopes(scene, VIEW).reshape(8, -1)
    bound = corner_bound(scene, VIEW)
    clean, region = scene.clean(VIEW).astype(float), region_of(scene, VIEW)
    estimate = np.linalg.pinv(slopes.T)
    errors = np.array([estimate @ (scene.render(VIEW, 0.0, i).image_grey - clean)[region].ravel()
                       for i in range(250)])
    chi2 = np.einsum('ni,ij,nj->n', errors, np.linalg.inv(bound), errors)
    # 8 degrees of freedom: the mean of 250 has a standard deviation of 0.25.
    assert chi2.mean() == pytest.approx(8.0, abs=1.0)
    sigma = np.sqrt(np.diag(bound) / len(errors))
    assert (np.abs(errors.mean(axis=0)) < 4.5 * sigma).all()


def test_bound_grows_with_noise_and_shrinks_with_contrast():
    scene = Scene(CAMERA, FACE_M, 0.0, SceneSettings(noise_grey=5.0))
    bound = corner_bound(scene, VIEW)
    assert np.linalg.eigvalsh(bound).min() > 0.0
    twice = corner_bound(scene, VIEW, noise_grey=10.0)
    assert np.trace(twice) / np.trace(bound) == pytest.approx(4.0, rel=0.01)
    settings = scene.settings
    halfway = 0.5 * (settings.face_level + settings.background_level)
    faint = Scene(CAMERA, FACE_M, 0.0, replace(settings, face_level=halfway))
    assert np.trace(corner_bound(faint, VIEW)) / np.trace(bound) == pytest.approx(4.0, rel=0.01)


def test_print_adds_no_information_and_what_hides_a_corner_takes_it_away():
    blank = Scene(CAMERA, FACE_M, 0.0, SceneSettings())
    printed = Scene(CAMERA, FACE_M, 0.0, SceneSettings(print_contrast=100.0))
    assert np.trace(corner_bound(printed, VIEW)) == pytest.approx(
        np.trace(corner_bound(blank, VIEW)), rel=0.05)
    hiding = Scene(CAMERA, FACE_M, 0.0, SceneSettings(occluder='corner', occluder_index=2))
    bound, hidden = corner_bound(blank, VIEW), corner_bound(hiding, VIEW, 1.5)
    worse = np.diag(hidden) / np.diag(bound)
    assert worse[4:6].min() > 2.0 and worse[:2].max() < 1.5


def test_light_that_flickers_changes_the_information_by_its_square():
    scene = Scene(CAMERA, FACE_M, 0.0, SceneSettings(flicker=0.5, flicker_hz=1.0))
    bright, dark = (np.trace(corner_bound(scene, VIEW, time_s)) for time_s in (0.25, 0.75))
    assert dark / bright == pytest.approx(9.0, rel=1e-6)


def test_a_face_that_is_cut_or_turned_away_has_no_bound():
    scene = Scene(CAMERA, FACE_M)
    for camera_from_object in (pose(x=0.3), pose(tilt_x=180.0), pose(x=3.0)):
        assert isinstance(corner_bound(scene, camera_from_object), Rejected)
    hidden = Scene(CAMERA, FACE_M, 0.0, SceneSettings(face_level=75.0))
    assert isinstance(corner_bound(hidden, VIEW), Rejected)
