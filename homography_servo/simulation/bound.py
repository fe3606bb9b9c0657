"""
How well any unbiased method could measure the corners in a rendered picture.

The Fisher information of the eight corner coordinates, J^T J / sigma^2 with J the
derivative of the noise-free picture; its inverse is the Cramer-Rao bound. Grey levels
and blur count as known, which can only make the bound lower.
"""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
from homography_servo.result import Rejected
from homography_servo.simulation.box import FACE
from homography_servo.simulation.box import Outline
from homography_servo.simulation.scene import Layers
from homography_servo.simulation.scene import Scene
import numpy as np

STEP_PX = 0.05
ROUNDING_VARIANCE = 1.0 / 12.0  # of grey levels rounded to whole numbers
SAME_PX = 1e-6


def corner_bound(scene: Scene, camera_from_object: np.ndarray, time_s: float = 0.0,
                 noise_grey: float | None = None) -> np.ndarray | Rejected:
    """
    Compute the Cramer-Rao bound of the corners of the face.

    Parameters
    ----------
    scene : Scene
        The world.
    camera_from_object : (4, 4) array
        Pose of the box.
    time_s : float
        Time of the scene, for what passes in front of the box.
    noise_grey : float, optional
        Standard deviation of the pixel noise; the scene's own by default.

    Returns
    -------
    (8, 8) array or Rejected
        Smallest covariance of (u0, v0, u1, v1, ...) [px^2]; Rejected where the face
        is not wholly in view, or a corner leaves no trace in the picture.

    References
    ----------
    Kay, Fundamentals of Statistical Signal Processing, vol. 1, sec. 3.9.

    """
    slopes = corner_slopes(scene, camera_from_object, time_s)
    if isinstance(slopes, Rejected):
        return slopes
    flat = slopes.reshape(8, -1)
    sigma = scene.settings.noise_grey if noise_grey is None else noise_grey
    information = flat @ flat.T / (sigma ** 2 + ROUNDING_VARIANCE)
    if np.linalg.cond(information) > 1e12:
        return Rejected('a corner leaves no trace in the picture')
    return np.linalg.inv(information)


def corner_slopes(scene: Scene, camera_from_object: np.ndarray,
                  time_s: float = 0.0) -> np.ndarray | Rejected:
    """
    Differentiate the noise-free picture with respect to the corners.

    What is printed on the face, the far corners of the box, its shadow and what is in
    front of it stay where they are: only the edges of the face tell of its corners.

    Returns
    -------
    (8, H, W) array or Rejected
        Grey levels per pixel of (u0, v0, u1, v1, ...), for the region of the picture
        that the box can change.

    """
    layers = scene.layers(camera_from_object, time_s)
    weights = _corner_weights(scene.camera, layers, scene.corners(camera_from_object))
    if isinstance(weights, Rejected):
        return weights
    region = scene.region(layers.points_px)
    slopes = []
    for corner in range(4):
        for axis in range(2):
            high, low = (scene.patch(_moved(scene.camera, layers, weights, corner, axis, step),
                                     camera_from_object, region) for step in (STEP_PX, -STEP_PX))
            slopes.append((high.astype(float) - low) / (2.0 * STEP_PX))
    return scene.flicker(time_s) * np.array(slopes)


def _corner_weights(camera: Camera, layers: Layers,
                    corners_px: np.ndarray) -> list[np.ndarray] | Rejected:
    """Tell for each outline how far each of its points goes along with each corner."""
    faces = [outline for outline in layers.faces if outline.face == FACE]
    if not faces or len(faces[0].polygon_px) % 4:
        return Rejected('the face is not wholly in view')
    face_px = faces[0].polygon_px
    pieces = len(face_px) // 4
    if np.abs(face_px[::pieces] - corners_px).max() > SAME_PX:
        return Rejected('the face is not wholly in view')
    share = np.arange(pieces) / pieces
    along = np.zeros((len(face_px), 4))
    for corner in range(4):
        rows = slice(corner * pieces, (corner + 1) * pieces)
        along[rows, corner] = 1.0 - share
        along[rows, (corner + 1) % 4] = share
    return [_weights_like(outline.polygon_px, face_px, along) for outline in layers.faces]


def _weights_like(polygon_px: np.ndarray, face_px: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Let points that a side of the box shares with the face go along with it."""
    distance = np.linalg.norm(polygon_px[:, None] - face_px[None], axis=2)
    nearest = distance.argmin(axis=1)
    shared = distance[np.arange(len(polygon_px)), nearest] < SAME_PX
    return np.where(shared[:, None], along[nearest], 0.0)


def _moved(camera: Camera, layers: Layers, weights: list[np.ndarray], corner: int, axis: int,
           step_px: float) -> Layers:
    """Move one corner; sides stay straight before the lens bends them."""
    faces = []
    for outline, weight in zip(layers.faces, weights):
        moving = weight[:, corner] > 0.0
        polygon_px = outline.polygon_px.copy()
        if moving.any():
            shift_px = np.zeros(2)
            shift_px[axis] = step_px
            polygon_px[moving] = _shifted(camera, polygon_px[moving], shift_px,
                                          weight[moving, corner][:, None])
        faces.append(Outline(outline.face, polygon_px))
    return layers._replace(faces=faces)


def _shifted(camera: Camera, points_px: np.ndarray, shift_px: np.ndarray,
             share: np.ndarray) -> np.ndarray:
    if not np.any(np.asarray(camera.distortion, dtype=float)):
        return points_px + share * shift_px
    # The shift is that of the corner, which is the point with the whole share.
    corner_px = points_px[share[:, 0].argmax()]
    shift = camera.rays(corner_px + shift_px) - camera.rays(corner_px)
    rays = camera.rays(points_px) + share * shift
    return camera.project(np.column_stack([rays, np.ones(len(rays))]))
