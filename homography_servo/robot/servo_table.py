"""Properties of the servos of the reference device, and where they are told to be."""

from __future__ import annotations

from homography_servo.result import required
from homography_servo.robot.protocol import NOT_NOW
from homography_servo.robot.script import Assign
from homography_servo.robot.script import Clause
from homography_servo.robot.script import Move
from homography_servo.robot.script import OUT_OF_RANGE
from homography_servo.robot.script import Restart
from homography_servo.robot.script import Token

DEFAULTS = {'minpos': -1400, 'maxpos': 1400, 'initpos': 0, 'p0pos': 3000, 'maxspd': 100,
            'accel': 10, 'decel': 10, 'invert': 0, 'power': 100}
PULSE = (800, 5400)  # what a servo can be sent; a position is a pulse minus p0pos


class Table:
    """Properties of all servos and where they are told to be."""

    def __init__(self, servos: int) -> None:
        self.rows = [dict(DEFAULTS) for _ in range(servos)]
        self.targets = [0.0] * servos

    def copy(self) -> Table:
        """Make an independent copy."""
        twin = Table(0)
        twin.rows = [dict(row) for row in self.rows]
        twin.targets = list(self.targets)
        return twin

    def assign(self, command: Assign) -> None:
        """Set properties; a value that does not fit raises ScriptError."""
        for servo in command.servos:
            for name in command.names:
                value = command.value if isinstance(command.value, int) else DEFAULTS[name]
                self._assign(servo, name, value, command.at)

    def _assign(self, servo: int, name: str, value: int, at: Token) -> None:
        row = {**self.rows[servo], name: value}
        if name == 'p0pos' and not PULSE[0] <= value <= PULSE[1]:
            raise at.error(OUT_OF_RANGE)
        places = [row['minpos'], row['maxpos'], row['initpos']]
        if not all(PULSE[0] <= place + row['p0pos'] <= PULSE[1] for place in places) \
                or row['minpos'] > row['maxpos']:
            raise at.error(OUT_OF_RANGE)
        self.targets[servo] += self.rows[servo]['p0pos'] - row['p0pos']
        self.rows[servo] = row

    def aim(self, command: Move | Restart) -> list[float]:
        """Give the targets that a motion command leads to; raises ScriptError."""
        targets = list(self.targets)
        clauses = [] if isinstance(command, Restart) else command.clauses
        for clause in clauses:
            for servo in clause.servos:
                targets[servo] = self._end(servo, clause)
                self.check(servo, targets[servo], clause.at)
        if isinstance(command, Restart):
            targets = [float(row['initpos']) for row in self.rows]
            for servo, target in enumerate(targets):
                self.check(servo, target, command.at)
        return targets

    def _end(self, servo: int, clause: Clause) -> float:
        if clause.by is not None:
            return self.targets[servo] + clause.by
        return self.rows[servo][clause.to] if isinstance(clause.to, str) else \
            required(clause.to, 'place to go to')

    def check(self, servo: int, target: float, at: Token) -> None:
        """Refuse a target outside minpos..maxpos, or motion of a servo without power."""
        row = self.rows[servo]
        if not row['minpos'] <= target <= row['maxpos']:
            raise at.error(OUT_OF_RANGE)
        if row['power'] == 0 and target != self.targets[servo]:
            raise at.error(NOT_NOW)
