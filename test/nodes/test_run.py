"""How a process of nodes ends."""

import os
import signal
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

NODE = """
import time
from homography_servo.nodes.kit import NodeKit
from homography_servo.nodes.run import run_nodes
from rclpy.node import Node


class Slow(NodeKit, Node):

    def __init__(self):
        super().__init__('slow')
        self.every(0.01, lambda: None)
        self.every(0.2, lambda: print('up', flush=True))

    def on_signal(self):
        time.sleep(0.3)
        self.last_word = True

    def close(self):
        print('last word said:', hasattr(self, 'last_word'), flush=True)


raise SystemExit(run_nodes([Slow], [], ''))
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_last_word_is_said_before_the_node_is_destroyed(domain, number):
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain),
                   'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    with subprocess.Popen([sys.executable, '-c', NODE], env=environment, text=True,
                          stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == 'up\n'
        process.send_signal(number)
        printed, _ = process.communicate(timeout=20.0)
    assert process.returncode == 0
    assert printed.splitlines()[-1] == 'last word said: True'
