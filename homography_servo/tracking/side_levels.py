"""How bright the sides of the box and what lies behind them are, learnt from good fits."""

from __future__ import annotations

from homography_servo.result import required
from homography_servo.tracking.edges import Edges
from homography_servo.tracking.levels import middle
from homography_servo.tracking.strips import Strips
import numpy as np

FIRST_LEVEL, FIRST_SIGMA = 0.55, 0.2  # of a side, over that of the face
DRIFT_SIGMA = 0.01  # per picture: the box turns in the light
SURFACE_SIGMA = 0.03  # of a side that is seen well
WIDTH_SIGMA_PX = 0.25  # of a strip, as the pose predicts it
EDGE_SIGMA_PX = 0.15  # of the face's edge beside it
LEARN_PX = 0.7  # narrower strips teach nothing
CLEAR_PX = 1.5  # a side this much wider than the scan lines hides what is behind
GOOD_WEIGHT = 0.1


class SideLevels:
    """Learns the brightness of the four sides; those of a Lambertian box depend on the pose."""

    def __init__(self) -> None:
        self._level = np.full(4, FIRST_LEVEL)  # over that of the face
        self._variance = np.full(4, FIRST_SIGMA ** 2)
        self._inside: float | None = None
        self._outside = np.zeros(4)

    @property
    def known(self) -> bool:
        """Tell whether anything has been learnt."""
        return self._inside is not None

    def relative(self) -> tuple[np.ndarray, np.ndarray]:
        """Give the brightness (4,), 0 as outside and 1 as the face, and its deviation (4,)."""
        inside = required(self._inside, 'level of the face')
        contrast = inside - self._outside
        contrast = np.where(np.abs(contrast) < 1.0, 1.0, contrast)
        level = (self._level * inside - self._outside) / contrast
        sigma = np.sqrt(self._variance) * inside / np.abs(contrast)
        return np.minimum(np.maximum(level, -1.0), 2.0), sigma

    def learn(self, edges: Edges, weight: np.ndarray, strips: Strips | None, half: int) -> None:
        """Take in the grey levels that a good fit has found."""
        good = weight > GOOD_WEIGHT
        if not good.any():
            return
        self._inside = middle((edges.outside + edges.contrast)[good])
        self._variance = np.minimum(self._variance + DRIFT_SIGMA ** 2, FIRST_SIGMA ** 2)
        seen = np.bincount(edges.side, good, 4)
        outside = np.bincount(edges.side, good * edges.outside, 4) / np.maximum(seen, 1.0)
        width = np.zeros(4) if strips is None else 0.5 * np.add.reduce(strips.width, axis=1)
        covered = (width > half + CLEAR_PX) & (seen > 0.0)
        behind = ~covered & (seen > 0.0)
        self._outside[behind] = outside[behind]
        face = max(self._inside, 1.0)
        for side in covered.nonzero()[0].tolist():
            self._update(side, float(outside[side]) / face, SURFACE_SIGMA ** 2)
        if edges.second is not None:
            self._learn_strips(edges, good, np.where(behind, width, 0.0), outside / face, face)

    def _learn_strips(self, edges: Edges, good: np.ndarray, width: np.ndarray,
                      behind: np.ndarray, face: float) -> None:
        """Learn from strips of known width (4,) before levels (4,) over that of the face."""
        second = required(edges.second, 'second edge')
        side, good = edges.side.take(second.segment), good.take(second.segment)
        information = np.bincount(side, good * second.level_own, 4)
        pull = np.bincount(side, good * second.level_pull, 4)
        noise = middle(edges.residual) / face ** 2
        for number in ((information > 1e-6) & (width > LEARN_PX)).nonzero()[0].tolist():
            wide, certain = float(width[number]), float(information[number])
            level = float(self._level[number] + pull[number] / certain / face)
            # A wrong width spreads the strip's light, a wrong edge mixes in the face's.
            spread = WIDTH_SIGMA_PX * (level - float(behind[number])) / wide
            mixed = EDGE_SIGMA_PX * (1.0 - level) / wide
            self._update(number, level,
                         noise / certain + spread ** 2 + mixed ** 2 + SURFACE_SIGMA ** 2)

    def _update(self, side: int, level: float, variance: float) -> None:
        gain = self._variance[side] / (self._variance[side] + variance)
        self._level[side] += gain * (min(max(level, 0.0), 2.0) - self._level[side])
        self._variance[side] *= 1.0 - gain
