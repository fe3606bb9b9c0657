"""
Find the face beside a side of its box.

A side of the box is a rectangle too and may be taken for the face, above all where a
print breaks the face up and the side is blank. Then the face hangs on one of its edges,
and where it must be follows from the sizes of both.
"""

from __future__ import annotations

from homography_servo.geometry.face import face_corners
from homography_servo.result import Rejected
from homography_servo.tracking.detection.candidates import in_reach
from homography_servo.tracking.detection.candidates import roughly_fits
from homography_servo.tracking.detection.region_check import examine
from homography_servo.tracking.detection.views import projected
from homography_servo.tracking.detection.views import Views
from homography_servo.tracking.detection.views import views_of_face
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.target import Found
from homography_servo.tracking.target import Target
import numpy as np

HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def find_beside(image: np.ndarray, side: np.ndarray, target: Target,
                plane: Plane) -> Found | Rejected:
    """
    Look for a face of which a quadrilateral is a side of the box.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    side : (4, 2) array
        Corners clockwise on the screen, in the plane.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.

    Returns
    -------
    Found or Rejected
        Its merit is that of the regions' check, not the edges'.

    """
    looked_at = [examine(image, corners, target, plane)
                 for corners in faces_beside(side, target, plane).corners]
    found = [one for one in looked_at if not isinstance(one, Rejected)]
    return max(found, key=lambda one: one.merit) if found \
        else Rejected('there is no face beside the quadrilateral')


def faces_beside(side: np.ndarray, target: Target, plane: Plane) -> Views:
    """List views of the face of which a quadrilateral (4, 2) may be a side of the box."""
    front = face_corners(*target.face_size_m)
    faces = []
    for first in (0, 1) if target.box_height_m > 0.0 else ():  # the other two look the same
        edge = front[first] - front[first + 1]
        length = float(np.linalg.norm(edge))
        views = views_of_face(side[None], (length, target.box_height_m), plane,
                              (target.nearest_m, target.farthest_m))
        views = views.chosen(roughly_fits(views))
        across, down = edge / length, np.array([0.0, 0.0, 1.0])
        side_from_face = np.stack([across, down, np.cross(across, down)])
        middle = 0.5 * (front[first] + front[first + 1] + target.box_height_m * down)
        for turn in (np.eye(3), HALF_TURN):
            rotation = views.rotation @ turn @ side_from_face
            translation = views.translation - rotation @ middle
            faces.append(Views(projected(front, rotation, translation, plane), rotation,
                               translation, views.miss_px))
    if not faces:
        return views_of_face(np.zeros((0, 4, 2)), target.face_size_m, plane)
    views = Views(*(np.concatenate(part) for part in zip(*faces)))
    return views.chosen(in_reach(views, target))
