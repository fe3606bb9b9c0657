"""Where the sides of the box behind the face show, and how bright they are."""

from __future__ import annotations

from typing import NamedTuple

import cv2
from homography_servo.geometry.face import face_corners
from homography_servo.result import Rejected
from homography_servo.tracking.edges import Edges
from homography_servo.tracking.face_pose import FacePose
from homography_servo.tracking.face_pose import moved_pose
from homography_servo.tracking.face_pose import pose_of_face
from homography_servo.tracking.face_pose import project_with_slopes
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.scan import Geometry
from homography_servo.tracking.scan import side_geometry
from homography_servo.tracking.side_levels import SideLevels
from homography_servo.tracking.strips import NARROWEST_PX
from homography_servo.tracking.strips import Strips
import numpy as np

RIGID_SIGMA_PX = 0.3  # of the corners about a view of the face: lens, size, flatness
CORNER_MARGIN_PX = 2.5  # a corner where a side shows is left out by this
LEAST_SPAN = 0.2  # of a side, else all of it is used
UNIT, WHOLE = np.eye(8), np.full((4, 2), (0.0, 1.0))
ENDS = np.array([[0, 4], [5, 9], [10, 14], [15, 3]])  # (corner, side) of both ends of each side


class Outline(NamedTuple):
    """The box behind the face in one picture."""

    near: FacePose  # where it was expected
    step: np.ndarray  # (6,) turn and shift from there
    corners: np.ndarray  # (4, 2) of the face [px]
    miss: np.ndarray  # (8,) from the corners of the expected pose to these [px]
    slopes: np.ndarray  # (8, 6) of the former
    focal: np.ndarray  # (2,) [px]
    pose_from_corners: np.ndarray  # (6, 8)
    length: np.ndarray  # (4,) of the sides of the face [px]
    width: np.ndarray  # (4, 2) of the strip beside each side, at its corners [px]
    reach: np.ndarray  # (4, 2) where along the side these widths are, 0 to 1
    rows: np.ndarray  # (4, 2, 8) change of the widths with the corners

    @property
    def left(self) -> np.ndarray:
        """Give what the corners (4, 2) miss a view of the face by [px]."""
        return (self.miss - self.slopes @ self.step).reshape(4, 2)

    @property
    def pose(self) -> FacePose:
        """Give the pose of the face."""
        return moved_pose(self.near, self.step, self.left / self.focal)

    @property
    def rigid(self) -> Prior:
        """Say that the corners are a view of the face."""
        return Prior(self.corners - self.left,
                     (UNIT - self.slopes @ self.pose_from_corners) / RIGID_SIGMA_PX ** 2)


