"""
The servos of the reference device: command queue and interpolator.

Time is an argument; nothing here knows bytes or replies. Jobs (lines of script) run one
after the other; `finished` tells which ended, and how.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Iterator, NamedTuple, Sequence

from homography_servo.robot.macros import expanded
from homography_servo.robot.macros import with_macros
from homography_servo.robot.profile import brake
from homography_servo.robot.profile import constant
from homography_servo.robot.profile import Profile
from homography_servo.robot.profile import Ramp
from homography_servo.robot.profile import rest
from homography_servo.robot.profile import together
from homography_servo.robot.protocol import NOT_NOW
from homography_servo.robot.script import Assign
from homography_servo.robot.script import Call
from homography_servo.robot.script import Command
from homography_servo.robot.script import Macro
from homography_servo.robot.script import Move
from homography_servo.robot.script import Restart
from homography_servo.robot.script import Script
from homography_servo.robot.script import ScriptError
from homography_servo.robot.script import Token
from homography_servo.robot.script import Wait
from homography_servo.robot.servo_table import Table

MAX_QUEUE = 64
CHECKED_AHEAD = 2000  # commands of one line looked at before it is accepted
STEPS_AT_ONCE = 1000  # commands without duration run in one call

DONE, STOPPED = 'DONE', 'STOPPED'


class Ended(NamedTuple):
    """A job that is over: DONE or STOPPED."""

    seq: int
    how: str


@dataclass
class Job:
    """A line of script that waits or runs."""

    seq: int
    steps: Iterator[Command]


class Machine:
    """
    Six servos, or any number, that follow profiles.

    Parameters
    ----------
    servos : int
        How many.
    tick_s : float
        Speeds are in units per tick, accelerations in units per tick squared.

    """

    def __init__(self, servos: int = 6, tick_s: float = 0.020) -> None:
        self.table = Table(servos)
        self.tick_s = tick_s
        self.latched = False
        self.paused = False
        self.last_finished = 0
        self.macros: dict[str, Macro] = {}
        self.frozen: set[int] = set()
        self.finished: list[Ended] = []
        self._ahead: Table | None = None  # the table as the queue will leave it
        self._queue: deque[Job] = deque()
        self._job: Job | None = None
        self._profiles: list[Profile] = [rest(0.0)] * servos
        self._start_s = 0.0
        self._busy_until_s = 0.0
        self._remaining_s = 0.0  # of a wait that was paused
        self._ramped = True

    @property
    def servos(self) -> int:
        """Count the servos."""
        return len(self.table.rows)

    @property
    def waiting(self) -> int:
        """Count the lines behind the one that runs."""
        return len(self._queue)

    @property
    def working(self) -> bool:
        """Tell whether a line runs."""
        return self._job is not None

    # --- where the servos are -------------------------------------------------------

    def state(self, now_s: float) -> list[tuple[float, float]]:
        """Give position and velocity of every servo."""
        return [profile.at(now_s - self._start_s) for profile in self._profiles]

    def positions(self, now_s: float) -> list[int]:
        """Give positions as whole units."""
        return [int(round(position)) for position, _ in self.state(now_s)]

    def value(self, servo: int, name: str, now_s: float) -> int | None:
        """Give a property by name; None for an unknown one."""
        position = self.positions(now_s)[servo]
        row = self.table.rows[servo]
        own = {'pos': position, 'pinned': int(position in (row['minpos'], row['maxpos']))}
        return own.get(name, row.get(name))

    # --- what it is told ------------------------------------------------------------

    def submit(self, seq: int, script: Script, now_s: float) -> None:
        """Check a script as a whole and queue it; ScriptError means nothing was queued."""
        self.step(now_s)
        if self.waiting >= MAX_QUEUE:
            raise ScriptError(NOT_NOW, 0, 'queue')
        macros = with_macros(self.macros, script)
        moves = False
        ahead = (self._ahead or self.table).copy()
        for number, command in enumerate(expanded(script.commands, macros)):
            if number >= CHECKED_AHEAD:
                break
            moves |= isinstance(command, (Move, Restart))
            if moves and self.latched:
                raise ScriptError(NOT_NOW, 0, 'latched')
            _look_ahead(ahead, command)
        self.macros = macros
        self._ahead = ahead
        self._queue.append(Job(seq, expanded(script.commands, macros)))
        self.step(now_s)

    def goto(self, seq: int, words: Sequence[Token], now_s: float) -> None:
        """Flush the queue and steer all servos; ScriptError means nothing happened."""
        self.step(now_s)
        if self.latched:
            raise ScriptError(NOT_NOW, 0, 'latched')
        for servo, word in enumerate(words):
            self.table.check(servo, int(word.text), word)
        self._flush()
        self._job = Job(seq, iter(()))
        self._remaining_s = 0.0
        self.table.targets = [float(word.text) for word in words]
        self._move_to(self.table.targets, now_s)

    def pause(self, now_s: float) -> None:
        """Slow down and stand."""
        self.step(now_s)
        if self.paused:
            return
        self.paused = True
        self._remaining_s = self._busy_until_s - now_s
        self._brake(now_s)

    def resume(self, now_s: float) -> None:
        """Go on to where the servos were going."""
        if not self.paused:
            return
        self.paused = False
        if self._job is None:
            return
        if [p.end for p in self._profiles] == self.table.targets:
            self._busy_until_s = now_s + max(self._remaining_s, 0.0)
        else:
            self._move_to(self.table.targets, now_s)

    def stop(self, now_s: float) -> None:
        """Decelerate, flush, latch."""
        self.step(now_s)
        self.latched = True
        self.paused = False
        self._brake(now_s)
        self._forget(now_s)

    def halt(self, now_s: float, latch: bool = True) -> None:
        """Stand at once where the servos are, flush, and latch."""
        self.step(now_s)
        self.latched |= latch
        self.paused = False
        self._stand(now_s)
        self._forget(now_s)

    def reset(self) -> None:
        """Leave the latched state; moves nothing."""
        self.latched = False

    def power(self, on: bool, now_s: float) -> None:
        """Switch all servos; without power they stand where they are."""
        if not on:
            self.halt(now_s, latch=False)
        for row in self.table.rows:
            row['power'] = 100 if on else 0
        self._ahead = None

    # --- running --------------------------------------------------------------------

    def step(self, now_s: float) -> None:
        """Run what is due; commands without duration follow each other at once."""
        for _ in range(STEPS_AT_ONCE):
            if self.paused or (self._job and now_s < self._busy_until_s):
                return
            if self._job is None:
                if not self._queue:
                    return
                self._job = self._queue.popleft()
                self._busy_until_s = now_s
            self._next_command(self._job)

    def _next_command(self, job: Job) -> None:
        """Start the next command at the moment when the one before it ended."""
        at_s = self._busy_until_s
        command = next(job.steps, None)
        if command is None:
            self._end(job, DONE)
            if self._queue:
                self._job = self._queue.popleft()
            return
        try:
            self._run(command, at_s)
        except ScriptError:  # only beyond what was looked at when the line came
            self._end(job, STOPPED)

    def _run(self, command: Command, at_s: float) -> None:
        if isinstance(command, Wait):
            self._busy_until_s = at_s + 0.1 * command.tenths
        elif isinstance(command, Assign):
            self.table.assign(command)
            if 'p0pos' in command.names:  # the same place has another number now
                self._profiles = [rest(target) for target in self.table.targets]
        elif not isinstance(command, Call):
            self.table.targets = self.table.aim(command)
            if isinstance(command, Move) and command.jump:
                self._jump(at_s)
            else:
                self._move_to(self.table.targets, at_s)

    def _move_to(self, targets: Sequence[float], at_s: float) -> None:
        state = self.state(at_s)
        velocities = [velocity if self._ramped else 0.0 for _, velocity in state]
        ramps = [self._ramp(row) for row in self.table.rows]
        if self.paused:
            return
        self._follow(together([p for p, _ in state], velocities, targets, ramps), at_s)
        self._ramped = True

    def _jump(self, at_s: float) -> None:
        self._follow([constant(position, target, self._ramp(row).speed)
                      for (position, _), target, row
                      in zip(self.state(at_s), self.table.targets, self.table.rows)], at_s)
        self._ramped = False

    def _ramp(self, row: dict) -> Ramp:
        return Ramp(row['maxspd'] / self.tick_s, row['accel'] / self.tick_s ** 2,
                    row['decel'] / self.tick_s ** 2)

    def _follow(self, profiles: list[Profile], at_s: float) -> None:
        stuck = self.state(at_s)
        self._profiles = [rest(stuck[i][0]) if i in self.frozen else profile
                          for i, profile in enumerate(profiles)]
        self._start_s = at_s
        self._busy_until_s = at_s + max(profile.duration for profile in profiles)

    def freeze(self, servo: int, now_s: float) -> None:
        """Hold one servo where it is, whatever it is told: a fault."""
        self.frozen.add(servo)
        self._profiles[servo] = rest(self.state(now_s)[servo][0])

    def _brake(self, now_s: float) -> None:
        if not self._ramped:
            self._stand(now_s)
            return
        slow = [brake(p, v, self._ramp(row).decel)
                for (p, v), row in zip(self.state(now_s), self.table.rows)]
        self._follow(slow, now_s)

    def _stand(self, now_s: float) -> None:
        self._follow([rest(position) for position, _ in self.state(now_s)], now_s)
        self._ramped = True

    def _forget(self, now_s: float) -> None:
        self._flush()
        self.table.targets = [profile.end for profile in self._profiles]
        self._ahead = None

    def _flush(self) -> None:
        if self._job is not None:
            self._end(self._job, STOPPED)
        for job in self._queue:
            self._end(job, STOPPED)
        self._queue.clear()
        self._ahead = None

    def _end(self, job: Job, how: str) -> None:
        self.finished.append(Ended(job.seq, how))
        self.last_finished = job.seq
        self._job = None
        if not self._queue:
            self._ahead = None


def _look_ahead(table: Table, command: Command) -> None:
    if isinstance(command, Assign):
        table.assign(command)
    elif isinstance(command, (Move, Restart)):
        table.targets = table.aim(command)
