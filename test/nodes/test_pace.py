"""Rates and latencies for the diagnostics."""

from homography_servo.nodes.pace import Pace
import pytest


def test_rate_and_latency_are_of_the_last_seconds():
    pace = Pace('pose')
    for k in range(100):  # slow and late at first, then at 50 Hz with 10 ms
        pace.note(0.1 * k, 0.5)
    for k in range(250):
        pace.note(20.0 + 0.02 * k, 0.01 if k % 50 else 0.03)
    facts = pace.facts(25.0)
    assert facts['pose_rate_hz'] == pytest.approx(50.0)
    assert facts['pose_latency_ms'] == pytest.approx(10.0)
    assert facts['pose_latency_p99_ms'] == pytest.approx(30.0)


def test_nothing_is_said_of_nothing():
    pace = Pace('pose')
    assert pace.facts(0.0) == {}
    pace.note(0.0, 0.01)
    pace.note(0.1, 0.01)
    assert pace.facts(0.2) and pace.facts(60.0) == {}


def test_stamps_of_another_clock_give_no_latency():
    pace = Pace('corners')
    for k in range(10):
        pace.note(0.1 * k, 1.7e9 if k % 2 else -3600.0)
    assert set(pace.facts(1.0)) == {'corners_rate_hz'}
