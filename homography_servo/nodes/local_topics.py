"""
What nodes in one process tell each other, without the middleware.

Between processes a message costs its writer 0.16 ms and every reader 0.25 ms of processor
time, and half a millisecond on the way. In one process it is handed over by reference
when the callback that published it has ended. To everybody outside nothing changes, but
what is worked on inside goes out after that: a command is not kept waiting for onlookers.
What several of the nodes hear from outside is taken once and handed to each.

The middleware must not deliver such a message a second time; our profiles of Fast DDS
see to that, and `heard_twice` finds out.
"""

from __future__ import annotations

from collections import deque
import time
from typing import Any, Callable

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import Empty

MATCHED_WITHIN_S = 0.3
_IDLE = 'taken_by_another_node'


def is_latched(qos: QoSProfile | int) -> bool:
    """Tell whether late listeners hear the last message."""
    return getattr(qos, 'durability', None) == DurabilityPolicy.TRANSIENT_LOCAL


def is_idle(subscription: Any) -> bool:
    """Tell whether what a subscription would hear is taken by another one."""
    return getattr(subscription, _IDLE, False)


class LocalTopics:
    """The topics of one process; everything happens in the thread that spins."""

    def __init__(self) -> None:
        self._listeners: dict[str, list[Callable[[Any], None]]] = {}
        self._latched: dict[str, Any] = {}
        self._waiting: deque[tuple[Callable[[Any], None], Any]] = deque()
        self._outside: deque[tuple[Callable[[Any], None], Any]] = deque()
        self._heard: dict[tuple, list[Callable[[Any], None]]] = {}

    def listen(self, topic: str, callback: Callable[[Any], None], qos: QoSProfile | int) -> None:
        """Have messages of a topic (its full name) handed over from now on."""
        self._listeners.setdefault(topic, []).append(callback)
        if is_latched(qos) and topic in self._latched:
            self._waiting.append((callback, self._latched[topic]))

    def subscribe(self, node: Node, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile | int) -> Subscription:
        """
        Subscribe a node to a topic of this process and of others.

        Where another node of the process hears the same, its messages are handed on: the
        subscription is there for the graph of nodes only, and idle (`is_idle`).
        """
        full = node.resolve_topic_name(topic)
        self.listen(full, callback, qos)
        if not isinstance(qos, QoSProfile) or is_latched(qos):
            return node.create_subscription(kind, topic, callback, qos)
        heard = self._heard.setdefault((full, kind, qos.depth, qos.reliability), [])
        heard.append(callback)
        if len(heard) == 1:
            return node.create_subscription(kind, topic, _in_turn(heard), qos)
        subscription = node.create_subscription(kind, topic, callback, qos)
        setattr(subscription, _IDLE, True)
        return subscription

    def publish(self, topic: str, msg: Any, latched: bool) -> None:
        """Leave a message, which nobody may change any more, for every listener."""
        if latched:
            self._latched[topic] = msg
        self._waiting.extend((callback, msg) for callback in self._listeners.get(topic, ()))

    def count(self, topic: str) -> int:
        """Give the number of listeners."""
        return len(self._listeners.get(topic, ()))

    def publish_later(self, publish: Callable[[Any], None], msg: Any) -> None:
        """Publish to the outside when everything has been handed over inside."""
        self._outside.append((publish, msg))

    def deliver(self) -> None:
        """Hand over what waits, in order, and what is published on the way."""
        while self._waiting or self._outside:
            take, msg = (self._waiting or self._outside).popleft()
            take(msg)


def _in_turn(callbacks: list[Callable[[Any], None]]) -> Callable[[Any], None]:
    def take(msg: Any) -> None:
        for callback in callbacks:
            callback(msg)
    return take


class LocalPublisher:
    """A publisher that serves the listeners of its own process, too."""

    def __init__(self, publisher: Any, topics: LocalTopics, qos: QoSProfile | int) -> None:
        self._publisher, self._topics = publisher, topics
        self._topic, self._latched = publisher.topic_name, is_latched(qos)

    def publish(self, msg: Any) -> None:
        """Publish, to the outside only where somebody listens."""
        self._topics.publish(self._topic, msg, self._latched)
        if not (self._latched or self._publisher.get_subscription_count()):
            return
        if self._topics.count(self._topic):
            self._topics.publish_later(self._publisher.publish, msg)
        else:
            self._publisher.publish(msg)

    def get_subscription_count(self) -> int:
        """Count the listeners in this process and outside."""
        return self._publisher.get_subscription_count() + self._topics.count(self._topic)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._publisher, name)


def heard_twice(node: Node) -> bool:
    """Tell whether the middleware also carries what a process tells itself."""
    publisher = Node.create_publisher(node, Empty, '~/told_to_itself', 1)
    listener = Node.create_subscription(node, Empty, '~/told_to_itself', lambda msg: None, 1)
    until_s = time.monotonic() + MATCHED_WITHIN_S
    while not publisher.get_subscription_count() and time.monotonic() < until_s:
        time.sleep(0.01)
    heard = publisher.get_subscription_count() > 0
    node.destroy_subscription(listener)
    node.destroy_publisher(publisher)
    return heard
