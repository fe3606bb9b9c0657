"""
What all nodes share: guarded callbacks, steady timers, counters, diagnostics.

No data may end a process: an exception in a callback is counted, logged at most
once a second per kind, and handed to `NodeKit.on_fault`.
"""

from __future__ import annotations

from collections import Counter
import functools
import time
from typing import Any, Callable, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from homography_servo.nodes.local_topics import is_idle
from homography_servo.nodes.local_topics import LocalPublisher
from homography_servo.nodes.local_topics import LocalTopics
from homography_servo.nodes.quiet import make_quiet
from homography_servo.nodes.quiet import take_waiting
from rclpy.clock import Clock
from rclpy.clock import ClockType
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
COMMANDS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEFAULT = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
COMPLAINT_PERIOD_S = 1.0
QUIET_PERIOD_S = 0.2


SHORT = QoSProfile(depth=3, reliability=ReliabilityPolicy.RELIABLE)  # old ones are no use


def images_qos(reliable: bool) -> QoSProfile:
    """Give the quality of service of images: depth 5, best effort unless asked."""
    policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=5, reliability=policy)


def newest_image_qos(reliable: bool) -> QoSProfile:
    """Take the newest image only, for a slow listener must not work on old ones, or all."""
    if reliable:
        return images_qos(True)
    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Health(NamedTuple):
    """One part of a node for ``/diagnostics``."""

    part: str
    level: bytes
    message: str
    values: dict[str, Any] = {}


class NodeKit:
    """
    Mixed into a node class; call `start_kit` at the end of ``__init__``.

    A subclass sets ``NAME``, ``SETTINGS`` (settings classes) and ``EXAMPLE``, maybe
    ``CARRIES_IMAGES``, and may override `diagnose`, `on_fault`, `on_signal` and `close`.
    """

    NAME = ''
    CARRIES_IMAGES = False  # over shared memory; all else goes by UDP
    SETTINGS: tuple = ()
    exit_code: int | None = None
    local: LocalTopics | None = None  # shared with other nodes of the same process

    @functools.cached_property
    def counts(self) -> Counter:
        """Give the counters that go into the diagnostics."""
        return Counter()

    @functools.cached_property
    def _complained_s(self) -> dict[str, float]:
        return {}

    def start_kit(self) -> None:
        """Begin to publish diagnostics."""
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', DEFAULT)
        self.every(1.0, self._publish_diagnostics)

    def on_finish(self) -> None:
        """Wake the spin loop; replaced by the process that runs the node."""

    def diagnose(self) -> list[Health]:
        """List the health of the node's parts; override."""
        return []

    def on_fault(self, error: Exception) -> None:
        """Bring the node into a safe state after a callback failed; override."""

    def on_signal(self) -> None:
        """Act at once on SIGINT or SIGTERM, from another thread; override."""

    def close(self) -> None:
        """Release what the node holds, before it is destroyed; override."""

    def finish(self, code: int) -> None:
        """End the process with an exit code."""
        self.exit_code = code
        self.on_finish()

    def listen(self, kind: type, topic: str, callback: Callable, qos: Any = DEFAULT,
               raw: bool = False) -> Any:
        """Subscribe with a guarded callback."""
        guarded = self.guarded(callback)
        if self.local is not None and not raw:
            return self.local.subscribe(self, kind, topic, guarded, qos)
        return self.create_subscription(kind, topic, guarded, qos, raw=raw)

    def listen_quietly(self, kind: type, topic: str, callback: Callable, qos: Any = DEFAULT
                       ) -> Callable[[], None]:
        """
        Subscribe without being woken.

        The callback hears all that has come when the returned function is called, and a
        few times a second.
        """
        subscription = self.listen(kind, topic, callback, qos)
        if is_idle(subscription):
            return lambda: None
        make_quiet(subscription)
        take = functools.partial(take_waiting, subscription)
        self.every(QUIET_PERIOD_S, take)
        return take

    def create_publisher(self, kind: type, topic: str, qos: Any, **kwargs: Any) -> Any:
        """Make a publisher, which also reaches the other nodes of the process."""
        publisher = super().create_publisher(kind, topic, qos, **kwargs)
        return publisher if self.local is None else LocalPublisher(publisher, self.local, qos)

    def serve(self, kind: type, name: str, callback: Callable[[Any], tuple[bool, str]]) -> Any:
        """Offer a Trigger or SetBool service; the callback gives success and sentence."""
        def answer(request: Any, response: Any) -> Any:
            try:
                response.success, response.message = callback(request)
            except Exception as error:  # an operator must always get an answer
                self.failed(callback, error)
                response.success, response.message = False, f'internal error: {error}'
            return response
        return self.create_service(kind, name, answer)

    def every(self, period_s: float, callback: Callable[[], None]) -> Any:
        """Call a function periodically by the steady clock, whatever ROS time does."""
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        return self.create_timer(period_s, self.guarded(callback), clock=clock)

    def latched(self, kind: type, topic: str) -> Any:
        """Make a publisher whose last message reaches late subscribers."""
        return self.create_publisher(kind, topic, LATCHED)

    def guarded(self, callback: Callable) -> Callable:
        """Wrap a callback so that no exception leaves it."""
        @functools.wraps(callback)
        def guard(*args: Any) -> None:
            try:
                callback(*args)
            except Exception as error:  # an exception here would end spin()
                self.failed(callback, error)
        return guard

    def age_s(self, header: Any) -> float:
        """Give the age of the stamp of a message by the clock of the node."""
        now = self.get_clock().now().nanoseconds
        return 1e-9 * (now - 1_000_000_000 * header.stamp.sec - header.stamp.nanosec)

    def count(self, what: str, number: int = 1) -> None:
        """Add to a counter shown in the diagnostics."""
        self.counts[what] += number

    def complain(self, sentence: str, key: str = '') -> None:
        """Log a warning, at most once a second for the same key."""
        now_s = time.monotonic()
        if now_s - self._complained_s.get(key or sentence, -COMPLAINT_PERIOD_S) \
                >= COMPLAINT_PERIOD_S:
            if len(self._complained_s) > 1000:  # sentences with numbers must not pile up
                self._complained_s.clear()
            self._complained_s[key or sentence] = now_s
            self.get_logger().warning(sentence)

    def reject(self, what: str, reason: str) -> None:
        """Count bad input and say why it was left out."""
        self.count(f'rejected_{what}')
        self.complain(f'{what} ignored: {reason}', key=what)

    def failed(self, callback: Callable, error: Exception) -> None:
        """Count and tell an exception, and let the node react."""
        name = getattr(callback, '__name__', 'callback')
        self.count('internal_errors')
        self.complain(f'{name} failed: {type(error).__name__}: {error}', key=name)
        self.on_fault(error)

    def _publish_diagnostics(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        counted = Health('counters', WARN if self.counts['internal_errors'] else OK,
                         'counts since start', dict(self.counts))
        message.status = [status_msg(self.get_name(), item)
                          for item in [*self.diagnose(), counted]]
        self._diagnostics.publish(message)


def status_msg(node_name: str, health: Health) -> DiagnosticStatus:
    """Turn the health of one part into a message."""
    values = [KeyValue(key=str(k), value=shown(v)) for k, v in health.values.items()]
    return DiagnosticStatus(name=f'{node_name}: {health.part}', level=health.level,
                            message=health.message, hardware_id=node_name, values=values)


def shown(value: Any) -> str:
    """Write a value of a status as a person, or a program, reads it."""
    if isinstance(value, bool):
        return 'true' if value else 'false'
    return f'{value:.6g}' if isinstance(value, float) else str(value)
