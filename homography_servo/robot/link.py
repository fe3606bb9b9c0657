"""
A connection that is opened, greeted, watched and opened again.

`Link.turn` does what is due and gives events; it never blocks and never raises for what
the line does. Time is an argument, the port comes from a function: no thread in here.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum
from typing import Callable, NamedTuple, Union

from homography_servo.errors import LinkError
from homography_servo.robot.protocol import ESTOP_BYTE
from homography_servo.robot.protocol import NOT_NOW
from homography_servo.robot.protocol import Notice
from homography_servo.robot.protocol import VERSION
from homography_servo.robot.session import Answer
from homography_servo.robot.session import Event
from homography_servo.robot.session import Session
from homography_servo.robot.transport import Transport

BACK_OFF_S = (0.5, 5.0)
GREET_AGAIN_S = 0.4  # a device that has just been switched on may need seconds
GREET_FOR_S = 3.0
WRITE_S = 0.1


class Up(NamedTuple):
    """The device has greeted: how many servos, and its name."""

    servos: int
    name: str


class Down(NamedTuple):
    """The connection is lost, and why."""

    reason: str


LinkEvent = Union[Event, Up, Down]


class Phase(Enum):
    """Where a link stands."""

    CLOSED = 'closed'
    GREETING = 'greeting'
    UP = 'up'


class Link:
    """
    One robot, across losses of the line.

    Parameters
    ----------
    opener : callable
        Opens the port; raises LinkError with a sentence.
    baud : int
        Line speed, for time-outs.
    first_seq : int
        Number of the first request.

    """

    def __init__(self, opener: Callable[[], Transport], baud: int = 115200,
                 first_seq: int = 1) -> None:
        self.phase = Phase.CLOSED
        self.counts: Counter = Counter()
        self.problem = 'not opened yet'
        self._opener = opener
        self._baud = baud
        self._session = Session(baud, first_seq)
        self._transport: Transport | None = None
        self._out = b''
        self._out_since_s = 0.0
        self._next_open_s = 0.0
        self._back_off_s = BACK_OFF_S[0]
        self._greet_at_s = 0.0
        self._give_up_s = 0.0

    @property
    def backlog(self) -> int:
        """Count the requests without an answer."""
        return self._session.backlog

    @property
    def all_counts(self) -> Counter:
        """Give the counters of all sessions."""
        return self.counts + self._session.counts

    def fileno(self) -> int | None:
        """Give the port's descriptor, None where there is none."""
        return self._transport.fileno() if self._transport else None

    @property
    def open(self) -> bool:
        """Tell whether there is a port."""
        return self._transport is not None

    def request(self, text: str, motion: bool = False) -> int:
        """Queue a line for a device that has greeted."""
        return self._session.request(text, motion)

    def drop_motion(self) -> None:
        """Take back every motion that was not answered."""
        self._session.drop_motion()

    def stop_now(self) -> bool:
        """
        Send the stop byte before anything queued; call it from any thread.

        The rest of a line that was half sent is thrown away, and so is every motion
        not answered yet. Gives False where there is no port or the write failed.
        """
        self._out = b''
        self._session.drop_motion()
        transport = self._transport
        if transport is None:
            return False
        try:
            transport.write_now(ESTOP_BYTE)
        except LinkError as error:
            self.problem = str(error)
            return False
        return True

    def close(self) -> None:
        """Release the port and do not open it again by itself."""
        self._drop()
        self._next_open_s = float('inf')

    def open_now(self) -> None:
        """Open the port at once; LinkError tells why not."""
        self._opened()

    def _opened(self) -> Transport:
        self._transport = self._opener()
        return self._transport

    def turn(self, now_s: float) -> list[LinkEvent]:
        """Do what is due; give what happened."""
        if self._transport is None and now_s < self._next_open_s:
            return []
        try:
            return self._turn(now_s)
        except LinkError as error:
            return self._lost(str(error), now_s)

    def next_due_s(self) -> float:
        """Give the time of the next thing to do by itself."""
        if self._transport is None:
            return self._next_open_s
        due = self._session.next_due_s()
        if self.phase is Phase.GREETING:
            return self._greet_at_s if due is None else min(due, self._greet_at_s)
        return float('inf') if due is None else due

    def _turn(self, now_s: float) -> list[LinkEvent]:
        transport = self._transport or self._opened()
        if self.phase is Phase.CLOSED:
            self._greet(now_s)
        events = self._understood(self._session.feed(transport.read()), now_s)
        if self.phase is Phase.GREETING and now_s >= self._greet_at_s:
            self._greet(now_s)
        self._send(transport, now_s)
        return events

    def _greet(self, now_s: float) -> None:
        """Begin a session; the port stays open, for opening it may restart the device."""
        if self.phase is Phase.CLOSED:
            self._give_up_s = now_s + GREET_FOR_S
        elif now_s >= self._give_up_s:
            raise LinkError(f'nobody answers !hello at {self._baud} baud; is the robot on, '
                            'and the baud rate right?')
        self.phase = Phase.GREETING
        self.counts.update(self._session.counts)
        self._session = Session(self._baud, self._session.seq)
        self._session.request('!hello')
        self._out = b'\n'
        self._out_since_s = now_s
        self._greet_at_s = now_s + max(GREET_AGAIN_S, 1500.0 / self._baud)

    def _understood(self, events: list[Event], now_s: float) -> list[LinkEvent]:
        """Let the greeting through first; a device that restarts needs a new one."""
        result: list[LinkEvent] = []
        for event in events:
            if self.phase is Phase.UP and (event == Notice('READY') or _ungreeted(event)):
                raise LinkError('the device has restarted')
            if self.phase is Phase.UP:
                result.append(event)
            elif isinstance(event, Answer) and event.kind == 'HELLO':
                result.append(self._greeted(event))
        return result

    def _greeted(self, answer: Answer) -> Up:
        version, servos, name = answer.values
        if version != VERSION:
            raise LinkError(f'the device speaks {version}, this program {VERSION}')
        self.phase = Phase.UP
        self.problem = ''
        self._back_off_s = BACK_OFF_S[0]
        return Up(servos, name)

    def _send(self, transport: Transport, now_s: float) -> None:
        try:
            data = self._session.due(now_s)
        except LinkError:
            if self.phase is not Phase.GREETING:
                raise
            return  # the greeting has its own patience
        if not self._out:
            self._out_since_s = now_s
        self._out += data
        if not self._out:
            return
        sent = transport.write(self._out)
        if sent:
            self._out, self._out_since_s = self._out[sent:], now_s
        elif now_s > self._out_since_s + WRITE_S:
            raise LinkError(f'the line has taken no byte for {WRITE_S} s')

    def _lost(self, reason: str, now_s: float) -> list[LinkEvent]:
        was_up = self.phase is Phase.UP
        self._drop()
        self.problem = reason
        self.counts['losses' if was_up else 'failed_openings'] += 1
        self._next_open_s = now_s + self._back_off_s
        self._back_off_s = min(2.0 * self._back_off_s, BACK_OFF_S[1])
        return [Down(reason)] if was_up else []

    def _drop(self) -> None:
        self.phase = Phase.CLOSED
        self._out = b''
        self.counts.update(self._session.counts)
        self._session = Session(self._baud, self._session.seq)
        if self._transport is not None:
            self._transport.close()
        self._transport = None


def _ungreeted(event: Event) -> bool:
    """Tell whether a device refuses a question, as only one does that was not greeted."""
    return isinstance(event, Answer) and event.kind == 'ERR' and event.text.startswith('?') \
        and event.values[0] == NOT_NOW
