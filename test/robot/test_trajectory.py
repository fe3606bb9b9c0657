"""Trajectories: the rules of joint_trajectory_controller, the limits, the stretching."""

import dataclasses

from arm_setup import default_robot
from homography_servo.result import Rejected
from homography_servo.robot.limits import limits_of
from homography_servo.robot.spline import Knots
from homography_servo.robot.spline import monotone_velocities
from homography_servo.robot.spline import Spline
from homography_servo.robot.trajectory import accept
from homography_servo.robot.trajectory import go_to
from homography_servo.robot.trajectory import MOST_POINTS
from homography_servo.robot.trajectory import State
from homography_servo.robot.trajectory import stop
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.trajectory import TrajectorySettings
import numpy as np
import pytest

ROBOT = default_robot()
LIMITS = limits_of(ROBOT, 0.05)
NAMES = ROBOT.joint_names
REST = State(np.zeros(6), np.zeros(6))
SLOW = TrajectorySettings(longest_stretch=1000.0)
LINEAR = TrajectorySettings(interpolation='linear')


def point(time_s, *values, **more):
    return TrajectoryPoint(time_s, values if len(values) == 6 else [values[0]] * 6, **more)


def dense(trajectory, count=4000):
    times_s = np.linspace(0.0, trajectory.duration_s, count)
    return times_s, trajectory.sample(times_s)


def check_inside(trajectory, limits=LIMITS):
    _, sample = dense(trajectory)
    assert np.all(sample.positions >= limits.lower_rad - 1e-9)
    assert np.all(sample.positions <= limits.upper_rad + 1e-9)
    assert np.all(np.abs(sample.velocities) <= limits.velocity_rad_s * (1 + 1e-9))


# --- acceptance ------------------------------------------------------------------------

def test_names_may_come_in_any_order():
    order = [2, 0, 5, 1, 4, 3]
    values = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    shuffled = accept(LIMITS, [NAMES[i] for i in order],
                      [TrajectoryPoint(3.0, values[order], np.zeros(6))], REST)
    np.testing.assert_allclose(shuffled.goal, values)
    np.testing.assert_allclose(shuffled.sample(3.0).positions, values)


GOOD = point(2.0, 0.3)
BAD = [
    ([GOOD, point(2.0, 0.4)], 'times must strictly increase'),
    ([GOOD, point(1.0, 0.4)], 'times must strictly increase'),
    ([point(-1.0, 0.1)], 'is negative'),
    ([point(np.nan, 0.1)], 'not finite'),
    ([point(np.inf, 0.1)], 'not finite'),
    ([TrajectoryPoint(1.0, [0.1] * 5)], 'point 0 has 5 positions for 6 joints'),
    ([GOOD, TrajectoryPoint(3.0, [])], 'point 1 has 0 positions for 6 joints'),
    ([point(1.0, 0.1, velocities=[0.0] * 7)], '7 velocities for 6 joints'),
    ([point(1.0, 0.1, velocities=[0.0] * 6, accelerations=[0.0])], '1 accelerations for 6'),
    ([point(1.0, 0.1, accelerations=[0.0] * 6)], 'accelerations but no velocities'),
    ([point(1.0, 0.1, effort=[0.0] * 6)], 'has effort'),
    ([point(1.0, 0.1, velocities=[0.1] * 6), point(2.0, 0.2)], 'some points have velocities'),
    ([point(1.0, 0.1, velocities=[0.1] * 6)], 'last point must be at rest'),
    ([point(1.0, 0.1, velocities=[9.0] * 6), point(2.0, 0.2, velocities=[0.0] * 6)],
     'joint1 at 9 rad/s is above its limit'),
    ([point(1.0, 0.1, velocities=[np.nan] * 6)], 'joint1 is not finite'),
    ([point(1.0, 0.1, velocities=[0.0] * 6, accelerations=[99.0] * 6)], 'above its limit'),
    ([point(1.0, np.nan)], 'joint1 is not finite'),
    ([point(1.0, 0, 0, -np.inf, 0, 0, 0)], 'joint3 is not finite'),
    ([GOOD, point(3.0, 0, 0, 0, 0, 1.26, 0), point(4.0, 0.0)], 'joint5 at 1.26 rad is'),
    ([point(1.0, 1e9)], 'joint1 at 1e+09 rad is'),
    ([point(1.0, *(LIMITS.upper_rad + [0, 0, 0, 0, 0, 1e-9]))], 'joint6 at'),
]


