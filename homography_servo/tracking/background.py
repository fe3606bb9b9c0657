"""
Remember what a fixed camera sees where the face is not.

What was in its place already while the face was followed somewhere else is not the face,
however much it looks like it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
from homography_servo.tracking.detection.segments import shrunk
from homography_servo.tracking.rectified import rectified_view
from homography_servo.tracking.rectified import spread_inside
import numpy as np

AROUND = 0.15  # of the object's size, around it: what of it the outline leaves out
GRID = (24, 24)  # samples across and down
MARGIN = 0.15  # of its width and height, around a thing: its edges belong to how it looks
INSIDE = np.s_[5:-5, 5:-5]  # samples well within the thing
LEAST_KNOWN = 0.2  # share of these that must have been seen before
SAME_GREY, SAME_SHARE = 8.0, 0.05  # difference that noise makes, at least and of the level
UNCHANGED = 0.8  # share of the samples that are as they were
ALIKE = 0.8  # correlation with what was there
FLAT_GREY = 2.0  # standard deviation of samples that show noise alone
# Grey levels of a few pixels inside that are surely not the same, whatever light and noise do.
OTHER_GREY, OTHER_SHARE, OTHER_MOST = 20.0, 0.25, 0.5
NEAR = np.ones((5, 5), np.uint8)  # half pixels around what is new that belong to it
FEW, FEW_PIXELS = spread_inside(5), np.s_[4::8, 4::8]
KNOWN = 255


class Past(NamedTuple):
    """A picture without the face."""

    picture: np.ndarray  # (H, W) uint8
    known: np.ndarray  # (H, W) uint8, KNOWN where it has been seen, else 0


class Background:
    """Keeps, for each pixel, how it looked when the face was last followed elsewhere."""

    def __init__(self) -> None:
        self._last: Past | None = None
        self._complete = False  # all of it has been seen

    def _past(self, image: np.ndarray) -> Past | None:
        """Give what has been seen, if in pictures of this size."""
        return None if self._last is None or self._last.picture.shape != image.shape \
            else self._last

    def remember(self, image: np.ndarray, silhouette_px: np.ndarray) -> None:
        """
        Take in a picture but for the object.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        silhouette_px : (M, 2) array
            Points between which the object is in it.

        """
        past = self._past(image)
        if past is None:
            past = self._last = Past(np.zeros_like(image), np.zeros_like(image))
            self._complete = False
        place, free = _around(silhouette_px, image.shape)
        covered = np.where(free, image[place], past.picture[place])
        past.picture[:] = image
        past.picture[place] = covered
        if not self._complete:
            covered = np.where(free, KNOWN, past.known[place])
            past.known[:] = KNOWN
            past.known[place] = covered
            self._complete = bool((covered == KNOWN).all())

    def light(self, image: np.ndarray) -> float:
        """Give how much brighter it has become; 1 if nothing is known."""
        past = self._past(image)
        if past is None:
            return 1.0
        seen = past.known[FEW_PIXELS] > 0
        if not seen.any():
            return 1.0
        now, then = (picture[FEW_PIXELS][seen] + 1.0 for picture in (image, past.picture))
        return float(np.median(now / then))  # most of them show what they did

    def news(self, image: np.ndarray) -> np.ndarray | None:
        """
        Mark what was not there before.

        Parameters
        ----------
        image : (H, W) uint8 array
            The present picture.

        Returns
        -------
        (H / 2, W / 2) uint8 array or None
            255 where something differs or was never seen, with a margin, else 0; None where
            nothing is known.

        """
        past = self._past(image)
        if past is None:
            return None
        then = cv2.convertScaleAbs(shrunk(past.picture), None, self.light(image))
        most = cv2.max(cv2.convertScaleAbs(then, None, SAME_SHARE), SAME_GREY)
        new = cv2.compare(cv2.absdiff(shrunk(image), then), most, cv2.CMP_GT)
        new |= cv2.compare(shrunk(past.known), KNOWN, cv2.CMP_LT)
        return cv2.dilate(cv2.medianBlur(new, 3), NEAR)

    def shows(self, image: np.ndarray, corners_px: np.ndarray) -> bool:
        """
        Tell whether the same was in this place while the face was elsewhere.

        Parameters
        ----------
        image : (H, W) uint8 array
            The present picture.
        corners_px : (4, 2) array
            Of a thing in it.

        Returns
        -------
        bool
            False also where nothing is known of the place.

        """
        past = self._past(image)
        if past is None:
            return False
        if _differ(image, past, corners_px):
            return False
        known, now, then = (rectified_view(picture, corners_px, GRID, -MARGIN)
                            for picture in (past.known, image, past.picture))
        seen = known > KNOWN - 1
        if seen[INSIDE].mean() < LEAST_KNOWN:
            return False
        then = self.light(image) * then
        same = np.abs(now - then) < np.maximum(SAME_GREY, SAME_SHARE * now)
        if min(same[seen].mean(), same[INSIDE][seen[INSIDE]].mean()) < UNCHANGED:
            return False
        now, then = now[seen], then[seen]
        spread = float(now.std()) * float(then.std())
        likeness = float(np.mean((now - now.mean()) * (then - then.mean())))
        return bool(spread > FLAT_GREY ** 2 and likeness > ALIKE * spread)


def _differ(image: np.ndarray, past: Past, corners_px: np.ndarray) -> bool:
    """Look at a few pixels between the corners first: mostly that is enough to tell."""
    at = (FEW @ corners_px).astype(np.float32)[:, None]
    grey, before, seen = [cv2.remap(picture, at, None, cv2.INTER_NEAREST, None,
                                    cv2.BORDER_REPLICATE) for picture in (image, *past)]
    other = cv2.absdiff(grey, before) > OTHER_GREY + OTHER_SHARE * grey
    return bool(np.count_nonzero(other & (seen > 0)) > OTHER_MOST * np.count_nonzero(seen))


def _around(points_px: np.ndarray, shape: tuple[int, ...]
            ) -> tuple[tuple[slice, slice], np.ndarray]:
    """Give the upright rectangle around points (M, 2), and which pixels are not among them."""
    hull = cv2.convexHull(points_px.astype(np.float32))[:, 0]
    middle = hull.mean(axis=0)
    hull = middle + (1.0 + 2.0 * AROUND) * (hull - middle)
    first = np.clip(np.floor(hull.min(axis=0)), 0, shape[::-1]).astype(int)
    last = np.clip(np.ceil(hull.max(axis=0)) + 1, first, shape[::-1]).astype(int)
    (left, top), (width, height) = first, last - first
    free = np.ones((height, width), np.uint8)
    if free.size:
        cv2.fillConvexPoly(free, np.rint(hull - first).astype(np.int32), 0)
    return (slice(top, top + height), slice(left, left + width)), free > 0
