"""The cameras inside this process: settings that change, and devices that are not there."""

import threading
import time

import cv2
from homography_servo.errors import ConfigError
from homography_servo.errors import HardwareError
from homography_servo.nodes import video_camera
from homography_servo.nodes.camera_sim import CameraSim
from homography_servo.nodes.conversions import grey_from_image
from homography_servo.nodes.conversions import joint_state_msg
from homography_servo.nodes.conversions import pixels_from_image
from homography_servo.nodes.conversions import points_from_polygon
from homography_servo.nodes.run import EXIT_HARDWARE
from homography_servo.nodes.run import EXIT_OK
from homography_servo.nodes.video_camera import VideoCamera
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np
import pytest
from rclpy.parameter import Parameter
from std_msgs.msg import Header

PICTURE = np.full((4, 6, 3), (250, 120, 10), np.uint8)


@pytest.fixture
def make(probe):
    """Give a function that makes a node in this process, with parameters."""
    made = []

    def start(kind, **parameters):
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = kind(context=probe.context, parameter_overrides=overrides)
        made.append(node)
        return node

    yield start
    for node in made:
        node.close()
        node.destroy_node()


def set_one(node, name: str, value):
    """Set a parameter and give the answer."""
    return node.set_parameters([Parameter(name, value=value)])[0]


def test_only_what_changes_the_scene_makes_it_anew(make):
    node = make(CameraSim)
    scene = node._scene
    for name, value in (('delay_s', 0.1), ('drop_share', 0.2), ('grip_error_m', [0.01, 0.0, 0.0]),
                        ('joint_zero_error_rad', [0.01] * 6)):
        assert set_one(node, name, value).successful, name
    assert node._scene is scene
    assert set_one(node, 'noise_grey', 7.0).successful
    assert node._scene is not scene and node._scene.settings.noise_grey == 7.0
    scene = node._scene
    assert set_one(node, 'focal_error', 0.1).successful
    assert node._scene.camera.fx == pytest.approx(1.1 * scene.camera.fx)


@pytest.mark.parametrize('name, value, reason', [
    ('joint_zero_error_rad', [0.1, 0.2], 'must have 6 items or none, got 2'),
    ('placement_error_m', [0.1], 'must have 3 items or none, got 1'),
    ('grip_error_rad', [9.0, 0.0, 0.0], 'must be in'),
    ('noise_grey', -1.0, ''),
    ('rate_hz', 60.0, 'read-only')])
def test_what_does_not_fit_is_refused_and_nothing_changes(make, name, value, reason):
    node = make(CameraSim)
    scene, errors = node._scene, node._arm.errors
    answer = set_one(node, name, value)
    assert not answer.successful and reason in answer.reason
    assert node._scene is scene and node._arm.errors == errors
    assert node._settings[SceneSettings] == SceneSettings()


def test_a_change_is_taken_as_a_whole_or_not_at_all(make):
    node = make(CameraSim)
    answer = node.set_parameters_atomically([
        Parameter('noise_grey', value=9.0), Parameter('joint_zero_error_rad', value=[0.1] * 5)])
    assert not answer.successful and node._scene.settings.noise_grey == 3.0


def centre_and_area(polygon: np.ndarray) -> tuple[np.ndarray, float]:
    """Compute centroid and area of a polygon (N, 2) by the shoelace formula."""
    following = np.roll(polygon, -1, axis=0)
    cross = polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1]
    centre = ((polygon + following) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())
    return centre, abs(cross.sum()) / 2.0


@pytest.mark.parametrize('errors', [
    {}, {'placement_error_m': [0.013, -0.021, 0.03], 'placement_error_rad': [0.02, 0.05, 0.1]},
    {'grip_error_m': [0.004, 0.002, -0.003], 'grip_error_rad': [0.05, -0.1, 0.2]},
    {'joint_zero_error_rad': [0.02, -0.01, 0.03, 0.02, -0.05, 0.01], 'focal_error': 0.05}],
    ids=['none', 'placement', 'grip', 'joints'])
def test_the_picture_shows_the_face_where_the_truth_says(make, probe, errors):
    node = make(CameraSim, noise_grey=0.0, background_level=50.0, side_levels=[50.0] * 4,
                face_level=250.0, **errors)
    images, corners = published(node), []
    node._true_corners = type('Out', (), {'publish': staticmethod(corners.append),
                                          'get_subscription_count': staticmethod(lambda: 1)})
    names = node._arm.robot.joint_names
    for joints_deg in ((-20, 40, 10, -10, 0, -20), (-5, 35, 20, -25, 8, 10)):
        node._on_joints(joint_state_msg(names, np.radians(joints_deg), Header()))
        node._expose()
        bright = (grey_from_image(images[-1]).astype(float) - 50.0) / 200.0
        centre_px, area_px2 = centre_and_area(points_from_polygon(corners[-1]))
        rows, columns = np.indices(bright.shape)
        seen_px = np.array([(bright * columns).sum(), (bright * rows).sum()]) / bright.sum()
        assert seen_px == pytest.approx(centre_px, abs=0.01)
        assert bright.sum() == pytest.approx(area_px2, rel=1e-3)
    assert node.counts['internal_errors'] == 0


