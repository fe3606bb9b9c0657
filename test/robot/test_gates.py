"""Small parts of the driver: governor, rivals, estimate, servo wire."""

import dataclasses
import re

from homography_servo.errors import LinkError
from homography_servo.robot.estimate import ArmEstimate
from homography_servo.robot.estimate import LONGEST_AHEAD_S
from homography_servo.robot.governor import Governor
from homography_servo.robot.profile import Ramp
from homography_servo.robot.profile import together
from homography_servo.robot.protocol import MAX_LINE
from homography_servo.robot.protocol import Request
from homography_servo.robot.rivals import Rivals
from homography_servo.robot.rivals import Turns
from homography_servo.robot.wire import ServoWire
from link_setup import ROBOT
import numpy as np
import pytest

# --- governor ----------------------------------------------------------------------------

LOW, HIGH, SPEED = np.array([-100, -50]), np.array([100, 50]), np.array([1000.0, 500.0])


def governor():
    gate = Governor(LOW, HIGH, SPEED, 0.01)
    gate.start(np.array([0, 0]), 10.0)
    return gate


def test_targets_inside_and_slow_enough_pass_unchanged():
    gate = governor()
    assert list(gate.step(np.array([10, -5]), 10.0101)) == [10, -5] and gate.held_back == 0
    assert gate.step(np.array([10, -5]), 10.02) is None  # nothing new


@pytest.mark.parametrize('over', [[101, 0], [-101, 0], [0, 51], [0, -51], [10**9, 0]])
def test_targets_outside_never_pass(over):
    gate = governor()
    assert gate.step(np.array(over), 99.0) is None and gate.whole(np.array(over)) is None
    assert gate.refused == 2


def test_too_far_a_step_is_held_back_for_all_joints_alike():
    gate = governor()
    assert list(gate.step(np.array([40, 20]), 10.0101)) == [10, 5] and gate.held_back == 1
    assert gate.step(np.array([40, 20]), 10.0101) is None  # no time has passed


@pytest.mark.parametrize('seed', range(20))
def test_whatever_comes_two_targets_are_never_too_far_apart(seed):
    rng = np.random.default_rng(seed)
    gate, now_s, last, last_s = governor(), 10.0, np.array([0, 0]), 10.0
    for _ in range(300):
        now_s += rng.choice([0.0, 0.001, 0.02, 0.5])
        target = gate.step(rng.integers(-150, 151, 2), now_s)
        if target is not None:
            assert (target >= LOW).all() and (target <= HIGH).all()
            assert (np.abs(target - last) <= SPEED * (now_s - last_s) + 1e-9).all()
            last, last_s = target, now_s


