"""The progress of the servo survives its message; nonsense in it is nothing known."""

import math

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')

from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402,I100
from diagnostic_msgs.msg import KeyValue  # noqa: E402
from homography_servo.nodes.kit import OK  # noqa: E402
from homography_servo.nodes.progress import number  # noqa: E402
from homography_servo.nodes.progress import progress_from_msg  # noqa: E402
from homography_servo.nodes.progress import progress_msg  # noqa: E402
from homography_servo.planning.servo_state import Progress  # noqa: E402


def test_the_message_says_all_of_it():
    progress = Progress(3, 31, True, 0.00125, 0.25, 2, 5, 0.5)
    msg = progress_msg('visual_servo: progress', OK, 'MOVING', progress)
    assert (msg.name, msg.message) == ('visual_servo: progress', 'MOVING')
    assert {pair.key: pair.value for pair in msg.values}['reached'] == 'true'
    assert progress_from_msg(msg) == progress


def test_nonsense_is_nothing_known():
    odd = {'pose': 'x', 'of': 'nan', 'reached': '1', 'position_error_m': 'inf', 'looks': '-',
           '': ''}
    msg = DiagnosticStatus(values=[KeyValue(key=key, value=odd[key]) for key in odd])
    read = progress_from_msg(msg)
    assert read[:3] == (0, 0, False) and (read.iterations, read.looks) == (0, 0)
    assert math.isnan(read.position_error_m) and math.isnan(read.sure)


@pytest.mark.parametrize('text, value', [
    ('1.5', 1.5), ('nan', None), ('inf', None), ('three', None), ('', None), (None, None)])
def test_numbers_are_read_or_left_out(text, value):
    assert number(text) == value
