"""
Numbered requests and their replies: who waits for what, what is repeated, what is lost.

No port or thread; bytes and time are arguments. A line is repeated once, with its number;
after the second silence the link is dead. At most four lines are unanswered.
"""

from __future__ import annotations

from collections import Counter
from collections import deque
from dataclasses import dataclass
import math
from typing import NamedTuple, Union

from homography_servo.errors import LinkError
from homography_servo.result import Rejected
from homography_servo.robot.protocol import BadLine
from homography_servo.robot.protocol import Line
from homography_servo.robot.protocol import LineDecoder
from homography_servo.robot.protocol import next_seq
from homography_servo.robot.protocol import Notice
from homography_servo.robot.protocol import parse_reply
from homography_servo.robot.protocol import Reply
from homography_servo.robot.protocol import Request

WINDOW = 4
REPLY_S = 0.1  # the least time that a reply may take
WIRE_FACTOR = 3.0
LOOK_S = 0.03  # the longest time between two looks at the line when nothing holds us up
LONGEST_EXCUSE_S = 0.2
LONGEST_REPLY = 60  # bytes of a POS of six servos, CRC and LF
BITS_PER_BYTE = 10  # 8N1
REMEMBERED_RUNS = 256


class Answer(NamedTuple):
    """
    A reply to a request of ours: its text, and what the device said.

    What was `repeated` may have been said at any time since the request was first sent: a
    device gives its old reply again.
    """

    seq: int
    text: str
    kind: str
    values: tuple
    repeated: bool = False


class Over(NamedTuple):
    """A motion that was accepted is over: DONE or STOPPED."""

    seq: int
    how: str


Event = Union[Answer, Over, Notice]
_KIND_OF_VERB = {'!hello': 'HELLO', '?': 'ST', '?pos': 'POS', '?prop': 'VAL'}


@dataclass
class _Pending:
    request: Request
    motion: bool
    due_s: float = 0.0
    sent: int = 0

    @property
    def orders(self) -> bool:
        """Tell whether this is one of the orders of which the last must be the one in force."""
        text = self.request.text
        return text.startswith('!') and not text.startswith('!goto')

    def expects(self, kind: str) -> bool:
        verb = self.request.text.split(' ', 1)[0].lower()
        return kind in ('ERR', _KIND_OF_VERB.get(verb, 'OK'))


