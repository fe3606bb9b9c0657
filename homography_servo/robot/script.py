"""
The Robix script language: text to commands, with the error codes of the original.

Only words and numbers are judged here; what depends on a robot (position limits, known
macros) is judged where the commands run, in `machine`.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import re
from typing import Callable, NamedTuple, Union

from homography_servo.errors import ServoError

TOO_LONG, BAD_NUMBER, OUT_OF_RANGE, EXTRA, UNKNOWN = 100, 101, 102, 103, 104
DUPLICATE, TO_OR_BY, NEEDS_TO, BAD_OPTION, ON_OFF, READ_ONLY = 106, 107, 108, 109, 110, 111
SYMBOL, SERVO_NUMBER, SERVO_LIST, MISPLACED_END = 501, 503, 508, 511
INSIDE_MACRO, CALLS_ITSELF = 512, 513

MAX_TOKEN = 32
MAX_WAIT = 65535
MAX_COUNT = 10000
PLACES = ('minpos', 'maxpos', 'initpos')
POSITION_NAMES = ('minpos', 'maxpos', 'initpos', 'p0pos')
RATE_NAMES = {'maxspd': ('maxspd',), 'accel': ('accel',), 'decel': ('decel',),
              'accdec': ('accel', 'decel')}


class ScriptError(ServoError):
    """A script line that cannot run: error code, column counted from 1, token."""

    def __init__(self, code: int, column: int, token: str) -> None:
        super().__init__(f'error {code} at column {column}: {token}')
        self.code = code
        self.column = column
        self.token = token


class Token(NamedTuple):
    """A word of the text, in lower case, and where it stands."""

    text: str
    column: int

    def error(self, code: int) -> ScriptError:
        """Make the error that points here."""
        return ScriptError(code, self.column, self.text or '-')


_NOWHERE = Token('', 0)


def _at() -> Token:
    return field(default=_NOWHERE, compare=False, repr=False)


@dataclass(frozen=True)
class Clause:
    """Servos of a move (counted from 0) and where they go: `to` or `by`."""

    servos: tuple[int, ...]
    to: int | str | None = None
    by: int | None = None
    at: Token = _at()


@dataclass(frozen=True)
class Move:
    """A coordinated move, or a jump without ramps."""

    clauses: tuple[Clause, ...]
    jump: bool = False


@dataclass(frozen=True)
class Assign:
    """Set properties of servos; the value may be the word ``default``."""

    names: tuple[str, ...]
    servos: tuple[int, ...]
    value: int | str
    at: Token = _at()


@dataclass(frozen=True)
class Wait:
    """Wait for so many tenths of a second."""

    tenths: int


@dataclass(frozen=True)
class Restart:
    """All servos to their initpos."""

    at: Token = _at()


@dataclass(frozen=True)
class Call:
    """Run a macro so many times."""

    name: str
    count: int = 1
    at: Token = _at()


@dataclass(frozen=True)
class Macro:
    """A macro that is defined, or still being defined."""

    name: str
    body: tuple = ()
    at: Token = _at()


Command = Union[Move, Assign, Wait, Restart, Call]


class Script(NamedTuple):
    """What a text holds: commands to run, macros it defined, the macro left open."""

    commands: tuple[Command, ...]
    macros: tuple[Macro, ...]
    open_macro: Macro | None


_WORDS = re.compile(r'[^\s,;#]+|[,;\n]|#[^\n]*')
_NUMBER = re.compile(r'[+-]?[0-9]+')
_NAME = re.compile(r'[a-z_][a-z0-9_]*')


def _sentences(text: str) -> list[list[Token]]:
    """Cut a text into commands; each ends in an empty token where it ended."""
    sentences: list[list[Token]] = [[]]
    for match in _WORDS.finditer(text.replace('\r', ' ')):
        token = Token(match[0].lower(), match.start() + 1)
        if token.text in (';', '\n'):
            sentences[-1].append(Token('', token.column))
            sentences.append([])
        elif token.text[0] != '#':
            if len(token.text) > MAX_TOKEN:
                raise token.error(TOO_LONG)
            sentences[-1].append(token)
    sentences[-1].append(Token('', len(text) + 1))
    return [words for words in sentences if len(words) > 1]


class _Reader:
    """Walk over the tokens of one command."""

    def __init__(self, words: list[Token], servos: int) -> None:
        self._words = words
        self._count = servos
        self._next = 0

    @property
    def token(self) -> Token:
        return self._words[self._next]

    def take(self) -> Token:
        token = self.token
        self._next = min(self._next + 1, len(self._words) - 1)
        return token

    def finish(self) -> None:
        if self.token.text:
            raise self.token.error(EXTRA)

    def number(self, low: int | None = None, high: int | None = None) -> int:
        token = self.take()
        if not _NUMBER.fullmatch(token.text):
            raise token.error(BAD_NUMBER)
        value = int(token.text)
        if (low is not None and value < low) or (high is not None and value > high):
            raise token.error(OUT_OF_RANGE)
        return value

    def servos(self) -> tuple[int, ...]:
        if self.token.text == 'all':
            self.take()
            return tuple(range(self._count))
        if not _NUMBER.fullmatch(self.token.text):
            raise self.token.error(SERVO_LIST)
        found = [self._servo(())]
        while self.token.text == ',':
            self.take()
            found.append(self._servo(found))
        return tuple(found)

    def _servo(self, before) -> int:
        token = self.take()
        if not _NUMBER.fullmatch(token.text) or not 1 <= int(token.text) <= self._count:
            raise token.error(SERVO_NUMBER)
        if int(token.text) - 1 in before:
            raise token.error(DUPLICATE)
        return int(token.text) - 1


def _move(verb: Token, reader: _Reader) -> Move:
    clauses = [_clause(reader, ())]
    while reader.token.text == ',':
        reader.take()
        clauses.append(_clause(reader, [s for clause in clauses for s in clause.servos]))
    return Move(tuple(clauses), jump=verb.text == 'jump')


def _clause(reader: _Reader, taken) -> Clause:
    at = reader.token
    servos = reader.servos()
    if set(servos) & set(taken):
        raise at.error(DUPLICATE)
    verb = reader.take()
    if verb.text not in ('to', 'by'):
        raise verb.error(TO_OR_BY)
    at = reader.token
    if at.text in PLACES:
        if verb.text == 'by':
            raise at.error(NEEDS_TO)
        return Clause(servos, to=reader.take().text, at=at)
    if _NAME.fullmatch(at.text):
        raise at.error(BAD_OPTION)
    value = reader.number(-99999, 99999)
    return Clause(servos, to=value, at=at) if verb.text == 'to' \
        else Clause(servos, by=value, at=at)


def _rate(verb: Token, reader: _Reader) -> Assign:
    servos, at = reader.servos(), reader.token
    return Assign(RATE_NAMES[verb.text], servos, reader.number(1, 10000), at)


def _position(verb: Token, reader: _Reader) -> Assign:
    servos, at = reader.servos(), reader.token
    if at.text == 'default':
        return Assign((verb.text,), servos, reader.take().text, at)
    if _NAME.fullmatch(at.text):
        raise at.error(BAD_OPTION)
    return Assign((verb.text,), servos, reader.number(-99999, 99999), at)


def _invert(verb: Token, reader: _Reader) -> Assign:
    servos, word = reader.servos(), reader.take()
    if word.text not in ('on', 'off'):
        raise word.error(ON_OFF)
    return Assign(('invert',), servos, int(word.text == 'on'), word)


def _power(verb: Token, reader: _Reader) -> Assign:
    servos, at = reader.servos(), reader.token
    if at.text in ('on', 'off'):
        return Assign(('power',), servos, 100 if reader.take().text == 'on' else 0, at)
    if not _NUMBER.fullmatch(at.text):
        raise at.error(BAD_OPTION)
    return Assign(('power',), servos, reader.number(1, 100), at)


def _wait(verb: Token, reader: _Reader) -> Wait:
    if reader.token.text.startswith('-'):
        raise reader.token.error(BAD_NUMBER)
    return Wait(reader.number(0, MAX_WAIT))


def _read_only(verb: Token, reader: _Reader) -> Assign:
    raise verb.error(READ_ONLY)


_VERBS: dict[str, Callable[[Token, _Reader], Command]] = {
    'move': _move, 'jump': _move,
    **{name: _rate for name in RATE_NAMES},
    **{name: _position for name in POSITION_NAMES},
    'invert': _invert,
    'power': _power,
    'wait': _wait, 'pause': _wait,
    'restart': lambda verb, reader: Restart(verb),
    'pos': _read_only, 'pinned': _read_only,
}
KEYWORDS = frozenset(_VERBS) | {'macro', 'end', 'to', 'by', 'all', 'on', 'off', 'default'}


def _command(reader: _Reader) -> Command:
    verb = reader.take()
    if verb.text in _VERBS:
        command = _VERBS[verb.text](verb, reader)
    elif verb.text in KEYWORDS:
        raise verb.error(UNKNOWN)
    elif not _NAME.fullmatch(verb.text):
        raise verb.error(SYMBOL)
    else:
        count = reader.number(1, MAX_COUNT) if reader.token.text else 1
        command = Call(verb.text, count, verb)
    reader.finish()
    return command


def _macro_name(reader: _Reader) -> Macro:
    reader.take()
    name = reader.take()
    if not _NAME.fullmatch(name.text) or name.text in KEYWORDS:
        raise name.error(SYMBOL)
    reader.finish()
    return Macro(name.text, at=name)


def parse(text: str, servos: int, open_macro: Macro | None = None) -> Script:
    """
    Read script text.

    Parameters
    ----------
    text : str
        Any number of commands, separated by ``;`` or LF.
    servos : int
        How many servos there are.
    open_macro : Macro, optional
        The macro that an earlier text began and did not end.

    Raises
    ------
    ScriptError
        For the first thing that is wrong.

    """
    commands: list[Command] = []
    macros: list[Macro] = []
    for words in _sentences(text):
        reader = _Reader(words, servos)
        verb = reader.token
        if verb.text == 'macro':
            if open_macro is not None:
                raise verb.error(INSIDE_MACRO)
            open_macro = _macro_name(reader)
        elif verb.text == 'end':
            if open_macro is None:
                raise verb.error(MISPLACED_END)
            reader.take()
            reader.finish()
            macros.append(open_macro)
            open_macro = None
        elif open_macro is not None:
            body = (*open_macro.body, _command(reader))
            open_macro = Macro(open_macro.name, body, open_macro.at)
        else:
            commands.append(_command(reader))
    return Script(tuple(commands), tuple(macros), open_macro)