class BoxSides:
    """
    Predicts the strips beside the face.

    Parameters
    ----------
    face_size_m : (float, float)
        Width and height of the face.
    height_m : float
        How far the box reaches behind the face.
    plane : Plane
        With a calibrated camera.

    """

    def __init__(self, face_size_m: tuple[float, float], height_m: float, plane: Plane) -> None:
        self._plane = plane
        front = face_corners(*face_size_m)
        self._front_m = front
        self._all_m = np.vstack([front, front + (0.0, 0.0, height_m)])
        self._pose: FacePose | None = None  # that was expected last
        self._step = self._due = np.zeros(6)  # from picture to picture, and from that pose
        self._levels = SideLevels()

    def forget(self) -> None:
        """Begin anew with the pose; how bright the sides are stays known."""
        self._pose = None

    def strips(self, corners: np.ndarray) -> tuple[Strips, Prior] | tuple[None, None]:
        """
        Predict the strips beside a face with these corners.

        Returns
        -------
        Strips or None, Prior or None
            The strips, and that the corners are a view of the face; None while nothing
            is known.

        """
        strips, outline = self.predict(corners)
        if strips is None or outline is None:
            return None, None
        return strips, outline.rigid

    def predict(self, corners: np.ndarray) -> tuple[Strips, Outline] | tuple[None, None]:
        """Give the same strips with the outline that they follow from."""
        if not self._levels.known:
            return None, None
        outline = self.outline(corners)
        if isinstance(outline, Rejected):
            return None, None
        self._pose, self._step = outline.near, self._step + outline.step
        self._due = self._step + outline.step
        return Strips(outline.width, outline.rows, *self._levels.relative(),
                      _spans(outline)), outline

    def learn(self, edges: Edges, weight: np.ndarray, strips: Strips | None, half: int,
              pictures: int = 1) -> None:
        """Take in the grey levels that a good fit with weights (s,) has found."""
        self._levels.learn(edges, weight, strips, half, pictures)

    def silhouette(self, corners: np.ndarray) -> np.ndarray:
        """Give the corners (8, 2) of the box, or (4, 2) of the face where it has no pose."""
        outline = self.outline(corners)
        if isinstance(outline, Rejected):
            return corners
        pose = outline.pose
        back, _ = project_with_slopes(self._all_m[4:], pose.rotation, pose.translation)
        return np.vstack([corners, self._plane.from_rays(back)])

    def outline(self, corners: np.ndarray) -> Outline | Rejected:
        """Find the pose of the face and from it the outline of the box."""
        near = self._expected(corners)
        if isinstance(near, Rejected):
            return near
        rays, slopes = project_with_slopes(self._all_m, near.rotation, near.translation)
        slopes *= self._plane.focal[:, None]
        expected, front = self._plane.from_rays(rays), slopes[:4].reshape(8, 6)
        determined, covariance = cv2.invert(front.T @ front, flags=cv2.DECOMP_CHOLESKY)
        if not determined:
            self._pose = None
            return Rejected('the pose of the face is not determined')
        pose_from_corners = covariance @ front.T
        miss = (corners - expected[:4]).ravel()
        step = pose_from_corners @ miss
        back, geometry = expected[4:] + slopes[4:] @ step, side_geometry(corners)
        width, reach, rows = _beside(geometry, back - corners, slopes[4:] - slopes[:4],
                                     pose_from_corners)
        return Outline(near, step, corners, miss, front, self._plane.focal, pose_from_corners,
                       geometry.length, width, reach, rows)

    def _expected(self, corners: np.ndarray) -> FacePose | Rejected:
        """Go on as from picture to picture, or begin with the pose of these corners."""
        if self._pose is not None:
            return moved_pose(self._pose, self._due, self._pose.miss)
        self._step = np.zeros(6)
        return pose_of_face(self._front_m, self._plane.rays(corners))


def _spans(outline: Outline) -> np.ndarray:
    """
    Say which part (4, 2) of each side of the face to use, 0 to 1.

    Corners where a side of the box shows are left out: more than two surfaces meet there.
    """
    shows = [max(ends) > NARROWEST_PX for ends in outline.width.tolist()]
    if not any(shows):
        return WHOLE
    spans = []
    for side, (length, (first, last)) in enumerate(zip(outline.length.tolist(),
                                                       outline.reach.tolist())):
        here, margin = shows[side], CORNER_MARGIN_PX / length
        low = max(first, 0.0) if here else 0.0
        high = min(last, 1.0) if here else 1.0
        low += margin * (here or shows[side - 1])
        high -= margin * (here or shows[side - 3])
        spans.append((low, high) if high - low > LEAST_SPAN else (0.0, 1.0))
    return np.array(spans)


def _beside(geometry: Geometry, behind: np.ndarray, lag: np.ndarray,
            pose_from_corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Measure how far the corners of the back lie beside the sides of the face.

    Parameters
    ----------
    geometry : Geometry
        Sides of the face.
    behind : (4, 2) array
        From the corners of the face to those of the back of the box.
    lag : (4, 2, 6) array
        How much more the back moves than the face with the pose.
    pose_from_corners : (6, 8) array
        How the pose follows the corners.

    Returns
    -------
    (4, 2) array, (4, 2) array, (4, 2, 8) array
        Width, reach and rows of the outline.

    """
    width = -(behind @ geometry.normal).take(ENDS)
    reach = (behind @ (geometry.edge.T / geometry.length ** 2)).take(ENDS) + (0.0, 1.0)
    drift = (geometry.normal.T @ lag).reshape(16, 6).take(ENDS, axis=0)
    return width, reach, -drift @ pose_from_corners
