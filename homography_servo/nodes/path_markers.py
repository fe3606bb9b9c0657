"""A plan as pictures: markers for RViz, image markers for Foxglove."""

from __future__ import annotations

from geometry_msgs.msg import Point
from homography_servo.geometry.camera import Camera
from homography_servo.nodes.conversions import pose_msg
from homography_servo.planning.planner import Plan
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
import numpy as np
from std_msgs.msg import ColorRGBA
from std_msgs.msg import Header
from visualization_msgs.msg import ImageMarker
from visualization_msgs.msg import Marker
from visualization_msgs.msg import MarkerArray

GOOD = ColorRGBA(r=0.2, g=0.8, b=0.3, a=0.9)
BAD = ColorRGBA(r=0.9, g=0.2, b=0.2, a=0.9)
PATH = ColorRGBA(r=0.2, g=0.5, b=1.0, a=0.9)
HOME = ColorRGBA(r=0.9, g=0.9, b=0.3, a=0.9)
QUIET = ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.5)
AXES = (BAD, GOOD, PATH)
AXIS_M = 0.02
_REACH_SAMPLES = 2000


def marker_array(plan: Plan, camera: Camera, points_m: np.ndarray, home_depth_m: float,
                 robot: Robot | None, header: Header) -> MarkerArray:
    """Draw faces, axes, the way of the centre, the camera's view and the arm's reach."""
    faces = points_m @ np.swapaxes(plan.poses[:, :3, :3], 1, 2) + plan.poses[:, None, :3, 3]
    colors = [BAD if reason else GOOD for reason in plan.verdict.reasons]
    clear = Marker(header=header, action=Marker.DELETEALL)
    shapes = [
        _lines(header, 'faces', _outlines(faces), _repeat(colors, 2 * faces.shape[1]), 0.001),
        _lines(header, 'axes', *_axes(plan.poses), 0.001),
        _lines(header, 'centres', _pairs(plan.poses[:, :3, 3]), PATH, 0.002),
        _lines(header, 'home', _outlines(points_m[None]), HOME, 0.001),
        _lines(header, 'camera', _frustum(camera, home_depth_m), QUIET, 0.002),
    ]
    if robot is not None:
        shapes.append(_lines(header, 'reach', _reach(robot), QUIET, 0.002))
    return MarkerArray(markers=[clear, *shapes])


def image_marker(plan: Plan, home_px: np.ndarray, header: Header) -> ImageMarker:
    """Draw the faces of the path and of the virtual home pose into the image."""
    colors = _repeat([BAD if reason else GOOD for reason in plan.verdict.reasons],
                     2 * plan.corners_px.shape[1])
    corners = np.concatenate([plan.corners_px, home_px[None]])
    colors += [HOME] * (2 * len(home_px))
    points = _outlines(corners)
    good = np.isfinite(points).all(axis=1).reshape(-1, 2).all(axis=1).repeat(2)
    return ImageMarker(
        header=header, ns='path', id=0, type=ImageMarker.LINE_LIST, action=ImageMarker.ADD,
        scale=1.0, outline_color=PATH, points=_points(points[good]),
        outline_colors=[c for c, keep in zip(colors, good) if keep])


def _lines(header: Header, name: str, points: np.ndarray, colors: list | ColorRGBA,
           width_m: float) -> Marker:
    marker = Marker(header=header, ns=name, id=0, type=Marker.LINE_LIST, action=Marker.ADD,
                    pose=pose_msg(np.eye(4)), points=_points(points))
    marker.scale.x = float(width_m)
    if isinstance(colors, list):
        marker.colors = colors
        marker.color = GOOD
    else:
        marker.color = colors
    return marker


def _points(points: np.ndarray) -> list[Point]:
    flat = np.zeros((len(points), 3))
    flat[:, :points.shape[1]] = points
    return [Point(x=x, y=y, z=z) for x, y, z in flat.tolist()]


def _outlines(polygons: np.ndarray) -> np.ndarray:
    """Turn (N, M, d) closed polygons into pairs of ends (N * 2 M, d)."""
    ends = np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=2)
    return ends.reshape(-1, polygons.shape[2])


def _pairs(points: np.ndarray) -> np.ndarray:
    return np.stack([points[:-1], points[1:]], axis=1).reshape(-1, points.shape[1])


def _repeat(items: list, times: int) -> list:
    return [item for item in items for _ in range(times)]


def _axes(poses: np.ndarray) -> tuple[np.ndarray, list[ColorRGBA]]:
    origin = np.repeat(poses[:, None, :3, 3], 3, axis=1)
    tips = origin + AXIS_M * np.swapaxes(poses[:, :3, :3], 1, 2)
    points = np.stack([origin, tips], axis=2).reshape(-1, 3)
    return points, _repeat(list(AXES), 2) * len(poses)


def _frustum(camera: Camera, home_depth_m: float) -> np.ndarray:
    w, h = camera.width - 1.0, camera.height - 1.0
    border = camera.rays(np.array([[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]]))
    eye = np.array([0.0, 0.0, -home_depth_m])
    far = np.column_stack([border * home_depth_m, np.zeros(4)])
    edges = np.stack([np.repeat(eye[None], 4, axis=0), far], axis=1).reshape(-1, 3)
    return np.concatenate([edges, _outlines(far[None])])


def _reach(robot: Robot) -> np.ndarray:
    """Outline, seen from above, what the object's centre can reach inside the limits."""
    rng = np.random.default_rng(0)
    joints = rng.uniform(robot.lower_rad, robot.upper_rad, (_REACH_SAMPLES, robot.count))
    base_from_home = np.linalg.inv(robot.home_from_base)
    places = (base_from_home @ object_pose(robot, joints))[:, :3, 3]
    sector = np.floor(np.arctan2(places[:, 1], places[:, 0]) / (np.pi / 18)).astype(int)
    distance = np.hypot(places[:, 0], places[:, 1])
    rim = np.array([places[sector == s][np.argmax(distance[sector == s])]
                    for s in np.unique(sector)])
    rim[:, 2] = 0.0
    in_home = rim @ robot.home_from_base[:3, :3].T + robot.home_from_base[:3, 3]
    return _pairs(in_home)