class FakeDevice:
    """A camera that gives pictures at a rate until it is told to stop."""

    opened = 0

    def __init__(self, source, rate_hz: float = 200.0) -> None:
        type(self).opened += 1
        self.rate_hz, self.broken = rate_hz, threading.Event()
        self.released = False

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def set(self, what, value) -> bool:
        return True

    def get(self, what) -> float:
        return 0.0

    def grab(self) -> bool:
        time.sleep(1.0 / self.rate_hz)
        return not self.broken.is_set()

    def retrieve(self):
        return True, PICTURE

    def release(self) -> None:
        self.released = True


@pytest.fixture
def device(monkeypatch):
    """Put a camera in place of /dev/video7."""
    exists = video_camera.Path.exists
    monkeypatch.setattr(FakeDevice, 'opened', 0)
    monkeypatch.setattr(cv2, 'VideoCapture', FakeDevice)
    monkeypatch.setattr(video_camera.Path, 'exists',
                        lambda path: True if str(path) == '/dev/video7' else exists(path))


def published(node) -> list:
    """Collect what a node publishes as image."""
    images = []
    node._image = type('Out', (), {'publish': staticmethod(images.append)})
    return images


@pytest.mark.parametrize('source', ['7', '/dev/video7'])
def test_a_device_is_read_at_the_wanted_rate_and_in_the_wanted_encoding(
        make, probe, device, source):
    node = make(VideoCamera, source=source, rate_hz=50.0, encoding='bgr8', frame_id='eye')
    images = published(node)
    probe.wait(lambda: len(images) >= 20, 'no pictures')
    assert np.array_equal(pixels_from_image(images[-1]), PICTURE)
    assert images[-1].encoding == 'bgr8' and images[-1].header.frame_id == 'eye'
    stamps_s = np.array([i.header.stamp.sec + 1e-9 * i.header.stamp.nanosec for i in images])
    assert np.diff(stamps_s).min() > 0.0
    assert np.diff(stamps_s).mean() > 0.9 / 50.0  # not faster; a busy machine may be slower
    node.close()
    assert node._capture.released


def test_a_device_that_was_unplugged_is_opened_again(make, probe, device, monkeypatch):
    monkeypatch.setattr(video_camera, 'REOPEN_S', 0.3)
    node = make(VideoCamera, source='7')
    images = published(node)
    probe.wait(lambda: images, 'no pictures')
    node._capture.broken.set()
    probe.wait(lambda: node.counts['reopened'], 'it is not opened again')
    count = len(images)
    probe.wait(lambda: len(images) > count, 'no pictures afterwards')
    assert FakeDevice.opened == 2 and node.exit_code is None


@pytest.mark.parametrize('encoding, pixels, shape', [
    ('mono8', PICTURE, (4, 6)), ('mono8', PICTURE[..., 0], (4, 6)),
    ('bgr8', PICTURE, (4, 6, 3)), ('bgr8', PICTURE[..., 0], (4, 6, 3))])
def test_pictures_go_out_in_the_encoding_that_was_asked_for(
        make, probe, device, encoding, pixels, shape):
    node = make(VideoCamera, source='7', encoding=encoding)
    node.close()
    images = published(node)
    node._publish(np.ascontiguousarray(pixels), probe.stamp())
    assert images[-1].encoding == encoding
    assert pixels_from_image(images[-1]).shape == shape


def test_colours_keep_their_order_and_grey_weighs_them(make, probe, device):
    node = make(VideoCamera, source='7', encoding='mono8')
    node.close()
    images = published(node)
    node._publish(PICTURE, probe.stamp())
    # ITU-R BT.601: 0.114 blue + 0.587 green + 0.299 red.
    assert pixels_from_image(images[-1])[0, 0] == pytest.approx(
        0.114 * 250 + 0.587 * 120 + 0.299 * 10, abs=1.0)


@pytest.mark.parametrize('source, words', [
    ('57', '/dev/video57 does not exist'), ('/dev/video57', '/dev/video57 does not exist'),
    ('nowhere.mp4', 'no video file nowhere.mp4'), ('', 'no video file'), ('²', 'no video file')])
def test_what_is_not_there_is_named(make, source, words):
    with pytest.raises(HardwareError, match=words):
        make(VideoCamera, source=source)


def test_a_calibration_that_is_not_there_is_named(make, device):
    with pytest.raises(ConfigError, match='camera_file'):
        make(VideoCamera, source='7', camera_file='no_such.yaml')


@pytest.fixture
def clip(tmp_path):
    """Give the path of a video of three pictures."""
    path = tmp_path / 'clip.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), 25.0, (64, 48))
    for level in (50, 100, 150):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    return path


def test_a_file_that_goes_away_while_it_loops_ends_with_code_3(make, clip):
    node = make(VideoCamera, source=str(clip), loop=True, wait_for_subscriber=False)
    images = published(node)
    for _ in range(4):
        node._next_of_file()
    assert len(images) == 4 and node.counts['loops'] == 1 and node.exit_code is None
    clip.unlink()
    for _ in range(4):
        node._next_of_file()
    assert node.exit_code == EXIT_HARDWARE and len(images) == 6


def test_the_end_may_be_reconsidered(make, clip):
    node = make(VideoCamera, source=str(clip), on_end='stay', wait_for_subscriber=False)
    images = published(node)
    for _ in range(6):
        node._next_of_file()
    assert len(images) == 3 and node.exit_code is None
    assert set_one(node, 'on_end', 'exit').successful
    node._next_of_file()
    assert node.exit_code == EXIT_OK
