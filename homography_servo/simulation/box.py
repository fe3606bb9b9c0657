"""The box as the camera sees it: outlines of its visible faces and of its shadow."""

from __future__ import annotations

from typing import NamedTuple

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.face import face_corners
import numpy as np

NEAR_M = 0.01
FACE, TOP, RIGHT, BOTTOM, LEFT, BACK = range(6)
# Corner 0..3 of the face, 4..7 behind them; the order of the corners runs clockwise as
# seen from outside, which decides whether a face looks at the camera.
_FACES = ([0, 1, 2, 3], [1, 0, 4, 5], [2, 1, 5, 6], [3, 2, 6, 7], [0, 3, 7, 4], [7, 6, 5, 4])
_PIECES_WHEN_BENT = 32


class Outline(NamedTuple):
    """A visible face: which one, and its outline in the image."""

    face: int
    polygon_px: np.ndarray


def box_vertices(face_size_m: tuple[float, float], height_m: float) -> np.ndarray:
    """List the eight vertices in object axes: the face's corners, then those behind them."""
    front = face_corners(*face_size_m)
    return np.vstack([front, front + (0.0, 0.0, height_m)])


def view_planes(camera: Camera, margin: float = 0.3) -> np.ndarray:
    """
    Give the planes of a pyramid a little wider than the camera's view.

    What lies outside of it cannot be seen, and the lens model need not hold there.

    Returns
    -------
    (5, 4) array
        Rows p with p . (x, y, z, 1) >= 0 for points inside, camera axes.

    """
    u, v = np.linspace(0.0, camera.width - 1.0, 9), np.linspace(0.0, camera.height - 1.0, 9)
    border = np.array([(a, b) for a in u for b in v])
    rays = camera.rays(border)
    low, high = rays.min(axis=0), rays.max(axis=0)
    spread = margin * (high - low)
    (x0, y0), (x1, y1) = low - spread, high + spread
    return np.array([[0, 0, 1, -NEAR_M], [1, 0, -x0, 0], [-1, 0, x1, 0], [0, 1, -y0, 0],
                     [0, -1, y1, 0]], float)


def clip_polygon(points_m: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Cut a plane polygon (N, 3) with half spaces; may return no point at all."""
    for plane in planes:
        if not len(points_m):
            return points_m
        side = points_m @ plane[:3] + plane[3]
        if (side >= 0.0).all():
            continue
        points_m = _clip_once(points_m, side)
    return points_m


def _clip_once(points_m: np.ndarray, side: np.ndarray) -> np.ndarray:
    kept = []
    for here, there, a, b in zip(points_m, np.roll(points_m, -1, axis=0), side, np.roll(side, -1)):
        if a >= 0.0:
            kept.append(here)
        if (a >= 0.0) != (b >= 0.0):
            kept.append(here + (there - here) * (a / (a - b)))
    return np.array(kept).reshape(-1, 3)


class BoxView:
    """
    Projects the box for one camera.

    Parameters
    ----------
    camera : Camera
        The lens; edges bend as it bends them.
    face_size_m : (float, float)
        Width and height of the face.
    height_m : float
        How far the body reaches behind the face; 0 is a plate.

    """

    def __init__(self, camera: Camera, face_size_m: tuple[float, float], height_m: float) -> None:
        self._camera = camera
        self._vertices_m = box_vertices(face_size_m, height_m)
        self._planes = view_planes(camera)
        self._bent = bool(np.any(np.asarray(camera.distortion, float)))
        self._faces = range(6) if height_m > 0.0 else (FACE, BACK)

    def outlines(self, camera_from_object: np.ndarray) -> list[Outline]:
        """List the faces that look at the camera and reach into its view."""
        vertices_m = self._in_camera(camera_from_object)
        seen = [face for face in self._faces if _looks_at_camera(vertices_m[_FACES[face][:3]])]
        if not self._bent and (vertices_m @ self._planes[:, :3].T + self._planes[:, 3]
                               >= 0.0).all():
            vertices_px = self._camera.project(vertices_m)  # nothing to cut off or to bend
            return [Outline(face, vertices_px[_FACES[face]]) for face in seen]
        polygons = [(face, self.project_polygon(vertices_m[_FACES[face]])) for face in seen]
        return [Outline(face, polygon_px) for face, polygon_px in polygons
                if polygon_px is not None]

    def corners(self, camera_from_object: np.ndarray) -> np.ndarray:
        """Project the corners of the face (4, 2), wherever they are."""
        return self._camera.project(self._in_camera(camera_from_object)[:4])

    def shadow(self, camera_from_object: np.ndarray, slope: tuple[float, float],
               gap_m: float) -> np.ndarray | None:
        """Project the box along the light onto a plane parallel to the image behind it."""
        vertices_m = self._in_camera(camera_from_object)
        depth_m = vertices_m[:, 2].max() + gap_m
        travel_m = (depth_m - vertices_m[:, 2])[:, None]
        cast_m = vertices_m + travel_m * (*slope, 1.0)
        hull_m = cv2.convexHull(cast_m[:, :2].astype(np.float32))[:, 0, :].astype(float)
        if len(hull_m) < 3:
            return None
        return self.project_polygon(np.column_stack([hull_m, np.full(len(hull_m), depth_m)]))

    def project_polygon(self, points_m: np.ndarray) -> np.ndarray | None:
        """Project a plane polygon in camera axes; None when it is out of view."""
        points_m = clip_polygon(points_m, self._planes)
        if len(points_m) < 3:
            return None
        return self._camera.project(self._divided(points_m) if self._bent else points_m)

    def _divided(self, points_m: np.ndarray) -> np.ndarray:
        share = (np.arange(_PIECES_WHEN_BENT) / _PIECES_WHEN_BENT)[None, :, None]
        step = np.roll(points_m, -1, axis=0) - points_m
        return (points_m[:, None, :] + share * step[:, None, :]).reshape(-1, 3)

    def _in_camera(self, camera_from_object: np.ndarray) -> np.ndarray:
        return self._vertices_m @ camera_from_object[:3, :3].T + camera_from_object[:3, 3]


def _looks_at_camera(corners_m: np.ndarray) -> bool:
    # The normal times the line of sight, written out: np.cross takes 50 us.
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners_m[:3].tolist()
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - bx, cy - by, cz - bz
    return ax * (uy * vz - uz * vy) + ay * (uz * vx - ux * vz) + az * (ux * vy - uy * vx) > 0.0
