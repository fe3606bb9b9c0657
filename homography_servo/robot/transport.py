"""
Byte pipes to a robot: a device name, any URL that pyserial opens, or memory.

All have the same verbs. ``write`` and ``read`` never block and raise `LinkError` when the
line is gone; ``write_now`` throws away what the system has not sent yet, and sends.
"""

from __future__ import annotations

import errno
import os
import select
import termios
import threading
import time
from typing import Callable, Protocol

from homography_servo.errors import LinkError
from homography_servo.robot.device import Device

CHUNK = 4096
WRITE_TIMEOUT_S = 0.1
DRAIN_S = 0.05


class PortMissing(LinkError):
    """There is no such port, or nobody listens at the other end of it."""


class PortBusy(LinkError):
    """Another program has the port."""


class Transport(Protocol):
    """A byte pipe to a robot."""

    def write(self, data: bytes) -> int:
        """Send what fits now; give how many bytes that were."""

    def write_now(self, data: bytes) -> None:
        """Send before anything that waits in the system."""

    def read(self) -> bytes:
        """Give what has come, maybe nothing."""

    def fileno(self) -> int | None:
        """Give something to select on, None where there is nothing."""

    def close(self) -> None:
        """Release the port; may be called twice."""


class MemoryTransport:
    """
    A device in the same process, without port or thread.

    It has no wire time, no fragmentation and no back-pressure.

    Parameters
    ----------
    device : Device
        Who answers.
    clock : callable
        Time in seconds.

    """

    def __init__(self, device: Device, clock: Callable[[], float]) -> None:
        self._device = device
        self._clock = clock
        self._closed = False

    def write(self, data: bytes) -> int:
        """Let the device hear it."""
        self._check()
        self._device.feed(data, self._clock())
        return len(data)

    def write_now(self, data: bytes) -> None:
        """Let the device hear it."""
        self.write(data)

    def read(self) -> bytes:
        """Give what the device has to say by now."""
        self._check()
        self._device.step(self._clock())
        return b''.join(self._device.take())

    def fileno(self) -> int | None:
        """Give None: there is nothing to wait for."""
        return None

    def close(self) -> None:
        """Hang up."""
        self._closed = True

    def _check(self) -> None:
        if self._closed:
            raise LinkError('the port is closed')


def _explain(url: str, error: Exception) -> LinkError:
    """Turn what pyserial says into a sentence and what to do."""
    number = getattr(error, 'errno', None)
    text = str(error)
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV) or 'No such file' in text:
        return PortMissing(f'{url} is not there: plug the robot in, or set the parameter port '
                           '(`fake` needs no hardware)')
    if number in (errno.EBUSY, errno.EWOULDBLOCK) or 'exclusively lock' in text:
        return PortBusy(f'{url} is used by another program: end that one first '
                        f'(`fuser {url}` names it)')
    if number in (errno.EACCES, errno.EPERM):
        return PortMissing(f'{url} may not be opened by this user: add the user to the group '
                           'dialout and log in again')
    return PortMissing(f'{url} cannot be opened: {text}')


class SerialTransport:
    """
    A serial device, opened exclusively.

    Reads and writes go to the file descriptor: a pyserial write can block, and spins when
    the line takes nothing.
    """

    def __init__(self, url: str, baud: int) -> None:
        import serial  # only a real port needs pyserial

        self._lock = threading.Lock()
        try:
            self._port = serial.Serial(url, baud, timeout=0.0, exclusive=True)
        except (OSError, termios.error, ValueError) as error:
            raise _explain(url, error) from error
        self._fd = self._port.fileno()
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def write(self, data: bytes) -> int:
        """Send what fits now; give how many bytes that were."""
        with self._lock:
            try:
                return os.write(self._open_fd(), data)
            except BlockingIOError:
                return 0
            except OSError as error:
                raise LinkError(f'the line is gone: {error}') from error

    def write_now(self, data: bytes) -> None:
        """Send before anything that waits in the system."""
        with self._lock:
            try:
                termios.tcflush(self._open_fd(), termios.TCOFLUSH)
                os.write(self._fd, data)
            except (OSError, termios.error) as error:
                raise LinkError(f'the line is gone: {error}') from error

    def read(self) -> bytes:
        """Give what has come; an unplugged adapter shows as hang-up or as an empty read."""
        with self._lock:
            try:
                self._open_fd()
                events = self._poll.poll(0)
                if not events:
                    return b''
                data = os.read(self._fd, CHUNK) if events[0][1] & select.POLLIN else b''
            except BlockingIOError:
                return b''
            except OSError as error:
                raise LinkError(f'the line is gone: {error}') from error
        if not data:
            raise LinkError('the line is gone: the port hung up')
        return data

    def fileno(self) -> int | None:
        """Give the file descriptor."""
        return self._fd if self._fd >= 0 else None

    def close(self) -> None:
        """Release the port without waiting for bytes that nobody takes."""
        with self._lock:
            if self._fd < 0:
                return
            self._drain()
            self._fd = -1
            try:
                self._port.close()
            except (OSError, termios.error):
                pass

    def _drain(self) -> None:
        """Let a last stop byte out, but do not wait for a line that takes nothing."""
        try:
            until_s = time.monotonic() + DRAIN_S
            while self._port.out_waiting:
                if time.monotonic() >= until_s:
                    termios.tcflush(self._fd, termios.TCOFLUSH)
                    break
                time.sleep(0.001)
        except (OSError, termios.error):
            pass  # it is gone already

    def _open_fd(self) -> int:
        if self._fd < 0:
            raise LinkError('the port is closed')
        return self._fd


class UrlTransport:
    """Any URL of pyserial, such as ``socket://host:port`` or ``rfc2217://host:port``."""

    def __init__(self, url: str, baud: int) -> None:
        import serial

        self._lock = threading.Lock()
        try:
            self._port = serial.serial_for_url(url, baudrate=baud, timeout=0.0,
                                               write_timeout=WRITE_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise _explain(url, error) from error

    def write(self, data: bytes) -> int:
        """Send; pyserial has its own buffer and its own time-out here."""
        with self._lock:
            return self._guarded(lambda: self._port.write(data)) or 0

    def write_now(self, data: bytes) -> None:
        """Send; what waits in a network cannot be called back."""
        self.write(data)

    def read(self) -> bytes:
        """Give what has come."""
        with self._lock:
            return bytes(self._guarded(lambda: self._port.read(CHUNK)))

    def fileno(self) -> int | None:
        """Give None: not every URL has a descriptor."""
        return None

    def close(self) -> None:
        """Release the port."""
        with self._lock:
            try:
                self._port.close()
            except (OSError, termios.error):
                pass

    def _guarded(self, action: Callable):
        try:
            return action()
        except (OSError, termios.error, TypeError, AttributeError, ValueError) as error:
            # pyserial's back ends raise the last three on a port closed under them
            raise LinkError(f'the line is gone: {error}') from error


def open_transport(url: str, baud: int) -> Transport:
    """
    Open a port by device name or URL.

    Raises
    ------
    PortMissing, PortBusy
        With a sentence that says what to do.

    """
    if '://' in url:
        return UrlTransport(url, baud)
    return SerialTransport(url, baud)
