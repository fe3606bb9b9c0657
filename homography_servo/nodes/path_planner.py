"""The planner as a ROS node: corners to poses, goals and services to plans."""

from __future__ import annotations

from dataclasses import dataclass
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseArray
from geometry_msgs.msg import PoseStamped
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.geometry.face import face_corners
from homography_servo.nodes.conversions import camera_from_info
from homography_servo.nodes.conversions import corners_from_polygon
from homography_servo.nodes.conversions import covariance_from_msg
from homography_servo.nodes.conversions import image_path_msg
from homography_servo.nodes.conversions import joints_from_state
from homography_servo.nodes.conversions import pose_array_msg
from homography_servo.nodes.conversions import pose_covariance_msg
from homography_servo.nodes.conversions import seconds_from_stamp
from homography_servo.nodes.conversions import stamp_label
from homography_servo.nodes.conversions import stamp_text
from homography_servo.nodes.conversions import transform_from_pose
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import newest_image_qos
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import SHORT
from homography_servo.nodes.kit import WARN
from homography_servo.nodes.pace import Pace
from homography_servo.nodes.parameters import Parameters
from homography_servo.nodes.path_markers import image_marker
from homography_servo.nodes.path_markers import marker_array
from homography_servo.nodes.path_messages import predicted_trajectory_msg
from homography_servo.nodes.path_messages import verdict_msg
from homography_servo.nodes.run import run_node
from homography_servo.nodes.transforms import camera_frames
from homography_servo.nodes.transforms import Frame
from homography_servo.nodes.transforms import Transforms
from homography_servo.places import load_named
from homography_servo.planning.desk import PlanningDesk
from homography_servo.planning.observer_settings import ObserverSettings
from homography_servo.planning.planner import Plan
from homography_servo.planning.settings import PlannerSettings
from homography_servo.result import Rejected
from homography_servo.robot.robot_file import load_robot
from homography_servo.settings import reals
from homography_servo.settings import Settings
from homography_servo.settings import text
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import ImageMarker
from visualization_msgs.msg import MarkerArray

COVARIANCES_KEPT = 8  # of images whose corners have not come yet


@dataclass(frozen=True)
class PathPlannerSettings(Settings):
    """What the path planner node works with."""

    robot_file: str = text(
        'robix_rcs6.yaml', 'the arm, its limits and the object; empty: the object flies freely '
        'and nothing about joints is checked', read_only=True)
    face_size_m: tuple[float, ...] = reals(
        (0.1, 0.06), 'm', 'width and height of the face when there is no robot file', length=2,
        low=0.0005, high=10.0, read_only=True)


