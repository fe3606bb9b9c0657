"""
Messages to arrays and back; the only place that fills message fields.

rclpy does not check field types, so every number passes ``float()`` or ``int()``
here. What cannot be used comes back as `Rejected`.
"""

from __future__ import annotations

import array
from functools import lru_cache
import math
from typing import Iterable, Sequence

from builtin_interfaces.msg import Duration
from builtin_interfaces.msg import Time
import cv2
from geometry_msgs.msg import Point32
from geometry_msgs.msg import Polygon
from geometry_msgs.msg import PolygonStamped
from geometry_msgs.msg import Pose
from geometry_msgs.msg import PoseArray
from geometry_msgs.msg import PoseStamped
from geometry_msgs.msg import PoseWithCovarianceStamped
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.camera import camera_from_calibration
from homography_servo.geometry.quaternion import quaternion_of
from homography_servo.geometry.quaternion import rotation_of
from homography_servo.result import Rejected
import numpy as np
from scipy.linalg import lapack
from sensor_msgs.msg import CameraInfo
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_msgs.msg import Header
from std_msgs.msg import MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory
from trajectory_msgs.msg import JointTrajectoryPoint

_CHANNELS = {'mono8': 1, 'bgr8': 3, 'rgb8': 3, 'bgra8': 4, 'rgba8': 4}
_TO_GREY = {'bgr8': cv2.COLOR_BGR2GRAY, 'rgb8': cv2.COLOR_RGB2GRAY,
            'bgra8': cv2.COLOR_BGRA2GRAY, 'rgba8': cv2.COLOR_RGBA2GRAY}
_TO_BGR = {'mono8': cv2.COLOR_GRAY2BGR, 'rgb8': cv2.COLOR_RGB2BGR,
           'bgra8': cv2.COLOR_BGRA2BGR, 'rgba8': cv2.COLOR_RGBA2BGR}
LARGEST_IMAGE_BYTES = 1 << 28
LONGEST_PATH = 2000


def seconds_from_stamp(stamp: Time) -> float:
    """Give a time stamp in seconds; a float keeps about 0.2 us today."""
    return stamp.sec + 1e-9 * stamp.nanosec


def stamp_from_seconds(time_s: float) -> Time:
    """Give a time stamp from seconds."""
    nanoseconds = int(round(time_s * 1e9))
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def stamp_text(stamp: Time) -> str:
    """Write a time stamp down to the nanosecond."""
    return f'{stamp.sec}.{stamp.nanosec:09d}'


def seconds_from_duration(duration: Duration) -> float:
    """Give a duration in seconds."""
    return duration.sec + 1e-9 * duration.nanosec


def duration_from_seconds(time_s: float) -> Duration:
    """Give a duration message from seconds."""
    nanoseconds = int(round(time_s * 1e9))
    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def pixels_from_image(msg: Image) -> np.ndarray | Rejected:
    """
    View the pixels of an image message without a copy.

    Returns
    -------
    (H, W) or (H, W, C) uint8 array, or Rejected
        In the encoding of the message, rows cut to their width when ``step`` is
        larger.

    """
    channels = _CHANNELS.get(msg.encoding)
    if channels is None:
        return Rejected(f'encoding {msg.encoding!r} is none of {", ".join(_CHANNELS)}')
    row, height = msg.width * channels, msg.height
    if row == 0 or height == 0:
        return Rejected(f'the image is empty ({msg.width} x {msg.height})')
    if msg.step < row:
        return Rejected(f'step {msg.step} is shorter than a row of {row} bytes')
    if msg.step * height > LARGEST_IMAGE_BYTES:
        return Rejected(f'the image is too large ({msg.width} x {height})')
    # The last row may lack its padding.
    if len(msg.data) < msg.step * (height - 1) + row:
        return Rejected(f'the image is cut short: {len(msg.data)} of {msg.step * height} bytes')
    flat = np.frombuffer(msg.data, np.uint8)
    strides = (msg.step, channels, 1)
    pixels = np.lib.stride_tricks.as_strided(flat, (height, msg.width, channels), strides,
                                             writeable=False)
    return pixels[:, :, 0] if channels == 1 else pixels


def grey_from_image(msg: Image) -> np.ndarray | Rejected:
    """Give the (H, W) uint8 grey image, without a copy where it is grey already."""
    pixels = pixels_from_image(msg)
    if isinstance(pixels, Rejected) or msg.encoding == 'mono8':
        return pixels
    return cv2.cvtColor(np.ascontiguousarray(pixels), _TO_GREY[msg.encoding])


def bgr_from_image(msg: Image) -> np.ndarray | Rejected:
    """Give a (H, W, 3) uint8 colour image that may be drawn on."""
    pixels = pixels_from_image(msg)
    if isinstance(pixels, Rejected):
        return pixels
    if msg.encoding == 'bgr8':
        return pixels.copy()
    return cv2.cvtColor(np.ascontiguousarray(pixels), _TO_BGR[msg.encoding])


