"""Servo units: rounding shown, and never outwards."""

from arm_setup import changed_joint
from arm_setup import default_robot
from arm_setup import random_joints
from homography_servo.robot.servo_units import acceleration_units_s2
from homography_servo.robot.servo_units import exact_units
from homography_servo.robot.servo_units import from_channels
from homography_servo.robot.servo_units import from_units
from homography_servo.robot.servo_units import resolution_rad
from homography_servo.robot.servo_units import to_channels
from homography_servo.robot.servo_units import to_units
from homography_servo.robot.servo_units import unit_range
from homography_servo.robot.servo_units import velocity_units_s
import numpy as np
import pytest

ROBOT = default_robot()
ODD = changed_joint(changed_joint(ROBOT, 1, sign=-1, zero_units=37.3), 4, zero_units=-0.5)


@pytest.mark.parametrize('robot', [ROBOT, ODD], ids=['default', 'odd'])
def test_there_and_back_costs_half_a_unit_at_most(robot):
    joints = 0.99 * random_joints(robot, 2000, 1)  # at the very ends rounding goes inwards
    back = from_units(robot, to_units(robot, joints))
    assert np.all(np.abs(back - joints) <= 0.5 * resolution_rad(robot) + 1e-12)


@pytest.mark.parametrize('margin_rad', [0.0, 0.05, 0.0123])
@pytest.mark.parametrize('robot', [ROBOT, ODD], ids=['default', 'odd'])
def test_rounding_never_leaves_the_limits(robot, margin_rad):
    lower, upper = robot.lower_rad + margin_rad, robot.upper_rad - margin_rad
    inside = np.concatenate([
        [lower, upper], lower + 1e-12, upper - 1e-12,
        *(lower + share * resolution_rad(robot) for share in (0.2, 0.5, 0.7)),
        *(upper - share * resolution_rad(robot) for share in (0.2, 0.5, 0.7)),
        lower + np.random.default_rng(2).random((500, 6)) * (upper - lower)],
        axis=None).reshape(-1, 6)
    units = to_units(robot, inside, margin_rad)
    assert units.dtype.kind == 'i'
    back = from_units(robot, units)
    assert np.all(back >= lower - 1e-9) and np.all(back <= upper + 1e-9)
    assert np.all(np.abs(units - exact_units(robot, inside)) < 1.0)
    low, high = unit_range(robot, margin_rad)
    assert np.all((units >= low) & (units <= high))


def test_outside_the_limits_nothing_is_clipped():
    beyond = ROBOT.upper_rad + 0.1
    assert np.all(to_units(ROBOT, beyond) > unit_range(ROBOT).high + 90)
    with pytest.raises(ValueError, match='finite'):
        to_units(ROBOT, np.full(6, np.nan))


def test_default_range_is_wider_than_a_fresh_servo_allows():
    low, high = unit_range(ROBOT)
    np.testing.assert_array_equal(low, [-1400, -1444, -1357, -1399, -1400, -1400])
    np.testing.assert_array_equal(high, [1400, 1354, 1442, 1399, 1400, 1400])


def test_rates_are_per_servo_unit():
    np.testing.assert_allclose(velocity_units_s(ROBOT),
                               90 * np.array([17.50, 18.06, 16.97, 16.47, 18.67, 17.50]))
    np.testing.assert_allclose(acceleration_units_s2(ROBOT), 4 * velocity_units_s(ROBOT))
    np.testing.assert_allclose(velocity_units_s(ODD), velocity_units_s(ROBOT))


def test_channels_may_be_wired_in_any_order():
    robot = ROBOT
    for index, channel in enumerate((13, 11, 15, 12, 10, 14)):
        robot = changed_joint(robot, index, channel=channel)
    units = np.array([1, 2, 3, 4, 5, 6])
    assert to_channels(robot, units) == [5, 2, 4, 1, 6, 3]
    np.testing.assert_array_equal(from_channels(robot, [5, 2, 4, 1, 6, 3]), units)
    with pytest.raises(ValueError, match='6 items, got 2'):
        from_channels(robot, [1, 2])