class PathPlanner(NodeKit, Node):
    """Measure the object's pose, and plan, check and show paths to a goal."""

    NAME = 'path_planner'
    SETTINGS = (PathPlannerSettings, PlannerSettings, ObserverSettings)
    EXAMPLE = 'ros2 run homography_servo path_planner --ros-args -p poses:=31'

    def __init__(self, **kwargs) -> None:
        super().__init__(self.NAME, **kwargs)
        self._settings = Parameters(self, *self.SETTINGS)
        self._settings.on_change(self._on_parameters)
        files = self._settings[PathPlannerSettings]
        self._robot = load_named(load_robot, files.robot_file, self.NAME, 'robot_file') \
            if files.robot_file else None
        size = files.face_size_m or (0.1, 0.06)
        points_m = face_corners(*size) if self._robot is None else self._robot.object_points_m
        self._desk = PlanningDesk(points_m, self._robot, self._settings[PlannerSettings],
                                  self._settings[ObserverSettings])
        self._last_sentence = 'no plan yet'
        self._pace = Pace('pose')
        self._covariances: dict[str, np.ndarray] = {}
        self._publish_to()
        self._transforms = Transforms(self, camera_frames(self._desk.home_depth_m))
        self._listen_to()
        self.start_kit()

    def _publish_to(self) -> None:
        self._pose = self.create_publisher(PoseWithCovarianceStamped, 'object/pose', 10)
        self._candidates = self.create_publisher(PoseArray, 'object/pose_candidates', 10)
        self._poses = self.latched(PoseArray, 'path/poses')
        self._image = self.latched(Float64MultiArray, 'path/image')
        self._joints = self.latched(JointTrajectory, 'path/joint_trajectory')
        self._verdict = self.latched(DiagnosticArray, 'path/verdict')
        self._markers = self.latched(MarkerArray, 'path/markers')
        self._image_markers = self.latched(ImageMarker, 'path/image_markers')

    def _listen_to(self) -> None:
        self._take_camera = self.listen_quietly(CameraInfo, 'camera_info', self._on_camera,
                                                newest_image_qos(False))
        self._take_covariances = self.listen_quietly(
            Float64MultiArray, 'object/corner_covariance', self._on_covariance, SHORT)
        self.listen(PolygonStamped, 'object/corners', self._on_corners, SHORT)
        self.listen(JointState, 'joint_states', self._on_joints)
        self.listen(PolygonStamped, 'goal/corners', self._on_goal_corners)
        self.listen(PoseStamped, 'goal/pose', self._on_goal_pose)
        self.serve(Trigger, '~/teach_goal', self._on_teach)
        self.serve(Trigger, '~/plan', self._on_plan)

    def _on_parameters(self) -> None:
        self._desk.change(self._settings[PlannerSettings], self._settings[ObserverSettings])

    def _on_camera(self, msg: CameraInfo) -> None:
        self._taken('camera_info', self._desk.set_camera(camera_from_info(msg)))

    def _on_joints(self, msg: JointState) -> None:
        if self._robot is None:
            return
        joints_rad = joints_from_state(msg, self._robot.joint_names)
        self._taken('joint_states', self._desk.set_joints(
            joints_rad, time.monotonic(), self._stamp_s(msg.header)))

    def _on_covariance(self, msg: Float64MultiArray) -> None:
        """Keep how well the corners of one image are known until they come."""
        covariance = covariance_from_msg(msg, 8)
        if self._taken('corner_covariance', covariance):
            self._covariances[stamp_label(msg)] = covariance
        while len(self._covariances) > COVARIANCES_KEPT:
            self._covariances.pop(next(iter(self._covariances)))

    def _on_corners(self, msg: PolygonStamped) -> None:
        self._take_covariances()
        if self._desk.camera is None:
            self._take_camera()
        corners_px = corners_from_polygon(msg)
        if corners_px is None:
            self.count('corners_empty')
            self._desk.lose_sight()
            return
        covariance = self._covariances.get(stamp_text(msg.header.stamp))
        estimate = self._desk.see(corners_px, time.monotonic(), self._stamp_s(msg.header),
                                  covariance)
        if not self._taken('corners', estimate):
            return
        header = Header(stamp=msg.header.stamp, frame_id='home')
        self._pose.publish(pose_covariance_msg(
            estimate.home_from_object, estimate.covariance, header))
        self._pace.note(time.monotonic(), self.age_s(header))
        self._transforms.send([Frame('home', 'object', estimate.home_from_object)], header.stamp)
        if self._candidates.get_subscription_count():
            self._candidates.publish(pose_array_msg(
                [candidate.home_from_object for candidate in estimate.candidates], header))

    def _stamp_s(self, header: Header) -> float:
        """Give a stamp in seconds; a missing one and one from the future mean now."""
        now_s = 1e-9 * self.get_clock().now().nanoseconds
        stamp_s = seconds_from_stamp(header.stamp)
        return min(stamp_s, now_s) if stamp_s > 0.0 else now_s

    def _on_goal_corners(self, msg: PolygonStamped) -> None:
        corners_px = corners_from_polygon(msg)
        if corners_px is None:
            corners_px = Rejected('the polygon is empty')
        self._tell_goal(self._desk.set_goal_corners(corners_px, time.monotonic()))

    def _on_goal_pose(self, msg: PoseStamped) -> None:
        goal = transform_from_pose(msg.pose)
        if msg.header.frame_id not in ('', 'home'):
            goal = Rejected(f'goal/pose must be in frame home, not {msg.header.frame_id!r}')
        self._tell_goal(self._desk.set_goal_pose(goal))

    def _tell_goal(self, answer: str | Rejected) -> None:
        if self._taken('goal', answer):
            self.get_logger().info(answer)

    def _on_teach(self, _request: Trigger.Request) -> tuple[bool, str]:
        self._take_camera()
        answer = self._desk.teach(time.monotonic())
        return bool(answer), str(answer)

    def _on_plan(self, _request: Trigger.Request) -> tuple[bool, str]:
        self._take_camera()
        plan = self._desk.plan(time.monotonic())
        self._last_sentence = str(plan) if isinstance(plan, Rejected) else plan.sentence
        if isinstance(plan, Rejected):
            return False, plan.reason
        self._show(plan)
        return plan.ok, plan.sentence

    def _show(self, plan: Plan) -> None:
        """Publish a plan; poses that may not be executed are left out of path/poses."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id='home')
        in_image = Header(stamp=header.stamp, frame_id='camera_optical')
        desk = self._desk
        self._image.publish(image_path_msg(plan.corners_px))
        self._joints.publish(predicted_trajectory_msg(plan, self._robot, header))
        self._markers.publish(marker_array(plan, desk.camera, desk.object_points_m,
                                           desk.home_depth_m, self._robot, header))
        self._image_markers.publish(image_marker(plan, desk.home_corners_px, in_image))
        self._verdict.publish(verdict_msg(plan, header, self._robot, desk.home_depth_m))
        self._poses.publish(pose_array_msg(plan.poses if plan.ok else [], header))

    def _taken(self, what: str, answer) -> bool:
        if isinstance(answer, Rejected):
            self.reject(what, answer.reason)
        return not isinstance(answer, Rejected)

    def diagnose(self) -> list[Health]:
        """Tell what is missing, the noise of the corners and the last plan."""
        missing = self._desk.missing(time.monotonic())
        facts = {'corner_noise_px': float(self._desk.noise_px),
                 **self._pace.facts(time.monotonic())}
        inputs = Health('inputs', WARN if missing else OK, missing or 'all is there', facts)
        return [inputs, Health('plan', OK, self._last_sentence)]


def main(args=None) -> int:
    """Run the path planner."""
    return run_node(PathPlanner, args)


if __name__ == '__main__':
    raise SystemExit(main())
