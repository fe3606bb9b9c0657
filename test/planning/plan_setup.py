"""The default arm and camera, and random pairs of postures that can be seen."""

from homography_servo.geometry.camera import Camera
from homography_servo.places import find_config
from homography_servo.planning.feasibility import look
from homography_servo.robot.kinematics import object_jacobian
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
import numpy as np

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
ROBOT = load_robot(find_config('robix_rcs6.yaml'))
START_RAD = np.radians([-50.0, 40.0, 10.0, -10.0, 0.0, -20.0])
GOAL_RAD = np.radians([-5.0, 40.0, 10.0, -10.0, 0.0, -20.0])
POINTS_M = ROBOT.object_points_m


def smallest(joints_rad):
    """Give the smallest singular value of the Jacobian, lengths in units of 0.1 m."""
    scaled = object_jacobian(ROBOT, joints_rad) * np.array([10.0] * 3 + [1.0] * 3)[:, None]
    return np.linalg.svd(scaled, compute_uv=False)[..., -1]


def postures(count, seed, least=0.03):
    """Draw joint vectors, one a row, that the camera sees well and that are not singular."""
    rng = np.random.default_rng(seed)
    found = np.zeros((0, 6))
    while len(found) < count:
        joints = rng.uniform(ROBOT.lower_rad + 0.06, ROBOT.upper_rad - 0.06, (500, 6))
        seen = look(object_pose(ROBOT, joints), CAMERA, POINTS_M, ROBOT.home_depth_m)
        good = (seen.border_px.min(axis=1) > 12.0) & (seen.facing_rad < 1.0)
        joints = joints[good]
        found = np.concatenate([found, joints[smallest(joints) > least]])
    return found[:count]
