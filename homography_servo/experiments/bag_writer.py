"""
Write a recording from a thread of its own, so that whoever records never waits.

What waits to be written is bounded: when the disk is too slow, messages are left out
and counted, pictures first. When the disk is nearly full, or a write fails, recording
ends and says so; nothing else does.
"""

from __future__ import annotations

from collections import Counter
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import shutil
import threading
import time
from typing import Any, Callable, NamedTuple

from homography_servo.experiments.bag import BagError
from homography_servo.experiments.bag import missing_library
from homography_servo.settings import real
from homography_servo.settings import Settings

METADATA_VERSION = 9  # what rosbag2 of Jazzy writes
LARGE_BYTES = 1 << 16  # what counts as a picture
SHARE_OF_LARGE = 0.75  # of the queue; the rest is kept for small messages
CHECK_BYTES, CHECK_S = 1 << 20, 0.25
RESERVE_BYTES = 8 << 20  # for a chunk and the index, should the disk be full after all
MB = 1e6


@dataclass(frozen=True)
class BagSettings(Settings):
    """How much disk a recording leaves free, and how much may wait for the disk."""

    keep_free_mb: float = real(500.0, 0.0, 1e8, 'MB', 'free disk space at which recording stops')
    queue_mb: float = real(64.0, 0.01, 4096.0, 'MB', 'messages that may wait for the disk; what '
                           'comes on top is left out')


class Channel(NamedTuple):
    """A topic, its type (``std_msgs/msg/String``) and what its publishers offer."""

    topic: str
    msgtype: str
    qos: tuple = ()  # of rosbags.interfaces.Qos


def free_bytes(folder: Path) -> int:
    """Tell how much room the disk of a folder has."""
    return shutil.disk_usage(folder).free


class BagWriter:
    """
    A bag being written: `put` never waits, `close` gives how it went.

    Parameters
    ----------
    folder : path
        Made by this; must not exist.
    settings : BagSettings
        Limits.
    free : callable
        Gives the free bytes on the disk of a folder.
    on_stop : callable
        Called with a sentence, from the writing thread, when recording ends early.

    Raises
    ------
    BagError
        When the folder exists or cannot be made, or the rosbags library is missing.

    """

    def __init__(self, folder: Path, settings: BagSettings = BagSettings(),
                 free: Callable[[Path], int] = free_bytes,
                 on_stop: Callable[[str], Any] = lambda sentence: None) -> None:
        self.folder = folder
        self.stopped = ''
        self.dropped: Counter[str] = Counter()
        self.written = self.written_bytes = 0
        self._keep_free = settings.keep_free_mb * MB
        self._queue_limit = settings.queue_mb * MB
        self._free, self._on_stop = free, on_stop
        self._waiting: deque[tuple[Channel, int, bytes]] = deque()
        self._waiting_bytes = 0
        self._news = threading.Condition()
        self._closing = False
        self._since_check, self._checked_s = 0, -CHECK_S
        self._connections: dict[str, Any] = {}
        self._bag, self._types = _open(folder)
        self._reserve = folder / '.reserve'
        self._safe_offset = 0
        with suppress(OSError):
            self._reserve.write_bytes(os.urandom(RESERVE_BYTES))
        self._thread = threading.Thread(target=self._work, name='bag writer', daemon=True)
        self._thread.start()

    def put(self, channel: Channel, time_ns: int, data: bytes) -> bool:
        """Hand a serialised message over; False when it is left out."""
        large = len(data) >= LARGE_BYTES
        limit = self._queue_limit * (SHARE_OF_LARGE if large else 1.0)
        with self._news:
            if self.stopped or self._closing:
                return False
            if self._waiting_bytes + len(data) > limit:
                self.dropped[channel.topic] += 1
                return False
            self._waiting.append((channel, time_ns, data))
            self._waiting_bytes += len(data)
            self._news.notify()
        return True

    def close(self, timeout_s: float = 10.0) -> str:
        """Write what waits, finish the files, and say in a sentence how it went."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            self.stopped = self.stopped or f'the disk did not answer for {timeout_s:.0f} s'
        return self.sentence()

    def sentence(self) -> str:
        """Say what has been recorded, what was left out, and why it ended early."""
        text = f'recorded {self.written} messages, {self.written_bytes / MB:.0f} MB, ' \
               f'in {self.folder}'
        if self.dropped:
            text += f'; {sum(self.dropped.values())} left out because the disk was too slow (' \
                    + ', '.join(f'{n} of {topic}' for topic, n in self.dropped.items()) + ')'
        return text + (f'; recording ended early: {self.stopped}' if self.stopped else '')

    def _work(self) -> None:
        while not self.stopped:
            item = self._next()
            if item is None:
                break
            try:
                self._write(*item)
            except Exception as error:  # whatever the disk or the library does, only this ends
                self._stop(f'writing failed: {error}')
                self._rewind()
        self._finish()
        if self.stopped:
            self._on_stop(f'recording ended early: {self.stopped}')

    def _next(self) -> tuple[Channel, int, bytes] | None:
        with self._news:
            self._news.wait_for(lambda: self._waiting or self._closing)
            if not self._waiting:
                return None
            item = self._waiting.popleft()
            self._waiting_bytes -= len(item[2])
            return item

    def _write(self, channel: Channel, time_ns: int, data: bytes) -> None:
        if not self._room_left(len(data)):
            return
        connection = self._connections.get(channel.topic)
        if connection is None:
            connection = self._connections[channel.topic] = self._bag.add_connection(
                channel.topic, channel.msgtype, typestore=self._types,
                offered_qos_profiles=channel.qos)
        self._bag.write(connection, time_ns, data)
        self._safe_offset = self._bag.storage.bio.tell()
        self.written += 1
        self.written_bytes += len(data)

    def _room_left(self, size: int) -> bool:
        """Stop when the disk is nearly full; asks it now and then only."""
        self._since_check += size
        now_s = time.monotonic()
        if self._since_check < CHECK_BYTES and now_s - self._checked_s < CHECK_S:
            return True
        self._since_check, self._checked_s = 0, now_s
        free = self._free(self.folder)
        if free >= self._keep_free:
            return True
        self._stop(f'the disk is nearly full: {free / MB:.0f} MB free, '
                   f'{self._keep_free / MB:.0f} MB are kept')
        return False

    def _stop(self, reason: str) -> None:
        with self._news:
            self.stopped = reason
            self._waiting.clear()
            self._waiting_bytes = 0

    def _rewind(self) -> None:
        """Make room for the index on a full disk, and drop what was written in part."""
        with suppress(Exception):
            self._reserve.unlink()
            file = self._bag.storage.bio
            file.seek(self._safe_offset)
            file.truncate()

    def _finish(self) -> None:
        with suppress(OSError):
            self._reserve.unlink(missing_ok=True)
        try:
            self._bag.close()
        except Exception as error:
            with suppress(Exception):
                self._bag.abort()  # closes the file; the oldest versions do not have it
            self.stopped = (f'{self.stopped}; ' if self.stopped else '') \
                + f'the recording has no index and cannot be played: {error}'


def _open(folder: Path) -> tuple[Any, Any]:
    try:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer
        from rosbags.rosbag2 import WriterError
        from rosbags.typesys import get_typestore
        from rosbags.typesys import Stores
    except ImportError as error:
        raise BagError(missing_library(error)) from error
    try:
        bag = Writer(folder, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
        bag.open()
    except (WriterError, OSError) as error:
        raise BagError(f'cannot record: {error}') from error
    return bag, get_typestore(Stores.ROS2_JAZZY)
