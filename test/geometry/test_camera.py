"""Laws of the camera: round trips, derivatives, files, refusals; OpenCV as the second opinion."""

import cv2
from geometry_cases import BENT
from geometry_cases import PINHOLE
from homography_servo.errors import ConfigError
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.camera import camera_from_calibration
from homography_servo.geometry.camera import load_camera
from homography_servo.geometry.camera import save_camera
from homography_servo.result import Rejected
import numpy as np
import pytest
import yaml

RATIONAL = Camera(620.0, 600.0, 310.0, 250.0, 640, 480, 'rational_polynomial',
                  (0.3, -0.2, 0.001, -0.001, 0.05, 0.4, -0.1, 0.02))
FISHEYE = Camera(300.0, 310.0, 320.0, 240.0, 640, 480, 'equidistant', (0.01, -0.02, 0.003, 0.001))
CAMERAS = {'pinhole': PINHOLE, 'plumb_bob': BENT, 'rational': RATIONAL, 'fisheye': FISHEYE}
K = (800.0, 0.0, 320.0, 0.0, 790.0, 240.0, 0.0, 0.0, 1.0)


@pytest.fixture(params=CAMERAS.values(), ids=CAMERAS)
def camera(request):
    return request.param


@pytest.fixture
def pixels():
    rng = np.random.default_rng(4)
    return np.vstack([rng.uniform((0, 0), (639, 479), (200, 2)), [[319.5, 239.5], [320, 240]]])


def test_rays_undo_projection(camera, pixels):
    rays = camera.rays(pixels)
    assert camera.project_rays(rays) == pytest.approx(pixels, abs=1e-8)
    depth = np.linspace(0.3, 3.0, len(rays))[:, None]
    points = np.column_stack([rays * depth, depth])
    assert camera.project(points) == pytest.approx(pixels, abs=1e-8)


def test_jacobian_is_the_derivative(camera, pixels):
    rays, step = camera.rays(pixels), 1e-6
    for axis, offset in enumerate(step * np.eye(2)):
        difference_px = camera.project_rays(rays + offset) - camera.project_rays(rays - offset)
        assert camera.jacobian(rays)[..., axis] == pytest.approx(
            difference_px / (2.0 * step), rel=1e-6, abs=1e-4)


def test_a_few_rays_are_shown_as_many_are(camera, pixels):
    rays = np.vstack([camera.rays(pixels[:5]), [[0.0, 0.0], [8.0, -9.0]]])
    shown, slopes = camera.show(rays)
    assert shown == pytest.approx(camera.project_rays(rays), abs=1e-9)
    assert slopes == pytest.approx(camera.jacobian(rays), abs=1e-6)


@pytest.mark.parametrize('camera', [BENT, RATIONAL], ids=['plumb_bob', 'rational'])
def test_polynomial_lenses_agree_with_opencv(camera):
    points = np.random.default_rng(5).uniform((-0.4, -0.3, 1.0), (0.4, 0.3, 1.0), (50, 3))
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix,
                                  np.array(camera.distortion))
    assert camera.project(points) == pytest.approx(theirs[:, 0], abs=1e-9)


def test_the_fisheye_is_linear_in_the_angle_without_coefficients():
    camera = Camera(300.0, 300.0, 0.0, 0.0, 640, 480, 'equidistant', (0.0, 0.0, 0.0, 0.0))
    angle = np.linspace(0.0, 1.4, 8)
    rays = np.column_stack([np.tan(angle), np.zeros(8)])
    assert camera.project_rays(rays)[:, 0] == pytest.approx(300.0 * angle)


