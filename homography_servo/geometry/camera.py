"""The camera: its model, and the camera_info files that hold its calibration."""

from homography_servo.geometry.camera_file import load_camera
from homography_servo.geometry.camera_file import save_camera
from homography_servo.geometry.camera_model import Camera
from homography_servo.geometry.camera_model import camera_from_calibration

__all__ = ['Camera', 'camera_from_calibration', 'load_camera', 'save_camera']
