"""Laws of the trapezoid profiles: continuous, inside their limits, arriving together."""

from homography_servo.robot.profile import brake
from homography_servo.robot.profile import constant
from homography_servo.robot.profile import fastest
from homography_servo.robot.profile import lasting
from homography_servo.robot.profile import Ramp
from homography_servo.robot.profile import together
import numpy as np
import pytest


def ramps(rng, count):
    return [Ramp(*rng.uniform((50.0, 500.0, 500.0), (5000.0, 30000.0, 30000.0)))
            for _ in range(count)]


def sampled(profile, count=400):
    times = np.linspace(0.0, profile.duration + 0.01, count)
    return times, *np.array([profile.at(t) for t in times]).T


def assert_lawful(profile, start, velocity, end, ramp):
    assert profile.at(0.0)[0] == pytest.approx(start)
    assert profile.at(profile.duration + 1.0) == (end, 0.0)
    times, position, speed = sampled(profile)
    step = times[1]
    limit = max(ramp.speed, abs(velocity)) * (1 + 1e-9)
    assert np.abs(speed).max() <= limit
    assert np.abs(np.diff(position)).max() <= limit * step + 1e-6
    assert np.abs(np.diff(speed)).max() <= max(ramp.accel, ramp.decel) * step + 1e-6


@pytest.mark.parametrize('seed', range(60))
def test_fastest_reaches_the_end_within_its_limits_from_any_speed(seed):
    rng = np.random.default_rng(seed)
    ramp, = ramps(rng, 1)
    start, end = rng.uniform(-1400, 1400, 2)
    velocity = rng.uniform(-1.0, 1.0) * ramp.speed
    profile = fastest(start, velocity, end, ramp)
    assert_lawful(profile, start, velocity, end, ramp)


@pytest.mark.parametrize('seed', range(60))
def test_lasting_takes_the_time_it_was_given_unless_it_must_brake_at_once(seed):
    rng = np.random.default_rng(seed)
    ramp, = ramps(rng, 1)
    start, end = rng.uniform(-1400, 1400, 2)
    velocity = rng.uniform(-1.0, 1.0) * ramp.speed
    time = fastest(start, velocity, end, ramp).duration * rng.uniform(1.0, 4.0)
    profile = lasting(start, velocity, end, ramp, time)
    assert_lawful(profile, start, velocity, end, ramp)
    assert profile.duration == pytest.approx(time, rel=1e-6)


@pytest.mark.parametrize('seed', range(20))
def test_from_rest_all_follow_one_straight_line_and_one_of_them_is_at_a_limit(seed):
    rng = np.random.default_rng(seed)
    limits, start, end = ramps(rng, 4), *rng.uniform(-1400, 1400, (2, 4))
    profiles = together(start, np.zeros(4), end, limits)
    assert np.ptp([p.duration for p in profiles]) < 1e-9
    for item in zip(profiles, start, np.zeros(4), end, limits):
        assert_lawful(*item)
    shares = [(sampled(p)[1] - a) / (b - a) for p, a, b in zip(profiles, start, end)]
    assert np.ptp(shares, axis=0).max() < 1e-9
    alone = [fastest(a, 0.0, b, r).duration for a, b, r in zip(start, end, limits)]
    assert profiles[0].duration >= max(alone) - 1e-9


@pytest.mark.parametrize('seed', range(20))
def test_in_motion_all_arrive_together(seed):
    rng = np.random.default_rng(seed)
    limits, start, end = ramps(rng, 4), *rng.uniform(-1400, 1400, (2, 4))
    velocity = rng.uniform(-1, 1, 4) * [r.speed for r in limits]
    profiles = together(start, velocity, end, limits)
    assert np.ptp([p.duration for p in profiles]) < 1e-6
    for item in zip(profiles, start, velocity, end, limits):
        assert_lawful(*item)


def test_a_servo_that_must_brake_at_once_may_arrive_first():
    ramp = Ramp(1000.0, 5000.0, 5000.0)
    end = 0.5 * 1000.0 ** 2 / 5000.0
    first, second = together([0.0, 0.0], [1000.0, 0.0], [end, 1400.0], [ramp, ramp])
    assert first.duration == pytest.approx(0.2) and second.duration > 1.0
    assert first.at(0.1)[0] < end


def test_brake_and_constant():
    stopping = brake(10.0, -400.0, 2000.0)
    assert (stopping.duration, stopping.end) == pytest.approx((0.2, -30.0))
    assert brake(3.0, 0.0, 10.0).at(5.0) == (3.0, 0.0)
    jump = constant(0.0, -100.0, 1000.0)
    assert jump.at(0.05) == pytest.approx((-50.0, -1000.0))
    assert jump.at(0.1) == (-100.0, 0.0)
    assert constant(5.0, 5.0, 10.0).duration == 0.0
