"""
What people use today to follow four corners, behind the same two verbs as ours.

Each peer is told the true corners in the first image; ``update`` gives (4, 2) corners
or None.
"""

from __future__ import annotations

import importlib.util
from typing import Protocol

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

OURS = 'homography_servo'


class Peer(Protocol):
    """Follows four corners."""

    def update(self, image: np.ndarray, time_s: float) -> np.ndarray | None: ...


class Ours:
    """The tracker of this package."""

    def __init__(self, corners_px: np.ndarray, image: np.ndarray, camera: Camera,
                 face_size_m: tuple[float, float], height_m: float) -> None:
        settings = TrackerSettings(
            initial_corners_px=tuple(float(v) for v in corners_px.ravel()))
        self.tracker = Tracker(face_size_m, settings, camera, height_m)
        self.state = ''

    def update(self, image: np.ndarray, time_s: float) -> np.ndarray | None:
        """Look at the next image."""
        track = self.tracker.update(image, time_s)
        self.state = track.state
        return track.corners_px


class OpticalFlow:
    """Pyramidal Lucas-Kanade from image to image, then cornerSubPix."""

    def __init__(self, corners_px: np.ndarray, image: np.ndarray, *_) -> None:
        self._corners = corners_px.astype(np.float32)[:, None]
        self._last = image

    def update(self, image: np.ndarray, time_s: float) -> np.ndarray | None:
        """Look at the next image."""
        moved, status, _ = cv2.calcOpticalFlowPyrLK(self._last, image, self._corners, None,
                                                    winSize=(21, 21), maxLevel=3)
        if moved is None or not status.all():
            return None
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
        height, width = image.shape
        if (moved < 6).any() or (moved[..., 0] > width - 7).any() \
                or (moved[..., 1] > height - 7).any():
            return None
        self._corners, self._last = cv2.cornerSubPix(image, moved, (5, 5), (-1, -1),
                                                     criteria), image
        return self._corners[:, 0].astype(float)


class Contours:
    """Otsu's threshold around the last place, contours, approxPolyDP."""

    MARGIN_PX = 40

    def __init__(self, corners_px: np.ndarray, *_) -> None:
        self._corners = corners_px

    def update(self, image: np.ndarray, time_s: float) -> np.ndarray | None:
        """Look at the next image."""
        low = np.maximum(self._corners.min(axis=0).astype(int) - self.MARGIN_PX, 0)
        high = self._corners.max(axis=0).astype(int) + self.MARGIN_PX
        part = image[low[1]:high[1], low[0]:high[0]]
        if part.size < 100:
            return None
        _, mask = cv2.threshold(cv2.GaussianBlur(part, (5, 5), 0), 0, 255,
                                cv2.THRESH_BINARY + cv2.THRESH_OTSU)
        contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[-2]
        quads = []
        for contour in contours:
            shape = cv2.approxPolyDP(contour, 0.04 * cv2.arcLength(contour, True), True)
            if len(shape) == 4 and cv2.contourArea(shape) > 400.0:
                quads.append(shape[:, 0].astype(float) + low)
        orders = [np.roll(quad[::sense], turn, axis=0) for quad in quads
                  for sense in (1, -1) for turn in range(4)]
        if not orders:
            return None
        self._corners = min(orders, key=lambda quad: np.abs(quad - self._corners).sum())
        return self._corners


class CorrelationCoefficient:
    """cv2.findTransformECC: the first view of the face, warped by a homography."""

    MARGIN_PX = 8

    def __init__(self, corners_px: np.ndarray, image: np.ndarray, *_) -> None:
        low = np.maximum(corners_px.min(axis=0).astype(int) - self.MARGIN_PX, 0)
        high = corners_px.max(axis=0).astype(int) + self.MARGIN_PX
        self._template = image[low[1]:high[1], low[0]:high[0]].copy()
        self._in_template = (corners_px - low)[:, None].astype(np.float32)
        self._warp = np.array([[1, 0, low[0]], [0, 1, low[1]], [0, 0, 1]], np.float32)

    def update(self, image: np.ndarray, time_s: float) -> np.ndarray | None:
        """Look at the next image."""
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 1e-4)
        try:
            _, self._warp = cv2.findTransformECC(
                self._template, image, self._warp, cv2.MOTION_HOMOGRAPHY, criteria, None, 5)
        except cv2.error:
            return None
        return cv2.perspectiveTransform(self._in_template, self._warp)[:, 0].astype(float)


class ActiveContour:
    """skimage.segmentation.active_contour from the last place, four lines fitted to it."""

    POINTS = 40  # per side

    def __init__(self, corners_px: np.ndarray, *_) -> None:
        self._corners = corners_px

    def update(self, image: np.ndarray, time_s: float) -> np.ndarray | None:
        """Look at the next image."""
        from skimage.segmentation import active_contour  # optional
        low = np.maximum(self._corners.min(axis=0).astype(int) - 25, 0)
        high = self._corners.max(axis=0).astype(int) + 25
        part = image[low[1]:high[1], low[0]:high[0]]
        if min(part.shape) < 20:  # it has run out of the image
            return None
        part = cv2.GaussianBlur(part, (0, 0), 1.5) / 255.0
        share = np.arange(self.POINTS)[:, None] / self.POINTS
        sides = [a + share * (b - a) for a, b in zip(self._corners,
                                                     np.roll(self._corners, -1, axis=0))]
        start = np.vstack(sides)[:, ::-1] - low[::-1]
        curve = active_contour(part, start, alpha=0.01, beta=0.1, w_edge=1.0, gamma=0.01,
                               max_num_iter=100)[:, ::-1] + low
        corners = _corners_of_lines([curve[i * self.POINTS + 4:(i + 1) * self.POINTS - 3]
                                     for i in range(4)])
        if corners is not None and np.isfinite(corners).all():
            self._corners = corners
        return corners


def _corners_of_lines(sides: list[np.ndarray]) -> np.ndarray | None:
    lines = []
    for points in sides:
        centre = points.mean(axis=0)
        normal = np.linalg.svd(points - centre)[2][1]
        lines.append(np.array([*normal, -normal @ centre]))
    crossings = np.array([np.cross(lines[i - 1], lines[i]) for i in range(4)])
    if np.abs(crossings[:, 2]).min() < 1e-9:
        return None
    return crossings[:, :2] / crossings[:, 2:]


PEERS = {OURS: Ours, 'cv2 LK + cornerSubPix': OpticalFlow,
         'cv2 findContours + approxPolyDP': Contours,
         'cv2 findTransformECC': CorrelationCoefficient}
if importlib.util.find_spec('skimage'):
    PEERS['skimage active_contour'] = ActiveContour