def test_points_behind_the_camera_are_infinitely_far(camera):
    pixels = camera.project([[0.1, 0.1, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.isinf(pixels[:2]).all()
    assert np.isfinite(pixels[2]).all()


def test_pixels_beyond_the_fold_of_a_lens_have_no_ray():
    barrel = Camera(400.0, 400.0, 320.0, 240.0, 640, 480, 'plumb_bob', (-0.4, 0.0, 0.0, 0.0, 0.0))
    assert np.isinf(barrel.rays([[5000.0, 240.0]])).all()
    assert not np.isnan(barrel.rays([[np.nan, 240.0]])).any()


def test_points_beyond_the_fold_of_a_lens_do_not_fold_into_the_image():
    barrel = Camera(400.0, 400.0, 320.0, 240.0, 640, 480, 'plumb_bob', (-0.4, 0.0, 0.0, 0.0, 0.0))
    points = np.column_stack([np.linspace(0.0, 1.6, 200), np.zeros(200), np.ones(200)])
    u = barrel.project(points)[:, 0]
    seen = np.isfinite(u)
    fold = np.sqrt(1.0 / 1.2)  # where 1 + 3 k1 r^2 = 0
    assert (np.diff(u[seen]) > 0.0).all()
    assert points[seen, 0].max() == pytest.approx(fold, abs=0.01)


def test_contains_counts_the_margin_from_the_outer_pixel_centres():
    corners = np.array([[0.0, 0.0], [639.0, 479.0], [-0.1, 5.0], [5.0, 479.1], [np.nan, 1.0]])
    assert PINHOLE.contains(corners).tolist() == [True, True, False, False, False]
    assert PINHOLE.contains([[9.0, 100.0], [10.0, 100.0]], 10.0).tolist() == [False, True]


def test_a_file_is_read_as_it_was_written(camera, tmp_path):
    save_camera(tmp_path / 'camera.yaml', camera, 'lab')
    assert load_camera(tmp_path / 'camera.yaml') == camera
    content = yaml.safe_load((tmp_path / 'camera.yaml').read_text())
    assert content['camera_name'] == 'lab'
    assert content['camera_matrix']['rows'] * content['camera_matrix']['cols'] == 9
    coefficients = content['distortion_coefficients']
    assert len(coefficients['data']) == coefficients['cols'] * coefficients['rows']
    assert len(content['projection_matrix']['data']) == 12


@pytest.mark.parametrize('old, new, line, key, reason', [
    ('image_width: 640', 'image_width: wide', 1, 'image_width', 'whole number'),
    ('image_width: 640', 'image_widht: 640', 0, 'image_width', 'is missing'),
    ('800.0', '0.0', 4, 'camera_matrix', 'not calibrated'),
    ('800.0', '.nan', 4, 'camera_matrix', 'finite'),
    ('plumb_bob', 'pincushion', 8, 'distortion_model', 'must be one of'),
    ('camera_matrix:', 'camera_matrix: [', 0, '', 'not YAML'),
])
def test_a_bad_file_is_named_with_line_key_and_reason(tmp_path, old, new, line, key, reason):
    path = tmp_path / 'camera.yaml'
    save_camera(path, PINHOLE)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError, match=reason) as caught:
        load_camera(path)
    assert (caught.value.file, caught.value.key) == (str(path), key)
    assert caught.value.line == line or not line


def test_a_missing_file_and_one_that_holds_a_list_are_named(tmp_path):
    with pytest.raises(ConfigError, match='cannot be read'):
        load_camera(tmp_path / 'nothing.yaml')
    (tmp_path / 'list.yaml').write_text('- 1\n- 2\n')
    with pytest.raises(ConfigError, match='keys and values'):
        load_camera(tmp_path / 'list.yaml')


def test_an_uncalibrated_camera_is_refused_in_a_sentence():
    refused = camera_from_calibration(640, 480, (0.0, *K[1:]))
    assert isinstance(refused, Rejected)
    assert 'not calibrated' in refused.reason and 'k[0]' in refused.reason


def test_calibrations_are_taken_or_refused_with_the_reason():
    assert camera_from_calibration(640, 480, K).matrix.ravel().tolist() == list(K)
    assert camera_from_calibration(640, 480, K, (), '').distortion == ()
    for change, reason in (((640, 480, K, (1, 2, 3)), 'coefficients'),
                           ((640, 480, K, (1.0,) * 5, 'magic'), 'must be one of'),
                           ((0, 480, K), 'size'),
                           ((640, 480, (800, 5.0, *K[2:])), 'skew'),
                           ((640, 480, (-800, *K[1:])), 'focal'),
                           ((640, 480, (np.nan, *K[1:])), 'finite')):
        refused = camera_from_calibration(*change)
        assert isinstance(refused, Rejected) and reason in refused.reason
    with pytest.raises(ValueError, match='9 numbers'):
        camera_from_calibration(640, 480, K[:8])


def test_wrong_shapes_name_the_shape_expected():
    for call, shape in ((PINHOLE.project, 3), (PINHOLE.rays, 2), (PINHOLE.contains, 2)):
        with pytest.raises(ValueError, match=rf'\(\.\.\., {shape}\), got \(4, 7\)'):
            call(np.zeros((4, 7)))