@pytest.mark.parametrize('points, reason', BAD, ids=[reason for _, reason in BAD])
def test_what_is_wrong_is_refused_with_its_reason(points, reason):
    refused = accept(LIMITS, NAMES, points, REST)
    assert isinstance(refused, Rejected) and reason in refused.reason
    moving = State(np.full(6, 0.2), np.full(6, 0.5))
    assert isinstance(accept(LIMITS, NAMES, points, moving), Rejected)


def test_what_would_take_too_long_to_judge_is_refused():
    points = [point(0.1 * (k + 1), 0.0) for k in range(MOST_POINTS + 1)]
    assert f'more than {MOST_POINTS} points' in accept(LIMITS, NAMES, points, REST).reason
    assert accept(LIMITS, NAMES, points[1:], REST).duration_s == pytest.approx(points[-1].time_s)


def test_wrong_names_are_refused():
    assert accept(LIMITS, NAMES[:5], [GOOD], REST) == Rejected('joint joint6 missing')
    assert accept(LIMITS, ['a', *NAMES[1:]], [GOOD], REST) == Rejected('joint a unknown')
    assert accept(LIMITS, [], [GOOD], REST) == Rejected('no joint names given')


def test_every_limit_itself_can_be_reached():
    for goal in (LIMITS.lower_rad, LIMITS.upper_rad):
        trajectory = go_to(LIMITS, goal, REST)
        np.testing.assert_array_equal(trajectory.goal, goal)
        check_inside(trajectory)


def test_header_stamps():
    points = [point(1.0, 0.1), point(2.0, 0.2), point(3.0, 0.3)]
    now = accept(LIMITS, NAMES, points, REST, stamp_s=0.0, now_s=1e9)
    same = accept(LIMITS, NAMES, points, REST, stamp_s=1e9, now_s=1e9)
    later = accept(LIMITS, NAMES, points, REST, stamp_s=1e9 + 2.0, now_s=1e9)
    assert [t.duration_s for t in (now, same, later)] == [3.0, 3.0, 5.0]
    begun = accept(LIMITS, NAMES, points, REST, stamp_s=1e9 - 1.5, now_s=1e9)
    np.testing.assert_allclose(begun.spline.times_s, [0.0, 0.5, 1.5])
    np.testing.assert_allclose(begun.sample(0.5).positions, 0.2)
    for stamp, reason in ((1e9 - 3.0, 'ended 0 s ago'), (1e9 - 7200, 'ended 7.2e+03 s ago'),
                          (1e9 + 3600, 'ahead of now'), (np.nan, 'not finite')):
        refused = accept(LIMITS, NAMES, points, REST, stamp_s=stamp, now_s=1e9)
        assert isinstance(refused, Rejected) and reason in refused.reason


# --- motion ----------------------------------------------------------------------------

def test_points_are_passed_at_their_times():
    values = np.array([[0.2, 0.1, -0.3, 0, 0, 0], [0.1, 0.4, -0.6, 0.1, 0, 0.3], [0.0] * 6])
    points = [TrajectoryPoint(2.0 * (i + 1), row) for i, row in enumerate(values)]
    for settings in (TrajectorySettings(), LINEAR):
        trajectory = accept(LIMITS, NAMES, points, REST, settings)
        assert trajectory.time_scale == 1.0 and trajectory.note == ''
        assert not trajectory.single_point
        np.testing.assert_allclose(trajectory.sample(np.array([2.0, 4.0, 6.0])).positions,
                                   values, atol=1e-12)
        np.testing.assert_array_equal(trajectory.sample(99.0).positions, values[-1])
        np.testing.assert_array_equal(trajectory.sample(99.0).velocities, 0.0)


