"""Real nodes as processes, and a probe that speaks to them; each test in its own domain."""

from __future__ import annotations

from contextlib import contextmanager
import itertools
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Any, Callable

from homography_servo.nodes.__main__ import PARENT
import pytest

ROOT = Path(__file__).resolve().parents[2]
# Domains up to 101 use ports below the ephemeral ones.
DOMAINS = itertools.cycle(range(1, 102))
for _ in range(os.getpid() % 101):
    next(DOMAINS)
PATIENCE_S = 30.0
ASK_AGAIN_S = 6.0


def wait_until(condition: Callable[[], Any], sentence: str, timeout_s: float = PATIENCE_S) -> Any:
    """Wait for a condition and give its value."""
    until_s = time.monotonic() + timeout_s
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < until_s, f'{sentence} (waited {timeout_s:.0f} s)'
        time.sleep(0.005)


class NodeProcess:
    """
    A node of this package as a process.

    ``lines`` is what it has printed so far.
    """

    def __init__(self, name: str, domain: int, arguments: list[str]) -> None:
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
                       'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                       'ROS_PYTHON_CHECK_FIELDS': '1',
                       # Not even a killed test leaves a node behind.
                       PARENT: os.environ.get(PARENT, str(os.getpid()))}
        self.name = name
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'homography_servo.nodes', name, *arguments],
            env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, start_new_session=True)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    @property
    def output(self) -> str:
        """Give everything printed so far."""
        return '\n'.join(self.lines)

    def signal(self, number: int) -> None:
        """Send a signal."""
        self.process.send_signal(number)

    def wait(self, timeout_s: float = PATIENCE_S) -> int:
        """Wait for the end and give the exit code."""
        code = self.process.wait(timeout_s)
        self._reader.join(5.0)
        return code

    def stop(self) -> int:
        """End the node as Ctrl-C does and give the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.wait()

    def kill(self) -> None:
        """End the process and whatever it started, if it is still there."""
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self.process.wait()


class Probe:
    """An rclpy node in the test's domain that records, publishes and calls."""

    def __init__(self, domain: int) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=domain,
                   signal_handler_options=rclpy.SignalHandlerOptions.NO)
        self.node = rclpy.create_node('probe', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}

    def record(self, kind: type, topic: str, qos: Any = 10) -> list:
        """Subscribe; the list grows as messages come while the probe spins."""
        messages: list = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, kind: type, topic: str, qos: Any = 10, matched: bool = True) -> Any:
        """Make a publisher, by default waiting until somebody listens."""
        publisher = self.node.create_publisher(kind, topic, qos)
        if matched:
            self.wait(lambda: publisher.get_subscription_count() > 0, f'no listener on {topic}')
        return publisher

    def spin_once(self, timeout_s: float = 0.02) -> None:
        """Take what has come."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def spin_for(self, duration_s: float) -> None:
        """Take what comes for a while: for asserting that something does not happen."""
        until_s = time.monotonic() + duration_s
        while time.monotonic() < until_s:
            self.spin_once()

    def wait(self, condition: Callable[[], Any], sentence: str,
             timeout_s: float = PATIENCE_S) -> Any:
        """Spin until a condition holds and give its value."""
        until_s = time.monotonic() + timeout_s
        while True:
            value = condition()
            if value:
                return value
            assert time.monotonic() < until_s, f'{sentence} (waited {timeout_s:.0f} s)'
            self.spin_once()

    def call(self, kind: type, name: str, request: Any = None,
             timeout_s: float = PATIENCE_S, again_s: float = ASK_AGAIN_S) -> Any:
        """
        Call a service and give its answer.

        Asks again after ``again_s``: a node that has just come up may not have found the
        caller yet, and the middleware then drops its first answer.

        """
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        self.wait(client.service_is_ready, f'no service {name}', timeout_s)
        request = kind.Request() if request is None else request
        futures, asked_s = [client.call_async(request)], time.monotonic()

        def answered() -> Any:
            nonlocal asked_s
            if time.monotonic() - asked_s > again_s:
                futures.append(client.call_async(request))
                asked_s = time.monotonic()
            return next((future for future in futures if future.done()), None)
        return self.wait(answered, f'no answer from {name}', timeout_s).result()

    def stamp(self) -> Any:
        """Give the time now as a message."""
        return self.node.get_clock().now().to_msg()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@contextmanager
def own_domain():
    """Take a ROS domain that no other test has, not even of a test run beside this one."""
    for number in itertools.islice(DOMAINS, 101):
        lock = socket.socket(socket.AF_UNIX)
        try:
            lock.bind(f'\0homography_servo_domain_{number}')  # a name without a file
        except OSError:
            lock.close()
            continue
        with lock:
            yield number
        return
    pytest.fail('every ROS domain is taken by another test')


@pytest.fixture
def domain():
    """Give the test a ROS domain of its own."""
    with own_domain() as number:
        yield number


@pytest.fixture
def probe(domain, monkeypatch):
    """Give a probe in the test's domain, reachable from this machine only."""
    pytest.importorskip('rclpy', reason='needs ROS 2')
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    made = Probe(domain)
    yield made
    made.close()


@pytest.fixture
def start_node(domain):
    """Give a function that starts a node by name, with parameters as keywords."""
    pytest.importorskip('rclpy', reason='needs ROS 2')
    started: list[NodeProcess] = []

    def start(name: str, *arguments: str, **parameters: Any) -> NodeProcess:
        words = [word for key, value in parameters.items()
                 for word in ('-p', f'{key}:={_yaml(value)}')]
        started.append(NodeProcess(name, domain, [*(['--ros-args', *words] if words else []),
                                                  *arguments]))
        return started[-1]

    yield start
    for node in started:
        node.kill()
        print(f'--- {node.name} printed:', *node.lines[-60:], sep='\n')  # seen after a failure


def _yaml(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return '[' + ', '.join(_yaml(item) for item in value) + ']'
    return {True: 'true', False: 'false'}[value] if isinstance(value, bool) else str(value)
