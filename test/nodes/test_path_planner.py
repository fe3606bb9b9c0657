"""The planner node as users meet it: poses, goals, plans, and a sentence for every refusal."""

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import PoseArray
from geometry_msgs.msg import PoseStamped
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.face import face_corners
from homography_servo.nodes.conversions import camera_info_msg
from homography_servo.nodes.conversions import joint_state_msg
from homography_servo.nodes.conversions import polygon_msg
from homography_servo.nodes.conversions import pose_stamped_msg
from homography_servo.nodes.conversions import transform_from_pose
from homography_servo.nodes.conversions import transforms_from_poses
from homography_servo.nodes.kit import LATCHED
from homography_servo.nodes.path_inbox import lead_from
from homography_servo.nodes.path_messages import predicted_trajectory_msg
from homography_servo.nodes.path_messages import verdict_msg
from homography_servo.places import find_config
from homography_servo.planning.feasibility import look
from homography_servo.planning.planner import plan
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import ImageMarker
from visualization_msgs.msg import MarkerArray

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
START_RAD = np.radians([-50.0, 40.0, 10.0, -10.0, 0.0, -20.0])
GOAL_RAD = np.radians([-5.0, 40.0, 10.0, -10.0, 0.0, -20.0])
KINDS = {'path/poses': PoseArray, 'path/image': Float64MultiArray,
         'path/joint_trajectory': JointTrajectory, 'path/verdict': DiagnosticArray,
         'path/markers': MarkerArray, 'path/image_markers': ImageMarker}


class Scene:
    """A camera and an arm that say where the object is."""

    def __init__(self, probe, robot):
        self.probe, self.robot = probe, robot
        self.points_m = face_corners(0.1, 0.06)
        self.rng = np.random.default_rng(4)
        self.poses = probe.record(PoseWithCovarianceStamped, 'object/pose')
        self.candidates = probe.record(PoseArray, 'object/pose_candidates')
        self.paths = {topic: probe.record(kind, topic, LATCHED) for topic, kind in KINDS.items()}
        self.corners = probe.publisher(PolygonStamped, 'object/corners')
        self.goal_corners = probe.publisher(PolygonStamped, 'goal/corners')
        self.goal_pose = probe.publisher(PoseStamped, 'goal/pose')
        self.joints = probe.publisher(JointState, 'joint_states')
        self.info = probe.publisher(CameraInfo, 'camera_info')
        probe.wait(lambda: probe.node.count_publishers('object/pose'), 'no object/pose')
        probe.wait(lambda: probe.node.count_publishers('path/poses'), 'no path/poses')
        probe.spin_for(0.3)

    def header(self, frame='camera_optical'):
        return Header(stamp=self.probe.stamp(), frame_id=frame)

    def seen(self, pose):
        return look(pose[None], CAMERA, self.points_m, 1.0).points_px[0]

    def show_camera(self):
        for _ in range(5):  # best effort: the first may come before the two have met
            self.info.publish(camera_info_msg(CAMERA, self.header()))
            self.probe.spin_for(0.05)

    def show(self, pose, joints_rad=None, looks=1, noise_px=0.1, order=slice(None)):
        """Publish joints and corners, and wait for the pose of each look."""
        for _ in range(looks):
            if joints_rad is not None:
                self.joints.publish(joint_state_msg(self.robot.joint_names, joints_rad,
                                                    self.header('')))
            corners = self.seen(pose)[order] + self.rng.normal(0.0, noise_px, (4, 2))
            before = len(self.poses)
            message = polygon_msg(corners, self.header())
            self.corners.publish(message)
            self.probe.wait(lambda: len(self.poses) > before, 'no pose for corners', 5.0)
            assert self.poses[-1].header.stamp == message.header.stamp
            assert self.poses[-1].header.frame_id == 'home'

    def ask(self, name):
        answer = self.probe.call(Trigger, f'path_planner/{name}')
        return answer.success, answer.message

    def last(self, topic, at_least=1):
        self.probe.wait(lambda: len(self.paths[topic]) >= at_least, f'nothing on {topic}')
        return self.paths[topic][-1]


@pytest.fixture
def robot():
    return load_robot(find_config('robix_rcs6.yaml'))


@pytest.fixture
def scene(probe, start_node, robot):
    start_node('path_planner')
    return Scene(probe, robot)