def test_linear_is_linear():
    trajectory = accept(LIMITS, NAMES, [point(2.0, 0.4)], REST, LINEAR)
    np.testing.assert_allclose(trajectory.sample(0.5).positions, 0.1)
    np.testing.assert_allclose(trajectory.sample(0.5).velocities, 0.2)


@pytest.mark.parametrize('degree', [3, 5])
def test_given_velocities_and_accelerations_are_met(degree):
    more = {'velocities': [0.2] * 6}
    last = {'velocities': [0.0] * 6}
    if degree == 5:
        more['accelerations'], last['accelerations'] = [0.3] * 6, [0.0] * 6
    trajectory = accept(LIMITS, NAMES, [point(1.0, 0.1, **more), point(2.0, 0.2, **last)], REST)
    assert trajectory.time_scale == 1.0
    at = trajectory.sample(np.array([1.0 - 1e-12, 1.0]))
    np.testing.assert_allclose(at.positions, 0.1, atol=1e-9)
    np.testing.assert_allclose(at.velocities, 0.2, atol=1e-9)
    if degree == 5:
        np.testing.assert_allclose(at.accelerations, 0.3, atol=1e-9)
        np.testing.assert_allclose(trajectory.sample(0.0).accelerations, 0.0, atol=1e-9)


def test_samples_are_derivatives_of_each_other():
    rng = np.random.default_rng(1)
    knots = Knots(np.array([0.0, 0.7, 1.0, 2.5]), *rng.normal(size=(3, 4, 6)))
    for spline in (Spline(knots), Spline(dataclasses.replace(knots, accelerations=None)),
                   Spline(Knots(knots.times_s, knots.positions))):
        times_s = rng.uniform(0.01, 2.49, 50)
        times_s = times_s[np.abs(times_s[:, None] - knots.times_s).min(axis=1) > 1e-3]
        ahead, behind = spline.sample(times_s + 1e-6), spline.sample(times_s - 1e-6)
        here = spline.sample(times_s)
        np.testing.assert_allclose((ahead.positions - behind.positions) / 2e-6, here.velocities,
                                   rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose((ahead.velocities - behind.velocities) / 2e-6,
                                   here.accelerations, rtol=1e-6, atol=1e-5)


def test_positions_alone_never_overshoot():
    rng = np.random.default_rng(2)
    for _ in range(30):
        times_s = np.cumsum(rng.uniform(0.05, 2.0, 8))
        knots = rng.uniform(-1, 1, (8, 6))
        rest = np.zeros(6)
        spline = Spline(Knots(times_s, knots, monotone_velocities(times_s, knots, rest, rest)))
        pieces = spline.dense().positions
        low, high = np.minimum(knots[:-1], knots[1:]), np.maximum(knots[:-1], knots[1:])
        assert np.all(pieces >= low[:, None] - 1e-9) and np.all(pieces <= high[:, None] + 1e-9)


def test_velocities_are_the_weighted_harmonic_mean_of_the_slopes():
    times_s = np.array([0.0, 1.0, 3.0])
    knots = np.array([[0.0, 0.0, 0.0, 0.0], [2.0, 1.0, -1.0, 1.0], [3.0, 9.0, -2.0, 0.0]])
    slopes, weights = np.diff(knots, axis=0) / [[1.0], [2.0]], np.array([[5.0], [4.0]])
    mean = weights.sum() / (weights[:, 0] @ (1.0 / slopes[:, :3]))
    found = monotone_velocities(times_s, knots, np.zeros(4), np.zeros(4))[1]
    np.testing.assert_allclose(found, [*mean, 0.0], rtol=1e-14)


def test_a_slope_of_almost_nothing_gives_a_velocity_of_almost_nothing():
    tiny = np.finfo(float).smallest_subnormal
    knots = np.array([[0.0, 0.0], [tiny, 1.0], [1.0, 1.0 + tiny], [1.0 + tiny, 2.0]])
    with np.errstate(all='raise', under='ignore'):
        found = monotone_velocities(np.arange(4.0), knots, np.zeros(2), np.zeros(2))
    assert np.isfinite(found).all() and found[1:3] == pytest.approx(0.0, abs=1e-300)


@pytest.mark.parametrize('times', [[1.0], [1.0, 1.0], [1.0, 0.0], [0.0, np.nan]])
def test_a_spline_needs_times_that_increase(times):
    with pytest.raises(ValueError, match='times_s'):
        Spline(Knots(np.array(times), np.zeros((len(times), 6))))


# --- stretching ------------------------------------------------------------------------

def test_a_single_point_without_time_takes_what_the_slowest_joint_needs():
    goal = np.array([1.0, 0.1, 0, 0, 0, -0.5])
    trajectory = go_to(LIMITS, goal, REST)
    assert trajectory.single_point and trajectory.time_scale == 1.0 and trajectory.note == ''
    check_inside(trajectory)
    _, sample = dense(trajectory)
    fastest = np.abs(sample.velocities).max(axis=0) / LIMITS.velocity_rad_s
    hardest = np.abs(sample.accelerations).max(axis=0) / LIMITS.acceleration_rad_s2
    assert 0.9 < max(fastest.max(), hardest.max()) <= 1.0 + 1e-6
    share = sample.positions[:, [0, 1, 5]] / goal[[0, 1, 5]]
    np.testing.assert_allclose(share, share[:, :1] + np.zeros(3), atol=1e-9)  # all together


def test_what_is_too_fast_is_slowed_down_all_joints_together_and_said():
    points = [point(0.4, 1, 0.5, 0, 0, 0, 0), point(0.8, 0.5, 0.7, 0, 0, 0, -1)]
    trajectory = accept(LIMITS, NAMES, points, REST)
    assert trajectory.time_scale > 1.5
    assert trajectory.duration_s == pytest.approx(0.8 * trajectory.time_scale)
    assert 'stretched by' in trajectory.note and 'joint1 would' in trajectory.note
    check_inside(trajectory)
    slow = accept(LIMITS, NAMES, [p._replace(time_s=p.time_s * trajectory.time_scale)
                                  for p in points], REST)
    times_s, sample = dense(trajectory)
    np.testing.assert_allclose(sample.positions, slow.sample(times_s).positions, atol=1e-6)


def test_stretching_has_a_limit():
    refused = accept(LIMITS, NAMES, [point(0.01, 0.5)], REST)
    assert isinstance(refused, Rejected)
    assert 'times the time given' in refused.reason and 'joint1 would' in refused.reason
    assert accept(LIMITS, NAMES, [point(0.01, 0.5)], REST, SLOW).time_scale > 10.0
    strict = TrajectorySettings(longest_stretch=1.0)
    assert isinstance(accept(LIMITS, NAMES, [point(0.5, 0.5)], REST, strict), Rejected)
    assert accept(LIMITS, NAMES, [point(1.5, 0.5)], REST, strict).time_scale == 1.0


def test_accelerations_of_smooth_motions_keep_their_limits():
    rng = np.random.default_rng(3)
    for _ in range(40):
        points = [TrajectoryPoint(t, row) for t, row in zip(
            np.cumsum(rng.uniform(0.2, 1.0, 5)),
            rng.uniform(LIMITS.lower_rad, LIMITS.upper_rad, (5, 6)))]
        trajectory = accept(LIMITS, NAMES, points, REST, SLOW)
        check_inside(trajectory)
        _, sample = dense(trajectory)
        assert np.all(np.abs(sample.accelerations) <= LIMITS.acceleration_rad_s2 * (1 + 1e-6))


def test_a_first_point_at_time_zero():
    here = accept(LIMITS, NAMES, [point(0.0, 0.0), point(2.0, 0.3)], REST)
    assert here.duration_s == 2.0 and here.note == ''
    away = accept(LIMITS, NAMES, [point(0.0, 0.5), point(2.0, 0.3)], REST)
    assert away.duration_s > 2.5 and 'added to reach the first point' in away.note
    check_inside(away)


def test_going_where_it_stands_takes_no_time():
    trajectory = go_to(LIMITS, np.zeros(6), REST)
    assert trajectory.duration_s <= 0.01
    np.testing.assert_array_equal(dense(trajectory)[1].positions, 0.0)


# --- replacing and stopping ------------------------------------------------------------

def test_a_new_trajectory_starts_where_and_how_fast_the_arm_is():
    rng = np.random.default_rng(4)
    now, braked, refused = REST, 0, 0
    for _ in range(300):
        goal = rng.uniform(LIMITS.lower_rad, LIMITS.upper_rad)
        trajectory = accept(LIMITS, NAMES, [TrajectoryPoint(rng.uniform(0.0, 2.0), goal)], now,
                            SLOW)
        if isinstance(trajectory, Rejected):
            refused += 1
            now = REST
            continue
        check_inside(trajectory)
        first = trajectory.sample(0.0)
        np.testing.assert_allclose(first.positions, now.positions, atol=1e-12)
        np.testing.assert_allclose(first.velocities, now.velocities, atol=1e-9)
        braked += 'braked first' in trajectory.note
        at = trajectory.sample(rng.uniform(0.0, trajectory.duration_s))
        now = State(at.positions, at.velocities)
    assert refused == 0
    assert braked > 0


def test_no_points_and_stop_come_to_rest_inside_the_limits():
    rng = np.random.default_rng(5)
    for _ in range(200):
        start = State(rng.uniform(LIMITS.lower_rad, LIMITS.upper_rad), np.zeros(6))
        trajectory = go_to(LIMITS, rng.uniform(LIMITS.lower_rad, LIMITS.upper_rad), start)
        at = trajectory.sample(rng.uniform(0.0, trajectory.duration_s))
        moving = State(at.positions, at.velocities)
        halted = accept(LIMITS, [], [], moving)
        check_inside(halted)
        np.testing.assert_array_equal(halted.goal, stop(LIMITS, moving).goal)
        first = halted.sample(0.0)
        np.testing.assert_allclose(first.velocities, moving.velocities, atol=1e-9)
        assert halted.duration_s <= 0.26  # 90 deg/s at 360 deg/s^2 takes 0.25 s


def test_an_arm_outside_its_limits_may_come_back_only():
    outside = State(LIMITS.upper_rad + [0.03, 0, 0, 0, 0, 0], np.zeros(6))
    back = go_to(LIMITS, np.zeros(6), outside)
    assert back.sample(0.0).positions[0] > LIMITS.upper_rad[0]
    assert np.all(np.diff(dense(back)[1].positions[:, 0]) <= 1e-12)
    assert isinstance(go_to(LIMITS, outside.positions, outside), Rejected)


def test_points_between_which_a_curve_leaves_the_limits_are_refused():
    high = LIMITS.upper_rad[0] - 0.01
    points = [point(1.0, high, 0, 0, 0, 0, 0, velocities=[0.8, 0, 0, 0, 0, 0]),
              point(2.0, high, 0, 0, 0, 0, 0, velocities=[0.0] * 6)]
    refused = accept(LIMITS, NAMES, points, REST)
    assert isinstance(refused, Rejected)
    assert refused.reason.startswith('between its points joint1 at')
