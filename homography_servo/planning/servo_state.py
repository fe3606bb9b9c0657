"""The states of the servo, and what it keeps count of."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

IDLE, MOVING, LOOKING = 'IDLE', 'MOVING', 'LOOKING'
HOLD, DONE, FAILED = 'HOLD', 'DONE', 'FAILED'
ACTIVE = (MOVING, LOOKING, HOLD)


class Progress(NamedTuple):
    """How far the servo is; poses count from 1."""

    pose: int = 0
    of: int = 0
    reached: bool = False
    position_error_m: float = math.nan
    rotation_error_rad: float = math.nan
    iterations: int = 0
    looks: int = 0
    sure: float = math.nan  # worst standard deviation over its tolerance


@dataclass
class Attempt:
    """What was tried at the present pose, counted from 0; -1 is not known yet."""

    index: int
    moves: int = 0
    looks: int = 0
    passing: int = 0  # looks that were taken on the way
    grown: int = 0
    last_over: float = math.inf
    past: bool = False  # poses before it were left out
