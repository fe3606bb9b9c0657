"""The dashboard as a ROS node: topics onto a web page, buttons to services."""

from __future__ import annotations

from dataclasses import dataclass
import functools
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from homography_servo.errors import ConfigError
from homography_servo.nodes.dashboard_board import Board
from homography_servo.nodes.dashboard_facts import joints_fact
from homography_servo.nodes.dashboard_facts import jpeg_from_image
from homography_servo.nodes.dashboard_facts import node_facts
from homography_servo.nodes.dashboard_facts import path_fact
from homography_servo.nodes.dashboard_facts import progress_fact
from homography_servo.nodes.dashboard_facts import verdict_fact
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import images_qos
from homography_servo.nodes.kit import LATCHED
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.run import run_node
from homography_servo.result import Rejected
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import String

SAMPLE_S = 0.1
SILENT_S = 3.0
JOINTS_AGE_S = 0.5
MOST_NODES = 50
STATES = ('snake_tracker', 'visual_servo', 'robix_bridge')
BUSY = ('MOVING', 'LOOKING', 'HOLD')


@dataclass(frozen=True)
class DashboardSettings(Settings):
    """Where the page is served, and how much is sent."""

    host: str = text(
        '127.0.0.1', 'address to listen on; with any other than 127.0.0.1 everybody in that '
        'network can watch and press the buttons', read_only=True)
    port: int = whole(8088, 0, 65535, '', 'port to listen on; 0 takes any that is free',
                      read_only=True)
    image_rate_hz: float = real(15.0, 0.5, 60.0, 'Hz', 'most pictures a second')
    image_width_px: int = whole(960, 64, 3840, 'px', 'widest picture that is sent; wider ones '
                                'are made smaller')
    jpeg_quality: int = whole(80, 10, 100, '%', 'quality of the pictures')
    history_s: float = real(90.0, 5.0, 600.0, 's', 'how long the curves reach back')


