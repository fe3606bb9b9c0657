"""
The reference device on a port: a pty of its own, or a real serial port.

The bridge runs one in a thread for ``port: fake``; the program `robix_emulator` runs one
for anybody. It does not simulate servo dynamics, voltage, heat or mechanical stops.
"""

from __future__ import annotations

import os
from pathlib import Path
import pty
import select
import threading
import time
import tty
from typing import Callable

from homography_servo.errors import LinkError
from homography_servo.robot.device import Device
from homography_servo.robot.faults import Fault
from homography_servo.robot.faults import FaultyLine
from homography_servo.robot.transport import CHUNK
from homography_servo.robot.transport import open_transport
from homography_servo.robot.transport import Transport

BUSY_S, QUIET_S = 0.005, 0.02  # how long it sleeps at most
REOPEN_S = 0.2  # between tries to open a real port that is gone


class PtyPort:
    """
    The device's end of a pseudo-terminal.

    Parameters
    ----------
    link : path, optional
        A symbolic link to keep pointing at the pty, whose own name changes when the cable
        is pulled and plugged.

    """

    def __init__(self, link: str | Path | None = None) -> None:
        self._link = Path(link) if link else None
        self._master, self._slave = -1, -1
        self.path = ''
        self.plug()

    def plug(self) -> None:
        """Make the pty."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)  # no echo, no line editing
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        if self._link:
            part = self._link.with_name(f'.{self._link.name}.{os.getpid()}')
            part.unlink(missing_ok=True)
            part.symlink_to(self.path)
            part.replace(self._link)
            self.path = str(self._link)

    def unplug(self) -> None:
        """Hang up: the host sees the port vanish."""
        if self._link:
            self._link.unlink(missing_ok=True)
        for handle in (self._master, self._slave):
            if handle >= 0:
                os.close(handle)
        self._master = self._slave = -1

    def write(self, data: bytes) -> int:
        """Send; what nobody reads is lost, as on a wire."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def read(self) -> bytes:
        """Give what the host has sent."""
        try:
            return os.read(self._master, CHUNK)
        except BlockingIOError:
            return b''

    def fileno(self) -> int | None:
        """Give the file descriptor, None while unplugged."""
        return self._master if self._master >= 0 else None

    def close(self) -> None:
        """Remove the pty."""
        self.unplug()


class RealPort:
    """
    The device's end of a real line, opened again when it comes back.

    Parameters
    ----------
    url : str
        Device name or URL.
    baud : int
        Line speed.

    """

    def __init__(self, url: str, baud: int) -> None:
        self.path = url
        self._baud = baud
        self._transport: Transport | None = None
        self.plug()

    def plug(self) -> None:
        """Open it; LinkError says why that fails."""
        self._opened()

    def _opened(self) -> Transport:
        self._transport = open_transport(self.path, self._baud)
        return self._transport

    def unplug(self) -> None:
        """Close it, as if the cable were pulled."""
        if self._transport:
            self._transport.close()
        self._transport = None

    def write(self, data: bytes) -> int:
        """Send what fits."""
        return self._transport.write(data) if self._transport else 0

    def read(self) -> bytes:
        """Give what the host has sent; LinkError while the port is gone."""
        try:
            return (self._transport or self._opened()).read()
        except LinkError:
            self.unplug()
            raise

    def fileno(self) -> int | None:
        """Give the file descriptor, None where there is none."""
        return self._transport.fileno() if self._transport else None

    def close(self) -> None:
        """Release the port."""
        self.unplug()


class Log:
    """Write the time and the raw bytes of what was heard, one line each; a full disk ends it."""

    def __init__(self, path: str | Path | None) -> None:
        self._file = open(path, 'w', buffering=1, encoding='ascii') if path else None

    def add(self, now_s: float, data: bytes) -> None:
        """Add one line: steady time in seconds, then the bytes as a Python literal."""
        if not self._file or not data:
            return
        try:
            self._file.write(f'{now_s:.6f} {data!r}\n')
        except OSError:
            self.close()

    def close(self) -> None:
        """End the log."""
        if self._file:
            try:
                self._file.close()
            except OSError:
                pass
        self._file = None


class Emulator:
    """
    Run a device on a port until told to stop.

    Parameters
    ----------
    device : Device
        Who answers.
    port : PtyPort or RealPort
        Where.
    faults : list of Fault
        What goes wrong, in seconds from the start.
    log : path, optional
        Where to write what is heard.
    baud : int
        Speed of the line to imitate on a pty, 0 for none.
    clock : callable
        Steady time in seconds.

    """

    def __init__(self, device: Device, port: PtyPort | RealPort,
                 faults: list[Fault] | None = None, log: str | Path | None = None, seed: int = 0,
                 baud: int = 0, clock: Callable[[], float] = time.monotonic) -> None:
        self.device = device
        self.port = port
        self.line = FaultyLine(faults or [], seed, baud)
        self._log = Log(log)
        self._clock = clock
        self._start_s = clock()
        self._ended = False  # not an Event: setting one in a signal handler can lock up
        self._thread: threading.Thread | None = None
        self._plugged = True

    def start(self) -> None:
        """Run in a thread of its own."""
        self._thread = threading.Thread(target=self.run, name='emulator', daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Make `run` return soon; may be called from a signal handler."""
        self._ended = True

    def stop(self) -> None:
        """End the thread and the port."""
        self.end()
        if self._thread:
            self._thread.join(2.0)

    def run(self) -> None:
        """Serve until `end`."""
        try:
            while not self._ended:
                self.turn()
        finally:
            self._log.close()
            self.port.close()

    def turn(self) -> None:
        """Wait for bytes or time, and do what is due."""
        busy = self.line.waiting or self.device.machine.working
        self._wait(BUSY_S if busy else QUIET_S)
        now_s = self._clock()
        age_s = now_s - self._start_s
        self._mend(age_s)
        data = b''
        if self._plugged and not self.line.active('stall', age_s):
            data = self._read()
            self._log.add(now_s, data)
        heard = self.line.hear(data, age_s)
        if heard:
            self.device.feed(heard, now_s)
        else:
            self.device.step(now_s)
        self.line.say(self.device.take(), age_s)
        due = self.line.due(age_s)
        if due and self._plugged:
            self._write(due)

    def _wait(self, time_s: float) -> None:
        handle = self.port.fileno()
        if handle is None or self.line.active('stall', self._clock() - self._start_s):
            time.sleep(min(time_s, 0.005))
        else:
            select.select([handle], [], [], time_s)

    def _mend(self, age_s: float) -> None:
        """Pull or plug the cable, freeze servos."""
        out = self.line.active('unplug', age_s) is not None
        if out and self._plugged:
            self._plugged = False
            self.line.clear()
            self.port.unplug()
        elif not out and not self._plugged:
            self._plugged = True
            self._plug()
        frozen = self.line.active('freeze', age_s)
        servo = int(frozen.value) - 1 if frozen else -1
        if 0 <= servo < self.device.machine.servos and \
                servo not in self.device.machine.frozen:
            self.device.machine.freeze(servo, self._clock())

    def _plug(self) -> None:
        try:
            self.port.plug()
        except LinkError:
            pass  # reading tries again

    def _read(self) -> bytes:
        try:
            return self.port.read()
        except (OSError, LinkError):
            time.sleep(REOPEN_S)
            return b''

    def _write(self, data: bytes) -> None:
        try:
            self.port.write(data)
        except (OSError, LinkError):
            pass