def test_the_trial_is_taught_and_planned_without_a_repair(scene, robot):
    scene.show_camera()
    goal, start = object_pose(robot, GOAL_RAD), object_pose(robot, START_RAD)
    scene.show(goal, GOAL_RAD, looks=20)
    success, sentence = scene.ask('teach_goal')
    assert success and '20 looks' in sentence and 'deg in tilt' in sentence
    scene.show(start, START_RAD, looks=20)
    success, sentence = scene.ask('plan')
    assert success and sentence.startswith('all 31 poses are feasible'), sentence

    poses = transforms_from_poses(scene.last('path/poses'))
    assert poses.shape == (31, 4, 4)
    assert np.abs(poses[0][:3, 3] - start[:3, 3]).max() < 0.01
    verdict = scene.last('path/verdict')
    assert verdict.header == scene.paths['path/poses'][-1].header
    assert len(verdict.status) == 32
    assert verdict.status[0].level == DiagnosticStatus.OK
    assert verdict.status[0].message == sentence
    image = scene.last('path/image')
    sizes = [(d.label, d.size) for d in image.layout.dim]
    assert sizes == [('pose', 31), ('corner', 4), ('uv', 2)]
    drawn = np.array(image.data).reshape(31, 4, 2)
    assert np.abs(drawn - look(poses, CAMERA, scene.points_m, 1.0).points_px).max() < 1e-6
    joints = scene.last('path/joint_trajectory')
    assert tuple(joints.joint_names) == robot.joint_names
    table = np.degrees([p.positions for p in joints.points])
    assert table[0] == pytest.approx(np.degrees(START_RAD), abs=1e-6)
    assert table[:, 0].min() == pytest.approx(-54.1, abs=2.0)
    assert table[:, 1].max() == pytest.approx(64.5, abs=2.0)
    markers = scene.last('path/markers').markers
    numbers = [v for m in markers for p in m.points for v in (p.x, p.y, p.z)]
    assert np.isfinite(numbers).all()
    assert len({(m.ns, m.id) for m in markers}) == len(markers)
    assert len(scene.last('path/image_markers').points) == 2 * 4 * 32


def test_every_missing_input_has_its_sentence(scene, robot):
    start = object_pose(robot, START_RAD)
    success, sentence = scene.ask('plan')
    assert not success and 'camera_info' in sentence
    assert 'camera_info' in scene.ask('teach_goal')[1]
    scene.show_camera()
    assert 'not seen' in scene.ask('plan')[1]
    scene.show(start, looks=3)
    assert 'no joint_states' in scene.ask('plan')[1]
    scene.show(start, START_RAD, looks=3)
    assert 'no goal' in scene.ask('plan')[1]
    assert 'looks' in scene.ask('teach_goal')[1]
    scene.probe.spin_for(0.6)
    assert 'has not been seen' in scene.ask('plan')[1]
    assert not scene.paths['path/poses'] and not scene.paths['path/verdict']


def plan_until(scene, fits):
    """Ask for a plan until what was sent before has arrived and the answer fits."""
    def answer():
        scene.show(object_pose(scene.robot, START_RAD), START_RAD)
        found = scene.ask('plan')
        return found if fits(found[1]) else None
    return scene.probe.wait(answer, 'never the right answer', 10.0)


def test_every_bad_goal_has_its_sentence_and_no_path(scene, robot):
    scene.show_camera()
    behind, aside, unreachable = np.eye(4), np.eye(4), np.eye(4)
    behind[2, 3], aside[0, 3], unreachable[2, 3] = -1.5, 0.6, 0.4
    goal_px = scene.seen(object_pose(robot, GOAL_RAD))

    def pose(goal, frame='home'):
        return lambda: scene.goal_pose.publish(pose_stamped_msg(goal, scene.header(frame)))

    def corners(points):
        return lambda: scene.goal_corners.publish(polygon_msg(points, scene.header()))
    for send, words in (
            (pose(behind), ['behind the camera']),
            (pose(aside), ['outside the image']),
            (pose(unreachable), ['no joints']),
            (pose(np.eye(4), 'base_link'), ["not 'base_link'"]),
            (corners(goal_px[::-1]), ['order', 'mirrored']),
            (corners(np.roll(goal_px, 1, axis=0)), ['order']),
            (corners(goal_px[[0, 1, 1, 3]]), ['coincide', 'line', 'degenerate']),
            (corners(goal_px[[0, 1, 2]]), ['4 corners']),
            (corners(None), ['empty']),
            (corners(np.full((4, 2), np.nan)), ['finite'])):
        send()
        success, _ = plan_until(scene, lambda sentence: any(w in sentence for w in words))
        assert not success
    assert not any(len(message.poses) for message in scene.paths['path/poses'])


