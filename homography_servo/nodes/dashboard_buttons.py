"""The buttons of the dashboard: which services each calls, and their answers."""

from __future__ import annotations

import asyncio
from typing import Any, NamedTuple

from homography_servo.nodes.dashboard_facts import sentence_of
from homography_servo.nodes.dashboard_server import Answer
from rclpy.node import Node
from std_srvs.srv import SetBool
from std_srvs.srv import Trigger


class Call(NamedTuple):
    """One service that a button calls, with its request's value for SetBool."""

    service: str
    value: bool | None = None


BUTTONS = {
    'teach_goal': (Call('path_planner/teach_goal'),),
    'plan': (Call('path_planner/plan'),),
    'start': (Call('visual_servo/start'),),
    'pause': (Call('visual_servo/pause', True),),
    'go_on': (Call('visual_servo/pause', False),),
    # Both at once: the arm stops even where one of the two is gone or stuck.
    'stop': (Call('robix_bridge/stop'), Call('visual_servo/stop')),
    'reset_arm': (Call('robix_bridge/reset'),),
}
PATIENCE_S = {'plan': 60.0}
SHORT_PATIENCE_S = 5.0


class Buttons:
    """
    Calls the services of other nodes from the web server's thread.

    The requests go out in the caller's thread, without waiting for the node's
    executor; rclpy guards its clients with a lock.
    """

    def __init__(self, node: Node) -> None:
        self._clients = {
            call.service: node.create_client(Trigger if call.value is None else SetBool,
                                             call.service)
            for calls in BUTTONS.values() for call in calls}

    async def press(self, name: str) -> Answer:
        """Do what a button says; every service is asked before any answer is awaited."""
        patience_s = PATIENCE_S.get(name, SHORT_PATIENCE_S)
        asked = [(call, self._ask(call)) for call in BUTTONS[name]]
        answers = await asyncio.gather(*(self._answer(call, future, patience_s)
                                         for call, future in asked))
        return Answer(*sentence_of(answers))

    def _ask(self, call: Call) -> Any:
        client = self._clients[call.service]
        if not client.service_is_ready():
            return None
        request = client.srv_type.Request()
        if call.value is not None:
            request.data = call.value
        return client.call_async(request)

    async def _answer(self, call: Call, future: Any, patience_s: float) -> tuple[str, bool, str]:
        node = call.service.partition('/')[0]
        if future is None:
            return node, False, 'is not there'
        try:
            result = await asyncio.wait_for(_awaitable(future), patience_s)
        except asyncio.TimeoutError:
            self._clients[call.service].remove_pending_request(future)
            return node, False, f'no answer within {patience_s:.0f} s'
        return node, bool(result.success), str(result.message)


def _awaitable(ros_future: Any) -> asyncio.Future:
    """Turn a future of rclpy, done in another thread, into one of this loop."""
    loop = asyncio.get_running_loop()
    waiting = loop.create_future()

    def pass_on(done: Any) -> None:
        try:
            loop.call_soon_threadsafe(_settle, waiting, done)
        except RuntimeError:  # the loop has ended: nobody waits any more
            pass

    ros_future.add_done_callback(pass_on)
    return waiting


def _settle(waiting: asyncio.Future, done: Any) -> None:
    if waiting.done():
        return
    if done.exception() is not None:
        waiting.set_exception(done.exception())
    else:
        waiting.set_result(done.result())
