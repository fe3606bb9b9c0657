"""Cameras, faces and poses that the tests of the renderer share."""

from dataclasses import replace

from homography_servo.geometry.camera import Camera
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np
from scipy.spatial.transform import Rotation

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
BENT = replace(CAMERA, distortion_model='plumb_bob', distortion=(-0.25, 0.0, 0.0, 0.0, 0.0))
FACE_M = (0.10, 0.06)
CLEAN = SceneSettings(noise_grey=0.0, blur_px=0.0, face_level=200.0, background_level=50.0)


def pose(x=0.0, y=0.0, z=0.75, tilt_x=0.0, tilt_y=0.0, turn=0.0) -> np.ndarray:
    """Place the box in front of the camera; angles in degrees."""
    camera_from_object = np.eye(4)
    camera_from_object[:3, :3] = Rotation.from_euler(
        'xyz', [tilt_x, tilt_y, turn], degrees=True).as_matrix()
    camera_from_object[:3, 3] = x, y, z
    return camera_from_object


def random_pose(rng: np.random.Generator) -> np.ndarray:
    """Place the box anywhere in view."""
    return pose(*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.6, 1.0), *rng.uniform(-40, 40, 2),
                rng.uniform(-180, 180))
