"""
Classical visual-servo laws as baselines, for many runs at once.

All give the twist of the object, axes of the camera, linear part of the object's
origin, for unit gain. The camera is fixed and the object moves, so signs differ from
the eye-in-hand form of the references; the laws are the same.

References
----------
Chaumette and Hutchinson, Visual servo control, part I, IEEE RAM 13(4), 2006
(image-based with the current, the desired and the mean interaction matrix, eq. 10-14;
position-based in the camera frame, eq. 20). Malis, Chaumette and Boudet, 2 1/2-D
visual servoing, IEEE TRA 15(2), 1999.

"""

from __future__ import annotations

from typing import Callable

from homography_servo.geometry.rigid import rotation_log
import numpy as np


def interaction(camera_from_object: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Give (M, 2N, 6): motion of rays x/z, y/z per object twist, at poses (M, 4, 4)."""
    arms = points_m @ np.swapaxes(camera_from_object[:, :3, :3], 1, 2)
    points = arms + camera_from_object[:, None, :3, 3]
    depth = points[..., 2]
    matrix = np.zeros((*points.shape[:2], 2, 6))
    matrix[..., 0, 0] = matrix[..., 1, 1] = 1.0 / depth
    matrix[..., :, 2] = -points[..., :2] / depth[..., None] ** 2
    matrix[..., 3:] = np.cross(arms[:, :, None, :], matrix[..., :3])
    return matrix.reshape(len(points), -1, 6)


def _image_based(matrix: np.ndarray, rays: np.ndarray, goal_rays: np.ndarray) -> np.ndarray:
    return np.einsum('mij,mj->mi', np.linalg.pinv(matrix), goal_rays - rays)


def ibvs_current(pose: np.ndarray, goal: np.ndarray, rays: np.ndarray, goal_rays: np.ndarray,
                 points_m: np.ndarray) -> np.ndarray:
    """Image-based, interaction matrix at the measured pose."""
    return _image_based(interaction(pose, points_m), rays, goal_rays)


def ibvs_desired(pose: np.ndarray, goal: np.ndarray, rays: np.ndarray, goal_rays: np.ndarray,
                 points_m: np.ndarray) -> np.ndarray:
    """Image-based, interaction matrix at the goal."""
    return _image_based(interaction(goal, points_m), rays, goal_rays)


def ibvs_mean(pose: np.ndarray, goal: np.ndarray, rays: np.ndarray, goal_rays: np.ndarray,
              points_m: np.ndarray) -> np.ndarray:
    """Image-based, mean of both interaction matrices."""
    mean = 0.5 * (interaction(pose, points_m) + interaction(goal, points_m))
    return _image_based(mean, rays, goal_rays)


def pbvs(pose: np.ndarray, goal: np.ndarray, rays: np.ndarray, goal_rays: np.ndarray,
         points_m: np.ndarray) -> np.ndarray:
    """Position-based in the camera frame: the origin goes straight, rotation decoupled."""
    return np.concatenate([goal[:, :3, 3] - pose[:, :3, 3], _turn(pose, goal)], axis=1)


def hybrid(pose: np.ndarray, goal: np.ndarray, rays: np.ndarray, goal_rays: np.ndarray,
           points_m: np.ndarray) -> np.ndarray:
    """2 1/2-D: the origin's image goes straight, log of its depth, rotation decoupled."""
    here, there = pose[:, :3, 3], goal[:, :3, 3]
    depth = here[:, 2:]
    sink = depth * np.log(there[:, 2:] / depth)
    shift = there[:, :2] / there[:, 2:] - here[:, :2] / depth
    sideways = depth * shift + here[:, :2] / depth * sink
    return np.concatenate([sideways, sink, _turn(pose, goal)], axis=1)


def _turn(pose: np.ndarray, goal: np.ndarray) -> np.ndarray:
    return rotation_log(goal[:, :3, :3] @ np.swapaxes(pose[:, :3, :3], 1, 2))


Law = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
LAWS: dict[str, Law] = {
    'ibvs_current': ibvs_current, 'ibvs_desired': ibvs_desired, 'ibvs_mean': ibvs_mean,
    'pbvs': pbvs, 'hybrid_2_5d': hybrid,
}
