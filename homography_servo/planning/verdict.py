"""What is known about a path before anything moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class PoseValues(NamedTuple):
    """What was measured at every pose; arrays of length N, NaN where it does not apply."""

    field_px: np.ndarray  # smallest distance of a point to the border, negative outside
    facing_rad: np.ndarray  # angle between face normal and line of sight
    reached: np.ndarray  # bool: the arm gets there from the start without a break
    joint_margin_rad: np.ndarray  # smallest distance to a joint limit, negative beyond
    joint_index: np.ndarray  # int: the joint that is nearest to its limit
    conditioning: np.ndarray  # smallest singular value, negative beyond a singularity
    led: np.ndarray  # bool: near a singularity, to be passed by the planned joints
    joint_step_rad: np.ndarray  # largest joint motion to the next pose, 0 at the last
    ambiguity: np.ndarray  # of the mirror pose, 0 certain to 1 toss-up


class Check(NamedTuple):
    """One rule applied to all poses."""

    name: str
    good: np.ndarray  # (N,) bool
    sentences: dict[int, str]  # of the bad poses, by index


@dataclass(frozen=True)
class Verdict:
    """
    Whether a path can be executed, and why not.

    Poses count from 0 in `first_bad` and from 1 in sentences.
    """

    ok: bool
    sentence: str
    first_bad: int | None
    values: PoseValues
    reasons: tuple[str, ...]  # per pose, empty where it is good
    joints_rad: np.ndarray | None  # (N, n) predicted along the path
    check: str = ''  # name of the check that the first bad pose failed

    def __bool__(self) -> bool:
        return self.ok

    @property
    def good_poses(self) -> int:
        """Count the poses before the first bad one."""
        return len(self.reasons) if self.first_bad is None else self.first_bad
