"""Processes are restarted within limits and never left behind."""

import os
import signal
import sys
import threading
import time

from homography_servo.launch import supervisor as module
from homography_servo.launch.supervisor import Child
from homography_servo.launch.supervisor import Supervisor
import pytest

STUBBORN = ('import signal, time; [signal.signal(s, signal.SIG_IGN) for s in (2, 15)]; '
            'print("ready", flush=True); time.sleep(60)')
POLITE = 'import time; print("ready", flush=True); time.sleep(60)'


def child(name: str, code: str) -> Child:
    """Describe a small Python process."""
    return Child(name, [sys.executable, '-c', code], dict(os.environ))


class Run:
    """A supervisor in a thread, with its output and its result."""

    def __init__(self, *children: Child) -> None:
        self.lines: list[str] = []
        self.supervisor = Supervisor(children, self.lines.append)
        self.code: int | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        self.code = self.supervisor.run()

    def wait_for(self, text: str, times: int = 1) -> None:
        """Wait until a text has been written."""
        until_s = time.monotonic() + 20.0
        while sum(text in line for line in self.lines) < times:
            assert time.monotonic() < until_s, f'{text!r} not in {self.lines}'
            time.sleep(0.01)

    def join(self) -> int:
        """Wait for the end and give the exit code."""
        self._thread.join(20.0)
        assert not self._thread.is_alive()
        return self.code


@pytest.fixture(autouse=True)
def hurry(monkeypatch):
    """Shorten what would only make the tests wait."""
    monkeypatch.setattr(module, 'PATIENCE_S', 0.3)
    monkeypatch.setattr(module, 'RESTART_DELAY_S', 0.02)


def test_output_carries_the_name_of_its_process():
    run = Run(child('a', 'print("hello")'), child('b', 'print("there")'))
    assert run.join() == 0
    run.wait_for('[a] hello')
    run.wait_for('[b] there')


def test_what_dies_is_restarted_until_it_is_too_much():
    run = Run(child('crash', 'raise SystemExit(7)'), child('polite', POLITE))
    assert run.join() == 1
    assert sum('restarting' in line for line in run.lines) == module.RESTARTS_IN_WINDOW
    assert any('giving up' in line for line in run.lines)
    assert not any(item.running for item in run.supervisor.children)


@pytest.mark.parametrize('code', [2, 3])
def test_bad_configuration_and_missing_hardware_end_everything_at_once(code):
    run = Run(child('bad', f'raise SystemExit({code})'), child('polite', POLITE))
    assert run.join() == code
    assert not any('restarting' in line for line in run.lines)


def test_a_killed_process_comes_back():
    run = Run(child('polite', POLITE))
    run.wait_for('ready')
    run.supervisor.children[0].signal(signal.SIGKILL)
    run.wait_for('was ended by SIGKILL')
    run.wait_for('ready', times=2)
    run.supervisor.interrupt()
    assert run.join() == 0


def test_the_ladder_ends_even_the_stubborn():
    run = Run(child('stubborn', STUBBORN))
    run.wait_for('ready')
    process = run.supervisor.children[0].process
    run.supervisor.interrupt()
    assert run.join() == 0
    assert process.returncode == -signal.SIGKILL


def test_asking_twice_skips_the_waiting(monkeypatch):
    monkeypatch.setattr(module, 'PATIENCE_S', 30.0)
    run = Run(child('stubborn', STUBBORN))
    run.wait_for('ready')
    until_s = time.monotonic() + 15.0
    while run.code is None and time.monotonic() < until_s:
        run.supervisor.interrupt()
        time.sleep(0.1)
    assert run.join() == 0


def test_grandchildren_end_with_their_parent():
    code = ('import subprocess, sys, time; '
            'p = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]); '
            'print("pid", p.pid, flush=True); time.sleep(60)')
    run = Run(child('parent', code))
    run.wait_for('[parent] pid')
    pid = int(run.lines[-1].split()[-1])
    run.supervisor.interrupt()
    run.join()
    until_s = time.monotonic() + 5.0
    while os.path.exists(f'/proc/{pid}/stat') and time.monotonic() < until_s:
        if open(f'/proc/{pid}/stat').read().split()[2] == 'Z':
            break
        time.sleep(0.01)
    else:
        assert not os.path.exists(f'/proc/{pid}/stat')