def test_a_vetoed_path_shows_its_verdict_but_cannot_be_executed(scene, robot):
    scene.show_camera()
    unreachable = np.eye(4)
    unreachable[2, 3] = 0.4
    scene.goal_pose.publish(pose_stamped_msg(unreachable, scene.header('home')))
    success, sentence = plan_until(scene, lambda sentence: 'no joints' in sentence)
    assert not success
    verdict = scene.last('path/verdict')
    assert verdict.status[0].level == DiagnosticStatus.ERROR
    assert verdict.status[0].message == sentence
    assert any(s.level == DiagnosticStatus.ERROR for s in verdict.status[1:])
    assert scene.last('path/poses').header == verdict.header
    assert not scene.paths['path/poses'][-1].poses


def test_goal_corners_plan_like_a_taught_goal(scene, robot):
    scene.show_camera()
    goal_px = scene.seen(object_pose(robot, GOAL_RAD))
    scene.goal_corners.publish(polygon_msg(goal_px, scene.header()))
    success, sentence = plan_until(
        scene, lambda sentence: 'no goal' not in sentence and 'looks' not in sentence)
    assert success, sentence


def test_the_arm_decides_between_the_minima_and_bad_corners_are_counted(scene, robot):
    scene.show_camera()
    tilted = START_RAD + np.radians([0.0, 0.0, 0.0, -25.0, 0.0, 0.0])
    pose = object_pose(robot, tilted)
    scene.show(pose, tilted, looks=10, noise_px=0.5)
    for message in scene.poses:
        found = transform_from_pose(message.pose.pose)
        turn = found[:3, :3] @ pose[:3, :3].T
        assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))) < 20.0
        covariance = np.array(message.pose.covariance).reshape(6, 6)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    scene.probe.wait(lambda: len(scene.candidates) == len(scene.poses), 'candidates missing')
    before = len(scene.poses)
    for points in (None, scene.seen(pose)[:3], scene.seen(pose)[::-1], np.full((4, 2), np.inf)):
        scene.corners.publish(polygon_msg(points, scene.header()))
    scene.show(pose, tilted)
    assert len(scene.poses) == before + 1


def test_without_a_robot_file_the_object_flies_freely(probe, start_node, robot):
    start_node('path_planner', robot_file="''", poses=0)
    scene = Scene(probe, robot)
    scene.show_camera()
    start, goal = object_pose(robot, START_RAD), object_pose(robot, GOAL_RAD)
    scene.goal_pose.publish(pose_stamped_msg(goal, scene.header('home')))
    scene.probe.spin_for(0.3)
    scene.show(start, looks=3)
    success, sentence = scene.ask('plan')
    assert success, sentence
    poses = transforms_from_poses(scene.last('path/poses'))
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps_m.max() < 0.0501
    assert not scene.last('path/joint_trajectory').points


def test_a_robot_file_that_is_not_there_ends_with_code_2(start_node):
    node = start_node('path_planner', robot_file='nowhere.yaml')
    assert node.wait() == 2
    assert 'nowhere.yaml' in node.output and 'Traceback' not in node.output


def test_the_servo_reads_where_planned_joints_lead_through_a_singularity(robot):
    start = np.radians([73.0, -64.0, -18.0, 47.0, 22.0, -64.0])
    goal = np.radians([-15.0, 17.0, 31.0, -8.0, -43.0, 69.0])
    found = plan(object_pose(robot, start), object_pose(robot, goal), CAMERA, robot, start,
                 goal_joints_rad=goal)
    assert found.ok and 'through a singularity' in found.family
    header = Header(frame_id='home')
    header.stamp.sec = 7
    verdict = verdict_msg(found, header, robot)
    joints = predicted_trajectory_msg(found, robot, header)
    lead = lead_from(verdict, joints, robot.joint_names)
    led = found.verdict.values.led
    assert lead.needed and [lead.passes(k) for k in range(len(led))] == [*led[:-1], False]
    assert lead.note(0, start) and np.abs(lead.target(20) - found.joints_rad[20]).max() < 1e-9
    assert lead_from(verdict, None, robot.joint_names) is None
    other = predicted_trajectory_msg(found, robot, Header(frame_id='home'))
    assert lead_from(verdict, other, robot.joint_names) is None
