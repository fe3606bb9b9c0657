"""The tracker node as users meet it: images in any shape, corners for every frame."""

import array

import cv2
import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402,I100
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from diagnostic_msgs.msg import KeyValue  # noqa: E402
from geometry_msgs.msg import PolygonStamped  # noqa: E402
from homography_servo.nodes.conversions import bgr_from_image  # noqa: E402
from homography_servo.nodes.conversions import image_path_msg  # noqa: E402
from homography_servo.nodes.kit import images_qos  # noqa: E402
from homography_servo.nodes.kit import LATCHED  # noqa: E402
from sensor_msgs.msg import CameraInfo  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

CORNERS_PX = np.array([[90.0, 80.0], [190.0, 84.0], [188.0, 144.0], [88.0, 140.0]])
CHANNELS = {'mono8': 1, 'bgr8': 3, 'rgb8': 3, 'bgra8': 4, 'rgba8': 4}


def picture(width=320, height=240, shift=0.0, noise=2.0, seed=0):
    """Draw a bright face with soft edges."""
    fine = 8
    canvas = np.full((height * fine, width * fine), 80, np.uint8)
    centres = (CORNERS_PX + shift + 0.5) * fine - 0.5
    cv2.fillPoly(canvas, [np.rint(centres).astype(np.int32)], 200)
    small = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA).astype(float)
    noisy = small + noise * np.random.default_rng(seed).standard_normal(small.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


class Camera:
    """Publishes pictures at a made-up 30 Hz and waits for the answers."""

    def __init__(self, probe):
        self.probe = probe
        self.corners = probe.record(PolygonStamped, 'object/corners')
        self.states = probe.record(String, 'snake_tracker/state', LATCHED)
        self.publisher = probe.publisher(Image, 'image', images_qos(True))
        probe.wait(lambda: self.states, 'no state')
        probe.wait(lambda: probe.node.count_publishers('object/corners'), 'no corners topic')
        probe.spin_for(0.3)
        self.index = 0

    def message(self, grey, encoding='mono8', padding=0, stamp=None):
        channels = CHANNELS[encoding]
        pixels = np.repeat(grey[:, :, None], channels, axis=2)
        rows = np.zeros((grey.shape[0], grey.shape[1] * channels + padding), np.uint8)
        rows[:, :grey.shape[1] * channels] = pixels.reshape(grey.shape[0], -1)
        data = array.array('B')
        data.frombytes(rows.tobytes())
        message = Image(height=grey.shape[0], width=grey.shape[1], encoding=encoding,
                        step=rows.shape[1], data=data)
        self.index += 1
        milliseconds = 1000000 + 33 * self.index if stamp is None else stamp
        message.header.stamp.sec = milliseconds // 1000
        message.header.stamp.nanosec = milliseconds % 1000 * 1000000
        message.header.frame_id = 'camera_optical'
        return message

    def show(self, message):
        """Publish one image and give the corners that come back for it."""
        before = len(self.corners)
        self.publisher.publish(message)
        self.probe.wait(lambda: len(self.corners) > before, 'no corners for an image', 5.0)
        answer = self.corners[-1]
        assert answer.header == message.header
        return np.array([(p.x, p.y) for p in answer.polygon.points]).reshape(-1, 2)

    def show_until_tracking(self, **kind):
        for _ in range(12):
            corners_px = self.show(self.message(picture(seed=self.index), **kind))
            if len(corners_px):
                return corners_px
        raise AssertionError(f'never tracking: {[state.data for state in self.states]}')


@pytest.fixture
def camera(start_node, probe):
    """Start the tracker for a face of 100 mm x 60 mm and give its camera."""
    node = start_node('snake_tracker', box_height_m=0.0, reliable_images=True,
                      image_timeout_s=20.0)
    made = Camera(probe)
    yield made
    assert node.stop() == 0, node.output
    assert 'Traceback' not in node.output


@pytest.mark.parametrize('encoding, padding', [('mono8', 0), ('bgr8', 7), ('rgba8', 1)])
def test_any_encoding_and_step_gives_the_same_corners(camera, encoding, padding):
    corners_px = camera.show_until_tracking(encoding=encoding, padding=padding)
    assert np.abs(corners_px - CORNERS_PX).max() < 0.35
    camera.probe.wait(lambda: camera.states[-1].data == 'TRACKING', 'state is not TRACKING')


def test_bad_images_are_counted_and_change_nothing(camera):
    camera.show_until_tracking()
    before = len(camera.corners)
    good = picture()
    for spoil in ({'data': array.array('B')}, {'step': 3}, {'encoding': '16UC1'}, {'width': 0},
                  {'height': 9999}, {'width': 4294967295, 'step': 4294967295}):
        message = camera.message(good)
        for name, value in spoil.items():
            setattr(message, name, value)
        camera.publisher.publish(message)
    camera.probe.spin_for(0.5)
    assert len(camera.corners) == before
    assert len(camera.show(camera.message(good))) == 4


def test_repeated_and_late_images_are_left_out(camera):
    camera.show_until_tracking()
    last_ms = 1000000 + 33 * camera.index
    before = len(camera.corners)
    for stamp in (last_ms, last_ms - 40, 0, last_ms + 3600000):
        camera.publisher.publish(camera.message(picture(shift=50.0), stamp=stamp))
    camera.probe.spin_for(0.5)
    assert len(camera.corners) == before
    assert len(camera.show(camera.message(picture()))) == 4


def test_a_new_image_size_starts_anew(camera):
    camera.show_until_tracking()
    larger = [camera.show(camera.message(picture(400, 300, seed=i))) for i in range(12)]
    assert len(larger[0]) == 0
    assert np.abs(larger[-1] - CORNERS_PX).max() < 0.35


def test_reset_forgets_and_a_vanished_face_is_reported_at_once(camera):
    camera.show_until_tracking()
    answer = camera.probe.call(Trigger, 'snake_tracker/reset')
    assert answer.success and answer.message
    assert len(camera.show(camera.message(picture()))) == 0
    camera.show_until_tracking()
    empty = np.full((240, 320), 80, np.uint8)
    assert len(camera.show(camera.message(empty))) == 0
    camera.probe.wait(lambda: camera.states[-1].data == 'COASTING', 'not coasting at once')
    for _ in range(3):
        camera.show(camera.message(empty))
    camera.probe.wait(lambda: camera.states[-1].data == 'LOST', 'not lost')


def test_annotated_image_only_on_demand_and_camera_info_is_used(camera):
    info = CameraInfo(width=320, height=240, distortion_model='plumb_bob',
                      d=[0.0] * 5, k=[800.0, 0.0, 159.5, 0.0, 800.0, 119.5, 0.0, 0.0, 1.0])
    camera.probe.publisher(CameraInfo, 'camera_info', images_qos(True)).publish(info)
    camera.show_until_tracking()
    assert camera.probe.node.count_publishers('snake_tracker/annotated_image') == 1
    pictures = camera.probe.record(Image, 'snake_tracker/annotated_image', images_qos(False))
    camera.probe.wait(lambda: camera.show(camera.message(picture())) is not None and pictures,
                      'no annotated image')
    assert (pictures[-1].encoding, pictures[-1].width) == ('bgr8', 320)


def test_the_annotated_image_shows_the_path_and_the_pose_aimed_at(camera):
    probe = camera.probe
    path_px = np.array([CORNERS_PX, CORNERS_PX + [60.0, 0.0], CORNERS_PX + [120.0, 30.0]])
    paths = probe.publisher(Float64MultiArray, 'path/image', LATCHED)
    paths.publish(image_path_msg(path_px))
    progress = probe.publisher(DiagnosticStatus, 'visual_servo/progress')
    pictures = probe.record(Image, 'snake_tracker/annotated_image', images_qos(False))
    camera.show_until_tracking()
    before, goal = path_px[1, 0] + [0, 30], path_px[2, 0] + [0, 30]

    def shown(place):
        camera.show(camera.message(picture()))
        if not pictures:
            return None
        u, v = (int(round(value)) for value in place)
        return bgr_from_image(pictures[-1])[v, u - 4:u + 5].astype(int)
    probe.wait(lambda: (found := shown(goal)) is not None and np.ptp(found, axis=0).max() > 60,
               'the goal is not drawn')
    assert np.ptp(shown(before), axis=0).max() < 60  # only noise there
    paths.publish(image_path_msg(path_px[:, :, :1]))  # useless: left out
    progress.publish(DiagnosticStatus(values=[KeyValue(key='pose', value='2')]))
    probe.wait(lambda: np.ptp(shown(before), axis=0).max() > 60, 'the target is not drawn')


def test_the_diagnostics_tell_rate_and_latency(camera):
    heard = camera.probe.record(DiagnosticArray, '/diagnostics')

    def told():
        stamp_ms = camera.probe.node.get_clock().now().nanoseconds // 1_000_000
        camera.show(camera.message(picture(), stamp=stamp_ms))
        return [item for msg in heard for status in msg.status for item in status.values
                if item.key == 'corners_latency_ms']
    found = camera.probe.wait(told, 'no latency in the diagnostics')
    assert 0.0 < float(found[-1].value) < 2000.0
    assert any(item.key == 'corners_rate_hz' and float(item.value) > 0.0
               for msg in heard for status in msg.status for item in status.values)


def test_without_images_the_state_is_lost(start_node, probe):
    node = start_node('snake_tracker', box_height_m=0.0, reliable_images=True)
    camera = Camera(probe)
    for _ in range(60):
        camera.publisher.publish(camera.message(picture(seed=camera.index)))
        probe.spin_for(0.03)
        if camera.states[-1].data == 'TRACKING':
            break
    assert camera.states[-1].data == 'TRACKING'
    probe.wait(lambda: camera.states[-1].data == 'LOST', 'still not lost', 2.0)
    assert node.stop() == 0
