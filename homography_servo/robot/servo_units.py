"""
Joint angles and servo positions.

A servo takes whole numbers only. Rounding goes to the nearest, except at a limit, where it
goes inwards: a joint inside its limits stays inside them as a servo position.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.robot.robot_model import Robot
import numpy as np


class UnitRange(NamedTuple):
    """Smallest and largest whole servo positions inside the limits, in joint order."""

    low: np.ndarray  # (n,) int
    high: np.ndarray  # (n,) int


def unit_range(robot: Robot, margin_rad: float = 0.0) -> UnitRange:
    """Give the servo positions that keep a margin to the joint limits."""
    ends = np.sort([exact_units(robot, robot.lower_rad + margin_rad),
                    exact_units(robot, robot.upper_rad - margin_rad)], axis=0)
    # A limit that falls on a whole number stays usable in spite of round-off.
    return UnitRange(np.ceil(ends[0] - 1e-9).astype(int), np.floor(ends[1] + 1e-9).astype(int))


def exact_units(robot: Robot, joints_rad: np.ndarray) -> np.ndarray:
    """Map joints (..., n) to servo positions, not rounded."""
    return robot.zero_units + robot.units_per_rad * np.asarray(joints_rad, dtype=float)


def to_units(robot: Robot, joints_rad: np.ndarray, margin_rad: float = 0.0) -> np.ndarray:
    """
    Map joints to servo positions.

    Parameters
    ----------
    robot : Robot
        Holds the mapping and the limits.
    joints_rad : (..., n) array
        Joint angles; whether they are inside the limits is not judged here.
    margin_rad : float
        Margin of the limits at which rounding goes inwards.

    Returns
    -------
    (..., n) array of int
        In joint order.

    """
    exact = exact_units(robot, joints_rad)
    if not np.isfinite(exact).all():
        raise ValueError('joints_rad must be finite')
    nearest = np.rint(exact).astype(int)
    low, high = unit_range(robot, margin_rad)
    nearest = np.where((nearest < low) & (exact > low - 1.0), low, nearest)
    return np.where((nearest > high) & (exact < high + 1.0), high, nearest)


def from_units(robot: Robot, units: np.ndarray) -> np.ndarray:
    """Map servo positions (..., n) in joint order to joints [rad]."""
    return (np.asarray(units, dtype=float) - robot.zero_units) / robot.units_per_rad


def resolution_rad(robot: Robot) -> np.ndarray:
    """Give the joint step (n,) of one servo unit; rounding costs at most half of it."""
    return 1.0 / np.abs(robot.units_per_rad)


def velocity_units_s(robot: Robot) -> np.ndarray:
    """Give the velocity limits (n,) in servo units per second."""
    return robot.velocity_rad_s * np.abs(robot.units_per_rad)


def acceleration_units_s2(robot: Robot) -> np.ndarray:
    """Give the acceleration limits (n,) in servo units per second squared."""
    return robot.acceleration_rad_s2 * np.abs(robot.units_per_rad)


def channel_order(robot: Robot) -> np.ndarray:
    """Give the joint indices (n,) that sort joints by servo channel."""
    return np.argsort([joint.channel for joint in robot.joints])


def to_channels(robot: Robot, units: np.ndarray) -> list[int]:
    """Sort servo positions (n,) in joint order by servo channel, for the wire."""
    return [int(value) for value in np.asarray(units)[channel_order(robot)]]


def from_channels(robot: Robot, positions: list[int]) -> np.ndarray:
    """Undo `to_channels`: servo positions (n,) in joint order."""
    if len(positions) != robot.count:
        raise ValueError(f'positions must have {robot.count} items, got {len(positions)}')
    units = np.empty(robot.count, dtype=int)
    units[channel_order(robot)] = positions
    return units
