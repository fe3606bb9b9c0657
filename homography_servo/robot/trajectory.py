"""
From a command to a motion that the arm can make.

The rules are those of joint_trajectory_controller: names in any order, all joints, strictly
increasing times, header stamp zero means now, a new trajectory replaces the old one, no
points means stop, the last velocity must be zero, effort is refused.

What the arm must not do is refused (`Rejected`): positions outside the limits, velocities
or accelerations given above them. What it can do, but not in the time that was given, is
done slower: all times are stretched by one factor, so that all joints keep together on the
same curve. The factor and the reason are in the result (`time_scale`, `note`), for whoever
sent the command. Stretching is limited by `TrajectorySettings.longest_stretch`.

Positions without velocities are joined by monotone cubic pieces that start with the
present velocity and end at rest: they pass all points at their times and never leave the
range between two points, and an arm can follow them, unlike straight lines with corners
(`interpolation: linear` gives those).
"""

from __future__ import annotations

import math
from typing import NamedTuple
from typing import Sequence

from homography_servo.result import Rejected
from homography_servo.robot.limits import acceleration_problem
from homography_servo.robot.limits import joint_order
from homography_servo.robot.limits import MotionLimits
from homography_servo.robot.limits import position_problem
from homography_servo.robot.limits import time_problem
from homography_servo.robot.limits import velocity_problem
from homography_servo.robot.spline import Knots
from homography_servo.robot.spline import Spline
from homography_servo.robot.timing import brake
from homography_servo.robot.timing import State
from homography_servo.robot.timing import timed
from homography_servo.robot.timing import Trajectory
from homography_servo.robot.timing import TrajectorySettings
from homography_servo.robot.timing import Wanted
import numpy as np

# Judging these takes up to 0.07 s, in which nothing else is sent and a stop may have to wait.
MOST_POINTS = 1000

__all__ = ['accept', 'go_to', 'MOST_POINTS', 'State', 'stop', 'Trajectory', 'TrajectoryPoint',
           'TrajectorySettings']


class TrajectoryPoint(NamedTuple):
    """A point of a command; velocities, accelerations and effort may be left out."""

    time_s: float
    positions: Sequence[float] | np.ndarray
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()
    effort: Sequence[float] = ()


def accept(limits: MotionLimits, names: Sequence[str], points: Sequence[TrajectoryPoint],
           start: State, settings: TrajectorySettings = TrajectorySettings(),
           stamp_s: float = 0.0, now_s: float = 0.0) -> Trajectory | Rejected:
    """
    Make a motion from a JointTrajectory, or say why not.

    Parameters
    ----------
    limits : MotionLimits
        Names and limits of the arm.
    names : sequence of str
        Joint names of the message.
    points : sequence of TrajectoryPoint
        Points of the message; none means stop.
    start : State
        Positions and velocities commanded now.
    settings : TrajectorySettings
        How much may be stretched, and how points are joined.
    stamp_s, now_s : float
        Header stamp (0 is now) and the time on the same clock.

    Returns
    -------
    Trajectory or Rejected
        The motion from `start`, time 0 is now.

    """
    if len(points) == 0:
        return stop(limits, start)
    if len(points) > MOST_POINTS:
        return Rejected(f'more than {MOST_POINTS} points')
    order = joint_order(limits, names)
    if isinstance(order, Rejected):
        return order
    problem = _shape_problem(points, len(order))
    if problem is None:
        problem = time_problem([point.time_s for point in points])
    if problem is not None:
        return problem
    wanted = _ordered(points, order)
    problem = _values_problem(limits, wanted)
    if problem is not None:
        return problem
    left = _from_now(wanted, stamp_s, now_s, settings)
    return left if isinstance(left, Rejected) else timed(limits, left, start, settings)


def go_to(limits: MotionLimits, joints_rad: Sequence[float] | np.ndarray, start: State,
          settings: TrajectorySettings = TrajectorySettings()) -> Trajectory | Rejected:
    """Make the shortest motion to a posture (n,): the slowest joint sets the time."""
    return accept(limits, limits.names, [TrajectoryPoint(0.0, joints_rad)], start, settings)


def stop(limits: MotionLimits, start: State) -> Trajectory:
    """Make the motion that comes to rest: all joints brake together, none too hard."""
    at_rest, time_s = brake(limits, start)
    return Trajectory(Spline(Knots(np.array([0.0, time_s]), np.stack([start.positions, at_rest]),
                                   np.stack([start.velocities, np.zeros_like(at_rest)]))))


def _shape_problem(points: Sequence[TrajectoryPoint], count: int) -> Rejected | None:
    for index, point in enumerate(points):
        if len(point.positions) != count:
            return Rejected(f'point {index} has {len(point.positions)} positions for {count} '
                            'joints')
        for what in ('velocities', 'accelerations'):
            size = len(getattr(point, what))
            if size not in (0, count):
                return Rejected(f'point {index} has {size} {what} for {count} joints')
        if len(point.effort):
            return Rejected(f'point {index} has effort, which this arm cannot follow')
        if len(point.accelerations) and not len(point.velocities):
            return Rejected(f'point {index} has accelerations but no velocities')
    for what in ('velocities', 'accelerations'):
        if len({len(getattr(point, what)) for point in points}) > 1:
            return Rejected(f'some points have {what} and some have none')
    return None


def _ordered(points: Sequence[TrajectoryPoint], order: np.ndarray) -> Wanted:
    def table(rows: list) -> np.ndarray:
        return np.array(rows, dtype=float)[:, order]
    first = points[0]
    return Wanted(
        np.array([point.time_s for point in points], dtype=float),
        table([point.positions for point in points]),
        table([point.velocities for point in points]) if len(first.velocities) else None,
        table([point.accelerations for point in points]) if len(first.accelerations) else None)


def _values_problem(limits: MotionLimits, wanted: Wanted) -> Rejected | None:
    problem = position_problem(limits, wanted.positions)
    if problem is None and wanted.velocities is not None:
        problem = velocity_problem(limits, wanted.velocities)
        if problem is None and np.any(wanted.velocities[-1] != 0.0):
            problem = Rejected('the last point must be at rest, its velocities are not 0')
    if problem is None and wanted.accelerations is not None:
        problem = acceleration_problem(limits, wanted.accelerations)
    return problem


def _from_now(wanted: Wanted, stamp_s: float, now_s: float,
              settings: TrajectorySettings) -> Wanted | Rejected:
    """Count times from now and drop the points that have passed."""
    if not math.isfinite(stamp_s):
        return Rejected('the header stamp is not finite')
    if stamp_s == 0.0:
        return wanted
    ahead_s = stamp_s - now_s
    if ahead_s > settings.longest_wait_s:
        return Rejected(f'the header stamp is {ahead_s:.3g} s ahead of now, more than '
                        f'{settings.longest_wait_s:g} s')
    times_s = wanted.times_s + ahead_s
    if times_s[-1] <= 0.0:
        return Rejected(f'the trajectory ended {abs(times_s[-1]):.3g} s ago')
    left = times_s > 0.0
    return wanted._replace(times_s=times_s).take(left)