def test_a_servo_slower_than_a_unit_a_step_takes_one_when_it_is_due():
    gate = Governor(np.array([-100, -100]), np.array([100, 100]), np.array([1000.0, 60.0]), 0.007)
    gate.start(np.array([0, 0]), 0.0)
    target = np.array([0, 0])
    for k in range(1, 13):
        due = k % 3 == 0  # 0.021 s for a unit that takes 0.017
        target = gate.step(target + [5, due], 0.007 * k)
        assert list(target) == [5 * k, k // 3] and gate.held_back == 0
    assert gate.step(target + [0, 1], 0.099) is None  # not due yet
    assert list(gate.step(target + [0, 1], 0.101)) == [60, 5]


def test_before_it_knows_where_the_arm_is_nothing_passes():
    gate = Governor(LOW, HIGH, SPEED, 0.01)
    assert gate.step(np.array([1, 1]), 10.0) is None
    gate = governor()
    gate.forget()
    assert gate.last is None and gate.step(np.array([1, 1]), 10.1) is None


# --- rivals ------------------------------------------------------------------------------

def met(numbers, period_s=0.02):
    rivals = Rivals()
    return [rivals.meet(number, 5.0 + k * period_s) for k, number in enumerate(numbers)]


@pytest.mark.parametrize('numbers', [
    list(range(1, 100)),                         # one publisher
    list(range(1, 2000, 37)),                    # that loses messages in a flood
    [1, 5, 300, 301, 900],                       # and many at once
    [*range(500, 530), *range(1, 60)],           # restarted
    [*range(1, 4), *range(1, 30)],               # restarted at once
    [1, 2, 1, 2, 3, 4, 1, 2, 3],                 # and again
])
def test_one_publisher_is_no_rival_of_itself(numbers):
    assert not any(met(numbers))


@pytest.mark.parametrize('first, second', [(1, 1), (500, 1), (1, 500), (7, 9), (100, 130)])
def test_two_are_noticed_within_two_messages_of_each(first, second):
    alone = list(range(first, first + 5))
    both = [n for k in range(10) for n in (second + k, first + 5 + k)]
    found = met(alone + both)
    assert not any(found[:5]) and any(found[5:9])


def test_what_was_long_ago_does_not_count():
    rivals = Rivals(memory_s=1.0)
    assert not any([rivals.meet(10, 0.0), rivals.meet(1, 0.1), rivals.meet(11, 2.0)])


@pytest.mark.parametrize('topics, period_s, found', [
    ('aaaabbbb', 0.02, False), ('abab', 0.02, True), ('aba', 0.3, False), ('aaba', 0.1, True),
    ('ab', 0.01, False),
])
def test_two_topics_that_take_turns_are_noticed(topics, period_s, found):
    turns = Turns()
    assert any([turns.meet(t, 7.0 + k * period_s) for k, t in enumerate(topics)]) == found


# --- estimate ----------------------------------------------------------------------------

def test_between_samples_it_goes_on_and_stands_after_two_equal_ones():
    arm = ArmEstimate()
    assert not arm.known and arm.age_s(3.0) == float('inf')
    with pytest.raises(ValueError, match='no position'):
        arm.at(0.0)
    for k in range(5):
        arm.add(0.02 * k, np.array([0.01 * k, 0.0]))
    now = arm.at(0.09)
    assert now.positions == pytest.approx([0.045, 0.0])
    assert now.velocities == pytest.approx([0.5, 0.0])
    assert arm.at(9.0).positions == pytest.approx([0.04 + 0.5 * LONGEST_AHEAD_S, 0.0])
    arm.add(0.10, np.array([0.04, 0.0]))
    assert not arm.at(0.2).velocities.any() and arm.last == pytest.approx([0.04, 0.0])


def test_samples_that_come_late_or_after_a_gap_give_no_velocity():
    arm = ArmEstimate()
    arm.add(1.0, np.array([0.0]))
    arm.add(0.9, np.array([9.0]))
    assert arm.last == 0.0
    arm.add(5.0, np.array([1.0]))
    assert arm.at(5.0).velocities == 0.0


# --- servo wire --------------------------------------------------------------------------

def shuffled():
    """Build an arm whose joints hang on channels 6 to 1, half of them turned round."""
    return dataclasses.replace(ROBOT, joints=tuple(
        dataclasses.replace(joint, channel=6 - k, sign=(-1) ** k)
        for k, joint in enumerate(ROBOT.joints)))


@pytest.mark.parametrize('robot', [ROBOT, shuffled()], ids=['straight', 'shuffled'])
def test_joints_go_to_their_servos_and_come_back(robot):
    wire = ServoWire(robot, 8, 0.02)
    joints = np.array([0.5, -0.4, 0.3, 0.2, -0.1, 0.6])
    units = wire.units(joints, 0.05)
    wire.heard([0, 0, 0, 0, 0, 0, 77, 88])
    sent = [int(v) for v in wire.goto(units).split()[1:]]
    assert sent[6:] == [77, 88]  # servos of somebody else stay where they are
    for joint, angle in zip(robot.joints, joints):
        assert sent[joint.channel - 1] == pytest.approx(
            joint.sign * joint.units_per_rad * angle, abs=0.51)
    assert wire.joints(wire.heard(sent)) == pytest.approx(joints, abs=6e-4)
    moved = {int(s): int(v) for s, v in re.findall(r'(\d+) to (-?\d+)', wire.move(units))}
    assert moved == {k + 1: v for k, v in enumerate(sent[:6])}
    assert wire.heard([1, 2, 3]) is None


def test_every_line_of_the_setup_fits():
    wire = ServoWire(ROBOT, 6, 0.02)
    lines = [*wire.setup(), *wire.maxspd(wire.full_pace), wire.move(np.full(6, -1400)),
             wire.goto(np.full(6, -1400))]
    assert all(len(Request(65535, line).encode()) <= MAX_LINE + 1 for line in lines)


@pytest.mark.parametrize('way, time_s', [([1000, 500, 0, 0, 0, 0], 1.5),
                                         ([300, -300, 100, 0, 0, 50], 0.6),
                                         ([0, 0, 0, 0, 0, 1400], 3.0)])
def test_the_pace_makes_a_move_last_as_long_as_it_should(way, time_s):
    wire, way = ServoWire(ROBOT, 6, 0.02), np.array(way)
    pace = wire.pace(way, time_s)
    assert (pace <= wire.full_pace).all() and (pace >= 1).all()
    ramps = [Ramp(v / 0.02, 2 / 0.0004, 2 / 0.0004) for v in pace]
    moves = together(np.zeros(6), np.zeros(6), way.astype(float), ramps)
    lasts = max(move.duration for move in moves)
    assert lasts == pytest.approx(time_s, rel=0.15)


def test_too_many_joints_for_a_line_are_a_sentence():
    many = dataclasses.replace(ROBOT, joints=tuple(
        dataclasses.replace(ROBOT.joints[0], name=f'j{k}', channel=k + 1) for k in range(20)))
    with pytest.raises(LinkError, match='20 joints do not fit'):
        ServoWire(many, 20, 0.02)
