"""
What a command may ask of the arm.

Every check gives `Rejected` with a sentence, or None; nothing is clipped. A value exactly
at a limit is allowed, one that is over by any amount is not.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
import math
from typing import Sequence

from homography_servo.result import Rejected
from homography_servo.robot.robot_model import Robot
import numpy as np


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """
    Limits of an arm in joint order; the margin is taken off already.

    Parameters
    ----------
    names : tuple of str
        Joint names.
    lower_rad, upper_rad : (n,) array
        Positions allowed.
    velocity_rad_s, acceleration_rad_s2 : (n,) array
        Largest velocity and acceleration to either side.

    """

    names: tuple[str, ...]
    lower_rad: np.ndarray
    upper_rad: np.ndarray
    velocity_rad_s: np.ndarray
    acceleration_rad_s2: np.ndarray

    def __post_init__(self) -> None:
        if not np.all(self.lower_rad < self.upper_rad):
            raise ValueError(f'the margin leaves no room between {self.lower_rad} and '
                             f'{self.upper_rad} rad')


def limits_of(robot: Robot, margin_rad: float = 0.0) -> MotionLimits:
    """Take the limits of a robot, with a margin to the ends of every joint."""
    if not (math.isfinite(margin_rad) and margin_rad >= 0.0):
        raise ValueError(f'margin_rad must be 0 or above, got {margin_rad}')
    return MotionLimits(robot.joint_names, robot.lower_rad + margin_rad,
                        robot.upper_rad - margin_rad, robot.velocity_rad_s,
                        robot.acceleration_rad_s2)


def joint_order(limits: MotionLimits, names: Sequence[str]) -> np.ndarray | Rejected:
    """
    Find where each joint of the arm stands in a message.

    Parameters
    ----------
    limits : MotionLimits
        Holds the names of the arm.
    names : sequence of str
        Names in the message: every joint of the arm once, in any order.

    Returns
    -------
    (n,) array of int, or Rejected
        ``values[order]`` is in joint order.

    """
    names = list(names)
    if not names:
        return Rejected('no joint names given')
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    unknown = [name for name in names if name not in limits.names]
    missing = [name for name in limits.names if name not in names]
    for problem, what in ((unknown, 'unknown'), (twice, 'repeated'), (missing, 'missing')):
        if problem:
            return Rejected(f'joint {_some(problem)} {what}')
    return np.array([names.index(name) for name in limits.names])


def _some(names: list[str]) -> str:
    shown = ', '.join(str(name)[:40] for name in names[:3])
    return shown + (f' and {len(names) - 3} more' if len(names) > 3 else '')


def position_problem(limits: MotionLimits, joints_rad: np.ndarray) -> Rejected | None:
    """Say which joint of (n,) or (..., n) positions is outside its limits."""
    joints = np.asarray(joints_rad, dtype=float)
    outside = ~((joints >= limits.lower_rad) & (joints <= limits.upper_rad))
    if not outside.any():
        return None
    return _position_reason(limits, joints, outside)


def _position_reason(limits: MotionLimits, joints: np.ndarray, outside: np.ndarray) -> Rejected:
    index = tuple(np.argwhere(outside)[0])
    name, value = limits.names[index[-1]], joints[index]
    if not math.isfinite(value):
        return Rejected(f'{name} is not finite')
    low, high = limits.lower_rad[index[-1]], limits.upper_rad[index[-1]]
    over = low - value if value < low else value - high
    return Rejected(f'{name} at {value:.6g} rad is {over:.3g} rad outside '
                    f'{low:.6g}..{high:.6g} rad')


def velocity_problem(limits: MotionLimits, velocities_rad_s: np.ndarray) -> Rejected | None:
    """Say which joint of (..., n) velocities is too fast."""
    return _rate_problem(limits.names, velocities_rad_s, limits.velocity_rad_s, 'rad/s')


def acceleration_problem(limits: MotionLimits, accelerations: np.ndarray) -> Rejected | None:
    """Say which joint of (..., n) accelerations is too high."""
    return _rate_problem(limits.names, accelerations, limits.acceleration_rad_s2, 'rad/s^2')


def _rate_problem(names: tuple[str, ...], values: np.ndarray, largest: np.ndarray,
                  unit: str) -> Rejected | None:
    values = np.asarray(values, dtype=float)
    fast = ~(np.abs(values) <= largest)
    if not fast.any():
        return None
    index = tuple(np.argwhere(fast)[0])
    name = names[index[-1]]
    if not math.isfinite(values[index]):
        return Rejected(f'{name} is not finite')
    return Rejected(f'{name} at {values[index]:.6g} {unit} is above its limit of '
                    f'{largest[index[-1]]:.6g} {unit}')


def time_problem(times_s: Sequence[float]) -> Rejected | None:
    """Say where times do not start at 0 or later, or do not strictly increase."""
    previous = -math.inf
    for index, time_s in enumerate(times_s):
        if not math.isfinite(time_s):
            return Rejected(f'time of point {index} is not finite')
        if time_s < 0.0:
            return Rejected(f'time of point {index} is negative, {time_s:.6g} s')
        if time_s <= previous:
            return Rejected(f'times must strictly increase, point {index} is at {time_s:.6g} s '
                            f'after {previous:.6g} s')
        previous = time_s
    return None
