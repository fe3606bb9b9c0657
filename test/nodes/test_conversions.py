"""Messages to arrays and back."""

from geometry_msgs.msg import Point32
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import Pose
from homography_servo.geometry.camera import Camera
from homography_servo.nodes import conversions as c
from homography_servo.result import Rejected
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

CHANNELS = {'mono8': 1, 'bgr8': 3, 'rgb8': 3, 'bgra8': 4, 'rgba8': 4}


def image(encoding: str, padding: int = 0) -> tuple[Image, np.ndarray]:
    """Make an image with a different grey in every pixel and odd padding."""
    height, width, channels = 5, 7, CHANNELS[encoding]
    grey = np.arange(height * width, dtype=np.uint8).reshape(height, width)
    pixels = np.repeat(grey[:, :, None], channels, axis=2).reshape(height, -1)
    rows = np.hstack([pixels, np.full((height, padding), 255, np.uint8)])
    return Image(height=height, width=width, encoding=encoding, step=rows.shape[1],
                 data=rows.tobytes()), grey


@pytest.mark.parametrize('encoding', CHANNELS)
@pytest.mark.parametrize('padding', [0, 1, 13])
def test_every_encoding_and_any_step_gives_the_same_grey(encoding, padding):
    msg, grey = image(encoding, padding)
    assert np.array_equal(c.grey_from_image(msg), grey)
    assert np.array_equal(c.bgr_from_image(msg)[:, :, 1], grey)


@pytest.mark.parametrize('change, said', [
    ({'encoding': '16UC1'}, 'encoding'), ({'width': 0}, 'empty'), ({'height': 0}, 'empty'),
    ({'step': 3}, 'shorter than a row'), ({'height': 6}, 'cut short'),
    ({'height': 2**31, 'step': 2**31}, 'too large'),
])
def test_damaged_images_are_rejected_with_a_reason(change, said):
    msg, _ = image('mono8')
    for key, value in change.items():
        setattr(msg, key, value)
    assert said in c.grey_from_image(msg).reason


def test_the_last_row_may_lack_its_padding():
    msg, grey = image('mono8', 3)
    msg.data = msg.data[:-3]
    assert np.array_equal(c.grey_from_image(msg), grey)


@pytest.mark.parametrize('shape', [(4, 6), (4, 6, 3)])
def test_images_survive_the_round_trip(shape):
    pixels = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    assert np.array_equal(c.pixels_from_image(c.image_msg(pixels, Header())), pixels)


def test_poses_survive_the_round_trip():
    rng = np.random.default_rng(2)
    for _ in range(50):
        transform = np.eye(4)
        transform[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
        transform[:3, 3] = rng.normal(size=3)
        assert np.allclose(c.transform_from_pose(c.pose_msg(transform)), transform, atol=1e-12)


@pytest.mark.parametrize('field, value, said', [
    ('position', np.nan, 'finite'), ('orientation', np.inf, 'finite'),
    ('orientation', 5.0, 'length')])
def test_bad_poses_are_rejected(field, value, said):
    pose = Pose()
    pose.orientation.w = 1.0
    getattr(pose, field).x = value
    assert said in c.transform_from_pose(pose).reason


def test_zero_quaternion_is_no_rotation():
    pose = Pose()
    pose.orientation.w = 0.0
    assert 'length 0' in c.transform_from_pose(pose).reason


def test_corners_are_four_or_none():
    corners_px = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]])
    assert np.allclose(c.corners_from_polygon(c.polygon_msg(corners_px, Header())), corners_px)
    assert c.corners_from_polygon(c.polygon_msg(None, Header())) is None
    assert '3 came' in c.corners_from_polygon(c.polygon_msg(corners_px[:3], Header())).reason
    bad = PolygonStamped()
    bad.polygon.points = [Point32(x=float('nan'))]
    assert 'finite' in c.corners_from_polygon(bad).reason


def test_joints_are_found_by_name():
    msg = JointState(name=['b', 'a'], position=[2.0, 1.0], velocity=[4.0, 3.0])
    assert np.array_equal(c.joints_from_state(msg, ['a', 'b']), [1.0, 2.0])
    assert np.array_equal(c.velocity_from_state(msg, ['a', 'b']), [3.0, 4.0])
    assert 'c is missing' in c.joints_from_state(msg, ['a', 'c']).reason


@pytest.mark.parametrize('names, positions, said', [
    (['a'], [], 'positions'), (['a', 'a'], [1.0, 2.0], 'twice'), (['a'], [np.nan], 'finite')])
def test_bad_joint_states_are_rejected(names, positions, said):
    assert said in c.joints_from_state(JointState(name=names, position=positions), ['a']).reason


def test_camera_survives_the_round_trip():
    camera = Camera(800.0, 810.0, 319.5, 239.5, 640, 480, 'plumb_bob', (-0.2, 0.05, 0.0, 0.0, 0.0))
    again = c.camera_from_info(c.camera_info_msg(camera, Header()))
    assert again == camera


def test_uncalibrated_camera_is_rejected():
    assert isinstance(c.camera_from_info(CameraInfo(width=640, height=480)), Rejected)


@pytest.mark.parametrize('time_s', [0.0, 0.25, 1.7e9 + 0.123456789, 12.999999999])
def test_stamps_keep_their_time(time_s):
    stamp = c.stamp_from_seconds(time_s)
    assert 0 <= stamp.nanosec < 10**9
    assert c.seconds_from_stamp(stamp) == pytest.approx(time_s, abs=1e-6)
    assert c.seconds_from_duration(c.duration_from_seconds(time_s)) == pytest.approx(
        time_s, abs=1e-6)


def test_trajectories_hold_plain_floats():
    msg = c.trajectory_msg(['a', 'b'], [np.array([1, 2]), np.float32([3, 4])], [0.5, 1])
    assert [list(p.positions) for p in msg.points] == [[1.0, 2.0], [3.0, 4.0]]
    assert all(isinstance(v, float) for p in msg.points for v in p.positions)
    assert msg.points[1].time_from_start.sec == 1


def test_covariances_keep_their_stamp_and_bad_ones_are_rejected():
    root = np.random.default_rng(4).normal(size=(8, 8))
    header = Header(stamp=c.stamp_from_seconds(12.25))
    msg = c.covariance_msg(root @ root.T, header)
    assert c.covariance_from_msg(msg, 8) == pytest.approx(root @ root.T)
    assert c.stamp_label(msg) == '12.250000000'
    assert '64' in c.covariance_from_msg(msg, 6).reason
    msg.data[0] = float('nan')
    assert 'finite' in c.covariance_from_msg(msg, 8).reason
    assert 'positive' in c.covariance_from_msg(c.covariance_msg(-np.eye(8), header), 8).reason
