"""Limits: what is wrong is refused with a sentence, whatever its size."""

import re

from arm_setup import default_robot
from homography_servo.result import Rejected
from homography_servo.robot.limits import acceleration_problem
from homography_servo.robot.limits import joint_order
from homography_servo.robot.limits import limits_of
from homography_servo.robot.limits import position_problem
from homography_servo.robot.limits import time_problem
from homography_servo.robot.limits import velocity_problem
import numpy as np
import pytest

ROBOT = default_robot()
LIMITS = limits_of(ROBOT, 0.05)
CHECKS = [
    (position_problem, LIMITS.lower_rad, LIMITS.upper_rad),
    (velocity_problem, -ROBOT.velocity_rad_s, ROBOT.velocity_rad_s),
    (acceleration_problem, -ROBOT.acceleration_rad_s2, ROBOT.acceleration_rad_s2),
]
IDS = ['position', 'velocity', 'acceleration']


@pytest.mark.parametrize('check, low, high', CHECKS, ids=IDS)
def test_up_to_the_limit_and_not_beyond(check, low, high):
    assert check(LIMITS, low) is None and check(LIMITS, high) is None
    for joint in range(6):
        for over in (1e-15, 1e-9, 1.0, 1e9, 1e300, np.inf, np.nan):
            for end, way in ((low, -1), (high, 1)):
                values = np.zeros(6)
                values[joint] = np.nextafter(end[joint], way * np.inf) + way * over
                problem = check(LIMITS, values)
                assert isinstance(problem, Rejected)
                assert f'joint{joint + 1} ' in problem.reason
                assert np.isfinite(over) or 'is not finite' in problem.reason


@pytest.mark.parametrize('check, low, high', CHECKS, ids=IDS)
def test_one_bad_row_in_many_is_found(check, low, high):
    rows = np.tile(0.5 * high, (40, 1))
    assert check(LIMITS, rows) is None
    rows[31, 2] = high[2] * 1.5
    assert 'joint3 ' in check(LIMITS, rows).reason


def test_the_sentence_has_the_numbers():
    joints = np.zeros(6)
    joints[1] = LIMITS.upper_rad[1] + 0.25
    reason = position_problem(LIMITS, joints).reason
    assert reason == 'joint2 at 1.509 rad is 0.25 rad outside -1.34626..1.259 rad'
    assert velocity_problem(LIMITS, np.full(6, -9.0)).reason == \
        'joint1 at -9 rad/s is above its limit of 1.5708 rad/s'


def test_margin_is_taken_off_both_ends_and_must_leave_room():
    np.testing.assert_allclose(LIMITS.lower_rad, ROBOT.lower_rad + 0.05)
    np.testing.assert_allclose(LIMITS.upper_rad, ROBOT.upper_rad - 0.05)
    for margin in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match='margin_rad must be 0 or above'):
            limits_of(ROBOT, margin)
    with pytest.raises(ValueError, match='leaves no room'):
        limits_of(ROBOT, 1.5)


def test_names_in_any_order_once_each():
    names = ['joint3', 'joint1', 'joint6', 'joint2', 'joint5', 'joint4']
    values = np.array([3, 1, 6, 2, 5, 4])
    np.testing.assert_array_equal(values[joint_order(LIMITS, names)], [1, 2, 3, 4, 5, 6])


@pytest.mark.parametrize('change, reason', [
    (lambda n: [], 'no joint names given'),
    (lambda n: n[:-1], 'joint joint6 missing'),
    (lambda n: [*n, 'joint7'], 'joint joint7 unknown'),
    (lambda n: [*n[:-1], 'joint1'], 'joint joint1 repeated'),
    (lambda n: [*n, 'joint1'], 'joint joint1 repeated'),
    (lambda n: [*n[:-1], 'JOINT6'], 'joint JOINT6 unknown'),
    (lambda n: [*n[:-1], ''], 'joint  unknown'),
    (lambda n: ['x' * 10000] * 5000, r'joint x{40}, x{40}, x{40} and 4997 more unknown'),
])
def test_other_names_are_refused(change, reason):
    problem = joint_order(LIMITS, change(list(ROBOT.joint_names)))
    assert isinstance(problem, Rejected)
    assert re.fullmatch(reason, problem.reason)


class CountedName(str):
    """A name that counts how often names are compared."""

    compared = 0
    __hash__ = str.__hash__

    def __eq__(self, other):
        CountedName.compared += 1
        return str(self) == str(other)


def test_many_names_are_refused_without_comparing_each_with_each():
    names = [CountedName(f'other{k % 999}') for k in range(1000)]
    assert '997 more unknown' in joint_order(LIMITS, names).reason
    assert 0 < CountedName.compared < 20 * len(names)


@pytest.mark.parametrize('times, reason', [
    ([0.1, 0.1], 'point 1 is at 0.1 s after 0.1 s'),
    ([0.0, 0.2, 0.1], 'point 2 is at 0.1 s after 0.2 s'),
    ([-1e-9], 'time of point 0 is negative'),
    ([0.0, np.nan], 'time of point 1 is not finite'),
    ([0.0, np.inf], 'time of point 1 is not finite'),
])
def test_times_must_increase(times, reason):
    assert reason in time_problem(times).reason


def test_good_times_pass():
    assert time_problem([]) is None
    assert time_problem([0.0]) is None
    assert time_problem([0.0, 1e-9, 5.0]) is None
