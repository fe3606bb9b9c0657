"""Ways to find the pose of a face from its four corners: ours, OpenCV's, the paper's."""

from __future__ import annotations

from typing import Callable

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.decomposition import decompose
from homography_servo.geometry.decomposition import decompose_paper
from homography_servo.geometry.decomposition import pose_from_parameters
from homography_servo.geometry.homography import estimate_homography
from homography_servo.geometry.homography import home_image
from homography_servo.geometry.rigid import transform
from homography_servo.result import Rejected
import numpy as np

HOME_DEPTH_M = 1.0
# A method takes corners (4, 2) in px and gives home_from_object (4, 4), or None.
Method = Callable[[np.ndarray], 'np.ndarray | None']


def methods(face_m: np.ndarray, camera: Camera) -> dict[str, Method]:
    """List the peers by name."""
    return {
        'opencv IPPE': _solve_pnp(face_m, camera, cv2.SOLVEPNP_IPPE),
        'opencv ITERATIVE': _solve_pnp(face_m, camera, cv2.SOLVEPNP_ITERATIVE),
        'opencv SQPNP': _solve_pnp(face_m, camera, cv2.SOLVEPNP_SQPNP),
        'opencv decomposeHomographyMat': _decompose_homography_mat(face_m, camera),
        'paper, eqs. 18-22': _closed_form(face_m, camera, decompose_paper),
        'decompose, without refinement': _closed_form(face_m, camera, decompose),
    }


def _solve_pnp(face_m: np.ndarray, camera: Camera, flag: int) -> Method:
    matrix = camera.matrix

    def pose(corners_px: np.ndarray) -> np.ndarray | None:
        found, turn, shift = cv2.solvePnP(face_m, corners_px, matrix, None, flags=flag)
        if not found:
            return None
        return transform(cv2.Rodrigues(turn)[0], shift[:, 0] - (0.0, 0.0, HOME_DEPTH_M))
    return pose


def _decompose_homography_mat(face_m: np.ndarray, camera: Camera) -> Method:
    """Take the solution whose plane is nearest to the home plane, as its normal is known."""
    home_px = camera.project_rays(home_image(face_m, HOME_DEPTH_M))
    matrix = camera.matrix

    def pose(corners_px: np.ndarray) -> np.ndarray | None:
        homography, _ = cv2.findHomography(home_px, corners_px)
        if homography is None:
            return None
        _, turns, shifts, normals = cv2.decomposeHomographyMat(homography, matrix)
        best = int(np.argmax([normal[2, 0] for normal in normals]))
        shift_m = turns[best][:, 2] + shifts[best][:, 0] - (0.0, 0.0, 1.0)
        return transform(turns[best], HOME_DEPTH_M * shift_m)
    return pose


def _closed_form(face_m: np.ndarray, camera: Camera, decomposer: Callable) -> Method:
    home = home_image(face_m, HOME_DEPTH_M)

    def pose(corners_px: np.ndarray) -> np.ndarray | None:
        homography = estimate_homography(home, camera.rays(corners_px))
        if isinstance(homography, Rejected):
            return None
        parameters = decomposer(homography)
        return pose_from_parameters(parameters, HOME_DEPTH_M) if parameters else None
    return pose
