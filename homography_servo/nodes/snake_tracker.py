"""The tracker as a ROS node: images in, corners out."""

from __future__ import annotations

from dataclasses import dataclass
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PolygonStamped
from homography_servo.nodes.conversions import bgr_from_image
from homography_servo.nodes.conversions import camera_from_info
from homography_servo.nodes.conversions import corners_from_polygon
from homography_servo.nodes.conversions import covariance_msg
from homography_servo.nodes.conversions import grey_from_image
from homography_servo.nodes.conversions import image_msg
from homography_servo.nodes.conversions import image_path_from_msg
from homography_servo.nodes.conversions import polygon_msg
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.kit import DEFAULT
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import images_qos
from homography_servo.nodes.kit import LATCHED
from homography_servo.nodes.kit import newest_image_qos
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import WARN
from homography_servo.nodes.pace import Pace
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.progress import progress_from_msg
from homography_servo.nodes.run import run_node
from homography_servo.result import Rejected
from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import reals
from homography_servo.settings import Settings
from homography_servo.tracking.frame_order import FrameOrder
from homography_servo.tracking.overlay import draw_path
from homography_servo.tracking.overlay import draw_track
from homography_servo.tracking.tracker import Track
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker import TRACKING
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import String
from std_srvs.srv import Trigger

WATCH_PERIOD_S = 0.05


@dataclass(frozen=True)
class SnakeTrackerSettings(Settings):
    """The object, and how images arrive."""

    face_size_m: tuple[float, ...] = reals(
        (0.10, 0.06), 'm', 'width and height of the tracked face', length=2, low=0.001,
        high=10.0, read_only=True)
    box_height_m: float = real(
        0.04, 0.0, 10.0, 'm', 'how far the box reaches behind the face; 0 is a plate',
        read_only=True)
    reliable_images: bool = flag(
        False, 'ask for reliable delivery of images (needed for large ones)', read_only=True)
    image_timeout_s: float = real(
        0.2, 0.02, 60.0, 's', 'time without an image after which the face counts as lost')
    prediction_age_s: float = real(
        0.2, 0.0, 10.0, 's', 'how far the stamp of the predicted corners may be from that of '
        'the image')


