"""Stamps decide which pictures are news."""

from homography_servo.result import Rejected
from homography_servo.tracking.frame_order import FrameOrder
import pytest


def accepted(stamps):
    order = FrameOrder()
    return [stamp for stamp in stamps if not isinstance(order.accept(stamp), Rejected)]


def test_a_clean_stream_passes_unchanged():
    stamps = [100.0 + 0.033 * index for index in range(30)]
    assert accepted(stamps) == stamps


@pytest.mark.parametrize('extra', [100.1, 100.05, 100.0, 0.0, -1.0, 3700.0, 1.0])
def test_one_bad_stamp_changes_nothing(extra):
    assert accepted([100.0, 100.1, extra, 100.2, 100.3]) == [100.0, 100.1, 100.2, 100.3]


@pytest.mark.parametrize('jump', [3600.0, -3600.0])
def test_a_clock_that_jumped_is_believed_from_the_second_picture(jump):
    start = 5000.0
    stamps = [start, start + 0.1, start + jump, start + jump + 0.1, start + jump + 0.2]
    assert accepted(stamps) == stamps[:2] + stamps[3:]


def test_a_pause_is_no_jump():
    assert accepted([100.0, 105.0]) == [100.0, 105.0]


def test_a_camera_that_never_stamps_still_works():
    order = FrameOrder()
    times = [order.accept(0.0) for _ in range(4)]
    assert times == pytest.approx([(index + 1) / 30.0 for index in range(4)])
