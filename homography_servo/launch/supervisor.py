"""
Keep a set of processes running, and leave none behind.

Each process has its own session, so a Ctrl-C in the terminal reaches the launcher
alone and the processes end in order: SIGINT, after 5 s SIGTERM, after 5 s SIGKILL.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from dataclasses import field
import os
from queue import Empty
from queue import SimpleQueue
import signal
import subprocess
import sys
import threading
import time
from typing import Callable, Sequence

PATIENCE_S = 5.0
RESTART_WINDOW_S = 60.0
RESTARTS_IN_WINDOW = 3
RESTART_DELAY_S = 0.5
FINAL_CODES = (2, 3)  # bad configuration, hardware not there: starting again cannot help
LADDER = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


def describe_exit(code: int) -> str:
    """Say how a process ended."""
    return f'was ended by {signal.Signals(-code).name}' if code < 0 else f'ended with code {code}'


@dataclass
class Child:
    """One process that is to be kept running."""

    name: str
    command: Sequence[str]
    environment: dict[str, str]
    process: subprocess.Popen | None = None
    restarts_s: deque = field(default_factory=deque)
    due_s: float = 0.0

    def start(self, write: Callable[[str], None]) -> None:
        """Start the process and a thread that passes its output on, line by line."""
        self.due_s = 0.0
        self.process = subprocess.Popen(
            self.command, env=self.environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)
        threading.Thread(target=_pass_on, args=(self.process.stdout, self.name, write),
                         daemon=True).start()

    @property
    def running(self) -> bool:
        """Tell whether the process is there."""
        return self.process is not None and self.process.poll() is None

    def signal(self, number: int) -> None:
        """Send a signal to the process and what it started."""
        if self.process is None:
            return
        try:
            os.killpg(self.process.pid, number)
        except ProcessLookupError:
            pass


def _pass_on(stream, name: str, write: Callable[[str], None]) -> None:
    for raw in stream:
        write(f'[{name}] {raw.decode("utf-8", "replace").rstrip()}')
    stream.close()


class Supervisor:
    """
    Starts processes, restarts what dies, and ends all in order.

    Parameters
    ----------
    children : list of Child
        What to run.
    write : callable, optional
        Takes each line of output.

    """

    def __init__(self, children: Sequence[Child],
                 write: Callable[[str], None] | None = None) -> None:
        self.children = list(children)
        self._lock = threading.Lock()
        self._write_line = write or _to_stdout
        self._signals = 0
        self._wake: SimpleQueue[None] = SimpleQueue()  # an Event deadlocks in a signal handler

    def write(self, line: str) -> None:
        """Write one whole line, whoever else is writing."""
        with self._lock:
            self._write_line(line)

    def interrupt(self, *_) -> None:
        """Ask for the end; asked again, the next signal of the ladder goes out at once."""
        self._signals += 1
        self._wake.put(None)

    def run(self) -> int:
        """
        Run until interrupted, until all have finished, or until one cannot go on.

        Returns
        -------
        int
            0 when interrupted or finished, else the code of the process that failed.

        """
        for child in self.children:
            child.start(self.write)
        try:
            return self._watch()
        finally:
            self.end()

    def _watch(self) -> int:
        while not self._signals:
            for child in self.children:
                code = self._tend(child)
                if code is not None:
                    return code
            if not any(child.running or child.due_s for child in self.children):
                return 0
            self._pause(0.05)
        return 0

    def _pause(self, time_s: float) -> None:
        try:
            self._wake.get(timeout=time_s)
        except Empty:
            pass

    def _tend(self, child: Child) -> int | None:
        """Restart a child that died; give an exit code when that cannot help."""
        if child.due_s and time.monotonic() >= child.due_s:
            child.start(self.write)
        if child.running or child.due_s or child.process is None:
            return None
        code = child.process.returncode
        child.process = None
        if code == 0:
            self.write(f'[bringup] {child.name} has finished')
            return None
        if code in FINAL_CODES:
            self.write(f'[bringup] {child.name} {describe_exit(code)}; its last lines say why')
            return code
        return self._plan_restart(child, code)

    def _plan_restart(self, child: Child, code: int) -> int | None:
        now_s = time.monotonic()
        while child.restarts_s and now_s - child.restarts_s[0] > RESTART_WINDOW_S:
            child.restarts_s.popleft()
        if len(child.restarts_s) >= RESTARTS_IN_WINDOW:
            self.write(f'[bringup] {child.name} {describe_exit(code)} and was restarted '
                       f'{RESTARTS_IN_WINDOW} times in {RESTART_WINDOW_S:.0f} s; giving up')
            return 1
        delay_s = RESTART_DELAY_S * 2 ** len(child.restarts_s)
        child.restarts_s.append(now_s)
        child.due_s = now_s + delay_s
        self.write(f'[bringup] {child.name} {describe_exit(code)}; restarting in {delay_s:.1f} s')
        return None

    def end(self) -> None:
        """End every process by the ladder of signals."""
        for number in LADDER:
            alive = [child for child in self.children if child.running]
            if not alive:
                return
            for child in alive:
                child.signal(number)
            self._wait_for(alive)

    def _wait_for(self, children: Sequence[Child]) -> None:
        asked, until_s = self._signals, time.monotonic() + PATIENCE_S
        while any(child.running for child in children) and time.monotonic() < until_s \
                and self._signals == asked:
            time.sleep(0.01)


def _to_stdout(line: str) -> None:
    try:
        print(line, flush=True)
    except (BrokenPipeError, ValueError):  # nobody reads any more; keep supervising
        sys.stdout = open(os.devnull, 'w')
