"""The executor of the nodes: everything is served, once, in the thread that spins."""

import threading
import time

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from homography_servo.nodes import executor as executor_module  # noqa: E402,I100
from homography_servo.nodes.executor import executor_for  # noqa: E402
from homography_servo.nodes.executor import PromptExecutor  # noqa: E402
from homography_servo.nodes.kit import DEFAULT  # noqa: E402
from homography_servo.nodes.kit import LATCHED  # noqa: E402
from homography_servo.nodes.quiet import make_quiet  # noqa: E402
from homography_servo.nodes.quiet import take_waiting  # noqa: E402
import rclpy  # noqa: E402
from rclpy.clock import Clock  # noqa: E402
from rclpy.clock import ClockType  # noqa: E402
from rclpy.event_handler import SubscriptionEventCallbacks  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402


@pytest.fixture
def served(probe, domain):
    """Give a node in this process with its executor."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain,
               signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node('served', context=context)
    yield node, executor_for(node)
    node.destroy_node()
    context.try_shutdown()


def until(executor, probe, condition, sentence='it does not come', timeout_s=20.0):
    """Spin the node and the probe in turn."""
    def both():
        executor.spin_once(timeout_sec=0.01)
        return condition()
    probe.wait(both, sentence, timeout_s)


def test_every_message_comes_once_and_in_order(served, probe):
    node, executor = served
    assert isinstance(executor, PromptExecutor)
    heard, threads = [], set()

    def take(msg):
        heard.append(msg.data)
        threads.add(threading.get_ident())
    everything = QoSProfile(depth=1000, reliability=DEFAULT.reliability)
    node.create_subscription(String, 'words', take, everything)
    publisher = probe.node.create_publisher(String, 'words', everything)
    until(executor, probe, lambda: publisher.get_subscription_count() == 1)
    for k in range(200):
        publisher.publish(String(data=str(k)))
        executor.spin_once(timeout_sec=0.005)
    until(executor, probe, lambda: len(heard) >= 200)
    assert heard == [str(k) for k in range(200)] and threads == {threading.get_ident()}


def test_a_quiet_subscription_wakes_nobody_and_keeps_what_comes(served, probe):
    node, executor = served
    heard, woken = [], []
    quiet = node.create_subscription(String, 'quiet', lambda msg: heard.append(msg.data), DEFAULT)
    node.create_subscription(String, 'loud', lambda msg: woken.append(msg.data), DEFAULT)
    make_quiet(quiet)
    publishers = [probe.node.create_publisher(String, name, DEFAULT) for name in ('quiet', 'loud')]
    until(executor, probe, lambda: all(item.get_subscription_count() for item in publishers))
    for _ in range(5):
        for publisher in publishers:
            publisher.publish(String(data='x'))
    until(executor, probe, lambda: len(woken) == 5)
    assert not heard

    def taken():
        take_waiting(quiet)
        return len(heard) == 5
    until(executor, probe, taken)
    node.destroy_subscription(quiet)
    take_waiting(quiet)
    assert len(heard) == 5


def test_timers_keep_their_period_and_can_be_cancelled(served):
    node, executor = served
    times_s = []
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    timer = node.create_timer(0.02, lambda: times_s.append(time.monotonic()), clock=clock)
    until_s = time.monotonic() + 0.5
    while time.monotonic() < until_s:
        executor.spin_once(timeout_sec=0.1)
    assert 5 <= len(times_s) <= 27
    timer.cancel()
    count = len(times_s)
    for _ in range(5):
        executor.spin_once(timeout_sec=0.03)
    assert len(times_s) == count


def test_a_service_answers_and_what_it_makes_is_served_too(served, probe):
    node, executor = served
    heard = []

    def answer(_, response):
        node.create_subscription(String, 'late', lambda msg: heard.append(msg.data), LATCHED)
        response.success, response.message = True, 'made'
        return response
    node.create_service(Trigger, 'make', answer)
    client = probe.node.create_client(Trigger, 'make')
    until(executor, probe, client.service_is_ready)
    future = client.call_async(Trigger.Request())
    until(executor, probe, future.done)
    assert future.result().message == 'made'
    probe.node.create_publisher(String, 'late', LATCHED).publish(String(data='here'))
    until(executor, probe, lambda: heard == ['here'])


def test_what_is_destroyed_in_a_callback_is_not_served(served, probe):
    node, executor = served
    heard, listeners = [], []

    def take(msg):
        heard.append(msg.data)
        for listener in listeners:
            node.destroy_subscription(listener)
        listeners.clear()
    for _ in range(2):
        listeners.append(node.create_subscription(String, 'words', take, DEFAULT))
    publisher = probe.node.create_publisher(String, 'words', DEFAULT)
    until(executor, probe, lambda: publisher.get_subscription_count() == 2)
    publisher.publish(String(data='once'))
    until(executor, probe, lambda: heard)
    for _ in range(10):
        executor.spin_once(timeout_sec=0.02)
    assert heard == ['once']


def test_a_timer_that_another_destroys_is_not_run(served):
    node, executor = served
    ran, timers = [], []

    def run():
        ran.append(1)
        for timer in timers:
            node.destroy_timer(timer)
        timers.clear()
    timers += [node.create_timer(0.01, run) for _ in range(2)]
    executor.spin_once(timeout_sec=0.0)  # both are waited for
    time.sleep(0.03)  # both are due
    for _ in range(5):
        executor.spin_once(timeout_sec=0.02)
    assert ran == [1]


def test_what_another_thread_destroys_may_be_waited_for(served, probe, monkeypatch):
    node, executor = served
    monkeypatch.setattr(executor_module, 'STATUS_PERIOD_S', 0.0)  # look at it every time
    publisher = probe.node.create_publisher(String, 'words', DEFAULT)
    ending, heard = threading.Event(), []

    def churn():
        while not ending.is_set():
            listener = node.create_subscription(String, 'words', heard.append, DEFAULT)
            time.sleep(0.001)
            node.destroy_subscription(listener)
    thread = threading.Thread(target=churn)
    thread.start()
    try:
        until_s = time.monotonic() + 2.0
        while time.monotonic() < until_s:
            publisher.publish(String(data='x'))
            executor.spin_once(timeout_sec=0.001)
    finally:
        ending.set()
        thread.join()


def test_another_thread_wakes_it(served):
    _, executor = served
    executor.spin_once(timeout_sec=0.0)
    threading.Timer(0.2, executor.wake).start()
    executor.spin_once(timeout_sec=0.0)
    began_s = time.monotonic()
    executor.spin_once(timeout_sec=1.0)
    assert time.monotonic() - began_s < 0.9


def test_mismatched_qualities_of_service_are_still_told(served, probe):
    node, executor = served
    told = []
    node.create_subscription(
        String, 'words', lambda msg: None, LATCHED,
        event_callbacks=SubscriptionEventCallbacks(incompatible_qos=told.append))
    probe.node.create_publisher(String, 'words', DEFAULT)  # volatile: these never meet
    until(executor, probe, lambda: told, 'nothing is told of the mismatch')
    assert told[0].total_count == 1


def test_a_callback_that_waits_for_something_is_a_clear_error(served):
    node, executor = served

    async def forever():
        await rclpy.task.Future()
    node.create_timer(0.01, forever)
    with pytest.raises(RuntimeError, match='awaits something'):
        for _ in range(100):
            executor.spin_once(timeout_sec=0.02)


def test_a_node_may_call_services_of_others(served, probe):
    node, executor = served

    def answer(_, response):
        response.message = 'yes'
        return response
    probe.node.create_service(Trigger, 'ask', answer)
    client = node.create_client(Trigger, 'ask')
    until(executor, probe, client.service_is_ready)
    probe.spin_for(0.3)  # an answer to somebody not yet known there is dropped
    future, followed = client.call_async(Trigger.Request()), []
    future.add_done_callback(lambda done: followed.append(done.result().message))
    until(executor, probe, lambda: followed)
    assert followed == ['yes'] and future.done()


def test_an_rclpy_that_is_made_otherwise_inside_is_served_its_own_way(served, monkeypatch):
    node, _ = served
    node.executor.remove_node(node)

    def missing(self):
        raise AttributeError('no such thing in this rclpy')
    monkeypatch.setattr(PromptExecutor, '_gather', missing)
    assert type(executor_for(node)) is SingleThreadedExecutor
