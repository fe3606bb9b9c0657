"""Random cameras, poses and views that the tests of the geometry share."""

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.face import face_corners
from homography_servo.geometry.rigid import transform
from homography_servo.geometry.rigid import transform_points
from hypothesis import strategies as st
import numpy as np
from scipy.spatial.transform import Rotation

PINHOLE = Camera(800.0, 790.0, 319.5, 239.5, 640, 480)
BENT = Camera(800.0, 790.0, 319.5, 239.5, 640, 480, 'plumb_bob',
              (-0.3, 0.1, 0.001, -0.002, 0.02))
FACE_M = face_corners(0.10, 0.06)
SOLID_M = np.vstack([FACE_M, FACE_M + (0.0, 0.0, 0.04)])
SHAPES = {'face': FACE_M, 'grid': np.vstack([FACE_M, 0.5 * FACE_M, [[0.01, 0.0, 0.0]]]),
          'solid': SOLID_M, 'four solid points': np.vstack([FACE_M[:3], SOLID_M[7]])}

angles = st.floats(-np.pi, np.pi)
lengths = st.floats(-2.0, 2.0)
vectors = st.tuples(lengths, lengths, lengths).map(np.array)
seeds = st.integers(0, 2**32 - 1)


def random_pose(rng: np.random.Generator, tilt_deg: float = 60.0) -> np.ndarray:
    """Draw home_from_object with the face in view and tilted up to an angle."""
    towards = rng.uniform(-np.pi, np.pi)
    tilt = np.radians(rng.uniform(0.0, tilt_deg)) * np.array([np.cos(towards), np.sin(towards), 0])
    gamma = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    rotation = Rotation.from_rotvec(tilt) * Rotation.from_rotvec(gamma)
    depth_m = rng.uniform(0.7, 1.3)
    across_m = depth_m * rng.uniform((-0.25, -0.18), (0.25, 0.18))
    return transform(rotation.as_matrix(), np.array([*across_m, depth_m - 1.0]))


def project(home_from_object: np.ndarray, points_m: np.ndarray = FACE_M,
            camera: Camera = PINHOLE, home_depth_m: float = 1.0) -> np.ndarray:
    """Project an object at a pose."""
    return camera.project(transform_points(home_from_object, points_m) + (0, 0, home_depth_m))
