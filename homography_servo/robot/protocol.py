"""
RBX/1, the serial link to the robot: bytes to messages and back.

No port, clock or thread in here. A line is ASCII text, ``*``, the CRC-16/CCITT-FALSE of
what stands before the ``*`` as four upper-case hex digits, and LF; at most 250 characters
without the LF. CR is ignored. The byte 0x18 is a stop wherever it stands. `docs/link.md`
describes the messages.
"""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import dataclass
from functools import lru_cache
import re
from typing import Sequence, Union

from homography_servo.result import Rejected

MAX_LINE = 250
TAIL = 5  # '*' and four digits
LAST_SEQ = 65535
ESTOP = 0x18
ESTOP_BYTE = bytes([ESTOP])
VERSION = 'RBX/1'

BAD_CRC, BAD_LENGTH, BAD_ASCII, BAD_REUSE = 900, 901, 902, 903
NOT_NOW = 130
FRAMING_NAMES = {BAD_CRC: 'crc', BAD_LENGTH: 'length', BAD_ASCII: 'ascii'}
NOTICES = ('READY', 'ESTOP', 'WATCHDOG')
STATES = ('IDLE', 'WORKING', 'STOPPED')

_SPLIT = re.compile(rb'[\n\x18]')
_NOT_TEXT = re.compile(rb'[^\x20-\x7e\t]')


def checksum(body: bytes) -> bytes:
    """Give the four hex digits that belong to the bytes before the ``*``."""
    return b'%04X' % crc_hqx(body, 0xFFFF)


def encode_line(text: str) -> bytes:
    """
    Make the bytes of one line, CRC and LF included.

    Raises
    ------
    ValueError
        When the text has a control character, is not ASCII, or is too long.

    """
    body = text.encode('ascii', 'replace') if text.isascii() else b'\xff'
    if _NOT_TEXT.search(body):
        raise ValueError(f'a line must be printable ASCII, got {text!r}')
    if len(body) + TAIL > MAX_LINE:
        raise ValueError(f'a line has at most {MAX_LINE - TAIL} characters before its CRC, '
                         f'got {len(body)}')
    return body + b'*' + checksum(body) + b'\n'


def next_seq(seq: int) -> int:
    """Give the sequence number that follows."""
    return seq + 1 if seq < LAST_SEQ else 1


# --- what a decoder finds in a stream ---------------------------------------------------

@dataclass(frozen=True)
class Line:
    """A line whose CRC is right, without it."""

    text: str


@dataclass(frozen=True)
class BadLine:
    """A line that cannot be used: error code 900 to 902."""

    code: int

    @property
    def name(self) -> str:
        """Word for the error code."""
        return FRAMING_NAMES[self.code]


@dataclass(frozen=True)
class StopByte:
    """The byte 0x18 was there; what stood before it on its line is gone."""


Item = Union[Line, BadLine, StopByte]


def _judge(raw: bytes) -> Line | BadLine:
    if len(raw) > MAX_LINE:
        return BadLine(BAD_LENGTH)
    if _NOT_TEXT.search(raw):
        return BadLine(BAD_ASCII)
    body, star, digits = raw[:-TAIL], raw[-TAIL:-TAIL + 1], raw[-TAIL + 1:]
    if star != b'*' or digits != checksum(body):
        return BadLine(BAD_CRC)
    return Line(body.decode('ascii'))


