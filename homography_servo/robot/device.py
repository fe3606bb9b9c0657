"""
The reference device of RBX/1: what a secondary PC or microcontroller has to do.

Bytes go in with `Device.feed`, replies come out of `Device.take`; time is an argument.
It moves nothing but numbers: servos have no feedback, so a position is the commanded,
interpolated one, as on the real arm.
"""

from __future__ import annotations

from collections import OrderedDict
import re
from typing import Callable

from homography_servo.result import Rejected
from homography_servo.robot.machine import Machine
from homography_servo.robot.protocol import BAD_REUSE
from homography_servo.robot.protocol import BadLine
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.protocol import error_text
from homography_servo.robot.protocol import Line
from homography_servo.robot.protocol import LineDecoder
from homography_servo.robot.protocol import NOT_NOW
from homography_servo.robot.protocol import parse_request
from homography_servo.robot.protocol import Request
from homography_servo.robot.protocol import StopByte
from homography_servo.robot.protocol import VERSION
from homography_servo.robot.script import BAD_NUMBER
from homography_servo.robot.script import BAD_OPTION
from homography_servo.robot.script import EXTRA
from homography_servo.robot.script import Macro
from homography_servo.robot.script import ON_OFF
from homography_servo.robot.script import OUT_OF_RANGE
from homography_servo.robot.script import parse
from homography_servo.robot.script import ScriptError
from homography_servo.robot.script import SERVO_NUMBER
from homography_servo.robot.script import Token
from homography_servo.robot.script import UNKNOWN

REMEMBERED = 512  # replies kept for lines that come again
MAX_WATCH_MS = 60000
_WORD = re.compile(r'\S+')
_NUMBER = re.compile(r'[+-]?[0-9]{1,9}')


