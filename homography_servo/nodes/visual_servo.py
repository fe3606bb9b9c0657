"""The servo as a ROS node: messages to `planning.servo` and back."""

from __future__ import annotations

from dataclasses import dataclass
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.nodes.calibration_desk import CalibrationDesk
from homography_servo.nodes.conversions import camera_from_info
from homography_servo.nodes.conversions import joints_from_state
from homography_servo.nodes.conversions import polygon_msg
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.conversions import trajectory_msg
from homography_servo.nodes.conversions import transform_from_pose
from homography_servo.nodes.deferred import DeferredTrigger
from homography_servo.nodes.kit import COMMANDS
from homography_servo.nodes.kit import DEFAULT
from homography_servo.nodes.kit import ERROR
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import LATCHED
from homography_servo.nodes.kit import newest_image_qos
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import WARN
from homography_servo.nodes.pace import Pace
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.path_inbox import PathInbox
from homography_servo.nodes.progress import progress_msg
from homography_servo.nodes.run import run_node
from homography_servo.places import load_named
from homography_servo.planning.command import Command
from homography_servo.planning.servo import Servo
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_state import FAILED
from homography_servo.planning.servo_state import HOLD
from homography_servo.planning.servo_state import Progress
from homography_servo.result import Rejected
from homography_servo.robot.robot_file import load_robot
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.tracking.tracker import LOST
from homography_servo.tracking.tracker import SEARCHING
import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_msgs.msg import String
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

TICK_S = 0.02
PROGRESS_PERIOD_S = 0.03
FAREWELL_S = 0.2  # that the end may take while the bridge takes the stop


@dataclass(frozen=True)
class VisualServoSettings(Settings):
    """Files of the visual servo node."""

    robot_file: str = text('robix_rcs6.yaml', 'the arm, its limits and the object',
                           read_only=True)


