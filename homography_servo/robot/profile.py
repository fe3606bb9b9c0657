"""
Trapezoid profiles of one servo, and of several that arrive together.

Positions in servo units, times in seconds. A profile starts at any speed, ends at rest,
and never exceeds its speed unless it started faster.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
import math
from typing import NamedTuple, Sequence

_TINY = 1e-9


class Ramp(NamedTuple):
    """Limits of one servo: units/s and units/s^2, all above 0."""

    speed: float
    accel: float
    decel: float


class Knot(NamedTuple):
    """From `time` on: position, velocity and constant acceleration."""

    time: float
    position: float
    velocity: float
    acceleration: float


@dataclass(frozen=True)
class Profile:
    """Piecewise constant acceleration from time 0; after the last knot it rests."""

    knots: tuple[Knot, ...]

    @property
    def duration(self) -> float:
        """Time until it rests [s]."""
        return self.knots[-1].time

    @property
    def end(self) -> float:
        """Position where it rests."""
        return self.knots[-1].position

    def at(self, time: float) -> tuple[float, float]:
        """Give position and velocity at a time; before 0 it is the start."""
        index = bisect_right(self.knots, time, key=_time_of) - 1
        knot = self.knots[max(index, 0)]
        t = max(time - knot.time, 0.0)
        return (knot.position + t * (knot.velocity + 0.5 * t * knot.acceleration),
                knot.velocity + t * knot.acceleration)


def _time_of(knot: Knot) -> float:
    return knot.time


def _from_pieces(position: float, velocity: float, end: float,
                 pieces: Sequence[tuple[float, float]]) -> Profile:
    """Chain (duration, acceleration) pieces; the last knot is exactly the end at rest."""
    knots, time = [], 0.0
    for duration, acceleration in pieces:
        if duration <= _TINY:
            continue
        knots.append(Knot(time, position, velocity, acceleration))
        time += duration
        position += duration * (velocity + 0.5 * duration * acceleration)
        velocity += duration * acceleration
    return Profile((*knots, Knot(time, end, 0.0, 0.0)))


def rest(position: float) -> Profile:
    """Stay where it is."""
    return Profile((Knot(0.0, position, 0.0, 0.0),))


def brake(position: float, velocity: float, decel: float) -> Profile:
    """Come to rest as soon as the deceleration allows."""
    time = abs(velocity) / decel
    end = position + 0.5 * velocity * time
    return _from_pieces(position, velocity, end, [(time, -math.copysign(decel, velocity))])


def constant(position: float, end: float, speed: float) -> Profile:
    """Go at one speed without ramps."""
    time = abs(end - position) / speed
    if time <= _TINY:
        return rest(end)
    velocity = (end - position) / time
    return Profile((Knot(0.0, position, velocity, 0.0), Knot(time, end, 0.0, 0.0)))


def fastest(position: float, velocity: float, end: float, ramp: Ramp) -> Profile:
    """Go to the end in the shortest time."""
    return _cruise(position, velocity, end, ramp, ramp.speed)


def _must_turn(velocity: float, way: float, decel: float) -> bool:
    """Tell whether it passes the end, or goes away from it, even when it brakes at once."""
    stop = 0.5 * velocity * abs(velocity) / decel
    return velocity != 0.0 and (way - stop) * velocity < -_TINY * abs(velocity)


def _cruise(position: float, velocity: float, end: float, ramp: Ramp, cruise: float) -> Profile:
    way = end - position
    if _must_turn(velocity, way, ramp.decel):
        return _turn(position, velocity, end, ramp, cruise)
    sign = math.copysign(1.0, way if velocity == 0.0 else velocity)
    way, start = abs(way), abs(velocity)
    if start > cruise:
        slow = ((start - cruise) / ramp.decel, -ramp.decel)
        way -= 0.5 * (start + cruise) * slow[0]
    else:
        highest = math.sqrt(max(way + 0.5 * start ** 2 / ramp.accel, 0.0)
                            / (0.5 / ramp.accel + 0.5 / ramp.decel))
        cruise = max(min(cruise, highest), start)
        slow = ((cruise - start) / ramp.accel, ramp.accel)
        way -= 0.5 * (start + cruise) * slow[0]
    stop = cruise / ramp.decel
    steady = max(way - 0.5 * cruise * stop, 0.0) / max(cruise, _TINY)
    pieces = [slow, (steady, 0.0), (stop, -ramp.decel)]
    return _from_pieces(position, velocity, end, [(t, sign * a) for t, a in pieces])


def _turn(position: float, velocity: float, end: float, ramp: Ramp, cruise: float) -> Profile:
    first = brake(position, velocity, ramp.decel)
    back = _cruise(first.end, 0.0, end, ramp, cruise)
    later = [knot._replace(time=knot.time + first.duration) for knot in back.knots]
    return Profile((*first.knots[:-1], *later))


def lasting(position: float, velocity: float, end: float, ramp: Ramp, time: float) -> Profile:
    """
    Go to the end in a given time, or as near to it as the ramp allows.

    The cruising speed is what changes; it solves a quadratic equation, or a linear one
    where the servo is already faster than it needs to be.
    """
    if _must_turn(velocity, end - position, ramp.decel):
        first = brake(position, velocity, ramp.decel)
        cruise = _cruise_speed(0.0, abs(end - first.end), ramp, time - first.duration)
    else:
        cruise = _cruise_speed(abs(velocity), abs(end - position), ramp, time)
    return _cruise(position, velocity, end, ramp, min(max(cruise, _TINY), ramp.speed))


def _cruise_speed(start: float, way: float, ramp: Ramp, time: float) -> float:
    half = 0.5 / ramp.accel + 0.5 / ramp.decel
    linear, offset = time + start / ramp.accel, way + 0.5 * start ** 2 / ramp.accel
    root = linear ** 2 - 4.0 * half * offset
    cruise = 2.0 * offset / (linear + math.sqrt(root)) if root > 0.0 else ramp.speed
    if cruise >= start:
        return cruise
    spare = time - start / ramp.decel
    return (way - 0.5 * start ** 2 / ramp.decel) / spare if spare > _TINY else ramp.speed


def together(positions: Sequence[float], velocities: Sequence[float], ends: Sequence[float],
             ramps: Sequence[Ramp]) -> list[Profile]:
    """
    Move several servos so that they arrive together.

    From rest all follow one straight line in joint space. A servo that has to brake
    at once to stop at its end may arrive before the others.
    """
    if not any(velocities):
        return _straight(positions, ends, ramps)
    limits = list(zip(positions, velocities, ends, ramps))
    time = max(fastest(*item).duration for item in limits)
    return [lasting(*item, time) for item in limits]


def _straight(positions: Sequence[float], ends: Sequence[float],
              ramps: Sequence[Ramp]) -> list[Profile]:
    ways = [end - position for position, end in zip(positions, ends)]
    moving = [(abs(way), ramp) for way, ramp in zip(ways, ramps) if abs(way) > _TINY]
    if not moving:
        return [rest(end) for end in ends]
    longest = max(way for way, _ in moving)
    shared = Ramp(*(min(ramp[i] * longest / way for way, ramp in moving) for i in range(3)))
    shape = fastest(0.0, 0.0, longest, shared)
    return [_scaled(shape, position, way / longest, end)
            for position, way, end in zip(positions, ways, ends)]


def _scaled(shape: Profile, start: float, scale: float, end: float) -> Profile:
    if abs(scale) <= _TINY:
        return rest(end)
    knots = [Knot(k.time, start + scale * k.position, scale * k.velocity,
                  scale * k.acceleration) for k in shape.knots]
    knots[-1] = knots[-1]._replace(position=end)
    return Profile(tuple(knots))
