"""
Move views of the box to fit the picture, and tell what its edges say of the face.

A side of the face that has no edge, because what lies behind it is as bright, leaves
corners free that three sides tell by their perspective only. The edges of the box
behind the other sides tell how the face is tilted, and with that where those are.
"""

from __future__ import annotations

from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.tracking.detection.box_views import BoxOutlook
from homography_servo.tracking.detection.box_views import look_at
from homography_servo.tracking.detection.outlook import inward_normals
from homography_servo.tracking.detection.outlook import median
from homography_servo.tracking.detection.outlook import Outlook
from homography_servo.tracking.detection.outlook import Picture
from homography_servo.tracking.detection.views import linearise
from homography_servo.tracking.detection.views import moved
from homography_servo.tracking.detection.views import Views
from homography_servo.tracking.face_pose import pose_of_face
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Prior
import numpy as np

ROUGH_PX, NEAR_PX = 4.0, 1.0  # scatter of corners, and of places that agree
EDGE_PX, SIGMAS = 0.2, 1.5  # least error of a whole edge; standard over median deviation
DAMPING = 1e-6  # [px^2] keeps the step of a degenerate view finite
ROUNDS = 2  # of looking, each from where the last one led
# Edges of the box by their ends; corners of the back come after those of the face.
FACE, BACK = ([0, 1, 2, 3], [1, 2, 3, 0]), ([4, 5, 6, 7], [5, 6, 7, 4])
FIRST_RIMS, SECOND_RIMS = ([0, 1, 2, 3], [4, 5, 6, 7]), ([5, 6, 7, 4], [1, 2, 3, 0])


def held_by_box(picture: Picture, corners: np.ndarray, points_m: np.ndarray,
                plane: Plane) -> Prior | None:
    """
    Say what the edges of the box tell about the corners of its face.

    Parameters
    ----------
    picture : Picture
        What is seen.
    corners : (4, 2) array
        To within some pixels, in the plane; the first is the face's first, or third.
    points_m : (4 or 8, 3) array
        Corners of the face, and of the back where the box has a height.
    plane : Plane
        With a camera.

    Returns
    -------
    Prior or None
        None if the face has no box, or the corners are no view of it.

    """
    held = None
    for _ in range(ROUNDS if len(points_m) > 4 else 0):
        pose = pose_of_face(points_m[:4], plane.rays(corners))
        if isinstance(pose, Rejected):
            return None
        view = Views(corners[None], pose.rotation[None], pose.translation[None], np.zeros(1))
        told, information = told_by_box(view, look_at(picture, view, points_m, plane), points_m,
                                        plane)
        corners, held = told[0], Prior(told[0], information[0])
    return held


def nearer(views: Views, seen: BoxOutlook, points_m: np.ndarray, plane: Plane) -> Views:
    """
    Move views to where the grey levels were found to change.

    Places that disagree count less; what no place shows stays as it was.
    """
    corners, slope = _seen_points(views, points_m, plane)
    rows = [_rows(corners, slope, FACE, seen.face)]
    if seen.back is not None:
        rows.append(_rows(corners, slope, BACK, seen.back, seen.sure))
    step, _ = _solved(rows, slope)
    return moved(views, step, points_m[:4], plane)


def told_by_box(views: Views, seen: BoxOutlook, points_m: np.ndarray,
                plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """
    Find out what the edges of the box behind the face alone say about views.

    Parameters
    ----------
    views : Views
        Of the face.
    seen : BoxOutlook
        What they show, with sides of the box.
    points_m : (8, 3) array
        Corners of the face and of the back.
    plane : Plane
        With a camera.

    Returns
    -------
    (n, 4, 2) array, (n, 8, 8) array
        Corners of the face [px], and the information about them [1/px^2].

    """
    back, rims = required(seen.back, 'back of the box'), required(seen.rims, 'rims of the box')
    corners, slope = _seen_points(views, points_m, plane)
    half = len(rims.share)
    rows = []
    for edges, outlook, which in ((BACK, back, slice(None)), (FIRST_RIMS, rims, slice(half)),
                                  (SECOND_RIMS, rims, slice(half, None))):
        part = Outlook(outlook.share, outlook.level, outlook.inward_px[..., which],
                       outlook.shown[..., which])
        rows.append(_rows(corners, slope, edges, part, seen.sure * _information(part)))
    step, told = _solved(rows, slope)
    face = slope[:, :4].reshape(len(slope), 8, 6)
    across = face.transpose(0, 2, 1)
    pose_from_corners = np.linalg.solve(across @ face + DAMPING * np.eye(6), across)
    return (corners[:, :4] + (face @ step[..., None]).reshape(-1, 4, 2),
            pose_from_corners.transpose(0, 2, 1) @ told @ pose_from_corners)


def _information(seen: Outlook) -> np.ndarray:
    """
    Say how much each place on an edge tells (n, 4) [1/px^2].

    Faint edges are seen late and at scattered places; all of those are wrong together.
    """
    away = np.abs(seen.inward_px - median(seen.inward_px)[..., None])
    late_px = EDGE_PX + SIGMAS * median(away)
    return 1.0 / (len(seen.share) * late_px ** 2)


def _seen_points(views: Views, points_m: np.ndarray,
                 plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """Project points (n, p, 2), and say how they move with the pose (n, p, 2, 6) [px]."""
    rays, slope = linearise(points_m, views.rotation, views.translation)
    slope = slope.reshape(len(slope), len(points_m), 2, 6) * plane.focal[:, None]
    return plane.from_rays(rays), slope


def _rows(corners: np.ndarray, slope: np.ndarray, edges: tuple[list[int], list[int]],
          seen: Outlook, sure: float | np.ndarray = 1.0) -> tuple[np.ndarray, ...]:
    """Say how places on edges move inwards with the pose, how far they are, and how surely."""
    first, second = edges
    edge = corners[:, second] - corners[:, first]
    normal = inward_normals(edge)[..., None]
    begin, end = ((normal * slope[:, point]).sum(axis=2)[:, :, None] for point in edges)
    count = len(slope), len(first) * len(seen.share)
    rows = (begin + seen.share[:, None] * (end - begin)).reshape(*count, 6)
    weight = seen.shown * np.reshape(sure, (*np.shape(sure), 1))
    return rows, seen.inward_px.reshape(count), weight.reshape(count)


def _solved(parts: list[tuple[np.ndarray, ...]],
            slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    Bring edges to where they were seen, robustly.

    Returns
    -------
    (n, 6) array, (n, 6, 6) array
        Steps of the pose, and how surely the places tell them.

    """
    rows, inward, weight = (np.concatenate(part, axis=1) for part in zip(*parts))
    corners = slope[:, :4].reshape(len(slope), 8, 6)
    held = corners.transpose(0, 2, 1) @ corners / ROUGH_PX ** 2 + DAMPING * np.eye(6)
    miss = inward
    for scatter_px in (ROUGH_PX, NEAR_PX, NEAR_PX):
        weighted = rows.transpose(0, 2, 1) * (weight / (1.0 + (miss / scatter_px) ** 2))[:, None]
        told = weighted @ rows
        step = np.linalg.solve(told + held, weighted @ inward[..., None])
        miss = inward - (rows @ step)[..., 0]
    return step[..., 0], told