def image_msg(pixels: np.ndarray, header: Header, encoding: str | None = None) -> Image:
    """Make an image message of a (H, W) mono8 or (H, W, 3) bgr8 array."""
    encoding = encoding or ('mono8' if pixels.ndim == 2 else 'bgr8')
    data = array.array('B')  # filling an array is 1000 times faster than msg.data = ndarray
    data.frombytes(np.ascontiguousarray(pixels))
    height, width = pixels.shape[:2]
    return Image(header=header, height=height, width=width, encoding=encoding,
                 is_bigendian=0, step=width * _CHANNELS[encoding], data=data)


def camera_from_info(msg: CameraInfo) -> Camera | Rejected:
    """Read the camera model of a CameraInfo message."""
    return _camera(int(msg.width), int(msg.height), tuple(map(float, msg.k)),
                   tuple(map(float, msg.d)), msg.distortion_model)


@lru_cache(maxsize=16)
def _camera(width: int, height: int, k: tuple[float, ...], d: tuple[float, ...], model: str
            ) -> Camera | Rejected:
    """Every image brings the same numbers again."""
    return camera_from_calibration(width, height, k, d, model)


def camera_info_msg(camera: Camera, header: Header) -> CameraInfo:
    """Make a CameraInfo message of a camera model."""
    k = [float(v) for v in camera.matrix.ravel()]
    p = np.hstack([camera.matrix, np.zeros((3, 1))])
    return CameraInfo(header=header, width=int(camera.width), height=int(camera.height),
                      distortion_model=camera.distortion_model,
                      d=[float(v) for v in camera.distortion], k=k,
                      r=[float(v) for v in np.eye(3).ravel()],
                      p=[float(v) for v in p.ravel()])


def polygon_msg(points_px: np.ndarray | None, header: Header) -> PolygonStamped:
    """Make a polygon of (N, 2) pixels; None gives an empty one."""
    rows: Iterable = () if points_px is None else np.asarray(points_px, dtype=float).tolist()
    points = [Point32(x=u, y=v, z=0.0) for u, v in rows]
    return PolygonStamped(header=header, polygon=Polygon(points=points))


def points_from_polygon(msg: PolygonStamped) -> np.ndarray | Rejected:
    """Give the (N, 2) pixels of a polygon, N may be 0."""
    points_px = np.array([(p.x, p.y) for p in msg.polygon.points], dtype=float).reshape(-1, 2)
    if not np.isfinite(points_px).all():
        return Rejected('a corner is not a finite number')
    return points_px


def corners_from_polygon(msg: PolygonStamped) -> np.ndarray | Rejected | None:
    """Give the (4, 2) corners of a polygon, None where it is empty."""
    points_px = points_from_polygon(msg)
    if isinstance(points_px, Rejected):
        return points_px
    if len(points_px) not in (0, 4):
        return Rejected(f'4 corners are needed, {len(points_px)} came')
    return points_px if len(points_px) else None


def covariance_msg(covariance: np.ndarray, header: Header) -> Float64MultiArray:
    """
    Make a message of an (n, n) covariance.

    The message has no header, so its stamp travels as the label of the first axis.
    """
    size = len(covariance)
    msg = Float64MultiArray(data=np.asarray(covariance, dtype=float).ravel().tolist())
    stamp = stamp_text(header.stamp)
    msg.layout.dim = [MultiArrayDimension(label=stamp, size=size, stride=size * size),
                      MultiArrayDimension(label='column', size=size, stride=size)]
    return msg


def covariance_from_msg(msg: Float64MultiArray, size: int) -> np.ndarray | Rejected:
    """Give the (size, size) covariance of a message."""
    if len(msg.data) != size * size:
        return Rejected(f'{size} x {size} numbers are needed, {len(msg.data)} came')
    covariance = np.array(msg.data, dtype=float).reshape(size, size)
    if not np.isfinite(covariance).all() or lapack.dpotrf(covariance)[1]:
        return Rejected('it is not finite and positive definite')
    return covariance


def stamp_label(msg: Float64MultiArray) -> str:
    """Give the stamp that `covariance_msg` has written down."""
    return msg.layout.dim[0].label if msg.layout.dim else ''