class SnakeTracker(NodeKit, Node):
    """Follow the face of the object through the images of a camera."""

    NAME = 'snake_tracker'
    SETTINGS = (SnakeTrackerSettings, TrackerSettings)
    CARRIES_IMAGES = True
    EXAMPLE = ('ros2 run homography_servo snake_tracker --ros-args -r image:=camera/image_raw '
               '-p face_size_m:="[0.10, 0.06]"')

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        self._settings.on_change(self._on_parameters)
        own = self._settings[SnakeTrackerSettings]
        self._tracker = Tracker(own.face_size_m or (0.10, 0.06), self._settings[TrackerSettings],
                                None, own.box_height_m)
        self._order, self._track = FrameOrder(), None
        self._predicted: tuple[float, np.ndarray] | None = None
        self._path_px: np.ndarray | None = None  # shown in the annotated image
        self._target: int | None = None
        self._shown_state, self._image_at_s, self._took_ms = '', None, 0.0
        self._pace = Pace('corners')
        self._publish_to()
        self._listen_to(own)
        self.every(WATCH_PERIOD_S, self._watch)
        self.start_kit()
        self._show_state()

    def _publish_to(self) -> None:
        self._corners = self.create_publisher(PolygonStamped, 'object/corners', DEFAULT)
        self._covariance = self.create_publisher(Float64MultiArray, 'object/corner_covariance',
                                                 DEFAULT)
        self._contour = self.create_publisher(PolygonStamped, 'object/contour', DEFAULT)
        self._annotated = self.create_publisher(Image, '~/annotated_image', images_qos(False))
        self._state = self.latched(String, '~/state')

    def _listen_to(self, own: SnakeTrackerSettings) -> None:
        qos = newest_image_qos(own.reliable_images)
        self.listen(Image, 'image', self._on_image, qos)
        self._take_camera = self.listen_quietly(CameraInfo, 'camera_info', self._on_camera,
                                                newest_image_qos(False))
        self.listen(PolygonStamped, 'object/predicted_corners', self._on_predicted)
        self.listen(Float64MultiArray, 'path/image', self._on_path, LATCHED)
        self.listen(DiagnosticStatus, 'visual_servo/progress', self._on_progress)
        self.serve(Trigger, '~/reset', self._on_reset)

    # Inputs.

    def _on_image(self, msg: Image) -> None:
        self.count('images')
        grey = grey_from_image(msg)
        if isinstance(grey, Rejected):
            self.reject('image', grey.reason)
            return
        stamp_s = self._order.accept(seconds_from_stamp(msg.header.stamp))
        if isinstance(stamp_s, Rejected):
            self.reject('image', stamp_s.reason)
            return
        if self._tracker.camera is None:
            self._take_camera()
        started_s = time.perf_counter()
        self._image_at_s = time.monotonic()
        self._track = self._tracker.update(grey, stamp_s, self._prediction(msg))
        self._took_ms = 1e3 * (time.perf_counter() - started_s)
        self._publish(msg, self._track)

    def _on_camera(self, msg: CameraInfo) -> None:
        camera = camera_from_info(msg)
        if isinstance(camera, Rejected):
            self.reject('camera_info', camera.reason)
        elif camera != self._tracker.camera:
            self._tracker.camera = camera

    def _on_predicted(self, msg: PolygonStamped) -> None:
        corners_px = corners_from_polygon(msg)
        if isinstance(corners_px, Rejected):
            self.reject('predicted_corners', corners_px.reason)
        elif corners_px is not None:
            self._predicted = (seconds_from_stamp(msg.header.stamp), corners_px)

    def _on_path(self, msg: Float64MultiArray) -> None:
        path_px = image_path_from_msg(msg)
        if isinstance(path_px, Rejected):
            self.reject('path_image', path_px.reason)
        else:
            self._path_px, self._target = path_px, None

    def _on_progress(self, msg: DiagnosticStatus) -> None:
        pose = progress_from_msg(msg).pose
        self._target = pose - 1 if pose > 0 else None

    def _on_reset(self, _request) -> tuple[bool, str]:
        self._tracker.reset()
        self._show_state()
        return True, 'the object is forgotten and looked for again'

    def _on_parameters(self) -> None:
        self._tracker.settings = self._settings[TrackerSettings]

    def _watch(self) -> None:
        """Notice by the steady clock that no images come any more."""
        limit_s = self._settings[SnakeTrackerSettings].image_timeout_s
        if self._image_at_s is not None and time.monotonic() - self._image_at_s > limit_s:
            self._image_at_s = None
            self.count('image_timeouts')
            self._tracker.interrupt()
            self._show_state()

    # Outputs.

    def _prediction(self, msg: Image) -> np.ndarray | None:
        if self._predicted is None:
            return None
        age_s = abs(seconds_from_stamp(msg.header.stamp) - self._predicted[0])
        fresh = age_s <= self._settings[SnakeTrackerSettings].prediction_age_s
        return self._predicted[1] if fresh else None

    def _publish(self, msg: Image, track: Track) -> None:
        if track.corners_px is not None:
            self._covariance.publish(covariance_msg(track.covariance_px2, msg.header))
        self._corners.publish(polygon_msg(track.corners_px, msg.header))
        self._pace.note(time.monotonic(), self.age_s(msg.header))
        if self._contour.get_subscription_count():
            self._contour.publish(polygon_msg(track.contour_px, msg.header))
        self._show_state()
        self.count(f'frames_{track.state.lower()}')
        if self._annotated.get_subscription_count():
            picture = draw_path(bgr_from_image(msg), self._path_px, self._target)
            picture = draw_track(picture, track)
            self._annotated.publish(image_msg(picture, msg.header))

    def _show_state(self) -> None:
        if self._tracker.state != self._shown_state:
            self._shown_state = self._tracker.state
            self._state.publish(String(data=self._shown_state))

    def diagnose(self) -> list[Health]:
        """Report state and quality of the last image."""
        track = self._track
        values = {'frame_ms': self._took_ms, 'camera_known': self._tracker.camera is not None}
        values.update(self._pace.facts(time.monotonic()))
        if track is not None and track.quality is not None:
            quality = track.quality
            values.update(inlier_share=quality.inlier_share, contrast=quality.contrast,
                          noise=quality.noise, residual_px=quality.residual)
        if self._image_at_s is None:
            return [Health('tracking', WARN, 'no images', values)]
        level = OK if self._shown_state == TRACKING else WARN
        reason = f': {track.reason}' if track is not None and track.reason else ''
        return [Health('tracking', level, self._shown_state + reason, values)]


def main(args=None) -> int:
    """Run the node."""
    return run_node(SnakeTracker, args)


if __name__ == '__main__':
    raise SystemExit(main())
