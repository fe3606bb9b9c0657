"""
Sides of a box that show as strips beside the face.

A strip of one or two pixels melts into the edge of the face. How wide it is follows
from the pose of the face and the height of the box; how bright, from earlier pictures.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.tracking.profile import EdgeProfile
from homography_servo.tracking.profile import STEPS_PER_PX
from homography_servo.tracking.scan import Scan
import numpy as np

NARROWEST_PX = 0.05
MELTED_PX = 1.5  # up to this width the strip's brightness shifts the edge


class Back(NamedTuple):
    """The far edges of the strips: k pixels on each of q lines."""

    lines: np.ndarray  # (q,) of the scan
    first_line: np.ndarray  # (r,) first of each segment, counted in `lines`
    segment: np.ndarray  # (r,)
    parts: np.ndarray  # (2, k, q) change with the width over the contrast; share of the strip


class Strips(NamedTuple):
    """Strips along the m sides of a polygon; a width of 0 or less is no strip."""

    width: np.ndarray  # (m, 2) at the first and second corner of each side
    rows: np.ndarray  # (m, 2, 2 m) how these widths change with the corners
    level: np.ndarray  # (m,) brightness: 0 as outside, 1 as the face
    level_sigma: np.ndarray  # (m,) of that brightness
    spans: np.ndarray  # (m, 2) part of each side where this holds, 0 to 1

    def rows_at(self, side: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Say how the widths at some places change with the corners: (s, 2 m)."""
        along = along[:, None]
        return (1.0 - along) * self.rows[side, 0] + along * self.rows[side, 1]

    def width_at(self, side: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Interpolate the widths."""
        first = self.width[:, 0].take(side)
        return first + (self.width[:, 1].take(side) - first) * along

    def doubt(self, side: np.ndarray, along: np.ndarray) -> np.ndarray:
        """
        Give the variance (s,) that a wrong brightness of the strips adds to an offset.

        It is common to the whole side, so each segment gets the side's share of it.
        """
        width = np.minimum(np.maximum(self.width_at(side, along), 0.0), MELTED_PX)
        segments = np.bincount(side, minlength=len(self.width))
        return segments.take(side) * (width * self.level_sigma.take(side)) ** 2

    def mix_in(self, scan: Scan, profile: EdgeProfile, place: np.ndarray,
               scale: np.ndarray | None, edge: np.ndarray) -> Back | None:
        """
        Turn the profile of one edge into that of two where there is a narrow strip.

        Parameters
        ----------
        scan : Scan
            The pixels.
        profile : EdgeProfile
            The blurred edge.
        place : (k, n or more) array
            Places of the pixels in the tables.
        scale : (n or more,) array or None
            Image pixels per unit of the plane on each line.
        edge : (2, k, n) array
            Share and slope of the face's edge; changed in place.

        Returns
        -------
        Back or None

        """
        layout, total, widest = scan.layout, scan.layout.total, len(scan.grey) // 2 - 1.0
        if not any(max(ends) > NARROWEST_PX and min(ends) < widest
                   for ends in self.width.tolist()):
            return None
        width = self.width_at(layout.side[:total], scan.along)
        if scale is not None:
            width = width * scale[:total]
        middle = width.take(layout.first_line + layout.lines // 2)
        chosen = (middle > NARROWEST_PX) & (middle < widest)
        if not chosen.any():
            return None
        lines = np.flatnonzero(np.repeat(chosen, layout.lines))
        counted = layout.lines[chosen]
        shift = np.rint(width.take(lines) * STEPS_PER_PX).astype(np.intp)
        behind = place.take(lines, axis=1) + shift
        level = self.level.take(layout.side.take(lines)).astype(np.float32)
        own, slope = edge.take(lines, axis=2)
        parts = profile.share_and_slope(behind)[::-1]
        parts[1] -= own
        parts[0] *= level
        own += level * parts[1]
        slope *= np.float32(1.0) - level
        slope += parts[0]
        edge[0][:, lines], edge[1][:, lines] = own, slope
        return Back(lines, np.cumsum(counted) - counted, np.flatnonzero(chosen), parts)
