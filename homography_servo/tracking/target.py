"""What the finder looks for, what it finds, and in which order the corners come."""

from __future__ import annotations

from typing import Callable
from typing import NamedTuple

from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.strips import Strips
import numpy as np

STEEPEST = 0.35  # cosine of the largest tilt
SQUARE = 0.02  # difference of the sides of a square


class Target(NamedTuple):
    """What is looked for."""

    face_size_m: tuple[float, float]
    box_height_m: float
    nearest_m: float
    farthest_m: float
    polarity: int  # 1 bright face, -1 dark face, 0 unknown
    blur_px: float
    guessed_lens: bool = False
    news: np.ndarray | None = None  # (H / 2, W / 2) uint8, 0 where it surely is not
    doubt: Callable[[np.ndarray], str] | None = None  # why corners surely are not the face's

    @property
    def turns(self) -> tuple[int, ...]:
        """Say by how many places the corners may be rolled for the face to look the same."""
        return turns_of(self.face_size_m)

    def strange(self, corners: np.ndarray) -> str:
        """Say why corners (4, 2) in the plane surely are not those of the face, if so."""
        return '' if self.doubt is None else self.doubt(corners)


class Found(NamedTuple):
    """A face that was found."""

    fit: SnakeFit
    merit: float  # to be compared within one search only


def turns_of(face_size_m: tuple[float, float]) -> tuple[int, ...]:
    """Say by how many places the corners may be rolled for a face to look the same."""
    width, height = face_size_m
    return (0, 1, 2, 3) if abs(width / height - 1.0) < SQUARE else (0, 2)


def turned(fit: SnakeFit, turns: tuple[int, ...], expected: np.ndarray | None) -> SnakeFit:
    """
    Begin a fit with another corner.

    Parameters
    ----------
    fit : SnakeFit
        Of the face.
    turns : tuple of int
        By how many places the corners may be rolled.
    expected : (4, 2) array or None
        Corners that it should come close to; without them the top side should point to
        the right.

    Returns
    -------
    SnakeFit

    """
    turn = min(turns, key=lambda turn: _turn_cost(np.roll(fit.corners, -turn, axis=0), expected))
    return rolled(fit, turn)


def rolled(fit: SnakeFit, turn: int) -> SnakeFit:
    """Begin a fit with the corner of this number."""
    if turn == 0:
        return fit
    order = np.roll(np.arange(4), -turn)
    both = (2 * order[:, None] + np.arange(2)).ravel()
    edges = fit.edges._replace(side=(fit.edges.side - turn) % 4)
    strips = fit.strips if fit.strips is None else Strips(
        fit.strips.width[order], fit.strips.rows[order][:, :, both],
        *(part[order] for part in fit.strips[2:]))
    return fit._replace(corners=fit.corners[order], covariance=fit.covariance[np.ix_(both, both)],
                        edges=edges, strips=strips)


def _turn_cost(corners: np.ndarray, expected: np.ndarray | None) -> float:
    if expected is not None:
        away = (corners - corners.mean(axis=0)) - (expected - expected.mean(axis=0))
        return float(np.abs(away).sum())
    top = corners[1] - corners[0] + corners[2] - corners[3]
    return abs(float(np.arctan2(top[1], top[0])))
