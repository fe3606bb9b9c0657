"""A trial's record is made from messages alone, live or replayed."""

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from homography_servo.nodes import conversions as c
from homography_servo.nodes.trial_log import TrialLog
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import Header
from std_msgs.msg import MultiArrayDimension
from std_msgs.msg import String

COUNT = 3


def shifted(x_m: float) -> np.ndarray:
    """Make a pose moved along x."""
    pose = np.eye(4)
    pose[0, 3] = x_m
    return pose


def progress(pose: int, iterations: int, **more: str) -> DiagnosticStatus:
    """Make a progress message."""
    values = {'pose': pose, 'of': COUNT, 'position_error_m': 0.001 * pose,
              'rotation_error_rad': 0.01, 'iterations': iterations, **more}
    return DiagnosticStatus(values=[KeyValue(key=k, value=str(v)) for k, v in values.items()])


def planned(log: TrialLog) -> None:
    """Feed a plan of three poses."""
    log.feed('path/poses', c.pose_array_msg([shifted(0.1 * k) for k in range(COUNT)], Header()), 0)
    image = Float64MultiArray(data=[float(v) for v in range(COUNT * 8)])
    image.layout.dim = [MultiArrayDimension(size=n) for n in (COUNT, 4, 2)]
    log.feed('path/image', image, 0.0)
    log.feed('path/joint_trajectory',
             c.trajectory_msg(['a', 'b'], np.zeros((COUNT, 2)), range(COUNT)), 0.0)
    log.feed('path/verdict', DiagnosticArray(status=[
        DiagnosticStatus(name='path_planner: path', message='good')]), 0.0)


def joints(position: float, velocity: float) -> JointState:
    """Make a joint state of two joints."""
    return JointState(name=['a', 'b'], position=[position, 0.0], velocity=[velocity, 0.0])


def text(log: TrialLog, topic: str, words: str, time_s: float) -> None:
    """Feed a text."""
    log.feed(topic, String(data=words), time_s)


def run_through(log: TrialLog) -> None:
    """Feed a short trial that converges."""
    planned(log)
    image = c.image_msg(np.full((48, 64), 9, np.uint8), Header())
    log.feed('image', image, 0.0)
    log.feed('object/true_pose', c.pose_stamped_msg(shifted(0.2), Header()), 1.0)
    text(log, 'servo_trial/events', 'taught', 1.0)
    text(log, 'servo_trial/events', 'started: all is well', 10.0)
    for time_s, position, velocity in ((10.0, 0.0, 0.0), (11.0, 0.1, 0.5), (12.0, 0.2, 0.0),
                                       (13.0, 0.2, 0.0)):
        log.feed('joint_states', joints(position, velocity), time_s)
    for pose, looks in ((1, 1), (1, 2), (2, 1), (3, 1), (3, 2)):
        log.feed('visual_servo/progress', progress(pose, looks), 10.0 + pose)
    log.feed('object/true_pose', c.pose_stamped_msg(shifted(0.2003), Header()), 14.0)
    text(log, 'visual_servo/state', 'DONE', 14.0)
    text(log, 'servo_trial/events', 'ended: converged: at the goal', 15.0)


def test_a_trial_is_put_together_from_its_messages():
    log = TrialLog()
    run_through(log)
    data = log.data
    assert data.converged and data.verdict == 'at the goal'
    assert data.plan_sentence == 'all is well'
    assert [(p.index, p.iterations, p.reached) for p in data.poses] == [
        (1, 2, True), (2, 1, True), (3, 2, True)]
    assert data.duration_s == 5.0 and data.motion_s == 1.0
    assert data.final_true_error['lateral_m'] == pytest.approx(3e-4)
    assert data.plan.corners_px.shape == (COUNT, 4, 2) and data.plan.joints_rad.shape == (COUNT, 2)
    assert data.states == [(4.0, 'DONE')]
    assert data.snapshots[-1].index == COUNT and data.snapshots[-1].image.shape == (48, 64)


def test_what_is_damaged_is_left_out():
    log = TrialLog()
    text(log, 'servo_trial/events', 'started', 0.0)
    log.feed('visual_servo/progress', progress(0, 1), 1.0)
    log.feed('visual_servo/progress', progress(1, 1, position_error_m='nan'), 1.0)
    log.feed('visual_servo/progress', DiagnosticStatus(), 1.0)
    log.feed('joint_states', joints(float('nan'), 0.0), 1.0)
    log.feed('joint_states', JointState(), 1.0)
    log.feed('path/image', Float64MultiArray(data=[1.0]), 1.0)
    log.feed('something/else', String(), 1.0)
    text(log, 'servo_trial/events', 'ended: failed: nothing came', 2.0)
    assert not log.data.poses and not log.data.joint_track
    assert not log.data.converged and log.data.verdict == 'nothing came'
    assert log.data.final_true_error is None and log.camera() is None


def test_poses_outside_the_run_do_not_count():
    log = TrialLog()
    log.feed('visual_servo/progress', progress(1, 1), 0.0)
    assert not log.data.poses
