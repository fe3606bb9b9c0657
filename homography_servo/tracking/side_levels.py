"""How bright the sides of the box and what lies behind them are, learnt from good fits."""

from __future__ import annotations

import math

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
        self._level = [FIRST_LEVEL] * 4  # over that of the face
        self._variance = [FIRST_SIGMA ** 2] * 4
        self._inside: float | None = None
        self._outside = [0.0] * 4
        self._relative: tuple[np.ndarray, np.ndarray] | None = None  # of the present levels

    @property
    def known(self) -> bool:
        """Tell whether anything has been learnt."""
        return self._inside is not None

    def relative(self) -> tuple[np.ndarray, np.ndarray]:
        """Give the brightness (4,), 0 as outside and 1 as the face, and its deviation (4,)."""
        if self._relative is not None:
            return self._relative
        inside, levels, sigmas = required(self._inside, 'level of the face'), [], []
        for level, variance, outside in zip(self._level, self._variance, self._outside):
            contrast = inside - outside if abs(inside - outside) >= 1.0 else 1.0
            levels.append(min(max((level * inside - outside) / contrast, -1.0), 2.0))
            sigmas.append(math.sqrt(variance) * inside / abs(contrast))
        self._relative = np.array(levels), np.array(sigmas)
        return self._relative

    def learn(self, edges: Edges, weight: np.ndarray, strips: Strips | None, half: int,
              pictures: int = 1) -> None:
        """Take in the grey levels that a good fit has found so many pictures after the last."""
        good = weight > GOOD_WEIGHT
        if not good.any():
            return
        self._relative = None
        self._inside = middle((edges.outside + edges.contrast)[good])
        self._variance = [min(variance + pictures * DRIFT_SIGMA ** 2, FIRST_SIGMA ** 2)
                          for variance in self._variance]
        seen = np.bincount(edges.side, good, 4).tolist()
        sums = np.bincount(edges.side, good * edges.outside, 4).tolist()
        widths = [0.0] * 4 if strips is None else list(map(sum, strips.width.tolist()))
        face, behind = max(self._inside, 1.0), []
        for side, (count, total, width) in enumerate(zip(seen, sums, widths)):
            covered = 0.5 * width > half + CLEAR_PX
            if count and covered:
                self._update(side, total / count / face, SURFACE_SIGMA ** 2)
            elif count:
                self._outside[side] = total / count
                behind.append(side)
        if edges.second is not None:
            self._learn_strips(edges, good, {side: 0.5 * widths[side] for side in behind}, face)

    def _learn_strips(self, edges: Edges, good: np.ndarray, width: dict[int, float],
                      face: float) -> None:
        """Learn from strips of known width that something else shows behind."""
        second = required(edges.second, 'second edge')
        side, good = edges.side.take(second.segment), good.take(second.segment)
        information = np.bincount(side, good * second.level_own, 4).tolist()
        pull = np.bincount(side, good * second.level_pull, 4).tolist()
        noise = middle(edges.residual) / face ** 2
        for number, wide in width.items():
            certain = information[number]
            if not (certain > 1e-6 and wide > LEARN_PX):
                continue
            level = self._level[number] + pull[number] / certain / face
            # A wrong width spreads the strip's light, a wrong edge mixes in the face's.
            spread = WIDTH_SIGMA_PX * (level - self._outside[number] / face) / wide
            mixed = EDGE_SIGMA_PX * (1.0 - level) / wide
            self._update(number, level,
                         noise / certain + spread ** 2 + mixed ** 2 + SURFACE_SIGMA ** 2)

    def _update(self, side: int, level: float, variance: float) -> None:
        gain = self._variance[side] / (self._variance[side] + variance)
        self._level[side] += gain * (min(max(level, 0.0), 2.0) - self._level[side])
        self._variance[side] *= 1.0 - gain