class VisualServo(NodeKit, Node):
    """Move the object along the planned path while looking at it."""

    NAME = 'visual_servo'
    SETTINGS = (VisualServoSettings, ServoSettings, *CalibrationDesk.SETTINGS)
    EXAMPLE = 'ros2 run homography_servo visual_servo --ros-args -p mode:=continuous'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        self._settings.on_change(self._on_parameters)
        self._robot = load_named(load_robot, self._settings[VisualServoSettings].robot_file,
                                 self.NAME, 'robot_file')
        self._servo = Servo(self._robot, self._settings[ServoSettings])
        self._camera = None
        self._inbox = PathInbox(self._robot.joint_names)
        self._desk = CalibrationDesk(self._robot, self._servo, self._settings)
        self._look_header: Header | None = None
        self._pace = Pace('command')
        self._shown_state = ''
        self._shown_progress: Progress | None = None
        self._shown_progress_s = 0.0
        self._publish_to()
        self._listen_to()
        self.every(TICK_S, self._tick)
        self.start_kit()
        self._tick()

    def _publish_to(self) -> None:
        self._speaking, self._silent = threading.RLock(), False
        self._commands = self.create_publisher(JointTrajectory, 'joint_trajectory', COMMANDS)
        self._corners = self.create_publisher(PolygonStamped, 'object/predicted_corners', DEFAULT)
        self._state = self.latched(String, '~/state')
        self._progress = self.create_publisher(DiagnosticStatus, '~/progress', DEFAULT)

    def _listen_to(self) -> None:
        self.listen(PoseArray, 'path/poses', self._on_poses, LATCHED)
        self.listen(DiagnosticArray, 'path/verdict', self._on_verdict, LATCHED)
        self.listen(JointTrajectory, 'path/joint_trajectory', self._on_plan, LATCHED)
        self.listen(PoseWithCovarianceStamped, 'object/pose', self._on_look)
        self.listen(JointState, 'joint_states', self._on_joints)
        self._take_camera = self.listen_quietly(CameraInfo, 'camera_info', self._on_camera,
                                                newest_image_qos(False))
        self.listen(String, 'snake_tracker/state', self._on_tracker, LATCHED)
        self.listen(String, 'robix_bridge/state', self._on_bridge, LATCHED)
        self.serve(Trigger, '~/start', self._on_start)
        self.serve(Trigger, '~/stop', self._on_stop)
        self.serve(SetBool, '~/pause', self._on_pause)
        self._calibrate = DeferredTrigger(self, '~/calibrate', self._on_calibrate)

    # Inputs.

    def _on_parameters(self) -> None:
        self._servo.settings = self._settings[ServoSettings]

    def _on_camera(self, msg: CameraInfo) -> None:
        camera = camera_from_info(msg)
        if isinstance(camera, Rejected):
            self.reject('camera_info', camera.reason)
            camera = None
        self._camera = camera
        self._servo.set_focal(None if camera is None else max(camera.fx, camera.fy))

    def _on_poses(self, msg: PoseArray) -> None:
        self._inbox.poses = msg
        self._take_path()

    def _on_verdict(self, msg: DiagnosticArray) -> None:
        self._inbox.verdict = msg
        self._take_path()

    def _on_plan(self, msg: JointTrajectory) -> None:
        self._inbox.joints = msg
        self._take_path()

    def _take_path(self) -> None:
        path = self._inbox.path()
        if path is None or (path.waits and self._servo.active):
            return  # the path before it must not be gone instead
        if path.broken:
            self.reject('path', path.sentence)
        self._servo.set_path(path.poses, path.feasible, path.sentence, path.lead)
        self._tick()

    def _on_joints(self, msg: JointState) -> None:
        joints_rad = joints_from_state(msg, self._robot.joint_names)
        if not isinstance(joints_rad, Rejected):
            stamp_s = seconds_from_stamp(msg.header.stamp)
            rejected = self._servo.add_joints(joints_rad, stamp_s, time.monotonic())
            joints_rad = joints_rad if rejected is None else rejected
        if isinstance(joints_rad, Rejected):
            self.reject('joint_states', joints_rad.reason)
            return
        self._tick()
        self._predict_corners(joints_rad, msg.header)

    def _on_look(self, msg: PoseWithCovarianceStamped) -> None:
        pose = transform_from_pose(msg.pose.pose)
        if not isinstance(pose, Rejected):
            covariance = np.array(msg.pose.covariance, dtype=float).reshape(6, 6)
            stamp_s = seconds_from_stamp(msg.header.stamp)
            pose = self._servo.add_look(pose, covariance, stamp_s, time.monotonic())
        if isinstance(pose, Rejected):
            self.reject('object_pose', pose.reason)
        else:
            self._look_header = msg.header
        self._tick()

    def _on_tracker(self, msg: String) -> None:
        """Hear sooner than by silence that the object is gone."""
        self._servo.watch.sight.tracker_lost = msg.data in (LOST, SEARCHING)
        self._tick()

    def _on_bridge(self, msg: String) -> None:
        """Hear why commands would be in vain."""
        state, _, reason = msg.data.partition(': ')
        self._servo.watch.arm_latched = reason or state if state == 'LATCHED' else ''
        self._tick()

    def _on_calibrate(self) -> Rejected | None:
        """Begin a calibration; its answer comes when it has ended."""
        if self._active:
            return Rejected('on the way; stop first')
        self._take_camera()
        refused = self._desk.begin(self._camera, time.monotonic())
        self._tick()
        return refused

    def _answer_calibration(self) -> None:
        success, sentence = self._desk.result()
        if success:
            self.get_logger().info(sentence)
        self._calibrate.answer(success, sentence)

    @property
    def _level(self) -> bytes:
        return {FAILED: ERROR, HOLD: WARN}.get(self._state_text.partition(':')[0], OK)

    @property
    def _active(self) -> bool:
        return self._servo.active or self._desk.open

    @property
    def _state_text(self) -> str:
        return self._desk.state_text or self._servo.state_text

    def _on_start(self, _) -> tuple[bool, str]:
        if self._desk.open:
            return False, 'a calibration is on the way; stop first'
        self._desk.clear()
        self._take_path()  # one that has waited for the end of the way
        self._take_camera()
        answer = self._servo.start(time.monotonic())
        self._tick()
        return not isinstance(answer, Rejected), str(answer)

    def _on_stop(self, _) -> tuple[bool, str]:
        was_open = self._desk.open
        self._desk.stop('stopped by the operator')
        answer = self._servo.stop()
        self._tick()
        self._desk.clear()
        return True, 'calibration stopped' if was_open else answer

    def _on_pause(self, request: SetBool.Request) -> tuple[bool, str]:
        answer = self._servo.pause(bool(request.data))
        self._tick()
        return True, answer

    # Outputs.

    def _tick(self) -> None:
        now_s = time.monotonic()
        command = self._desk.tick(now_s) if self._desk.open else self._servo.tick(now_s)
        if command is not None:
            self._send(command)
            if self._look_header is not None and len(command.points_rad):
                self._pace.note(now_s, self.age_s(self._look_header))
        if self._desk.over:
            self._answer_calibration()
        if self._state_text != self._shown_state:
            self._shown_state = self._state_text
            self._state.publish(String(data=self._shown_state))
            if self._shown_state.startswith((FAILED, HOLD)):
                self.get_logger().warning(self._shown_state)
        self._show_progress(now_s)

    def _show_progress(self, now_s: float) -> None:
        """Tell every pose that is reached, and errors as often as anybody can follow."""
        progress, shown = self._servo.progress, self._shown_progress
        if progress is shown:
            return
        news = shown is None or (progress.pose, progress.reached) != (shown.pose, shown.reached)
        if news or now_s - self._shown_progress_s > PROGRESS_PERIOD_S:
            self._shown_progress, self._shown_progress_s = progress, now_s
            self._progress.publish(progress_msg(
                f'{self.get_name()}: progress', self._level, self._servo.state_text, progress))

    def _trajectory(self, command: Command) -> JointTrajectory:
        msg = trajectory_msg(self._robot.joint_names, command.points_rad, command.times_s)
        for point, velocity in zip(msg.points, command.velocities_rad_s):
            point.velocities = velocity.tolist()
        return msg  # one without points means stop

    def _predict_corners(self, joints_rad: np.ndarray, header: Header) -> None:
        if self._camera is None:
            return
        pose = self._servo.filter.pose(joints_rad)
        points_m = self._robot.object_points_m @ pose[:3, :3].T + pose[:3, 3]
        points_m[:, 2] += self._robot.home_depth_m
        if points_m[:, 2].min() <= 0.05:
            return
        corners_px = self._camera.project(points_m)
        if np.isfinite(corners_px).all():
            header = Header(stamp=header.stamp, frame_id='camera_optical')
            self._corners.publish(polygon_msg(corners_px, header))

    # Health.

    def diagnose(self) -> list[Health]:
        """Report the state and the last errors."""
        values = {**self._servo.progress._asdict(), 'looks_in_filter': self._servo.filter.looks,
                  'surprise': self._servo.filter.surprise,
                  'poses_passed_over': self._servo.passed_over,
                  **self._pace.facts(time.monotonic())}
        return [Health('servo', self._level, self._state_text, values)]

    def on_fault(self, error: Exception) -> None:
        """Stop when the servo itself failed."""
        self._desk.stop(f'internal error: {error}')
        if self._desk.over:
            self._answer_calibration()
        self._desk.clear()
        self._servo.fail(f'internal error: {error}')
        self._send(Command())

    def _send(self, command: Command) -> None:
        """Publish a command, unless the last word has been said."""
        with self._speaking:
            if not self._silent:
                self._commands.publish(self._trajectory(command))

    def on_signal(self) -> None:
        """Stop the arm before the process ends; a tick under way sends nothing after that."""
        with self._speaking:
            if self._active:
                self._send(Command())
            self._silent = True

    def close(self) -> None:
        """Let the bridge hear the stop before the process ends."""
        if self._silent:
            self._commands.wait_for_all_acked(Duration(seconds=FAREWELL_S))


def main(args=None) -> int:
    """Run the node."""
    return run_node(VisualServo, args)
