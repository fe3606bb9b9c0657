"""
Find the face among quadrilaterals that bound regions of like grey level.

They are ranked by quick looks at the grey levels along their sides; the best
are fitted like in tracking, must be the projection of a rectangle of the known size
within reach, and are ranked again by how well edges, evenness, pose and the sides of
the box behind them agree.
"""

from __future__ import annotations

from homography_servo.result import Rejected
from homography_servo.tracking.detection.region_check import AWAY_PX
from homography_servo.tracking.detection.region_check import CLEAR_GREY
from homography_servo.tracking.detection.region_check import EVEN_GREY
from homography_servo.tracking.detection.region_check import examine
from homography_servo.tracking.detection.region_check import LEAST_SCORE
from homography_servo.tracking.detection.region_quads import list_quads
from homography_servo.tracking.detection.region_quads import side_contrast
from homography_servo.tracking.detection.segments import SMALLER_BY
from homography_servo.tracking.detection.views import parallelograms
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.rectified import spread_inside
from homography_servo.tracking.target import Found
from homography_servo.tracking.target import STEEPEST
from homography_servo.tracking.target import Target
import numpy as np

LOOKED_AT = 16  # candidates fitted at most
CONVINCING = 0.7  # score that ends the search
MOST_SKEW, MOST_STRETCH = 0.55, 0.55  # of a candidate: cosine, log of the aspect
SAME_PX = 3.0
LEAST_NEWS = 0.3  # share of a quadrilateral that was not there before
INSIDE = spread_inside(5)


def find_by_regions(image: np.ndarray, target: Target, plane: Plane) -> Found | Rejected:
    """
    Find the quadrilateral that looks most like the face.

    Parameters
    ----------
    image : (H, W) uint8 array
        Contiguous grey image.
    target : Target
        The face and where it may be.
    plane : Plane
        With a camera.

    Returns
    -------
    Found or Rejected

    """
    best, reason = None, 'no quadrilateral in the image can be the face'
    for quad in candidates(image, target, plane):
        found = examine(image, quad, target, plane)
        if isinstance(found, Rejected):
            reason = found.reason
        elif best is None or found.merit > best.merit:
            best = found
            if best.merit > CONVINCING:
                break
    if best is None:
        return Rejected(reason)
    if best.merit < LEAST_SCORE:
        return Rejected(f'the best quadrilateral looks like the face to {best.merit:.0%} only')
    return best


def candidates(image: np.ndarray, target: Target, plane: Plane) -> np.ndarray:
    """List quadrilaterals (N, 4, 2) in the plane that may be the face, best first."""
    longest_px = plane.mean_focal * max(target.face_size_m) / target.farthest_m
    least = STEEPEST * longest_px ** 2 * min(target.face_size_m) / max(target.face_size_m)
    quads = list_quads(image, least)
    if target.news is not None:
        quads = quads[_shown_share(target.news, quads) > LEAST_NEWS]
    if not len(quads):
        return quads
    contrast, inside = side_contrast(image, quads, AWAY_PX)
    quads = plane.from_image(quads)
    cosine, in_reach = _affine_pose(quads, target, plane)
    signed = np.abs(contrast) if target.polarity == 0 else contrast * target.polarity
    levels = inside.reshape(len(quads), -1)
    even = np.abs(levels - np.median(levels, axis=1, keepdims=True)) < EVEN_GREY
    across = quads[:, 2:] - quads[:, :2]
    area = np.abs(across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0])
    shown = (signed > CLEAR_GREY).mean(axis=(1, 2))
    merit = shown + 2.0 * even.mean(axis=1) + 0.3 * cosine + 0.1 * np.log(area / least)
    merit[~in_reach | (shown < 0.5) | ~_in_proportion(quads, target, plane)] = -np.inf
    return _distinct(quads[np.argsort(-merit)[:np.isfinite(merit).sum()]])


def _shown_share(news: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Give the share (N,) of places in quadrilaterals (N, 4, 2) that a small picture marks."""
    places = np.rint((INSIDE @ quads) / SMALLER_BY).astype(int)
    height, width = news.shape
    return (news[places[..., 1].clip(0, height - 1), places[..., 0].clip(0, width - 1)]
            > 0).mean(axis=1)


def _distinct(quads: np.ndarray) -> np.ndarray:
    """Keep the first of those whose centre and extent are alike."""
    far = quads - quads.mean(axis=1, keepdims=True)
    marks = np.column_stack([quads.mean(axis=1), np.abs(far).max(axis=1)])
    kept: list[int] = []
    for index, mark in enumerate(marks):
        if not kept or np.abs(marks[kept] - mark).max(axis=1).min() > SAME_PX:
            kept.append(index)
        if len(kept) == LOOKED_AT:
            break
    return quads[kept]


def _in_proportion(quads: np.ndarray, target: Target, plane: Plane) -> np.ndarray:
    """Tell which quadrilaterals may be views of the face; their corners are rough."""
    across, down, _ = parallelograms(quads, plane)
    long, short = (np.linalg.norm(edge, axis=1) + 1e-12 for edge in (across, down))
    skew = np.abs((across * down).sum(axis=1)) / (long * short)
    wanted = abs(np.log(target.face_size_m[0] / target.face_size_m[1]))
    stretch = np.abs(np.abs(np.log(long / short)) - wanted)
    return (skew < MOST_SKEW) & (stretch < MOST_STRETCH)


def _affine_pose(quads: np.ndarray, target: Target,
                 plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the cosine of the tilt, and whether the distance is within reach."""
    across = 0.5 * (quads[:, 1] - quads[:, 0] + quads[:, 2] - quads[:, 3])
    down = 0.5 * (quads[:, 3] - quads[:, 0] + quads[:, 2] - quads[:, 1])
    best, allowed = np.zeros(len(quads)), np.zeros(len(quads), bool)
    for width, height in (target.face_size_m, target.face_size_m[::-1]):
        spread = np.linalg.svd(np.stack([across / width, down / height], axis=2),
                               compute_uv=False)
        depth = plane.mean_focal / np.maximum(spread[:, 0], 1e-9)
        cosine = spread[:, 1] / np.maximum(spread[:, 0], 1e-9)
        possible = (depth > 0.85 * target.nearest_m) & (depth < 1.15 * target.farthest_m) \
            & (cosine > 0.8 * STEEPEST)
        best = np.where(possible, np.maximum(best, cosine), best)
        allowed |= possible
    return best, allowed
