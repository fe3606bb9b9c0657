"""Nodes in one process tell each other everything once, and the outside as before."""

from functools import partial
import os
import signal
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from geometry_msgs.msg import PolygonStamped  # noqa: E402,I100
from geometry_msgs.msg import PoseWithCovarianceStamped  # noqa: E402
from homography_servo.nodes.conversions import stamp_text  # noqa: E402
from homography_servo.nodes.kit import DEFAULT  # noqa: E402
from homography_servo.nodes.kit import LATCHED  # noqa: E402
from homography_servo.nodes.local_topics import heard_twice  # noqa: E402
from homography_servo.nodes.local_topics import is_idle  # noqa: E402
from homography_servo.nodes.local_topics import LocalPublisher  # noqa: E402
from homography_servo.nodes.local_topics import LocalTopics  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

ROBOT = 'robix_rcs6.yaml'


def test_messages_wait_until_they_are_delivered_and_keep_their_order():
    topics, heard = LocalTopics(), []

    def answer(msg):
        heard.append(msg)
        if msg == 'one':
            topics.publish('/b', 'answer', latched=False)
    topics.listen('/a', answer, DEFAULT)
    topics.listen('/b', heard.append, DEFAULT)
    for word in ('one', 'two'):
        topics.publish('/a', word, latched=False)
    topics.publish('/nobody', 'lost', latched=False)
    assert heard == []
    topics.deliver()
    assert heard == ['one', 'two', 'answer']


class Onlooked:
    """A publisher of the middleware that somebody outside listens to."""

    def __init__(self, topic_name, order):
        self.topic_name, self._order = topic_name, order

    def publish(self, msg):
        self._order.append(msg)

    def get_subscription_count(self):
        return 1


def test_what_is_worked_on_inside_goes_out_after_what_comes_of_it():
    topics, order = LocalTopics(), []
    seen, done = (LocalPublisher(Onlooked(name, order), topics, DEFAULT)
                  for name in ('/seen', '/done'))
    topics.listen('/seen', lambda msg: done.publish('done'), DEFAULT)
    seen.publish('seen')
    assert order == []  # nothing goes out before it is handed over
    topics.deliver()
    assert order == ['done', 'seen']


def test_late_listeners_hear_what_is_latched():
    topics, late, other = LocalTopics(), [], []
    topics.publish('/state', 'old', latched=True)
    topics.publish('/state', 'new', latched=True)
    topics.publish('/word', 'gone', latched=False)
    topics.listen('/state', late.append, LATCHED)
    topics.listen('/state', other.append, DEFAULT)  # did not ask for it
    topics.listen('/word', late.append, LATCHED)
    topics.deliver()
    assert late == ['new'] and other == []


def test_it_counts_listeners_here_and_outside(probe):
    topics = LocalTopics()
    topics.listen('/words', lambda msg: None, DEFAULT)
    publisher = LocalPublisher(probe.node.create_publisher(String, '/words', DEFAULT), topics,
                               DEFAULT)
    assert publisher.get_subscription_count() == 1 and publisher.topic_name == '/words'
    probe.record(String, '/words', DEFAULT)
    probe.wait(lambda: publisher.get_subscription_count() == 2, 'nobody outside')


class Hearer:
    """A node that only subscribes."""

    def resolve_topic_name(self, topic):
        return f'/{topic}'

    def create_subscription(self, kind, topic, callback, qos):
        return SimpleNamespace(callback=callback)


def test_what_two_nodes_hear_from_outside_is_taken_once():
    topics, heard = LocalTopics(), []
    first, second, other, latched, again = (
        topics.subscribe(Hearer(), String, name, partial(lambda who, msg: heard.append(who), who),
                         qos)
        for who, name, qos in ((1, 'a', DEFAULT), (2, 'a', DEFAULT), (3, 'b', DEFAULT),
                               (4, 'c', LATCHED), (5, 'c', LATCHED)))
    assert [is_idle(item) for item in (first, second, other, latched, again)] == [
        False, True, False, False, False]  # what is latched is heard by each from the start
    first.callback('from outside')
    assert heard == [1, 2]
    topics.publish('/a', 'from inside', latched=False)
    topics.deliver()
    assert heard == [1, 2, 1, 2]


def test_it_is_noticed_where_the_middleware_would_deliver_a_second_time(probe):
    assert heard_twice(probe.node)  # the probe has no profile of ours


def test_the_chain_measures_every_image_once(probe, start_node):
    corners = probe.record(PolygonStamped, 'object/corners')
    poses = probe.record(PoseWithCovarianceStamped, 'object/pose')
    states = {name: probe.record(String, f'{name}/state', LATCHED)
              for name in ('snake_tracker', 'visual_servo')}
    chain = start_node('servo_chain', '--ros-args', '-p', 'snake_tracker:box_height_m:=0.04')
    start_node('robix_bridge', robot_file=ROBOT, port='fake')
    start_node('camera_sim', robot_file=ROBOT)
    probe.wait(lambda: len(poses) >= 30, 'no poses')
    probe.wait(lambda: all(states.values()), 'a node does not tell its state')
    assert states['snake_tracker'][-1].data == 'TRACKING'
    for messages in (corners, poses):
        stamps = [stamp_text(msg.header.stamp) for msg in messages]
        assert len(set(stamps)) == len(stamps)
    # From outside each node is there with its services, as if it ran for itself.
    for service in ('snake_tracker/reset', 'path_planner/plan', 'visual_servo/stop'):
        assert probe.call(Trigger, service).message
    assert chain.stop() == 0


def test_the_chain_refuses_a_middleware_that_delivers_twice(start_node, tmp_path, monkeypatch):
    profile = tmp_path / 'own.xml'
    profile.write_text('<profiles xmlns="http://www.eprosima.com"></profiles>')
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
    chain = start_node('servo_chain')
    assert chain.wait() == 2
    assert 'hears its own messages twice' in chain.output and str(profile) in chain.output


def test_a_signal_ends_the_whole_chain(start_node, probe):
    states = probe.record(String, 'visual_servo/state', LATCHED)
    chain = start_node('servo_chain')
    probe.wait(lambda: states, 'no state')
    os.kill(chain.process.pid, signal.SIGTERM)
    assert chain.wait(10.0) == 0