class Session:
    """
    The host's side of one connection.

    Parameters
    ----------
    baud : int
        Line speed, for the time a reply may take.
    first_seq : int
        Number of the first request.

    """

    def __init__(self, baud: int = 115200, first_seq: int = 1) -> None:
        self.counts: Counter = Counter()
        self._byte_s = BITS_PER_BYTE / baud
        self._seq = first_seq
        self._decoder = LineDecoder()
        self._waiting: deque[_Pending] = deque()
        self._unanswered: dict[int, _Pending] = {}
        self._running: dict[int, None] = {}
        self._looked_s = math.inf

    @property
    def seq(self) -> int:
        """Give the number that the next request gets."""
        return self._seq

    @property
    def idle(self) -> bool:
        """Tell whether every request has been answered."""
        return not (self._waiting or self._unanswered)

    @property
    def backlog(self) -> int:
        """Count the requests without an answer."""
        return len(self._waiting) + len(self._unanswered)

    def request(self, text: str, motion: bool = False) -> int:
        """Queue a line; `motion` marks what `drop_motion` takes back."""
        seq, self._seq = self._seq, next_seq(self._seq)
        self._waiting.append(_Pending(Request(seq, text), motion))
        return seq

    def drop_motion(self) -> None:
        """Neither send nor repeat any motion that was asked for: it is out of date."""
        self._waiting = deque(item for item in self._waiting if not item.motion)
        self._unanswered = {seq: item for seq, item in self._unanswered.items()
                            if not item.motion}

    def feed(self, data: bytes) -> list[Event]:
        """Take bytes of the device; give what they mean."""
        events: list[Event] = []
        for item in self._decoder.feed(data):
            event = self._event(item)
            if event is not None:
                events.append(event)
        return events

    def due(self, now_s: float) -> bytes:
        """
        Give the bytes to send now: new lines, and repeats of what got no reply.

        Raises
        ------
        LinkError
            When a line was repeated and got no reply again.

        """
        out = b''
        self._excuse(now_s)
        for item in list(self._unanswered.values()):
            if now_s < item.due_s:
                continue
            if item.sent > 1:
                raise LinkError(f'no reply to {item.request.text.split(" ", 1)[0]!r}, '
                                'asked twice')
            self.counts['repeats'] += 1
            out += b'\n' + self._sent(item, now_s)  # LF ends what noise may have begun
        while len(self._unanswered) < WINDOW:
            following = self._next()
            if following is None:
                break
            self._waiting.remove(following)
            self._unanswered[following.request.seq] = following
            out += self._sent(following, now_s)
        return out

    def _next(self) -> _Pending | None:
        """
        Give the line to send next, None where all have to wait.

        An order waits for the answer of the one before it, which might be lost and be
        repeated after it. Of what is behind, only motion goes on.
        """
        waits = any(item.orders for item in self._unanswered.values())
        if not (self._waiting and self._waiting[0].orders and waits):
            return self._waiting[0] if self._waiting else None
        return next((item for item in self._waiting if item.motion and not item.orders), None)

    def _excuse(self, now_s: float) -> None:
        """Leave out time in which nobody looked: our absence is not the device's silence."""
        absent_s = min(now_s - self._looked_s - LOOK_S, LONGEST_EXCUSE_S)
        self._looked_s = now_s
        if absent_s > 0.0:
            self.counts['late_looks'] += 1
            for item in self._unanswered.values():
                item.due_s += absent_s

    def next_due_s(self) -> float | None:
        """Give the time at which `due` has something to do at the latest."""
        return min((item.due_s for item in self._unanswered.values()), default=None)

    def _sent(self, item: _Pending, now_s: float) -> bytes:
        data = item.request.encode()
        ahead = sum(len(other.request.text) + LONGEST_REPLY + 12
                    for other in self._unanswered.values())
        wire_s = self._byte_s * (len(data) + max(ahead, LONGEST_REPLY))
        item.due_s = now_s + max(REPLY_S, WIRE_FACTOR * wire_s)
        item.sent += 1
        return data

    def _event(self, item) -> Event | None:
        if not isinstance(item, Line):
            self.counts['bad_lines'] += 1 if isinstance(item, BadLine) else 0
            return None
        reply = parse_reply(item.text)
        if isinstance(reply, Rejected):
            self.counts['bad_replies'] += 1
            return None
        if isinstance(reply, Notice):
            return reply
        return self._over(reply) if reply.kind in ('DONE', 'STOPPED') else self._answer(reply)

    def _answer(self, reply: Reply) -> Event | None:
        pending = self._unanswered.get(reply.seq)
        if pending is None or not pending.expects(reply.kind):
            self.counts['stray_replies'] += 1  # late, twice, or with a wrong number
            return None
        del self._unanswered[reply.seq]
        if reply.kind == 'OK':
            self._remember(reply.seq)
        return Answer(reply.seq, pending.request.text, reply.kind, reply.values,
                      pending.sent > 1)

    def _over(self, reply: Reply) -> Event | None:
        pending = self._unanswered.get(reply.seq)
        if pending is not None and pending.expects('OK'):  # its OK was lost
            del self._unanswered[reply.seq]
        elif reply.seq not in self._running:
            self.counts['stray_replies'] += 1
            return None
        self._running.pop(reply.seq, None)
        return Over(reply.seq, reply.kind)

    def _remember(self, seq: int) -> None:
        self._running[seq] = None
        while len(self._running) > REMEMBERED_RUNS:
            self._running.pop(next(iter(self._running)))
