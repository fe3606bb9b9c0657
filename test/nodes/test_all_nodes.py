"""What holds for every node: help, parameters, diagnostics, signals."""

import os
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from homography_servo.launch.registry import NODES
from homography_servo.launch.registry import settings_types
from homography_servo.settings import rules_of
import pytest
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters
from rcl_interfaces.srv import GetParameters

EXIT_S = 1.0
SLACK_S = 1.5  # the machine that runs the tests may be busy with others


@pytest.fixture
def quiet_arguments(tmp_path):
    """Give parameters with which each node starts without hardware."""
    import cv2
    import numpy as np
    video = tmp_path / 'endless.avi'
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*'MJPG'), 30.0, (64, 48))
    for level in range(10):
        writer.write(np.full((48, 64, 3), 20 * level, np.uint8))
    writer.release()
    return {'video_camera': {'source': str(video), 'loop': True}, 'dashboard': {'port': 0}}


def rules(name):
    """Give the rules of all parameters of a node."""
    return {key: rule for kind in settings_types(name) for key, rule in rules_of(kind).items()}


@pytest.mark.parametrize('name', NODES)
def test_help_tells_what_it_does_with_an_example(name, start_node):
    node = start_node(name, '--help')
    assert node.wait() == 0
    assert 'Example:' in node.output and f'homography_servo {name}' in node.output
    assert all(key in node.output for key in rules(name))


@pytest.mark.parametrize('name', NODES)
def test_unknown_and_bad_parameters_end_with_code_2_and_a_sentence(name, start_node):
    unknown = start_node(name, no_such_thing=1)
    assert unknown.wait() == 2
    assert 'no_such_thing' in unknown.output and 'Traceback' not in unknown.output
    key, rule = next((k, r) for k, r in rules(name).items() if r.kind == 'real')
    bad = start_node(name, **{key: rule.high * 2.0 + 1e9})
    assert bad.wait() == 2
    assert key in bad.output and 'Traceback' not in bad.output


@pytest.mark.parametrize('name', NODES)
def test_parameters_describe_themselves_and_two_signals_end_it_in_peace(
        name, start_node, probe, quiet_arguments):
    heard = probe.record(DiagnosticArray, '/diagnostics')
    node = start_node(name, **quiet_arguments.get(name, {}))
    expected = rules(name)
    answer = probe.call(DescribeParameters, f'{name}/describe_parameters',
                        DescribeParameters.Request(names=list(expected)))
    for (key, rule), said in zip(expected.items(), answer.descriptors):
        assert said.description == rule.description and said.read_only == rule.read_only, key
        if rule.kind == 'real':
            assert said.floating_point_range[0].to_value == rule.high
    values = probe.call(GetParameters, f'{name}/get_parameters',
                        GetParameters.Request(names=list(expected)))
    assert all(value.type != ParameterType.PARAMETER_NOT_SET or rule.kind in ('reals', 'texts')
               for value, rule in zip(values.values, expected.values()))
    mine = probe.wait(lambda: [status for msg in heard for status in msg.status
                               if status.name.startswith(f'{name}: ')], 'no diagnostics')
    assert all(status.message for status in mine)
    began_s = time.monotonic()
    node.signal(signal.SIGINT)
    node.signal(signal.SIGTERM)
    assert node.wait() == 0, node.output
    assert time.monotonic() - began_s < EXIT_S + SLACK_S
    assert 'Traceback' not in node.output


def test_nodes_work_in_a_namespace(start_node, probe):
    start_node('path_planner', '--ros-args', '-r', '__ns:=/cell/left')
    probe.wait(lambda: any(topic == '/cell/left/object/pose'
                           for topic, _ in probe.node.get_topic_names_and_types()),
               'object/pose is not in the namespace')


def test_a_node_ends_when_its_launcher_is_gone(start_node, monkeypatch):
    monkeypatch.setenv('HOMOGRAPHY_SERVO_LAUNCHER', str(os.getpid() + 1))
    assert start_node('path_planner').wait() == 1
