"""The thread that owns the port."""

from __future__ import annotations

import os
import select
import threading
import time

from homography_servo.robot.driver import ArmDriver

SHORTEST_S, LONGEST_S = 0.001, 0.02
BLIND_S = 0.003  # between looks at a port that cannot be waited for


class ArmThread:
    """
    Turn a driver as often as it needs.

    Parameters
    ----------
    driver : ArmDriver
        The driver; nobody else calls its `turn`.

    """

    def __init__(self, driver: ArmDriver) -> None:
        self._driver = driver
        self._ended = threading.Event()
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._reader, False)
        os.set_blocking(self._writer, False)
        self._thread = threading.Thread(target=self._run, name='arm', daemon=True)
        self.longest_turn_s = 0.0
        self._turned_s = 0.0

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def wake(self) -> None:
        """Have the next turn now."""
        try:
            os.write(self._writer, b'.')
        except (BlockingIOError, OSError):
            pass

    def stop(self) -> None:
        """End the thread and release the port."""
        self._ended.set()
        self.wake()
        if self._thread.is_alive():
            self._thread.join(1.0)
        self._driver.close()
        if not self._thread.is_alive() and self._reader >= 0:
            for handle in (self._reader, self._writer):
                os.close(handle)
            self._reader = self._writer = -1

    def _run(self) -> None:
        while not self._ended.is_set():
            start_s = time.monotonic()
            try:
                self._driver.turn(start_s)
            except Exception as error:  # a fault in here must stop the arm, not the thread
                self._driver.stop_now(f'internal error: {error}')
                self._ended.wait(0.1)
            self._turned_s = time.monotonic()
            self.longest_turn_s = max(self.longest_turn_s, self._turned_s - start_s)
            self._sleep()

    def _sleep(self) -> None:
        due_s = self._driver.next_due_s() - time.monotonic()
        time_s = min(max(due_s, SHORTEST_S), LONGEST_S)
        handle = self._driver.link.fileno()
        blind = handle is None and self._driver.link.open
        handles = [self._reader] if handle is None else [self._reader, handle]
        try:
            ready = select.select(handles, [], [], min(time_s, BLIND_S) if blind else time_s)[0]
        except (OSError, ValueError):  # the port was closed under us
            return
        if self._reader in ready:
            os.read(self._reader, 4096)
            early_s = self._turned_s + SHORTEST_S - time.monotonic()
            if early_s > 0.0:  # a flood of wakes must not become a flood of turns
                time.sleep(early_s)
