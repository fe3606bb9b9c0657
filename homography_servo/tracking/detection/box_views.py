"""
Compare many views of the box with the picture at once.

The face must end at its four sides. Behind a side that shows there is a side of the
box, of one grey level, another one than the face's; it must end where the pose of the
face and the height of the box say. Both edges together tell the tilt well, which the
face alone tells poorly.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.face import face_corners
from homography_servo.tracking.detection.outlook import AFTER
from homography_servo.tracking.detection.outlook import edges_and_normals
from homography_servo.tracking.detection.outlook import look_across
from homography_servo.tracking.detection.outlook import Outlook
from homography_servo.tracking.detection.outlook import Picture
from homography_servo.tracking.detection.outlook import Rows
from homography_servo.tracking.detection.outlook import rows_across
from homography_servo.tracking.detection.views import projected
from homography_servo.tracking.detection.views import Views
from homography_servo.tracking.plane import Plane
import numpy as np

SHARES = np.linspace(0.08, 0.92, 8)
OUTER = [2, 1, 3]  # edges of a side of the box: at the back, and from the face to it
INSIDE_PX, REACH_PX, READ = 5.0, 8.0, 14  # a print may begin farther inside
STRIP_FROM, STRIP_FROM_PX = 0.6, 6.0  # of its width, and at most: where its level is read
UNEVEN_GREY = 9.0  # along a side of the face, in uneven light
OFF_PX = 2.2  # from the face
NARROWEST_PX, WIDE_PX = 2.8, 5.0  # of a side of the box that tells nothing, and all
# Logarithms of how much likelier something is with the face and its box than without:
# that all sides of the face show, and what is lost where none does; that a side of the
# box ends where it must, over that it does not; that it does not. Where none is in view
# nothing is told: other things look so as often.
CLEAR_FACE, HIDDEN_FACE = 1.75, 8.0
SEEN, UNSEEN = 9.0, 4.5
SHOWN = 0.45  # least share of the sides that must show
BROKEN = 0.5  # weight of changes within the face
WEAKEST = 0.15  # weight of the side that shows least


class BoxOutlook(NamedTuple):
    """What n views of the box show."""

    face: Outlook  # across the sides of the face
    back: Outlook | None  # across the far edges of the box's sides
    rims: Outlook | None  # across the edges from the face to the back, both of each side
    sure: np.ndarray  # (n, 4) how well those sides can be judged, 0 to 1

    def chosen(self, which: np.ndarray) -> BoxOutlook:
        """Select some."""
        back, rims = (None if part is None else part.chosen(which)
                      for part in (self.back, self.rims))
        return BoxOutlook(self.face.chosen(which), back, rims, self.sure[which])


def only_face(face: Outlook) -> BoxOutlook:
    """Take what the face shows for all that there is to see."""
    return BoxOutlook(face, None, None, np.zeros(face.level.shape))


def look_at(picture: Picture, views: Views, points_m: np.ndarray, plane: Plane,
            face: Outlook | None = None) -> BoxOutlook:
    """
    Look across all edges of a box.

    Parameters
    ----------
    picture : Picture
        What is looked at.
    views : Views
        Of the face.
    points_m : (4 or 8, 3) array
        Corners of the face, and of the back where the box has a height.
    plane : Plane
        With a camera.
    face : Outlook or None
        What the sides of the face show, where that has been looked at.

    Returns
    -------
    BoxOutlook

    """
    front = rows_across(views.corners if face is None else views.corners[:0], SHARES)
    count = 4 * len(front.place)
    if len(points_m) == 4:
        return only_face(look_across(picture, front, plane, INSIDE_PX, -REACH_PX, READ,
                                     UNEVEN_GREY) if face is None else face)
    sides, width = _sides(views, points_m, plane)
    sure = np.clip((width - NARROWEST_PX) / (WIDE_PX - NARROWEST_PX), 0.0, 1.0)
    in_view = sure > 0.0
    sides, width = sides[in_view], width[in_view]
    behind = rows_across(sides, SHARES)
    behind = Rows(SHARES, behind.place[:, OUTER], behind.inward[:, OUTER])
    first_px = np.full((len(width), len(OUTER)), STRIP_FROM_PX)
    first_px[:, 0] = np.clip(np.minimum(STRIP_FROM * width, width - OFF_PX), 0.5, STRIP_FROM_PX)
    # All of them at once: so few cost little more than one.
    seen = look_across(picture, front.and_those(behind), plane,
                       np.append(np.full(count, INSIDE_PX), first_px), -REACH_PX, READ,
                       UNEVEN_GREY * (np.arange(count + first_px.size) < count))
    if face is None:
        face = seen.chosen(slice(count)).grouped(4)
    seen = seen.chosen(slice(count, None)).grouped(len(OUTER))
    other = np.abs(seen.level[:, 0] - face.level[in_view]) > picture.other_grey
    seen.shown[:, 0] &= other[:, None]
    back, rims = (_spread(seen, edges, in_view) for edges in ([0], [1, 2]))
    return BoxOutlook(face, back, rims, sure)


def _spread(seen: Outlook, edges: list[int], in_view: np.ndarray) -> Outlook:
    """Arrange what some edges of the sides in view (n, 4) show by views and sides."""
    level = np.zeros(in_view.shape)
    level[in_view] = seen.level[:, edges[0]]
    parts = []
    for part in seen[2:]:
        whole = np.zeros((*in_view.shape, len(edges), len(seen.share)), part.dtype)
        whole[in_view] = part[:, edges]
        parts.append(whole.reshape(*in_view.shape, len(edges) * len(seen.share)))
    return Outlook(seen.share, level, *parts)


def _sides(views: Views, points_m: np.ndarray, plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """Give the sides of the box (n, 4, 4, 2), and their widths (n, 4), < 0 if turned away."""
    behind = projected(points_m[4:], views.rotation, views.translation, plane)
    front, away = views.corners, behind - views.corners
    normal = edges_and_normals(front)[1]
    width = -0.5 * (normal * (away + away[:, AFTER])).sum(axis=2)
    # Clockwise on the screen where they face the camera.
    return np.stack([front[:, AFTER], front, behind, behind[:, AFTER]], axis=2), width


def odds(seen: BoxOutlook, close_px: float) -> np.ndarray:
    """
    Tell how much speaks for the face (n,); -inf where too little of it shows.

    Parameters
    ----------
    seen : BoxOutlook
        What is seen.
    close_px : float
        From an edge to the farthest change that supports it.

    Returns
    -------
    (n,) array
        Logarithm of how much likelier this is with the face there than without.

    """
    face = face_merit(seen.face, close_px)
    told = np.where(face > 0.0, CLEAR_FACE - HIDDEN_FACE * (1.0 - face), -np.inf)
    if seen.back is None or seen.rims is None:
        return told
    shows = 0.5 * (seen.back.closeness(close_px) + seen.rims.closeness(close_px))
    return told + (seen.sure * (SEEN * shows - UNSEEN)).sum(axis=1)


def face_merit(face: Outlook, reach_px: float) -> np.ndarray:
    """Rate how well the sides of the face show (n,), 0 to 1."""
    support, broken = face.closeness(reach_px), face.broken(reach_px).mean(axis=1)
    shown = support.mean(axis=1)
    rated = (1.0 - WEAKEST) * shown + WEAKEST * support.min(axis=1) - BROKEN * broken
    return np.where(face.even & (shown > SHOWN), np.maximum(rated, 0.0), 0.0)


def box_points(face_size_m: tuple[float, float], height_m: float) -> np.ndarray:
    """Give the corners of the face, and of the back where there is a height (4 or 8, 3)."""
    front = face_corners(*face_size_m)
    return np.vstack([front, front + (0.0, 0.0, height_m)]) if height_m > 0.0 else front
