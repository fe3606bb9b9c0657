"""
Misbehaviour of the emulator's line: what a cable, an adapter or firmware may do.

`FaultyLine` stands between a device and its port. Chances are drawn from a seeded
generator; time is an argument.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import random
import re

from homography_servo.robot.protocol import checksum

# name: (default value, what the value is)
FAULTS = {
    'drop': (1.0, 'share of replies that are lost'),
    'delay': (0.2, 'seconds by which every reply is late'),
    'duplicate': (1.0, 'share of replies sent twice'),
    'truncate': (1.0, 'share of replies cut short'),
    'corrupt': (1.0, 'share of replies with one bit wrong'),
    'wrong_seq': (1.0, 'share of replies with another sequence number and a right CRC'),
    'split': (0.001, 'seconds between the single bytes of a reply'),
    'silent': (1.0, 'hears and obeys, but says nothing'),
    'deaf': (1.0, 'hears nothing'),
    'stall': (1.0, 'does not read, so that the host cannot write'),
    'baud': (9600.0, 'both directions arrive as garbage'),
    'unplug': (1.0, 'the port goes away, and comes back at the end of the time'),
    'freeze': (1.0, 'number of a servo that does not move any more'),
}
_SPEC = re.compile(r'([a-z_]+)(?:=([0-9.]+))?(?:@([0-9.]+)(?:-([0-9.]+))?)?')


@dataclass(frozen=True)
class Fault:
    """A fault, its value, and from when to when it acts [s]."""

    name: str
    value: float
    start_s: float = 0.0
    end_s: float = math.inf

    def active(self, now_s: float) -> bool:
        """Tell whether it acts now."""
        return self.start_s <= now_s < self.end_s


def parse_fault(text: str) -> Fault:
    """
    Read ``NAME[=VALUE][@START[-END]]``, such as ``drop=0.1`` or ``unplug@5-8``.

    Raises
    ------
    ValueError
        With a sentence.

    """
    match = _SPEC.fullmatch(text)
    if not match or match[1] not in FAULTS:
        raise ValueError(f'a fault is NAME[=VALUE][@START[-END]] with NAME one of '
                         f'{", ".join(FAULTS)}, got {text!r}')
    try:
        value = FAULTS[match[1]][0] if match[2] is None else float(match[2])
        start, end = float(match[3] or 0.0), float(match[4] or 'inf')
    except ValueError:
        raise ValueError(f'not a number in the fault {text!r}') from None
    return Fault(match[1], value, start, end)


class FaultyLine:
    """
    The way of bytes to and from a device, with faults.

    Parameters
    ----------
    faults : list of Fault
        What goes wrong, and when.
    seed : int
        Of the chances.
    baud : int
        Speed of the line to imitate, 0 for none.

    """

    def __init__(self, faults: list[Fault], seed: int = 0, baud: int = 0) -> None:
        self.faults = list(faults)
        self._random = random.Random(seed)
        self._byte_s = 10.0 / baud if baud else 0.0
        self._out: list[tuple[float, bytes]] = []
        self._in = bytearray()
        self._heard_until_s = 0.0
        self._free_s = 0.0

    def active(self, name: str, now_s: float) -> Fault | None:
        """Give the fault of a name that acts now, or None."""
        return next((f for f in self.faults if f.name == name and f.active(now_s)), None)

    @property
    def waiting(self) -> bool:
        """Tell whether bytes are under way."""
        return bool(self._out or self._in)

    def hear(self, data: bytes, now_s: float) -> bytes:
        """Give what of the host's bytes reaches the device by now."""
        if self.active('deaf', now_s):
            data = b''
        if self.active('baud', now_s):
            data = self._garbage(len(data))
        if not self._byte_s:
            return data
        if not self._in:
            self._heard_until_s = now_s
        self._in += data
        count = min(int((now_s - self._heard_until_s) / self._byte_s), len(self._in))
        self._heard_until_s += count * self._byte_s
        heard, self._in = bytes(self._in[:count]), self._in[count:]
        return heard

    def say(self, lines: list[bytes], now_s: float) -> None:
        """Take lines of the device, to be sent when it is time."""
        for line in lines:
            for data in self._spoiled(line, now_s):
                self._schedule(data, now_s)

    def due(self, now_s: float) -> bytes:
        """Give the bytes that leave the line by now."""
        data = b''.join(item for time_s, item in self._out if time_s <= now_s)
        self._out = [item for item in self._out if item[0] > now_s]
        return data

    def clear(self) -> None:
        """Forget what is under way: the cable is out."""
        self._out.clear()
        self._in.clear()

    def _schedule(self, data: bytes, now_s: float) -> None:
        delay, split = self.active('delay', now_s), self.active('split', now_s)
        start_s = max(now_s + (delay.value if delay else 0.0), self._free_s)
        pause_s = max(self._byte_s, split.value if split else 0.0)
        if not pause_s:
            self._out.append((start_s, data))
            return
        self._out += [(start_s + (i + 1) * pause_s, data[i:i + 1]) for i in range(len(data))]
        self._free_s = start_s + len(data) * pause_s

    def _spoiled(self, line: bytes, now_s: float) -> list[bytes]:
        if self.active('silent', now_s) or self._strikes('drop', now_s):
            return []
        if self.active('baud', now_s):
            return [self._garbage(len(line))]
        if self._strikes('wrong_seq', now_s):
            line = _renumbered(line)
        if self._strikes('truncate', now_s):
            line = line[:self._random.randrange(len(line))]
        elif self._strikes('corrupt', now_s):
            place = self._random.randrange(len(line) - 1)
            wrong = line[place] ^ (1 << self._random.randrange(7))
            line = line[:place] + bytes([wrong]) + line[place + 1:]
        return [line, line] if self._strikes('duplicate', now_s) else [line]

    def _strikes(self, name: str, now_s: float) -> bool:
        fault = self.active(name, now_s)
        return fault is not None and self._random.random() < fault.value

    def _garbage(self, count: int) -> bytes:
        return self._random.randbytes(count)


def _renumbered(line: bytes) -> bytes:
    """Add 1000 to the sequence number of a reply."""
    seq, _, rest = line.rpartition(b'*')[0].partition(b' ')
    if not seq.isdigit():
        return line
    body = b'%d %s' % ((int(seq) + 999) % 65535 + 1, rest)
    return body + b'*' + checksum(body) + b'\n'