class Device:
    """
    A robot controller at the other end of the line.

    Parameters
    ----------
    servos : int
        Number of servos.
    name : str
        What it answers to ``!hello``.
    tick_s : float
        Interpolator tick, see `Machine`.

    """

    def __init__(self, servos: int = 6, name: str = 'robix_emulator',
                 tick_s: float = 0.020) -> None:
        self.machine = Machine(servos, tick_s)
        self.name = name
        self._decoder = LineDecoder()
        self._out: list[str] = ['! READY']
        self._greeted = False
        self._seen: OrderedDict[int, tuple[str, str]] = OrderedDict()
        self._open_macro: Macro | None = None
        self._watch_s = 0.0
        self._heard_s = 0.0
        self._expired = False
        self._commands: dict[str, Callable[[Request, list[Token], float], str]] = {
            '!hello': self._hello, '!goto': self._goto, '!pause': self._pause,
            '!resume': self._resume, '!stop': self._stop, '!reset': self._reset,
            '!power': self._power, '!watch': self._watch,
            '?': self._status, '?pos': self._positions, '?prop': self._property,
        }

    def feed(self, data: bytes, now_s: float) -> None:
        """Take bytes that came from the host."""
        self.step(now_s)
        for item in self._decoder.feed(data):
            if isinstance(item, StopByte):
                self.machine.halt(now_s)
                self._open_macro = None
                self._out.append('! ESTOP')
            elif isinstance(item, BadLine):
                self._out.append(error_text(0, item.code, 0, item.name))
            else:
                self._line(item, now_s)
            self._report()

    def step(self, now_s: float) -> None:
        """Let time pass."""
        deadline_s = self._heard_s + self._watch_s
        if self._watch_s > 0.0 and not self._expired and now_s > deadline_s:
            self._expired = True
            self.machine.stop(deadline_s)
            self._out.append('! WATCHDOG')
        self.machine.step(now_s)
        self._report()

    def take(self) -> list[bytes]:
        """Give the lines that go to the host, and forget them."""
        lines, self._out = [encode_line(text) for text in self._out], []
        return lines

    def _report(self) -> None:
        for seq, how in self.machine.finished:
            self._out.append(f'{seq} {how}')
        self.machine.finished.clear()

    def _line(self, line: Line, now_s: float) -> None:
        request = parse_request(line.text)
        if isinstance(request, Rejected):
            word = (line.text.split() or ['-'])[0]
            code = OUT_OF_RANGE if word.isdigit() else BAD_NUMBER
            self._out.append(error_text(0, code, 1, word))
            return
        self._heard_s = now_s
        self._expired = False
        self._out.append(self._answer(request, now_s))

    def _answer(self, request: Request, now_s: float) -> str:
        """Give the reply to a request; one seen before gets its old reply and runs no more."""
        words = [Token(m[0], m.start() + 1) for m in _WORD.finditer(request.text)]
        verb = words[0].text.lower() if words else ''
        if verb != '!hello':  # a greeting begins a new session, with new numbers
            if request.seq in self._seen:
                text, reply = self._seen[request.seq]
                return reply if text == request.text else \
                    error_text(request.seq, BAD_REUSE, 0, 'seq')
            if not self._greeted:
                return error_text(request.seq, NOT_NOW, 1, verb)
        reply = self._reply(request, verb, words, now_s)
        self._seen[request.seq] = (request.text, reply)
        while len(self._seen) > REMEMBERED:
            self._seen.popitem(last=False)
        return reply

    def _reply(self, request: Request, verb: str, words: list[Token], now_s: float) -> str:
        try:
            if verb in self._commands:
                return f'{request.seq} {self._commands[verb](request, words[1:], now_s)}'
            if verb[:1] in ('!', '?'):
                raise words[0].error(UNKNOWN)
            self._run(request, now_s)
            return f'{request.seq} OK'
        except ScriptError as error:
            return error_text(request.seq, error.code, error.column, error.token)

    def _run(self, request: Request, now_s: float) -> None:
        script = parse(request.text, self.machine.servos, self._open_macro)
        self.machine.submit(request.seq, script, now_s)
        self._open_macro = script.open_macro

    # --- link commands; each gives what follows the sequence number -----------------

    def _hello(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 0)
        self._greeted = True
        self._open_macro = None
        self._seen.clear()
        return f'HELLO {VERSION} {self.machine.servos} {self.name}'

    def _goto(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, self.machine.servos)
        for word in words:
            _number(word)
        self.machine.goto(request.seq, words, now_s)
        return 'OK'

    def _pause(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 0)
        self.machine.pause(now_s)
        return 'OK'

    def _resume(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 0)
        self.machine.resume(now_s)
        return 'OK'

    def _stop(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 0)
        self.machine.stop(now_s)
        self._open_macro = None
        return 'OK'

    def _reset(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 0)
        self.machine.reset()
        return 'OK'

    def _power(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 1)
        if words[0].text.lower() not in ('on', 'off'):
            raise words[0].error(ON_OFF)
        self.machine.power(words[0].text.lower() == 'on', now_s)
        return 'OK'

    def _watch(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 1)
        self._watch_s = 1e-3 * _number(words[0], 0, MAX_WATCH_MS)
        return 'OK'

    def _status(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 0)
        machine = self.machine
        state = 'STOPPED' if machine.latched else 'WORKING' if machine.working else 'IDLE'
        return f'ST {state} {int(machine.paused)} {machine.last_finished} {machine.waiting}'

    def _positions(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 0)
        return 'POS ' + ' '.join(str(v) for v in self.machine.positions(now_s))

    def _property(self, request: Request, words: list[Token], now_s: float) -> str:
        _only(words, 2)
        servo = _number(words[0])
        if not 1 <= servo <= self.machine.servos:
            raise words[0].error(SERVO_NUMBER)
        value = self.machine.value(servo - 1, words[1].text.lower(), now_s)
        if value is None:
            raise words[1].error(BAD_OPTION)
        return f'VAL {value}'


def _only(words: list[Token], count: int) -> None:
    """Refuse words that are missing or too many."""
    if len(words) > count:
        raise words[count].error(EXTRA)
    if len(words) < count:
        raise ScriptError(BAD_NUMBER, 0, '-')


def _number(word: Token, low: int | None = None, high: int | None = None) -> int:
    if not _NUMBER.fullmatch(word.text):
        raise word.error(BAD_NUMBER)
    value = int(word.text)
    if (low is not None and value < low) or (high is not None and value > high):
        raise word.error(OUT_OF_RANGE)
    return value