def pose_msg(a_from_b: np.ndarray) -> Pose:
    """Make a pose message of a (4, 4) transform."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = (float(v) for v in a_from_b[:3, 3])
    q = pose.orientation
    q.x, q.y, q.z, q.w = quaternion_of(a_from_b[:3, :3])
    return pose


def transform_from_pose(msg: Pose) -> np.ndarray | Rejected:
    """Give the (4, 4) transform of a pose message."""
    p, q = msg.position, msg.orientation
    norm = math.hypot(q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, (p.x, p.y, p.z, norm))):
        return Rejected('the pose is not finite')
    if abs(norm - 1.0) > 1e-3:
        return Rejected(f'the quaternion has length {norm:.4g} instead of 1')
    a_from_b = np.eye(4)
    a_from_b[:3, :3] = rotation_of(q.x, q.y, q.z, q.w)
    a_from_b[:3, 3] = p.x, p.y, p.z
    return a_from_b


def pose_stamped_msg(a_from_b: np.ndarray, header: Header) -> PoseStamped:
    """Make a stamped pose of a (4, 4) transform."""
    return PoseStamped(header=header, pose=pose_msg(a_from_b))


def pose_covariance_msg(a_from_b: np.ndarray, covariance: np.ndarray,
                        header: Header) -> PoseWithCovarianceStamped:
    """Make a pose with its (6, 6) covariance, order x, y, z, rotation."""
    msg = PoseWithCovarianceStamped(header=header)
    msg.pose.pose = pose_msg(a_from_b)
    msg.pose.covariance = [float(v) for v in np.asarray(covariance).ravel()]
    return msg


def pose_array_msg(transforms: Sequence[np.ndarray], header: Header) -> PoseArray:
    """Make a pose array of (4, 4) transforms."""
    return PoseArray(header=header, poses=[pose_msg(item) for item in transforms])


def transforms_from_poses(msg: PoseArray) -> np.ndarray | Rejected:
    """Give the (N, 4, 4) transforms of a pose array."""
    transforms = [transform_from_pose(pose) for pose in msg.poses]
    for index, item in enumerate(transforms):
        if isinstance(item, Rejected):
            return Rejected(f'pose {index + 1} of {len(transforms)}: {item.reason}')
    return np.array(transforms).reshape(-1, 4, 4)


def joint_state_msg(names: Sequence[str], position_rad: np.ndarray, header: Header,
                    velocity_rad_s: np.ndarray | None = None) -> JointState:
    """Make a joint state message."""
    msg = JointState(header=header, name=list(names))
    msg.position = [float(v) for v in position_rad]
    if velocity_rad_s is not None:
        msg.velocity = [float(v) for v in velocity_rad_s]
    return msg


def joints_from_state(msg: JointState, names: Sequence[str]) -> np.ndarray | Rejected:
    """Give the positions of named joints in their order, whatever the message's order."""
    if len(msg.position) != len(msg.name):
        return Rejected(f'{len(msg.name)} names but {len(msg.position)} positions')
    if len(set(msg.name)) != len(msg.name):
        return Rejected('a joint is named twice')
    known = dict(zip(msg.name, msg.position))
    missing = [name for name in names if name not in known]
    if missing:
        return Rejected(f'joint {missing[0]} is missing')
    joints_rad = np.array([known[name] for name in names], dtype=float)
    if not np.isfinite(joints_rad).all():
        return Rejected('a joint position is not a finite number')
    return joints_rad


def velocity_from_state(msg: JointState, names: Sequence[str]) -> np.ndarray | None:
    """Give the velocities of named joints, None where the message has none."""
    if len(msg.velocity) != len(msg.name):
        return None
    known = dict(zip(msg.name, msg.velocity))
    return np.array([known.get(name, np.nan) for name in names], dtype=float)


def trajectory_msg(names: Sequence[str], points_rad: Sequence[np.ndarray],
                   times_s: Sequence[float], header: Header | None = None) -> JointTrajectory:
    """Make a joint trajectory; a header stamp of zero means now, no points mean stop."""
    msg = JointTrajectory(header=header or Header(), joint_names=list(names))
    for joints_rad, time_s in zip(points_rad, times_s):
        msg.points.append(JointTrajectoryPoint(
            positions=np.asarray(joints_rad, dtype=float).tolist(),
            time_from_start=duration_from_seconds(float(time_s))))
    return msg


def image_path_msg(corners_px: np.ndarray) -> Float64MultiArray:
    """Make the path in the image: (N, M, 2) pixels, labelled pose, corner, uv."""
    msg = Float64MultiArray()
    sizes = corners_px.shape
    for axis, (label, size) in enumerate(zip(('pose', 'corner', 'uv'), sizes)):
        stride = int(np.prod(sizes[axis:]))
        msg.layout.dim.append(MultiArrayDimension(label=label, size=int(size), stride=stride))
    msg.data = [float(v) for v in corners_px.ravel()]
    return msg


def image_path_from_msg(msg: Float64MultiArray) -> np.ndarray | Rejected:
    """Read a path in the image: (N, M, 2) pixels, NaN where a corner has no place."""
    sizes = [int(dim.size) for dim in msg.layout.dim]
    if len(sizes) != 3 or sizes[2] != 2 or sizes[0] > LONGEST_PATH:
        return Rejected(f'the path in the image has sizes {sizes} instead of [poses, corners, 2]')
    if math.prod(sizes) != len(msg.data):
        return Rejected(f'the path in the image has {len(msg.data)} numbers, not {sizes}')
    return np.array(msg.data, dtype=float).reshape(sizes)
