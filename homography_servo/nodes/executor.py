"""
Serve one node from one thread, with little between a message and its callback.

For every message rclpy's SingleThreadedExecutor builds a wait set from all that a node
has, some fifty things here, and wakes itself twice: about 0.9 ms of processor time. At
120 images a second that is more than one of two cores for the whole chain.
`PromptExecutor` keeps one wait set and fills it with what carries data or time; what
only tells of the state of the middleware (mismatched qualities of service) is looked at
once a second. ``benchmark latency`` measures what that is worth.
"""

from __future__ import annotations

from contextlib import ExitStack
import time
from typing import Any, Callable, Coroutine, Sequence

from homography_servo.nodes.local_topics import is_idle
from homography_servo.nodes.quiet import is_quiet
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Task

STATUS_PERIOD_S = 1.0


class PromptExecutor(SingleThreadedExecutor):
    """
    An executor for some nodes of one process.

    Everything runs in the thread that calls `spin_once`; other threads may call `wake`.

    Parameters
    ----------
    nodes : sequence of Node
        What to serve; they may make and destroy publishers and subscriptions at any time.
    after : callable, optional
        Called after every callback.

    """

    def __init__(self, nodes: Sequence[Node], after: Callable[[], None] | None = None) -> None:
        super().__init__(context=nodes[0].context)
        self._served, self._after = nodes, after
        self._stale = True
        self._status_due_s = 0.0
        self._wait_set: Any = None
        self._waited_for: list[tuple[Callable, Any]] = []
        self._held = ExitStack()
        self._takers: dict[str, dict[int, tuple[Callable, Any]]] = {}
        for node in nodes:
            self.add_node(node)
        self._gather()

    def wake(self) -> None:
        """Return from waiting; rclpy calls this when the node has something new, too."""
        self._stale = True
        super().wake()

    def remove_node(self, node: Node) -> None:
        """Serve the node no longer; it may be destroyed then."""
        super().remove_node(node)
        self._held.close()

    def create_task(self, callback: Callable, *args: Any, **kwargs: Any) -> Task:
        """Run at once what follows the answer of a service."""
        task = Task(callback, args, kwargs)
        task()
        return task

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait until something is there, at most for a time, and run all of it once."""
        if self._stale:
            self._gather()
        now_s = time.monotonic()
        if now_s >= self._status_due_s:
            self._status_due_s = now_s + STATUS_PERIOD_S
            self._take_status()
        longest_s = STATUS_PERIOD_S if timeout_sec is None else min(timeout_sec, STATUS_PERIOD_S)
        for take, entity in self._ready(longest_s):
            _run(take, entity)
            if self._after is not None:
                self._after()

    def _gather(self) -> None:
        """List what the node has now."""
        self._stale = False
        kinds: tuple[tuple[str, str, Callable], ...] = (
            ('service', 'services', self._take_service),
            ('client', 'clients', self._take_client),
            ('timer', 'timers', self._take_due_timer),
            ('subscription', 'subscriptions', self._take_subscription),
            ('guard_condition', 'guards', self._take_guard_condition))
        entities = {kind: [(item, take) for node in self._served for item in getattr(node, listed)
                           if not is_idle(item) and not is_quiet(item)]
                    for kind, listed, take in kinds}
        own = [self._guard.handle, self._sigint_gc.handle]
        self._wait_set = waiting = rclpy_implementation.WaitSet(
            len(entities['subscription']), len(entities['guard_condition']) + len(own),
            len(entities['timer']), len(entities['client']), len(entities['service']), 0,
            self._context.handle)
        self._waited_for = [(waiting.add_guard_condition, handle) for handle in own]
        self._takers = {kind: {} for kind in entities}
        # Handles are held, or another thread might destroy what is being waited for.
        before, self._held = self._held, ExitStack()
        for kind, pairs in entities.items():
            for item, take in pairs:
                if _succeeds(self._held.enter_context, item.handle):
                    self._waited_for.append((getattr(waiting, f'add_{kind}'), item.handle))
                    self._takers[kind][item.handle.pointer] = take, item
        before.close()

    def _ready(self, timeout_s: float) -> list[tuple[Callable, Any]]:
        """Wait, and list what is ready with how to take it: services and timers first."""
        waiting = self._wait_set
        waiting.clear_entities()
        for add, handle in self._waited_for:
            add(handle)
        waiting.wait(max(int(1e9 * timeout_s), 0))
        if not self._context.ok():
            raise ExternalShutdownException()
        return [takers[pointer] for kind, takers in self._takers.items()
                for pointer in waiting.get_ready_entities(kind) if pointer in takers]

    def _take_due_timer(self, timer: Any) -> Callable | None:
        # A timer that was cancelled or reset by a callback before it is not due any more.
        with timer.handle:
            return self._take_timer(timer) if timer.handle.is_timer_ready() else None

    def _take_status(self) -> None:
        """Run what tells of the state of the middleware."""
        waitables = [item for node in self._served for item in node.waitables]
        with ExitStack() as held:
            waitables = [item for item in waitables if _succeeds(held.enter_context, item)]
            waiting = rclpy_implementation.WaitSet(0, 0, 0, 0, 0, len(waitables),
                                                   self._context.handle)
            waiting.clear_entities()
            waitables = [item for item in waitables if _succeeds(item.add_to_wait_set, waiting)]
            if not waitables:
                return
            waiting.wait(0)
            for waitable in waitables:
                if waitable.is_ready(waiting):
                    _run(self._take_waitable, waitable)


def executor_for(node: Node) -> SingleThreadedExecutor:
    """Give the prompt executor where it can be used, else the one of rclpy."""
    try:
        return PromptExecutor([node])
    except (AttributeError, TypeError):  # an rclpy that is made otherwise inside
        pass
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    return executor


def _succeeds(use: Callable[[Any], Any], argument: Any) -> bool:
    """Use something that another thread may destroy; False where it just has."""
    try:
        use(argument)
    except InvalidHandle:
        return False
    return True


def _run(take: Callable[[Any], Callable[[], Coroutine] | None], entity: Any) -> None:
    """Take what is there for an entity and run its callback to the end; ours never wait."""
    try:
        begin = take(entity)
        if begin is None:
            return
        begin().send(None)
    except StopIteration:
        return
    except InvalidHandle:  # destroyed by a callback that ran before
        return
    raise RuntimeError('a callback of a node awaits something, which it must not')
