"""A webcam or a video file as `image` and `camera_info`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import threading
import time

import cv2
from homography_servo.errors import ConfigError
from homography_servo.errors import HardwareError
from homography_servo.geometry.camera import load_camera
from homography_servo.nodes.conversions import camera_info_msg
from homography_servo.nodes.conversions import image_msg
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import images_qos
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import WARN
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.run import EXIT_FAILED
from homography_servo.nodes.run import EXIT_OK
from homography_servo.nodes.run import run_node
from homography_servo.places import find_config
from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import text
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Header

DEFAULT_RATE_HZ = 30.0
FASTEST_HZ = 1000.0
REOPEN_S = 2.0
SETTLE_S = 0.5


@dataclass(frozen=True)
class VideoCameraSettings(Settings):
    """Where the pictures come from, and how they go out."""

    source: str = text('0', 'number of a camera device, or path of a video file', read_only=True)
    camera_file: str = text('', 'calibration in camera_info format; empty: camera_info says '
                            'uncalibrated', read_only=True)
    rate_hz: float = real(0.0, 0.0, FASTEST_HZ, 'Hz', 'pictures per second; 0 is the rate of '
                          'the file or device', read_only=True)
    loop: bool = flag(False, 'begin a file again at its end')
    on_end: str = text('exit', 'what to do at the end of a file', choices=('exit', 'stay'))
    wait_for_subscriber: bool = flag(True, 'show a file only when somebody subscribes to image',
                                     read_only=True)
    encoding: str = text('mono8', 'encoding of the images', choices=('mono8', 'bgr8'),
                         read_only=True)
    reliable_images: bool = flag(False, 'send every image until it is received', read_only=True)
    frame_id: str = text('camera_optical', 'frame of the images', read_only=True)


class VideoCamera(NodeKit, Node):
    """Publish a webcam or a video file as a camera."""

    NAME = 'video_camera'
    SETTINGS = (VideoCameraSettings,)
    EXAMPLE = 'ros2 run homography_servo video_camera --ros-args -p source:=box.mp4 -p loop:=true'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        settings = self._settings[VideoCameraSettings]
        self._device = settings.source.isdigit()
        self._camera = _camera_from(settings.camera_file)
        self._capture = _open(settings.source)
        qos = images_qos(settings.reliable_images)
        self._image = self.create_publisher(Image, 'image', qos)
        self._info = self.create_publisher(CameraInfo, 'camera_info', qos)
        self._closing = threading.Event()
        self._last_s = self._opened_s = time.monotonic()
        self._heard_s: float | None = None
        self._reader: threading.Thread | None = None
        if self._device:  # waiting for a device must not hold up services and signals
            self._reader = threading.Thread(target=self._read_device, daemon=True)
            self._reader.start()
        else:
            self.every(1.0 / self._rate_hz(settings.rate_hz), self._next_of_file)
        self.start_kit()

    def _rate_hz(self, wanted_hz: float) -> float:
        file_hz = self._capture.get(cv2.CAP_PROP_FPS)
        usable = np.isfinite(file_hz) and 0.0 < file_hz <= FASTEST_HZ
        return wanted_hz or (file_hz if usable else DEFAULT_RATE_HZ)

    def _read_device(self) -> None:
        wanted_hz = self._settings[VideoCameraSettings].rate_hz
        pause_s = 1.0 / wanted_hz if wanted_hz else 0.0
        read_one = self.guarded(self._next_of_device)
        while not self._closing.is_set():
            began_s = time.monotonic()
            read_one()
            self._closing.wait(max(0.0, pause_s - (time.monotonic() - began_s)))

    def _next_of_device(self) -> None:
        good, pixels = self._capture.read()
        if good:
            self._publish(pixels)
            return
        self.complain('the camera gives no picture', key='read')
        self._closing.wait(0.1)
        if time.monotonic() - max(self._last_s, self._opened_s) > REOPEN_S:
            self._reopen()

    def _reopen(self) -> None:
        """Open the device anew: one that was unplugged never comes back by itself."""
        self._opened_s = time.monotonic()
        self._capture.release()
        try:
            self._capture = _open(self._settings[VideoCameraSettings].source)
            self.count('reopened')
        except HardwareError as error:
            self.complain(str(error), key='reopen')

    def _may_begin(self, settings: VideoCameraSettings) -> bool:
        """Wait for a subscriber, and a moment more: it must know this publisher too."""
        if not settings.wait_for_subscriber or self.counts['images']:
            return True
        if not self._image.get_subscription_count():
            self._heard_s = None
            return False
        self._heard_s = self._heard_s or time.monotonic()
        return time.monotonic() - self._heard_s >= SETTLE_S

    def _next_of_file(self) -> None:
        settings = self._settings[VideoCameraSettings]
        if not self._may_begin(settings):
            return
        good, pixels = self._capture.read()
        if not good and settings.loop and self.counts['images']:
            self._capture.release()
            self._capture = _open(settings.source)
            self.count('loops')
            good, pixels = self._capture.read()
        if good:
            self._publish(pixels)
        else:
            self._at_end(settings)

    def _at_end(self, settings: VideoCameraSettings) -> None:
        if settings.on_end == 'exit' and self.exit_code is None:
            shown = self.counts['images']
            self.get_logger().info(f'{settings.source} is at its end after {shown} images')
            self.finish(EXIT_OK if shown else EXIT_FAILED)

    def _publish(self, pixels: np.ndarray) -> None:
        header = Header(stamp=self.get_clock().now().to_msg(),
                        frame_id=self._settings[VideoCameraSettings].frame_id)
        if self._settings[VideoCameraSettings].encoding == 'mono8' and pixels.ndim == 3:
            pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
        self._image.publish(image_msg(pixels, header))
        self._info.publish(self._info_msg(pixels, header))
        self.count('images')
        self._last_s = time.monotonic()

    def _info_msg(self, pixels: np.ndarray, header: Header) -> CameraInfo:
        height, width = pixels.shape[:2]
        if self._camera is None:
            return CameraInfo(header=header, width=width, height=height)
        if (width, height) != (self._camera.width, self._camera.height):
            self.complain(f'images are {width} x {height}, but the calibration is for '
                          f'{self._camera.width} x {self._camera.height}', key='size')
            return CameraInfo(header=header, width=width, height=height)
        return camera_info_msg(self._camera, header)

    def diagnose(self) -> list[Health]:
        """Tell whether pictures come."""
        age_s = time.monotonic() - self._last_s
        waiting = not self.counts['images']
        fresh = age_s < 2.0
        message = 'waiting for a subscriber' if waiting and not self._device else \
            'publishing' if fresh else f'no picture for {age_s:.0f} s'
        return [Health('camera', OK if fresh or waiting else WARN, message,
                       {'images': self.counts['images'], 'loops': self.counts['loops']})]

    def close(self) -> None:
        """Give the device back."""
        self._closing.set()
        if self._reader is not None:
            self._reader.join(0.5)
        self._capture.release()


def _camera_from(name: str):
    if not name:
        return None
    try:
        return load_camera(find_config(name))
    except FileNotFoundError as error:
        raise ConfigError(VideoCamera.NAME, 0, 'camera_file', str(error)) from error


def _open(source: str) -> cv2.VideoCapture:
    if source.isdigit():
        if not Path(f'/dev/video{source}').exists():
            raise HardwareError(f'no camera {source}: /dev/video{source} does not exist; plug it '
                                'in or give another number or a video file as `source`')
        capture, what = cv2.VideoCapture(int(source)), f'camera {source}'
    else:
        path = Path(source).expanduser()
        if not path.is_file():
            raise HardwareError(f'no video file {source} in {Path.cwd()}; give its path as '
                                '`source`, or run from the folder it is relative to')
        capture, what = cv2.VideoCapture(str(path)), str(path)
    if not capture.isOpened():
        raise HardwareError(f'{what} cannot be opened: is it in use, or not a video?')
    return capture


def main(args=None) -> int:
    """Run the camera."""
    return run_node(VideoCamera, args)


if __name__ == '__main__':
    raise SystemExit(main())
