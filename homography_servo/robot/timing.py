"""
The timing of motions: as asked for where the limits allow, slower where they do not.

All times are stretched by one factor, so that all joints keep together on the same curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
from typing import NamedTuple

from homography_servo.result import Rejected
from homography_servo.robot.limits import MotionLimits
from homography_servo.robot.limits import position_problem
from homography_servo.robot.spline import Knots
from homography_servo.robot.spline import monotone_velocities
from homography_servo.robot.spline import Sample
from homography_servo.robot.spline import Spline
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import text
import numpy as np

_ROUNDS = 12  # of stretching; two or three are used
_SHORTEST_S = 1e-3
_ROUND_OFF_RAD = 1e-12  # of polynomials between points; the points themselves are exact


@dataclass(frozen=True)
class TrajectorySettings(Settings):
    """How commands become motions."""

    longest_stretch: float = real(
        10.0, 1.0, 1000.0, '', 'largest factor by which a motion may be slowed down to keep '
        'the limits, 1 refuses every motion that is too fast')
    headroom: float = real(
        0.05, 0.0, 0.5, '', 'share of the velocity limit kept free for rounding to servo units')
    interpolation: str = text(
        'smooth', 'between positions without velocities', ('smooth', 'linear'))
    longest_wait_s: float = real(
        10.0, 0.0, 3600.0, 's', 'largest time that a header stamp may be ahead of now')


class State(NamedTuple):
    """What the arm is told now, in joint order."""

    positions: np.ndarray
    velocities: np.ndarray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    A motion inside all limits, from the state at its start.

    Parameters
    ----------
    spline : Spline
        Its time 0 is the start.
    time_scale : float
        Factor on the times that were asked for, 1 or above.
    note : str
        What was changed and why; empty when nothing was.
    single_point : bool
        The command had one point, so one `move` does it as well.

    """

    spline: Spline
    time_scale: float = 1.0
    note: str = ''
    single_point: bool = False

    @property
    def duration_s(self) -> float:
        """Time from start to rest."""
        return self.spline.duration_s

    @property
    def goal(self) -> np.ndarray:
        """(n,) last positions."""
        return self.spline.knots.positions[-1]

    def sample(self, time_s: float) -> Sample:
        """Give positions, velocities and accelerations at a time since the start."""
        return self.spline.sample(time_s)


class Wanted(NamedTuple):
    """A command in joint order."""

    times_s: np.ndarray  # (K,)
    positions: np.ndarray  # (K, n)
    velocities: np.ndarray | None
    accelerations: np.ndarray | None

    def take(self, which: np.ndarray | slice) -> Wanted:
        """Select points."""
        return Wanted(self.times_s[which], self.positions[which],
                      None if self.velocities is None else self.velocities[which],
                      None if self.accelerations is None else self.accelerations[which])


def timed(limits: MotionLimits, wanted: Wanted, start: State,
          settings: TrajectorySettings) -> Trajectory | Rejected:
    """Go there directly; where the present motion forbids that, brake first."""
    direct = _stretched(limits, wanted, start, settings)
    if not isinstance(direct, Rejected) or not np.any(start.velocities):
        return direct
    at_rest, brake_s = brake(limits, start)
    later = _stretched(limits, wanted, State(at_rest, np.zeros_like(at_rest)), settings)
    if isinstance(later, Rejected):
        return later
    notes = [f'braked first, for {brake_s:.3g} s', later.note]
    return replace(later, spline=_after_brake(start, brake_s, later.spline),
                   note='; '.join(note for note in notes if note))


def _after_brake(start: State, brake_s: float, spline: Spline) -> Spline:
    """Put a brake (a parabola, so any of the pieces can be one) before a spline."""
    knots = spline.knots
    velocities, accelerations = knots.velocities, knots.accelerations
    if velocities is not None:
        velocities = np.concatenate([start.velocities[None], velocities])
    if accelerations is not None:
        accelerations = np.concatenate([-start.velocities[None] / brake_s, accelerations])
    return Spline(Knots(np.concatenate([[0.0], knots.times_s + brake_s]),
                        np.concatenate([start.positions[None], knots.positions]),
                        velocities, accelerations))


def _stretched(limits: MotionLimits, wanted: Wanted, start: State,
               settings: TrajectorySettings) -> Trajectory | Rejected:
    """Stretch all times by one factor until velocities and accelerations fit."""
    wanted, lead_s = _with_lead(limits, wanted, start)
    single = len(wanted.times_s) == 1
    spline, scale, reason = _fitted(limits, wanted, start, settings)
    if spline is None:
        return Rejected(f'no slower motion keeps the limits: {reason}')
    told = 1.0 if lead_s > 0.0 and single else scale
    if told > settings.longest_stretch:
        return Rejected(f'{reason}; it needs {told:.3g} times the time given, more than '
                        f'{settings.longest_stretch:g}')
    problem = position_problem(_reaching(limits, start), spline.dense().positions)
    if problem is not None:
        return Rejected(f'between its points {problem.reason}')
    return Trajectory(spline, told, _note(told, reason, 0.0 if single else lead_s), single)


