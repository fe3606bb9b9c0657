"""The RViz configuration and the Foxglove layout show what the nodes really publish."""

import json
import re

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from homography_servo.nodes.kit import LATCHED  # noqa: E402,I100
from homography_servo.places import find_config  # noqa: E402
import yaml  # noqa: E402

NODES = ('snake_tracker', 'path_planner', 'visual_servo', 'robix_bridge')
LATCHED_TOPICS = ('/robot_description', '/path/markers')
FROM_CAMERA = '/camera_info'
TYPES = {  # what each display or panel can show
    'RobotModel': 'std_msgs/msg/String', 'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
    'PoseArray': 'geometry_msgs/msg/PoseArray', 'Image': 'sensor_msgs/msg/Image'}


@pytest.fixture
def graph(probe, start_node):
    """Give topics and services of the running nodes, each with its type."""
    for name in NODES:
        start_node(name)
    probe.wait(lambda: set(NODES) <= set(probe.node.get_node_names()) and
               probe.node.count_publishers('/path/image_markers') and
               probe.node.count_publishers('/visual_servo/progress') and
               probe.node.count_publishers('/robot_description') and
               probe.node.count_publishers('/snake_tracker/annotated_image') and
               {'/robix_bridge/stop', '/visual_servo/pause', '/path_planner/plan'} <=
               {name for name, _ in probe.node.get_service_names_and_types()},
               'nodes are missing')
    return (dict(probe.node.get_topic_names_and_types()),
            dict(probe.node.get_service_names_and_types()))


def displays():
    """List class and topic of every display of the RViz configuration that has one."""
    text = find_config('servo.rviz').read_text()
    for display in yaml.safe_load(text)['Visualization Manager']['Displays']:
        topic = display.get('Topic') or display.get('Description Topic')
        if topic:
            yield display['Class'].rpartition('/')[2], topic


def panels():
    """Give the panels of the Foxglove layout by name."""
    return json.loads(find_config('foxglove_layout.json').read_text())['configById']


def test_every_display_has_its_topic_and_type(graph, probe):
    topics, services = graph
    for kind, topic in displays():
        assert topics[topic['Value']] == [TYPES[kind]], topic
        offered = probe.node.get_publishers_info_by_topic(topic['Value'])[0].qos_profile
        wanted = topic['Reliability Policy'], topic['Durability Policy']
        if topic['Value'] in LATCHED_TOPICS:
            assert offered.durability == LATCHED.durability
            assert wanted == ('Reliable', 'Transient Local')
        else:  # a listener that asks for more than is offered hears nothing
            assert wanted[1] == 'Volatile'
            assert wanted[0] == 'Best Effort' or offered.reliability.name == 'RELIABLE'
    for name, panel in panels().items():
        kind = name.partition('!')[0]
        if kind == 'CallService':
            assert panel['serviceName'] in services
            assert json.loads(panel['requestPayload']) in ({}, {'data': True})
        for topic in named_topics(kind, panel):
            assert topic in topics, (name, topic)


def named_topics(kind, panel):
    """List the topics that a panel of the Foxglove layout shows."""
    if kind == 'Plot':
        return {re.match(r'[\w/]+', path['value']).group() for path in panel['paths']}
    if kind == '3D':
        return {*panel['topics'], panel['layers']['arm']['topic']}
    if kind == 'Image':
        mode = panel['imageMode']
        assert mode['calibrationTopic'] == FROM_CAMERA
        return {mode['imageTopic'], *mode['annotations']}
    return {panel[key] for key in ('topicToRender', 'topicPath') if key in panel}


def test_every_panel_has_its_place():
    def leaves(node):
        if isinstance(node, str):
            return [node]
        return leaves(node['first']) + leaves(node['second'])
    layout = json.loads(find_config('foxglove_layout.json').read_text())
    assert sorted(leaves(layout['layout'])) == sorted(layout['configById'])
