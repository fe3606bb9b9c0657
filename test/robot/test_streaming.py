"""Targets on their way to the wire: never too fast, never outside, whatever the clock does."""

from arm_setup import changed_joint
from arm_setup import default_robot
from homography_servo.robot.limits import limits_of
from homography_servo.robot.servo_units import from_units
from homography_servo.robot.servo_units import to_units
from homography_servo.robot.servo_units import unit_range
from homography_servo.robot.servo_units import velocity_units_s
from homography_servo.robot.streaming import TargetStream
from homography_servo.robot.trajectory import accept
from homography_servo.robot.trajectory import go_to
from homography_servo.robot.trajectory import State
from homography_servo.robot.trajectory import stop
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.trajectory import TrajectorySettings
import numpy as np
import pytest

ROBOT = default_robot()
MARGIN = 0.05
LIMITS = limits_of(ROBOT, MARGIN)
REST = State(np.zeros(6), np.zeros(6))


def stream(robot=ROBOT, now_s=0.0):
    return TargetStream(robot, np.zeros(6, dtype=int), now_s, MARGIN)


def too_fast(sent, robot=ROBOT, free_units=0):
    """Find the worst speed over limit between any two targets, as a listener sees them."""
    times_s = np.array([time_s for time_s, _ in sent])
    units = np.array([units for _, units in sent], dtype=float)
    worst = 0.0
    for gap in range(1, min(len(sent), 40)):
        moved = np.abs(units[gap:] - units[:-gap]) - free_units
        moved = moved / velocity_units_s(robot)
        passed = times_s[gap:] - times_s[:-gap]
        worst = max(worst, (moved / passed[:, None]).max())
    return worst


def test_it_goes_where_the_trajectory_goes_and_ends():
    goal = np.array([1.0, -0.5, 0.3, 0.2, -0.1, 0.7])
    trajectory = go_to(LIMITS, goal, REST)
    targets = stream()
    targets.follow(trajectory, 0.0)
    sent, now_s = [], 0.0
    while targets.trajectory is not None:
        now_s += 0.02
        target = targets.step(now_s)
        sent.append((now_s, target.units))
        assert np.abs(target.joints_rad - from_units(ROBOT, target.units)).max() < 0.0011
    np.testing.assert_array_equal(target.units, to_units(ROBOT, goal, MARGIN))
    assert target.done and not targets.state.velocities.any()
    assert target.late_s == pytest.approx(0.0, abs=0.02)
    assert now_s == pytest.approx(trajectory.duration_s, abs=0.03)
    assert too_fast(sent) <= 1.0
    np.testing.assert_array_equal(targets.step(now_s + 5.0).units, target.units)


@pytest.mark.parametrize('settings', [
    TrajectorySettings(longest_stretch=1000.0, headroom=0.0),
    TrajectorySettings(longest_stretch=1000.0, headroom=0.0, interpolation='linear')],
    ids=['smooth', 'linear'])
def test_never_too_fast_and_never_outside_with_a_clock_that_stumbles(settings):
    rng = np.random.default_rng(1)
    targets, now_s, sent = stream(), 0.0, []
    low, high = unit_range(ROBOT, MARGIN)
    for _ in range(4000):
        if rng.random() < 0.02:
            goals = rng.uniform(LIMITS.lower_rad, LIMITS.upper_rad, (3, 6))
            goals = np.where(rng.random((3, 6)) < 0.2, LIMITS.upper_rad, goals)
            points = [TrajectoryPoint(0.3 * (i + 1), goal) for i, goal in enumerate(goals)]
            trajectory = accept(LIMITS, ROBOT.joint_names, points, targets.state, settings)
            if trajectory:
                targets.follow(trajectory, now_s)
        if rng.random() < 0.005:
            targets.follow(stop(LIMITS, targets.state), now_s)
        now_s += rng.choice([1e-4, 0.004, 0.02, 0.02, 0.02, 0.05, 1.0])
        target = targets.step(now_s)
        assert np.all((target.units >= low) & (target.units <= high))
        sent.append((now_s, target.units))
    assert too_fast(sent) <= 1.0 + 1e-9
    assert np.ptp([units for _, units in sent], axis=0).min() > 1500  # it did move


@pytest.mark.parametrize('speed_rad_s', [0.01, 0.06])
@pytest.mark.parametrize('step_s', [0.02, 0.008])
def test_a_joint_slower_than_a_unit_a_step_loses_little_time(speed_rad_s, step_s):
    robot = changed_joint(ROBOT, 0, velocity_rad_s=speed_rad_s)
    limits = limits_of(robot, MARGIN)
    targets = TargetStream(robot, np.zeros(6, dtype=int), 0.0, MARGIN, 0.02, step_s)
    trajectory = go_to(limits, np.full(6, 0.05), targets.state)
    targets.follow(trajectory, 0.0)
    sent, now_s = [], 0.0
    while targets.trajectory is not None and now_s < 60.0:
        now_s += step_s
        sent.append((now_s, targets.step(now_s).units))
    np.testing.assert_array_equal(sent[-1][1], to_units(robot, np.full(6, 0.05)))
    assert too_fast(sent, robot, free_units=1) <= 1.0 + 1e-9
    assert now_s < 1.6 * trajectory.duration_s


def test_waiting_joints_wait_together_and_it_is_said():
    targets = stream()
    targets.follow(go_to(LIMITS, [1.0, 0.5, 0, 0, 0, 0], REST), 0.0)
    now_s = 0.0
    for _ in range(25):
        now_s += 0.02
        targets.step(now_s)
    now_s += 3.0  # the process slept: it goes on where it was
    target = targets.step(now_s)
    assert target.late_s > 2.8
    assert target.joints_rad[1] / target.joints_rad[0] == pytest.approx(0.5, abs=1e-9)
    assert not target.done


def test_a_clock_that_runs_backwards_stands_still():
    targets = stream(now_s=100.0)
    targets.follow(go_to(LIMITS, np.full(6, 0.5), REST), 100.0)
    moved = targets.step(100.3)
    back = targets.step(50.0)
    np.testing.assert_array_equal(back.units, moved.units)
    assert np.any(targets.step(100.4).units != moved.units)


def test_restart_forgets_the_motion():
    targets = stream()
    targets.follow(go_to(LIMITS, np.full(6, 0.5), REST), 0.0)
    targets.step(0.1)
    units = np.array([10, 20, -30, 40, 50, 60])
    targets.restart(units, 0.2)
    target = targets.step(0.4)
    np.testing.assert_array_equal(target.units, units)
    assert target.done and not targets.state.velocities.any()
    np.testing.assert_allclose(targets.state.positions, from_units(ROBOT, units))
