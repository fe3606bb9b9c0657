"""What the parameter ``port`` means: an emulator of our own, a device, or a URL."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import time
from typing import TextIO

from homography_servo.errors import LinkError
from homography_servo.robot.device import Device
from homography_servo.robot.emulator import Emulator
from homography_servo.robot.emulator import PtyPort
from homography_servo.robot.faults import parse_fault
from homography_servo.robot.transport import open_transport
from homography_servo.robot.transport import Transport
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import texts

FAKE = 'fake'


@dataclass(frozen=True)
class PortSettings(Settings):
    """Where the robot is."""

    port: str = text(FAKE, 'device such as /dev/ttyUSB0, URL that pyserial opens, or `fake`: an '
                     'emulated robot inside this program', read_only=True)
    session_log: str = text('', 'file for everything said on the line, with times; empty for '
                            'none', read_only=True)
    fake_faults: tuple[str, ...] = texts((), 'misbehaviour of the emulated robot, as for '
                                         'robix_emulator --fault', read_only=True)
    fake_log: str = text('', 'file for what the emulated robot hears; empty for none',
                         read_only=True)


class LogError(LinkError):
    """A log cannot be written."""


class SessionLog:
    """A text file of both directions; a full disk ends the log, not the session."""

    def __init__(self, path: str | Path) -> None:
        try:
            self._file: TextIO | None = open(path, 'a', buffering=1, encoding='ascii')
        except OSError as error:
            raise LogError(f'the session log {path} cannot be written: {error}') from error

    def add(self, arrow: str, data: bytes) -> None:
        """Write steady time, direction and bytes."""
        if not self._file or not data:
            return
        try:
            self._file.write(f'{time.monotonic():.6f} {arrow} {data!r}\n')
        except OSError:
            self.close()

    def close(self) -> None:
        """End the log."""
        log, self._file = self._file, None
        if log:
            try:
                log.close()
            except OSError:
                pass


class LoggedTransport:
    """A transport that writes down what passes."""

    def __init__(self, inner: Transport, log: SessionLog) -> None:
        self._inner = inner
        self._log = log

    def write(self, data: bytes) -> int:
        """Send and write down what was taken."""
        sent = self._inner.write(data)
        self._log.add('>', data[:sent])
        return sent

    def write_now(self, data: bytes) -> None:
        """Send first, then write down."""
        self._inner.write_now(data)
        self._log.add('>', data)

    def read(self) -> bytes:
        """Receive and write down."""
        data = self._inner.read()
        self._log.add('<', data)
        return data

    def fileno(self) -> int | None:
        """Give the port's descriptor."""
        return self._inner.fileno()

    def close(self) -> None:
        """Release the port; the log stays open for the next connection."""
        self._inner.close()


class Port:
    """
    The port of a robot, to be opened again and again.

    Parameters
    ----------
    settings : PortSettings
        Where and what.
    baud : int
        Line speed.
    servos : int
        Servos of the emulated robot.
    tick_s : float
        Interpolator tick of the emulated robot.

    """

    def __init__(self, settings: PortSettings, baud: int, servos: int = 6,
                 tick_s: float = 0.020) -> None:
        self._emulator: Emulator | None = None
        self._log = SessionLog(settings.session_log) if settings.session_log else None
        self._baud = baud
        self.url = settings.port
        if settings.port == FAKE:
            faults = [parse_fault(item) for item in settings.fake_faults]
            pty = PtyPort()
            self.url = pty.path
            try:
                self._emulator = Emulator(Device(servos, 'fake', tick_s), pty, faults,
                                          settings.fake_log or None)
            except OSError as error:
                pty.close()
                self.close()
                raise LogError(f'the log {settings.fake_log} cannot be written: {error}') \
                    from error
            self._emulator.start()

    def open(self) -> Transport:
        """Open it; LinkError says why that fails and what to do."""
        url = self._emulator.port.path if self._emulator else self.url
        transport = open_transport(url, self._baud)
        return LoggedTransport(transport, self._log) if self._log else transport

    def close(self) -> None:
        """End the emulator and the log."""
        if self._emulator:
            self._emulator.stop()
        if self._log:
            self._log.close()
