"""A video file as a camera: every picture, its rate, its end, and what is not there."""

import cv2
from homography_servo.nodes.conversions import camera_from_info
from homography_servo.nodes.conversions import pixels_from_image
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.kit import images_qos
from homography_servo.result import Rejected
import numpy as np
import pytest
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image

FRAMES = 12
LEVELS = np.linspace(20.0, 230.0, FRAMES)


def write_video(path, size=(64, 48), rate_hz=25.0):
    """Write a video in which every picture has its own grey level."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), rate_hz, size)
    for level in LEVELS:
        writer.write(np.full((size[1], size[0], 3), round(level), np.uint8))
    writer.release()
    return str(path)


@pytest.fixture
def video(tmp_path):
    """Give the path of a short video."""
    return write_video(tmp_path / 'short.avi')


def numbers_of(images):
    """Tell which picture of the video each image is."""
    means = np.array([pixels_from_image(image).mean() for image in images])
    assert np.abs(LEVELS[:, None] - means).min(axis=0).max() < 5.0
    return list(np.abs(LEVELS[:, None] - means).argmin(axis=0))


def test_a_file_waits_for_a_subscriber_and_is_shown_once_and_whole(start_node, probe, video):
    node = start_node('video_camera', source=video, reliable_images=True)
    probe.wait(lambda: probe.node.count_publishers('image'), 'no publisher of image')
    probe.spin_for(0.5)
    images = probe.record(Image, 'image', images_qos(True))
    infos = probe.record(CameraInfo, 'camera_info', images_qos(True))
    probe.wait(lambda: len(images) >= FRAMES, 'some pictures are missing')
    assert node.wait() == 0
    probe.spin_for(0.1)
    assert numbers_of(images) == list(range(FRAMES))
    assert images[0].encoding == 'mono8' and images[0].header.frame_id == 'camera_optical'
    stamps_s = np.array([seconds_from_stamp(image.header.stamp) for image in images])
    assert np.median(np.diff(stamps_s)) == pytest.approx(1.0 / 25.0, abs=0.012)
    assert isinstance(camera_from_info(infos[-1]), Rejected)  # uncalibrated: k is zero
    assert (infos[-1].width, infos[-1].height) == (64, 48)


def test_a_loop_goes_on_at_the_wanted_rate_and_in_colour(start_node, probe, video):
    node = start_node('video_camera', source=video, loop=True, rate_hz=60.0, encoding='bgr8',
                      reliable_images=True)
    images = probe.record(Image, 'image', images_qos(True))
    probe.wait(lambda: len(images) >= 3 * FRAMES, 'the loop ends')
    assert pixels_from_image(images[0]).shape == (48, 64, 3)
    steps = np.diff(numbers_of(images)) % FRAMES
    assert np.mean(steps == 1) > 0.8  # a busy machine may lose some
    stamps_s = np.array([seconds_from_stamp(image.header.stamp) for image in images])
    assert np.median(np.diff(stamps_s)) == pytest.approx(1.0 / 60.0, abs=0.006)
    assert node.stop() == 0


def test_at_the_end_it_can_stay(start_node, probe, video):
    node = start_node('video_camera', source=video, on_end='stay', rate_hz=60.0,
                      reliable_images=True)
    every_one = QoSProfile(depth=2 * FRAMES, reliability=images_qos(True).reliability)
    images = probe.record(Image, 'image', every_one)
    probe.wait(lambda: len(images) >= FRAMES, 'some pictures are missing')
    probe.spin_for(0.5)
    assert node.process.poll() is None and len(images) == FRAMES
    assert node.stop() == 0


def test_the_calibration_is_published_only_if_it_is_for_this_size(start_node, probe, tmp_path):
    fitting = write_video(tmp_path / 'fitting.avi', (640, 480))
    start_node('video_camera', '--ros-args', '-r', 'camera_info:=fitting', '-r', 'image:=image_1',
               '-p', f'source:={fitting}', '-p', 'loop:=true', '-p', 'wait_for_subscriber:=false',
               '-p', 'camera_file:=teabox_640x480.yaml')
    other = write_video(tmp_path / 'other.avi')
    start_node('video_camera', '--ros-args', '-r', 'camera_info:=other', '-r', 'image:=image_2',
               '-p', f'source:={other}', '-p', 'loop:=true', '-p', 'wait_for_subscriber:=false',
               '-p', 'camera_file:=teabox_640x480.yaml', '-r', '__node:=other_camera')
    good = probe.record(CameraInfo, 'fitting', images_qos(False))
    bad = probe.record(CameraInfo, 'other', images_qos(False))
    probe.wait(lambda: good and bad, 'no camera_info')
    assert camera_from_info(good[-1]).fx == pytest.approx(839.2147)
    assert isinstance(camera_from_info(bad[-1]), Rejected)


@pytest.mark.parametrize('source', ['nowhere.mp4', '57'])
def test_what_is_not_there_ends_with_code_3_and_a_sentence(start_node, source):
    node = start_node('video_camera', '--ros-args', '-p', f"source:='{source}'")
    assert node.wait() == 3
    assert source in node.output and 'Traceback' not in node.output


def test_a_file_that_is_no_video_ends_with_code_3(start_node, tmp_path):
    (tmp_path / 'text.avi').write_text('this is no video')
    node = start_node('video_camera', source=str(tmp_path / 'text.avi'))
    assert node.wait() == 3
    assert 'cannot be opened' in node.output and 'Traceback' not in node.output


def test_a_damaged_video_ends_with_code_1(start_node, video):
    with open(video, 'rb') as file:
        content = bytearray(file.read())
    start = content.find(b'00dc')
    content[start:] = bytes(len(content) - start)
    with open(video, 'wb') as file:
        file.write(content)
    node = start_node('video_camera', source=video, wait_for_subscriber=False)
    assert node.wait() in (1, 3)
    assert 'Traceback' not in node.output
