"""A webcam or a video file as `image` and `camera_info`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import threading
import time

from builtin_interfaces.msg import Time
import cv2
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
from homography_servo.nodes.run import EXIT_HARDWARE
from homography_servo.nodes.run import EXIT_OK
from homography_servo.nodes.run import run_node
from homography_servo.places import load_named
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
EARLY_SHARE = 0.2


@dataclass(frozen=True)
class VideoCameraSettings(Settings):
    """Where the pictures come from, and how they go out."""

    source: str = text('0', 'path of a camera device (/dev/video0), its number in quotes, or path '
                       'of a video file', read_only=True)
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
    CARRIES_IMAGES = True
    EXAMPLE = 'ros2 run homography_servo video_camera --ros-args -p source:=box.mp4 -p loop:=true'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        settings = self._settings[VideoCameraSettings]
        self._device = _device_number(settings.source) is not None
        self._camera = load_named(load_camera, settings.camera_file, self.NAME, 'camera_file') \
            if settings.camera_file else None
        self._capture = _open(settings.source)
        qos = images_qos(settings.reliable_images)
        self._image = self.create_publisher(Image, 'image', qos)
        self._info = self.create_publisher(CameraInfo, 'camera_info', qos)
        self._closing = threading.Event()
        self._last_s = self._opened_s = time.monotonic()
        self._due_s = 0.0
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
        read_one = self.guarded(self._next_of_device)
        while not self._closing.is_set():
            read_one()

    def _next_of_device(self) -> None:
        """Take every picture, lest old ones queue up, and publish those that are due."""
        if self._capture.grab():
            stamp, now_s = self.get_clock().now().to_msg(), time.monotonic()
            if not self._is_due(now_s):
                self._last_s = now_s
                return
            good, pixels = self._capture.retrieve()
            if good:
                self._publish(pixels, stamp)
                return
        self.complain('the camera gives no picture', key='read')
        self._closing.wait(0.1)
        if time.monotonic() - max(self._last_s, self._opened_s) > REOPEN_S:
            self._reopen()

    def _is_due(self, now_s: float) -> bool:
        """Tell whether to publish a picture, so that the rate is kept in the mean."""
        wanted_hz = self._settings[VideoCameraSettings].rate_hz
        if not wanted_hz:
            return True
        early_s = EARLY_SHARE / wanted_hz  # the device's clock is not ours
        if now_s < self._due_s - early_s:
            return False
        self._due_s = max(self._due_s, now_s - early_s) + 1.0 / wanted_hz
        return True

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
            good, pixels = self._first_again(settings.source)
        if good:
            self._publish(pixels, self.get_clock().now().to_msg())
        else:
            self._at_end(settings)

    def _first_again(self, source: str) -> tuple[bool, np.ndarray | None]:
        self._capture.release()
        try:
            self._capture = _open(source)
        except HardwareError as error:  # the file has gone
            self.complain(str(error))
            self.finish(EXIT_HARDWARE)
            return False, None
        self.count('loops')
        return self._capture.read()

    def _at_end(self, settings: VideoCameraSettings) -> None:
        if settings.on_end == 'exit' and self.exit_code is None:
            shown = self.counts['images']
            self.get_logger().info(f'{settings.source} is at its end after {shown} images')
            self.finish(EXIT_OK if shown else EXIT_FAILED)

    def _publish(self, pixels: np.ndarray, stamp: Time) -> None:
        settings = self._settings[VideoCameraSettings]
        header = Header(stamp=stamp, frame_id=settings.frame_id)
        if settings.encoding == 'mono8' and pixels.ndim == 3:
            pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
        elif settings.encoding == 'bgr8' and pixels.ndim == 2:
            pixels = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
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
        if self._reader is None or not self._reader.is_alive():
            self._capture.release()  # not under the feet of a read that hangs


def _device_number(source: str) -> int | None:
    """Give the number of a camera device named by it or by its path; None for a file."""
    digits = source.removeprefix('/dev/video')
    return int(digits) if digits.isascii() and digits.isdigit() else None


def _open(source: str) -> cv2.VideoCapture:
    number = _device_number(source)
    if number is not None:
        if not Path(f'/dev/video{number}').exists():
            raise HardwareError(f'no camera {number}: /dev/video{number} does not exist; plug it '
                                'in or give another number or a video file as `source`')
        capture, what = cv2.VideoCapture(number), f'camera {number}'
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
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