class Dashboard(NodeKit, Node):
    """Show image, path, curves, states and verdict on a web page, with buttons."""

    NAME = 'dashboard'
    SETTINGS = (DashboardSettings,)
    CARRIES_IMAGES = True
    EXAMPLE = 'ros2 run homography_servo dashboard --ros-args -p port:=8088'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        self._settings.on_change(self._on_parameters)
        self._board = Board(1)
        self._on_parameters()
        self._images: Any = None
        self._due_s, self._began_s = 0.0, time.monotonic()
        self._joints: tuple[float, list[float]] | None = None
        self._heard_s: dict[str, float] = {}
        self._server = self._serve_page()
        self._listen_to()
        self.every(SAMPLE_S, self._sample)
        self.start_kit()
        self._server.start()
        self.get_logger().info(f'open {self._server.url} in a browser')

    def _serve_page(self) -> Any:
        try:
            from homography_servo.nodes.dashboard_buttons import Buttons
            from homography_servo.nodes.dashboard_buttons import BUTTONS
            from homography_servo.nodes.dashboard_server import DashboardServer
        except ImportError as error:  # only this node needs a web server
            raise ConfigError(self.NAME, 0, '', f'{error}; install python3-tornado, or '
                              'tornado with pip') from error
        settings = self._settings[DashboardSettings]
        host, port = settings.host, settings.port
        try:
            return DashboardServer(self._board, Buttons(self).press, BUTTONS, host, port)
        except OSError as error:
            raise ConfigError(self.NAME, 0, 'port', f'cannot listen on {host}:{port} '
                              f'({error.strerror}); port 0 takes any that is free') from error

    def _listen_to(self) -> None:
        self.listen(DiagnosticArray, '/diagnostics', self._on_diagnostics)
        self.listen(DiagnosticArray, 'path/verdict', self._on_verdict, LATCHED)
        self.listen(Float64MultiArray, 'path/image', self._on_path, LATCHED)
        self.listen(DiagnosticStatus, 'visual_servo/progress', self._on_progress)
        self.listen(JointState, 'joint_states', self._on_joints)
        for name in STATES:
            self.listen(String, f'{name}/state', functools.partial(self._on_state, name), LATCHED)

    # Inputs.

    def _on_parameters(self) -> None:
        history_s = self._settings[DashboardSettings].history_s
        self._board.resize(int(history_s / SAMPLE_S))
        self._board.put('span_s', history_s)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for name, fact in node_facts(msg).items():
            if name in self._heard_s or len(self._heard_s) < MOST_NODES:
                self._heard_s[name] = time.monotonic()
                self._board.put(f'node/{name}', fact)

    def _on_state(self, name: str, msg: String) -> None:
        self._board.put(f'state/{name}', msg.data)

    def _on_verdict(self, msg: DiagnosticArray) -> None:
        self._board.put('verdict', verdict_fact(msg))

    def _on_path(self, msg: Float64MultiArray) -> None:
        path = path_fact(msg)
        if isinstance(path, Rejected):
            self.reject('path_image', path.reason)
        else:
            self._board.put('path', path)

    def _on_progress(self, msg: DiagnosticStatus) -> None:
        self._board.put('progress', progress_fact(msg))

    def _on_joints(self, msg: JointState) -> None:
        joints = joints_fact(msg)
        if isinstance(joints, Rejected):
            self.reject('joint_states', joints.reason)
            return
        names, degrees = joints
        self._board.put('joint_names', names)
        self._joints = (time.monotonic(), degrees)

    def _on_image(self, data: bytes) -> None:
        """Send a picture on; the others are dropped before they cost anything."""
        now_s, settings = time.monotonic(), self._settings[DashboardSettings]
        if now_s < self._due_s:
            return
        self._due_s = max(self._due_s + 1.0 / settings.image_rate_hz, now_s)
        msg = deserialize_message(data, Image)
        jpeg = jpeg_from_image(msg, settings.image_width_px, settings.jpeg_quality)
        if isinstance(jpeg, Rejected):
            self.reject('image', jpeg.reason)
            return
        self.count('pictures')
        self._board.put('image_size', [int(msg.width), int(msg.height)])
        self._server.show_frame(jpeg)

    # Outputs.

    def _sample(self) -> None:
        """Add to the curves, and look after what changes by itself."""
        now_s = time.monotonic()
        joints, progress = self._joints, self._board.get('progress') or {}
        fresh = joints is not None and now_s - joints[0] < JOINTS_AGE_S
        busy = str(self._board.get('state/visual_servo')).startswith(BUSY)
        errors = [progress.get(key) if busy else None
                  for key in ('position_error_mm', 'rotation_error_deg')]
        self._board.add([round(now_s - self._began_s, 2), joints[1] if fresh else None, *errors])
        self._follow_watchers()
        for name, heard_s in self._heard_s.items():
            if now_s - heard_s > SILENT_S:
                self._board.put(f'node/{name}', {'level': 'stale', 'message': 'silent',
                                                 'parts': []})

    def _follow_watchers(self) -> None:
        """Ask for pictures only while somebody looks: the tracker makes them for that."""
        wanted = self._server.watching > 0
        if wanted and self._images is None:
            self._images = self.listen(Image, 'snake_tracker/annotated_image', self._on_image,
                                       images_qos(False), raw=True)
        elif not wanted and self._images is not None:
            self.destroy_subscription(self._images)
            self._images = None

    def diagnose(self) -> list[Health]:
        """Tell where the page is, and who looks at it."""
        return [Health('page', OK, self._server.url, {
            'browsers': self._server.browsers, 'watching': self._server.watching})]

    def on_signal(self) -> None:
        """Stop serving at once."""
        self._server.stop()

    def close(self) -> None:
        """Stop serving."""
        self._server.stop()


def main(args=None) -> int:
    """Run the dashboard."""
    return run_node(Dashboard, args)


if __name__ == '__main__':
    raise SystemExit(main())
