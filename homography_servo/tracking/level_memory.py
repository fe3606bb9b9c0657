"""What is known about the grey levels of an edge from other pixels and earlier pictures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

MEMORY_GAIN = 0.1  # of a picture among earlier ones
STEADY_GREY = 0.8  # grey levels that change less from picture to picture are remembered
FIRST_SPREAD_GREY = 1.0  # of grey levels from picture to picture before that is known


class Alike(NamedTuple):
    """How far levels are alike."""

    spread: list[float]  # four, of far and of common levels about the segments' own
    pixels: np.ndarray  # (2, 2, 1) that such a level stands for; far or common, out- or inside
    limit: np.ndarray  # (2, 2, 1) how far from a segment's own level it may be


class Known(NamedTuple):
    """Grey levels from other pixels than those across the edge, outside and inside."""

    table: np.ndarray  # (8, s) how many they count for, far and common; sums of their grey
    common: list[float]  # two levels that most segments share in this picture
    alike: Alike
    doubt: float  # how far the common level could give in to an offset of all sides, 0 to 1


class LevelMemory(NamedTuple):
    """What most segments had in earlier pictures, outside and inside."""

    level: list[float]  # two common grey levels
    variance: list[float]  # of one picture's level about them
    alike: Alike
    age: int  # pictures

    @staticmethod
    def first(known: Known) -> LevelMemory:
        """Begin with one picture."""
        return LevelMemory(known.common, [FIRST_SPREAD_GREY ** 2] * 2, known.alike, 1)

    def updated(self, known: Known) -> LevelMemory:
        """Take in another picture."""
        away = [new - old for new, old in zip(known.common, self.level)]
        return LevelMemory(
            [old + MEMORY_GAIN * change for old, change in zip(self.level, away)],
            [old + MEMORY_GAIN * (change * change - old)
             for old, change in zip(self.variance, away)], known.alike, self.age + 1)

    def gain(self) -> list[float]:
        """Say how much of a new level to believe, 0 to 1, outside and inside."""
        return [variance / (variance + STEADY_GREY ** 2) for variance in self.variance]