class LineDecoder:
    """
    Cut a byte stream into lines, however it was fragmented.

    Keeps at most one line in memory. Empty lines are skipped, so a LF in front of a
    line clears what noise has left behind.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self._too_long = False

    def feed(self, chunk: bytes) -> list[Item]:
        """Take bytes; give the lines, bad lines and stop bytes that they complete."""
        if b'\r' in chunk:
            chunk = chunk.replace(b'\r', b'')
        items: list[Item] = []
        start = 0
        for end in _SPLIT.finditer(chunk):
            self._keep(chunk[start:end.start()])
            start = end.end()
            if chunk[end.start()] == ESTOP:
                items.append(StopByte())
            elif self._too_long:
                items.append(BadLine(BAD_LENGTH))
            elif self._pending:
                items.append(_judge(bytes(self._pending)))
            self.clear()
        self._keep(chunk[start:])
        return items

    def clear(self) -> None:
        """Forget the unfinished line."""
        self._pending.clear()
        self._too_long = False

    def _keep(self, piece: bytes) -> None:
        if self._too_long or len(self._pending) + len(piece) > MAX_LINE:
            self._too_long = True
            self._pending.clear()
        else:
            self._pending += piece


# --- host to device ---------------------------------------------------------------------

@dataclass(frozen=True)
class Request:
    """A numbered line of the host."""

    seq: int
    text: str

    def encode(self) -> bytes:
        """Make the bytes of the line."""
        if not 1 <= self.seq <= LAST_SEQ:
            raise ValueError(f'seq must be in [1, {LAST_SEQ}], got {self.seq}')
        return encode_line(f'{self.seq} {self.text}')


_REQUEST = re.compile(r'([0-9]{1,5})(?:[ \t]+(.*))?')


def parse_request(text: str) -> Request | Rejected:
    """Read a line of the host."""
    match = _REQUEST.fullmatch(text.strip())
    if not match:
        return Rejected(f'a line begins with a sequence number, got {text[:20]!r}')
    seq = int(match[1])
    if not 1 <= seq <= LAST_SEQ:
        return Rejected(f'the sequence number must be in [1, {LAST_SEQ}], got {seq}')
    return Request(seq, (match[2] or '').strip())


def goto_text(targets_units: Sequence[int]) -> str:
    """Write a ``!goto`` for whole servo positions."""
    return '!goto ' + ' '.join(str(int(v)) for v in targets_units)


# --- device to host ---------------------------------------------------------------------

@dataclass(frozen=True)
class Reply:
    """
    A numbered line of the device.

    ``kind`` is HELLO, OK, ERR, DONE, STOPPED, ST, POS or VAL; ``values`` are the words
    after it, numbers as int.
    """

    seq: int
    kind: str
    values: tuple = ()


@dataclass(frozen=True)
class Notice:
    """An unasked line of the device: READY, ESTOP or WATCHDOG."""

    name: str


def _hello(words: list[str]) -> tuple | None:
    if len(words) < 3 or not words[1].isdigit():
        return None
    return words[0], int(words[1]), ' '.join(words[2:])


def _error(words: list[str]) -> tuple | None:
    if len(words) < 2 or not (words[0].isdigit() and words[1].isdigit()):
        return None
    return int(words[0]), int(words[1]), ' '.join(words[2:])


def _status(words: list[str]) -> tuple | None:
    if len(words) != 4 or words[0] not in STATES or words[1] not in ('0', '1') \
            or not (words[2].isdigit() and words[3].isdigit()):
        return None
    return words[0], int(words[1]), int(words[2]), int(words[3])


@lru_cache(maxsize=4096)
def _whole(word: str) -> int | None:
    digits = word[1:] if word[:1] in ('-', '+') else word
    return int(word) if digits.isdigit() and len(digits) <= 9 else None


def _numbers(words: list[str]) -> tuple | None:
    values = tuple(_whole(word) for word in words)
    return None if not values or None in values else values


_READERS = {
    'HELLO': _hello,
    'OK': lambda words: None if words else (),
    'DONE': lambda words: None if words else (),
    'STOPPED': lambda words: None if words else (),
    'ERR': _error,
    'ST': _status,
    'POS': _numbers,
    'VAL': lambda words: _numbers(words) if len(words) == 1 else None,
}


def parse_reply(text: str) -> Reply | Notice | Rejected:
    """Read a line of the device; anything that is not to the letter is refused."""
    words = text.split()
    if len(words) < 2:
        return Rejected(f'not a reply: {text[:40]!r}')
    if words[0] == '!':
        return Notice(words[1]) if len(words) == 2 and words[1] in NOTICES \
            else Rejected(f'unknown notice: {text[:40]!r}')
    reader = _READERS.get(words[1])
    if reader is None or not (words[0].isdigit() and len(words[0]) <= 5):
        return Rejected(f'not a reply: {text[:40]!r}')
    values, seq = reader(words[2:]), int(words[0])
    if values is None or seq > LAST_SEQ or (seq == 0 and words[1] != 'ERR'):
        return Rejected(f'not a reply: {text[:40]!r}')
    return Reply(seq, words[1], values)


# --- what the device writes -------------------------------------------------------------

def error_text(seq: int, code: int, column: int, token: str) -> str:
    """Write an ERR reply; a long or unprintable token is cut."""
    shown = ''.join(c if ' ' < c <= '~' else '?' for c in token)[:32] or '-'
    return f'{seq} ERR {code} {column} {shown}'