def _fitted(limits: MotionLimits, wanted: Wanted, start: State, settings: TrajectorySettings
            ) -> tuple[Spline | None, float, str]:
    """Give the spline that fits, its factor on the times, and the first reason for it."""
    scale, first_reason = 1.0, ''
    for _ in range(_ROUNDS):
        spline = _spline(wanted, start, scale, settings)
        factor, reason = _excess(limits, spline, start, settings)
        first_reason = first_reason or (reason if factor > 1.0 else '')
        if factor <= 1.0:
            return spline, scale, first_reason
        scale *= min(factor * (1.0 + 1e-6), 1e6)
    return None, scale, reason


def _reaching(limits: MotionLimits, start: State) -> MotionLimits:
    """Let an arm that stands outside its limits (or their margin) come back; allow round-off."""
    return replace(limits,
                   lower_rad=np.minimum(limits.lower_rad, start.positions) - _ROUND_OFF_RAD,
                   upper_rad=np.maximum(limits.upper_rad, start.positions) + _ROUND_OFF_RAD)


def _note(scale: float, reason: str, lead_s: float) -> str:
    notes = []
    if scale > 1.0:
        notes.append(f'all times stretched by {scale:.4g}: {reason}')
    if lead_s > 0.0:
        notes.append(f'{lead_s:.3g} s added to reach the first point')
    return '; '.join(notes)


def _with_lead(limits: MotionLimits, wanted: Wanted, start: State) -> tuple[Wanted, float]:
    """Give a first point at time 0 the time that it takes to get there."""
    if wanted.times_s[0] > 0.0:
        return wanted, 0.0
    way = np.abs(wanted.positions[0] - start.positions)
    if len(wanted.times_s) > 1 and way.max() < 1e-9:
        return wanted.take(slice(1, None)), 0.0
    needed = np.maximum(1.5 * way / limits.velocity_rad_s,
                        np.sqrt(6.0 * way / limits.acceleration_rad_s2))
    lead_s = max(float(needed.max()), _SHORTEST_S)
    return wanted._replace(times_s=wanted.times_s + lead_s), lead_s


def _spline(wanted: Wanted, start: State, scale: float, settings: TrajectorySettings) -> Spline:
    times_s = np.concatenate([[0.0], wanted.times_s * scale])
    positions = np.concatenate([start.positions[None], wanted.positions])
    if wanted.velocities is None:
        if settings.interpolation == 'linear':
            return Spline(Knots(times_s, positions))
        rest = np.zeros_like(start.positions)
        return Spline(Knots(times_s, positions, monotone_velocities(
            times_s, positions, start.velocities, rest)))
    velocities = np.concatenate([start.velocities[None], wanted.velocities / scale])
    if wanted.accelerations is None:
        return Spline(Knots(times_s, positions, velocities))
    accelerations = np.concatenate([np.zeros_like(positions[:1]),
                                    wanted.accelerations / scale**2])
    return Spline(Knots(times_s, positions, velocities, accelerations))


def _excess(limits: MotionLimits, spline: Spline, start: State, settings: TrajectorySettings
            ) -> tuple[float, str]:
    """Give the factor on the times that the limits ask for, and which joint asks."""
    dense = spline.dense()
    allowed = limits.velocity_rad_s * (1.0 - settings.headroom)
    # What moves now may be a little faster than that; no stretching slows the start down.
    allowed = np.maximum(allowed, np.minimum(np.abs(start.velocities) * (1.0 + 1e-9),
                                             limits.velocity_rad_s))
    fast = np.abs(dense.velocities).max(axis=(0, 1)) / allowed
    hard = np.sqrt(np.abs(dense.accelerations).max(axis=(0, 1)) / limits.acceleration_rad_s2)
    return _worst(limits, fast, hard)


def _worst(limits: MotionLimits, fast: np.ndarray, hard: np.ndarray) -> tuple[float, str]:
    joint = int(np.argmax(np.maximum(fast, hard)))
    factor = float(max(fast[joint], hard[joint]))
    if fast[joint] >= hard[joint]:
        return factor, f'{limits.names[joint]} would be faster than ' \
                       f'{limits.velocity_rad_s[joint]:.4g} rad/s'
    return factor, f'{limits.names[joint]} would accelerate by more than ' \
                   f'{limits.acceleration_rad_s2[joint]:.4g} rad/s^2'


def brake(limits: MotionLimits, start: State) -> tuple[np.ndarray, float]:
    """Give where and when the joints rest; at a limit they brake harder than allowed."""
    time_s = max(float(np.max(np.abs(start.velocities) / limits.acceleration_rad_s2)), _SHORTEST_S)
    room = np.where(start.velocities > 0.0, limits.upper_rad - start.positions,
                    start.positions - limits.lower_rad)
    speed = np.abs(start.velocities)
    longest = np.where(speed > 0.0, 2.0 * np.maximum(room, 0.0) / np.maximum(speed, 1e-12), np.inf)
    time_s = max(min(time_s, float(longest.min())), _SHORTEST_S)
    at_rest = start.positions + 0.5 * time_s * start.velocities
    return np.clip(at_rest, limits.lower_rad, limits.upper_rad), time_s
