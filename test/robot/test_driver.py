"""The driver: when it moves, when it stops, and what lets it go on."""

import itertools
import math
import threading
import time

from homography_servo.errors import LinkError
from homography_servo.result import Rejected
from homography_servo.robot.device import Device
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.protocol import Request
from homography_servo.robot.trajectory import accept
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.wire import LINE_SHARE
from homography_servo.robot.wire import LineBudget
from homography_servo.robot.wire import rate_for
from homography_servo.robot.wire import ServoWire
from link_setup import decoded
from link_setup import Judge
from link_setup import NAMES
from link_setup import Rig
from link_setup import ROBOT
import numpy as np
import pytest

HALF_UNIT = 0.6 / 940.0  # rad, of the coarsest servo


@pytest.fixture
def rig():
    return Rig().run(0.2)


def moving(rig, joints_rad=(0.8,) * 6):
    """Begin a motion and be in the middle of it."""
    assert rig.send((1.0, joints_rad), (2.0, np.negative(joints_rad))) is None
    rig.run(0.5)
    assert rig.state == 'MOVING'
    return rig


def stands(rig, time_s=0.3):
    before = rig.device.machine.positions(rig.now_s)
    rig.run(time_s)
    return rig.device.machine.positions(rig.now_s) == before


def first_words(lines):
    return [line.split()[0] for line in lines if line]


# --- coming up ---------------------------------------------------------------------------

def test_it_comes_up_idle_and_has_told_the_device_its_limits(rig):
    assert [state for _, state in rig.states] == ['DISCONNECTED', 'IDLE']
    for joint in ROBOT.joints:
        low, high = joint.limits_units
        row = rig.device.machine.table.rows[joint.channel - 1]
        assert low - 1e-6 <= row['minpos'] < low + 1 and high - 1 < row['maxpos'] <= high + 1e-6
        assert row['maxspd'] / 0.02 <= joint.velocity_rad_s * joint.units_per_rad
        assert row['accel'] / 0.02 ** 2 <= joint.acceleration_rad_s2 * joint.units_per_rad
    assert rig.heard()[0] == '!hello' and '!watch 500' in rig.heard()


def test_a_device_is_set_up_in_the_order_that_the_page_of_the_link_tells(rig):
    at_start = ['!hello', '!watch', '?', '!resume', 'minpos', 'minpos', 'minpos', 'maxspd',
                '?pos', '?prop', '?']
    assert first_words(rig.heard())[:len(at_start)] == at_start
    rig.break_at.add(rig.operations + 1)
    lost_s = rig.now_s
    rig.run(1.0)
    again = first_words(rig.heard(lost_s))
    again = again[again.index('!hello'):]
    assert again[:len(at_start) + 1] == ['!hello', '!stop', *at_start[1:]]
    assert '!reset' not in again and rig.state.startswith('LATCHED: the link was lost')


def test_a_device_that_had_been_stopped_needs_a_reset_first():
    device = Device()
    device.feed(b'\x18', 0.0)
    rig = Rig(device).run(0.2)
    assert rig.state == 'LATCHED: the device had been stopped before'
    rig.reset()
    assert rig.state == 'IDLE'


def test_a_device_that_moves_when_the_link_comes_up_is_stopped():
    device = Device()
    device.feed(Request(1, '!hello').encode() + Request(2, 'move 1 to 1400').encode(), 1000.0)
    rig = Rig(device).run(0.2)
    assert rig.state.startswith('LATCHED: the arm was moving') and stands(rig)


@pytest.mark.parametrize('baud', [9600, 115200])
def test_a_device_that_somebody_has_paused_on_the_way_does_not_go_on(rig, baud):
    rig.send((5.0, [0.9] * 6))
    rig.run(1.0).driver.pause(True, rig.now_s)
    rig.run(0.5)
    device = rig.device
    device._watch_s = 0.0  # it waits for us for as long as it takes
    where = device.machine.positions(rig.now_s)
    other = Rig(device, DriverSettings(baud=baud), first_seq=30000)
    other.now_s = rig.now_s
    other.run(3.0)
    assert other.state == 'LATCHED: the arm was moving when the link came up'
    assert device.machine.positions(other.now_s) == where
    other.reset()
    assert other.state == 'IDLE' and stands(other) and not device.machine.paused


def test_what_does_not_fit_is_forgotten_with_the_device():
    rig = Rig(Device(servos=4)).run(0.5)
    assert 'uses servo 6' in rig.driver.problem
    rig.absent = True
    rig.break_at.add(rig.operations + 1)
    rig.run(1.0)
    assert 'absent' in rig.driver.problem and 'uses servo 6' not in rig.driver.problem


def test_too_few_servos_are_a_sentence():
    rig = Rig(Device(servos=4)).run(0.5)
    assert rig.go([0.1] * 6).reason == 'not connected' and rig.state == 'DISCONNECTED'
    assert 'uses servo 6' in rig.driver.problem
    with pytest.raises(LinkError, match='uses servo 6, the device has 4'):
        ServoWire(ROBOT, 4, 0.02)


def test_before_the_link_is_up_nothing_is_taken():
    rig = Rig()
    assert rig.go([0.0] * 6).reason == 'not connected'
    assert rig.driver.power(True).reason == 'not connected'
    assert 'not connected' in rig.driver.reset(0.0).reason
    rig.run(0.2).driver.active = False
    assert rig.go([0.0] * 6).reason == 'the node is not active'


# --- moving ------------------------------------------------------------------------------

def test_a_single_point_is_one_move_that_takes_the_time_it_was_given(rig):
    start_s = rig.now_s
    assert rig.send((1.5, [0.5, -0.4, 0.3, 0.0, 0.2, -0.1])) is None
    rig.run(2.5)
    lines = rig.heard(start_s)
    assert sum(line.startswith('move ') for line in lines) == 1
    assert not any(line.startswith('!goto') for line in lines)
    assert rig.arm.positions == pytest.approx([0.5, -0.4, 0.3, 0.0, 0.2, -0.1], abs=HALF_UNIT)
    ended_s = [time_s for time_s, state in rig.states if state == 'IDLE'][-1]
    assert ended_s - start_s == pytest.approx(1.5, abs=0.3) and rig.state == 'IDLE'


def test_several_points_are_streamed_and_passed_in_time(rig):
    joints = ROBOT.joint_names
    wanted = [(0.8, [0.3, 0.2, -0.3, 0.1, 0.0, 0.2]), (2.0, [0.6, 0.0, -0.1, 0.1, 0.3, 0.2])]
    start_s = rig.now_s
    assert rig.send(*wanted) is None
    rig.run(0.8)
    lag = np.abs(rig.arm.positions - wanted[0][1]).max()
    assert lag < 0.1, lag  # the device brakes for every target: it follows a little later
    rig.run(1.7)
    gotos = [line for line in rig.heard(start_s) if line.startswith('!goto')]
    assert 60 <= len(gotos) <= 110 and len(joints) == 6
    assert rig.arm.positions == pytest.approx(wanted[1][1], abs=HALF_UNIT)
    assert rig.state == 'IDLE' and not rig.arm.velocities.any()


def test_a_stream_that_stands_at_its_goal_on_the_way_goes_on(rig):
    assert rig.send((0.5, [0.3] * 6), (1.0, [0.3] * 6), (1.8, [0.6] * 6), (2.6, [0.3] * 6)) is None
    rig.run(1.9)
    assert rig.arm.positions == pytest.approx([0.6] * 6, abs=0.05) and rig.state == 'MOVING'
    rig.run(1.5)
    assert rig.arm.positions == pytest.approx([0.3] * 6, abs=HALF_UNIT) and rig.state == 'IDLE'


def test_velocities_tell_that_it_moves_and_that_it_stands(rig):
    rig.send((1.0, [0.5] * 6))
    rig.run(0.5)
    assert rig.arm.velocities == pytest.approx([0.7] * 6, rel=0.5)
    rig.run(1.0)
    assert not rig.arm.velocities.any()


def test_a_new_trajectory_replaces_the_old_one_without_a_jump(rig):
    moving(rig)
    start_s = rig.now_s
    assert rig.send((1.5, [-0.2] * 6)) is None
    rig.run(2.5)
    assert rig.arm.positions == pytest.approx([-0.2] * 6, abs=HALF_UNIT)
    assert Judge().watch(rig.log).violations == [] and rig.state == 'IDLE'
    assert not any(line.startswith('move') for line in rig.heard(start_s))


@pytest.mark.parametrize('every_s', [1.0 / 30.0, 1.0 / 120.0])
def test_commands_that_keep_coming_do_not_slow_the_arm_down(rig, every_s):
    def time_to_goal(goal, again_s):
        start_s = next_s = rig.now_s
        while np.abs(rig.arm.positions - goal).max() > 0.01 and rig.now_s < start_s + 10.0:
            if rig.now_s >= next_s:
                assert rig.go(goal) is None
                next_s += again_s
            rig.turn()
        return rig.now_s - start_s
    alone_s = time_to_goal([0.7, 0.5, -0.4, 0.3, 0.2, 0.6], 10.0)
    rig.run(0.5)
    assert time_to_goal([0.0] * 6, every_s) < 1.6 * alone_s
    assert Judge().watch(rig.log).violations == []


def test_a_new_trajectory_is_on_the_wire_at_once(rig):
    moving(rig)
    assert rig.send((2.5, [-0.9] * 6)) is None
    rig.run(0.5)  # where the arm turns round there is no new whole number for a while
    waited_s, step_s = [], 0.001
    rig.step_s = step_s
    for k in range(40):
        rig.run(0.02 + 0.00137 * (k % 10))
        sent_s = rig.now_s
        assert rig.send((2.5 - 0.03 * k, [-0.9] * 6), (5.0, [0.0] * 6)) is None
        while not any(line.startswith('!goto') for line in rig.heard(sent_s)):
            rig.turn()
            assert rig.now_s < sent_s + 0.1
        waited_s.append(rig.now_s - sent_s)
    assert max(waited_s) < LineBudget(115200).least_s + 3 * step_s
    assert Judge().watch(rig.log).violations == []


def test_a_move_under_way_is_replaced_too(rig):
    rig.send((1.5, [0.9] * 6))
    rig.run(0.7)
    before = rig.arm
    assert rig.send((1.0, [0.0] * 6)) is None
    rig.run(0.05)
    assert (rig.arm.positions > before.positions - 0.02).all()  # no jerk backwards
    rig.run(2.0)
    assert rig.arm.positions == pytest.approx([0.0] * 6, abs=HALF_UNIT) and rig.state == 'IDLE'


def test_no_points_mean_stop_softly_and_stay_ready(rig):
    moving(rig)
    assert rig.send() is None
    rig.run(0.8)
    assert rig.state == 'IDLE' and stands(rig) and b'\x18' not in rig.log[-1][1]
    assert rig.go([0.0] * 6) is None


@pytest.mark.parametrize('way_rad', [0.03, 0.05, 0.3])
@pytest.mark.parametrize('moved_s', [0.03, 0.1, 0.25])
def test_a_slow_move_is_stopped_even_where_braking_takes_less_than_a_servo_step(
        rig, way_rad, moved_s):
    assert rig.send((2.0, [way_rad, -way_rad, 0.0, 0.1 * way_rad, 0.0, way_rad])) is None
    rig.run(moved_s)
    assert rig.state == 'MOVING' and rig.send() is None
    rig.run(0.25)
    assert rig.state == 'IDLE' and stands(rig, 2.5)
    assert np.abs(rig.arm.positions).max() < 0.5 * way_rad + HALF_UNIT


def test_a_hold_stops_a_slow_move_too(rig):
    rig.send((2.0, [0.02] * 6))
    rig.run(0.3)
    rig.driver.hold('a reason', rig.now_s)
    rig.run(0.2)
    assert rig.state == 'HOLD: a reason' and stands(rig, 2.0)


def test_what_replaces_a_slow_move_is_not_slow(rig):
    rig.send((5.0, [0.2] * 6))
    rig.run(0.5)
    assert rig.send((0.6, [0.3] * 6), (1.2, [0.6] * 6)) is None
    rig.run(1.6)
    assert rig.arm.positions == pytest.approx([0.6] * 6, abs=HALF_UNIT) and rig.state == 'IDLE'
    rows = [row['maxspd'] for row in rig.device.machine.table.rows]
    assert rows == list(rig.driver._mover.wire.full_pace)
    assert Judge().watch(rig.log).violations == []


def test_the_pace_is_told_again_when_the_device_has_thrown_it_away(rig):
    for _ in range(3):  # slow, stopped, streamed, stopped: whatever the queue has lost
        rig.send((5.0, [0.2] * 6))
        rig.run(0.3)
        rig.send()
        rig.send((0.5, [0.1] * 6), (0.8, [0.0] * 6))
        rig.run(0.1)
        rig.send()
        rig.run(0.3)
    start_s = rig.now_s
    assert rig.send((0.5, [0.3] * 6)) is None
    rig.run(0.9)
    assert rig.arm.positions == pytest.approx([0.3] * 6, abs=HALF_UNIT) and rig.state == 'IDLE'
    assert [line for line in rig.heard(start_s) if line.startswith('move')]


def lose_line(rig, word):
    """Lose the next line with a word on its way to the device; give a list of what was lost."""
    lost, feed = [], rig.device.feed
    rig.device.feed = lambda data, now_s: feed(without_next(word, lost, data), now_s)
    return lost


def without_next(word, lost, data):
    """Take the next line with a word out of data, unless one is lost already."""
    kept = b''
    for line in data.splitlines(True):
        if word in line and not lost:
            lost.append(line)
        else:
            kept += line
    return kept


def test_home_is_slow_even_if_the_line_that_makes_it_slow_is_lost(rig):
    rig.send((1.5, [1.0] * 6))
    rig.run(2.5)
    lost, start_s, fastest = lose_line(rig, b'maxspd'), rig.now_s, 0.0
    assert rig.driver.home(rig.now_s) is None
    while rig.state != 'IDLE' or rig.now_s < start_s + 0.5:
        rig.run(0.02)
        fastest = max(fastest, np.abs(rig.arm.velocities).max())
    assert lost and 0.1 < fastest < 0.35 and not rig.arm.positions.any()


def test_what_replaces_a_slow_move_is_not_slow_if_the_first_target_is_lost(rig):
    rig.send((5.0, [0.2] * 6))
    rig.run(1.0)
    lost = lose_line(rig, b'!goto')
    assert rig.send((1.0, [0.6] * 6), (2.0, [1.2] * 6)) is None
    rig.run(2.7)
    assert lost and rig.arm.positions == pytest.approx([1.2] * 6, abs=HALF_UNIT)


@pytest.mark.parametrize('after_s', [0.005, 0.02, 0.04])
def test_what_comes_after_a_stop_is_not_slow_whatever_was_under_way(rig, after_s):
    rig.send((5.0, [0.2] * 6))
    rig.run(1.0)
    rig.send((1.0, [0.6] * 6), (2.0, [1.2] * 6))  # the line of its pace waits for a target
    rig.run(after_s)
    rig.driver.stop_now('a test')
    rig.run(0.1)
    rig.reset()
    assert rig.send((1.0, [0.6] * 6), (2.0, [1.2] * 6)) is None
    rig.run(2.5)
    assert rig.arm.positions == pytest.approx([1.2] * 6, abs=HALF_UNIT) and rig.state == 'IDLE'


def test_a_pace_that_was_lost_is_not_told_again_after_a_stop(rig):
    lost = lose_line(rig, b'maxspd')
    rig.send((5.0, [0.2] * 6))
    rig.run(0.02)
    rig.driver.stop_now('a test')
    rig.driver.reset(0.0)
    rig.run(0.03)
    assert lost and rig.state == 'IDLE'
    points = (0.02, [0.001] * 6), (0.3, [0.001] * 6), (1.3, [0.6] * 6), (2.3, [1.2] * 6)
    assert rig.send(*points) is None
    rig.run(4.5)
    assert rig.arm.positions == pytest.approx([1.2] * 6, abs=HALF_UNIT) and rig.state == 'IDLE'


def test_a_command_to_where_it_stands_moves_nothing(rig):
    start_s = rig.now_s
    assert rig.go([0.0] * 6) is None
    rig.run(0.3)
    assert {line for line in rig.heard(start_s)} <= {'?', '?pos'} and rig.state == 'IDLE'


@pytest.mark.parametrize('names, points, reason', [
    (NAMES[:5], [(1.0, [0.0] * 5)], 'joint6'),
    ((*NAMES[:5], 'wrist'), [(1.0, [0.0] * 6)], 'wrist'),
    ((*NAMES[:5], 'joint1'), [(1.0, [0.0] * 6)], 'joint1'),
    ((), [(1.0, [0.0] * 6)], 'names'),
    (NAMES, [(1.0, [0.0] * 5)], '5 positions'),
    (NAMES, [(2.0, [0.0] * 6), (1.0, [0.0] * 6)], 'increase'),
    (NAMES, [(-1.0, [0.0] * 6)], 'negative'),
    (NAMES, [(1.0, [math.nan] + [0.0] * 5)], 'not finite'),
    (NAMES, [(1.0, [math.inf] + [0.0] * 5)], 'not finite'),
    (NAMES, [(1.0, [ROBOT.upper_rad[0] - 0.05 + 1e-9] + [0.0] * 5)], 'outside'),
    (NAMES, [(1.0, [-1e9] + [0.0] * 5)], 'outside'),
    (NAMES, [(1.0, [0.1] * 6, [99.0] * 6)], 'above its limit'),
    (NAMES, [(1.0, [0.1] * 6, [0.1] * 6)], 'at rest'),
    (NAMES, [(1e-4, [1.0] * 6)], 'more than'),
])
def test_what_is_wrong_is_refused_with_a_reason_and_moves_nothing(rig, names, points, reason):
    start_s = rig.now_s
    problem = rig.driver.command(names, [TrajectoryPoint(*p) for p in points], rig.now_s)
    assert isinstance(problem, Rejected) and reason in problem.reason
    rig.run(0.3)
    assert {line for line in rig.heard(start_s)} <= {'?', '?pos'} and rig.state == 'IDLE'


def test_a_command_at_the_limit_is_taken_and_arrives_inside(rig):
    goal = ROBOT.upper_rad - 0.05
    assert rig.send((3.0, goal)) is None
    rig.run(4.0)
    assert (rig.arm.positions <= goal + 1e-9).all()
    assert rig.arm.positions == pytest.approx(goal, abs=2 * HALF_UNIT)


def test_home_is_slow_and_ends_at_zero(rig):
    rig.send((2.0, [0.6] * 6))
    rig.run(3.0)
    start_s = rig.now_s
    assert rig.driver.home(rig.now_s) is None
    fastest = 0.0
    while rig.state != 'IDLE' or rig.now_s < start_s + 0.5:
        rig.run(0.02)
        fastest = max(fastest, np.abs(rig.arm.velocities).max())
    assert 0.1 < fastest < 0.35 and not rig.arm.positions.any()


def test_an_arm_outside_its_limits_comes_back_by_one_move_only():
    device = Device()
    device.feed(Request(1, '!hello').encode() + Request(2, 'move 1 to 1400').encode(), 990.0)
    rig = Rig(device).run(0.2)
    assert rig.state == 'IDLE'
    assert 'outside its limits' in rig.send((1.0, [0.1] * 6), (2.0, [0.2] * 6)).reason
    assert rig.driver.home(rig.now_s) is None
    rig.run(8.0)
    assert rig.state == 'IDLE' and not rig.arm.positions.any()


# --- stopping ----------------------------------------------------------------------------

def test_stop_reaches_the_wire_at_once_and_nothing_moves_before_a_reset(rig):
    moving(rig)
    before = len(rig.log)
    assert rig.driver.stop_now('a test')
    assert rig.log[before][1] == b'\x18'
    assert stands(rig) and rig.state == 'LATCHED: a test'
    assert 'latched (a test); call ~/reset' in rig.go([0.0] * 6).reason
    rig.run(0.5)
    assert Judge().watch(rig.log).violations == []
    rig.reset()
    assert rig.state == 'IDLE' and stands(rig)
    assert rig.go([0.0] * 6) is None
    rig.run(2.0)
    assert not rig.arm.positions.any()


def test_a_command_that_waits_when_the_stop_comes_does_not_run(rig):
    seen = []
    rig.driver.offer(lambda now_s: seen.append(rig.go([0.5] * 6)))
    rig.driver.stop_now('a test')
    rig.run(0.3)
    assert 'latched' in seen[0].reason and not rig.arm.positions.any()


def test_a_reset_while_it_moves_changes_nothing(rig):
    moving(rig)
    rig.reset()
    rig.run(5.0)
    assert rig.arm.positions == pytest.approx([-0.8] * 6, abs=HALF_UNIT)


def test_reset_waits_for_the_device(rig):
    rig.driver.stop_now('a test')
    answers = []
    thread = threading.Thread(target=lambda: answers.append(rig.driver.reset(5.0)))
    thread.start()
    while thread.is_alive():
        rig.turn()
        time.sleep(0.001)
    assert answers == [None] and rig.state == 'IDLE'
    rig.silent = True
    rig.driver.stop_now('again')
    assert 'did not answer' in rig.driver.reset(0.01).reason


@pytest.mark.parametrize('on_its_way', [False, True])
def test_a_stop_after_a_reset_that_has_no_answer_yet_is_stronger(rig, on_its_way):
    rig.driver.stop_now('a test')
    rig.run(0.1)
    if on_its_way:
        lose_line(rig, b'!reset')  # and asked for again after the stop
    rig.driver.reset(0.0)
    if on_its_way:
        rig.turn()
    rig.states.clear()
    rig.driver.stop_now('again')
    rig.run(1.0)
    assert [state for _, state in rig.states] == ['LATCHED: a test']
    assert rig.device.machine.latched
    rig.reset()
    assert rig.state == 'IDLE'


def test_a_stream_of_commands_that_ends_is_held_in_time(rig):
    for k in range(40):
        assert rig.go([0.02 * k] * 6) is None
        rig.run(0.02)
    ended_s = rig.now_s
    rig.run(1.0)
    held_s = next(time_s for time_s, state in rig.states if state.startswith('HOLD'))
    assert held_s - ended_s < 0.27 and 'no command for 0.25 s' in rig.state
    assert rig.go([0.0] * 6) is None and rig.state == 'MOVING'  # goes on by itself


def test_one_command_is_no_stream_and_runs_to_its_end(rig):
    rig.send((1.5, [0.8] * 6))
    rig.run(0.1)
    rig.send((1.5, [0.7] * 6))
    rig.run(3.0)
    assert rig.arm.positions == pytest.approx([0.7] * 6, abs=HALF_UNIT) and rig.state == 'IDLE'


def test_a_timed_hold_locks_commands_out_until_it_is_over(rig):
    moving(rig)
    rig.driver.hold('two of them', rig.now_s, 1.0)
    assert rig.go([0.0] * 6).reason == 'two of them'
    rig.run(0.9)
    assert rig.state == 'HOLD: two of them' and stands(rig, 0.05)
    rig.run(0.1)
    assert rig.state == 'IDLE' and rig.go([0.0] * 6) is None


def test_pause_stands_and_going_on_ends_where_it_should(rig):
    for points in ([(1.0, [0.5] * 6)], [(1.0, [-0.5] * 6), (2.0, [0.2] * 6)]):
        assert rig.send(*points) is None
        rig.run(0.5)
        assert rig.driver.pause(True, rig.now_s) is None
        rig.run(0.4)
        assert rig.state == 'HOLD: paused' and stands(rig)
        assert 'paused' in rig.go([0.0] * 6).reason
        rig.driver.pause(False, rig.now_s)
        rig.run(3.0)
        assert rig.arm.positions == pytest.approx(points[-1][1], abs=HALF_UNIT)
        assert rig.state == 'IDLE'


@pytest.mark.parametrize('points', [[(1.0, [0.5] * 6)], [(1.0, [-0.5] * 6), (2.0, [0.2] * 6)]])
def test_what_is_stopped_while_it_is_paused_does_not_go_on(rig, points):
    assert rig.send(*points) is None
    rig.run(0.5)
    rig.driver.pause(True, rig.now_s)
    rig.run(0.4)
    stood = rig.arm.positions
    assert rig.driver.command((), (), rig.now_s) is None
    rig.run(0.2)
    assert rig.state == 'HOLD: paused' and rig.arm.positions == pytest.approx(stood, abs=HALF_UNIT)
    rig.driver.pause(False, rig.now_s)
    rig.run(3.0)
    assert rig.state == 'IDLE'
    assert np.abs(np.array(rig.arm.positions) - stood).max() < 0.12  # it brakes on the way


@pytest.mark.parametrize('on', [False, True])
@pytest.mark.parametrize('what', ['pause', 'power'])
def test_the_last_order_is_in_force_even_if_the_one_before_was_lost(rig, what, on):
    def order(value, then_s):
        assert rig.driver.power(value) is None if what == 'power' else \
            rig.driver.pause(value, rig.now_s) is None
        rig.run(then_s)
    moving(rig)
    order(on, 0.1)
    lost = lose_line(rig, b'!power' if what == 'power' else b'!resume' if on else b'!pause')
    order(not on, 0.01)
    order(on, 0.5)
    machine = rig.device.machine
    assert lost
    assert (machine.paused if what == 'pause' else machine.table.rows[0]['power'] > 0) == on


def test_power_off_ends_a_motion_and_refuses_others(rig):
    moving(rig)
    assert rig.driver.power(False) is None
    rig.run(0.1)
    assert rig.state == 'HOLD: power is off' and stands(rig)
    assert 'power is off' in rig.go([0.0] * 6).reason
    rig.driver.power(True)
    rig.run(0.1)
    assert rig.state == 'IDLE' and rig.go([0.0] * 6) is None


def test_an_arm_has_power_when_the_device_says_so(rig):
    rig.driver.power(False)
    rig.run(0.1)
    rig.silent = True
    rig.driver.power(True)
    rig.run(0.05)
    assert 'power is off' in rig.go([0.1] * 6).reason
    rig.driver.power(False)
    rig.silent = False
    rig.run(0.5)
    assert rig.state == 'HOLD: power is off'  # the last order


@pytest.mark.parametrize('restarted', [False, True])
def test_power_that_is_off_is_known_after_a_lost_link_and_after_a_restart(rig, restarted):
    rig.driver.power(False)
    rig.run(0.1)
    if restarted:
        rig = Rig(rig.device).run(0.2)
    else:
        rig.silent = True
        rig.run(0.3)
        rig.silent = False
        rig.run(2.0)
        assert rig.state.startswith('LATCHED: the link was lost')
        rig.reset()
    assert rig.state == 'HOLD: power is off' and 'power is off' in rig.go([0.1] * 6).reason
    rig.driver.power(True)
    rig.run(0.1)
    assert rig.state == 'IDLE' and rig.go([0.1] * 6) is None


def test_power_on_while_it_moves_changes_nothing(rig):
    moving(rig)
    rig.driver.power(True)
    rig.run(5.0)
    assert rig.arm.positions == pytest.approx([-0.8] * 6, abs=HALF_UNIT)
    assert Judge().watch(rig.log).violations == []


def test_a_farewell_stops_a_moving_arm_and_leaves_a_resting_one_unlatched(rig):
    rig.driver.quit(rig.now_s)
    rig.device.step(rig.now_s + 10.0)
    assert not rig.device.machine.latched and rig.heard()[-1] == '!watch 0'
    moving(rig)
    rig.driver.quit(rig.now_s)
    assert rig.log[-1][1] == b'\x18'


# --- faults ------------------------------------------------------------------------------

def test_a_silent_line_latches_within_300_ms(rig):
    moving(rig)
    rig.silent, since_s = True, rig.now_s
    rig.run(0.3)
    assert rig.state == 'DISCONNECTED' and rig.states[-1][0] - since_s < 0.3
    rig.silent = False
    rig.run(2.0)
    assert rig.state.startswith('LATCHED: the link was lost') and stands(rig)
    assert Judge().watch(rig.log).violations == []
    rig.reset()
    assert rig.state == 'IDLE' and stands(rig)


def test_it_comes_back_within_6_s_after_a_long_absence(rig):
    rig.absent, rig.silent = True, True
    rig.run(30.0)
    rig.absent = rig.silent = False
    back_s = rig.now_s
    rig.run(6.0)
    assert rig.state.startswith('LATCHED') and rig.states[-1][0] - back_s < 6.0


def test_a_line_that_takes_no_byte_is_lost_and_no_write_waits(rig):
    moving(rig)
    rig.blocked, start = True, time.monotonic()
    rig.run(0.4)
    assert rig.state == 'DISCONNECTED' and time.monotonic() - start < 1.0


@pytest.mark.parametrize('notice, why', [('ESTOP', 'the device was stopped'),
                                         ('WATCHDOG', 'heard nothing')])
def test_what_the_device_cries_latches(rig, notice, why):
    moving(rig)
    rig.spoil = lambda data: data + encode_line(f'! {notice}')
    rig.turn()
    rig.spoil = lambda data: data
    rig.run(0.2)
    assert why in rig.state


def test_a_device_that_restarts_is_greeted_again_and_latched(rig):
    moving(rig)
    rig.device.__init__()
    rig.run(2.0)
    assert rig.state.startswith('LATCHED') and 'restarted' in rig.state
    assert rig.device.machine.table.rows[0]['maxspd'] < 100  # told its limits again


def test_a_device_that_restarts_unheard_is_greeted_again_and_latched(rig):
    moving(rig)
    rig.device.__init__()
    rig.device.take()  # its READY is lost
    rig.run(2.0)
    assert rig.state.startswith('LATCHED')
    assert rig.device.machine.table.rows[0]['maxspd'] < 100
    rig.reset()
    assert rig.state == 'IDLE'


def test_a_refused_motion_latches_with_the_error(rig):
    rig.device.machine.table.rows[2]['maxpos'] = 10
    rig.send((1.0, [0.5] * 6))
    rig.run(0.5)
    assert rig.state.startswith('LATCHED: the device refused move: error 102')


def test_a_servo_that_does_not_follow_is_noticed(rig):
    rig.device.machine.freeze(2, rig.now_s)
    rig.send((1.0, [0.5] * 6))
    rig.run(2.0)
    assert rig.state.startswith('LATCHED: joint3 did not follow')


def test_a_lost_done_is_made_up_by_the_status(rig):
    rig.spoil = lambda data: b''.join(line for line in data.splitlines(True)
                                      if b'DONE' not in line)
    for points in ([(0.5, [0.3] * 6)], [(0.5, [0.1] * 6), (1.0, [0.2] * 6)]):
        rig.send(*points)
        rig.run(3.0)
        assert rig.state == 'IDLE'


def lose_reply(rig, word):
    """Lose the next reply with a word; give a list of what was lost."""
    lost = []
    rig.spoil = lambda data: without_next(word, lost, data)
    return lost


@pytest.mark.parametrize('after_s', np.linspace(0.9, 0.96, 13))
def test_an_old_position_told_again_is_not_taken_for_where_the_arm_is_now(rig, after_s):
    assert rig.send((1.0, [0.5] * 6)) is None
    back_rad, before = 0.0, rig.arm.positions
    rig.run(after_s)  # it arrives within the 100 ms until the position is asked for again
    lost = lose_reply(rig, b' POS')
    for _ in range(200):
        rig.turn()
        back_rad, before = max(back_rad, (before - rig.arm.positions).max()), rig.arm.positions
    assert lost and rig.state == 'IDLE' and back_rad < 0.01


def test_an_old_status_told_again_does_not_undo_a_reset(rig):
    rig.driver.stop_now('a test')
    lost = lose_reply(rig, b' ST STOPPED')
    while not lost:
        rig.turn()
    rig.reset()
    rig.run(0.3)
    assert [state for _, state in rig.states if state != 'IDLE'][1:] == ['LATCHED: a test']
    assert rig.state == 'IDLE'


def test_a_device_that_answers_late_every_time_is_believed(rig):
    late = []

    def spoil(data):
        late.append((rig.now_s + 0.15, data))
        said = b''.join(data for due_s, data in late if due_s <= rig.now_s)
        late[:] = [item for item in late if item[0] > rig.now_s]
        return said
    rig.spoil = spoil
    rig.run(0.5)
    for points in ([(1.0, [0.5] * 6)], [(1.0, [0.2] * 6), (2.0, [0.4] * 6)]):
        assert rig.send(*points) is None
        rig.run(6.0)
        assert rig.arm.positions == pytest.approx(points[-1][1], abs=HALF_UNIT)
        assert rig.state == 'IDLE'


def test_a_lost_ok_is_made_up_by_the_end_of_its_target(rig):
    assert rig.send((0.3, [0.1] * 6), (0.8, [0.1] * 6), (1.5, [0.2] * 6)) is None
    while rig.arm.positions[0] < 0.098:
        rig.turn()
    lost = lose_reply(rig, b' OK')  # of one of the last targets before the arm waits
    rig.run(3.0)
    assert lost and rig.state == 'IDLE'
    assert rig.arm.positions == pytest.approx([0.2] * 6, abs=HALF_UNIT)


@pytest.mark.parametrize('share', [0.1, 0.3])
def test_lost_replies_are_asked_for_again_and_nothing_runs_twice(share):
    rng = np.random.default_rng(1)
    rig = Rig().run(0.2)
    rig.spoil = lambda data: b''.join(line for line in data.splitlines(True)
                                      if rng.random() > share)
    rig.send((1.0, [0.3] * 6), (2.0, [0.2] * 6))
    rig.run(4.0)
    judge = Judge().watch(rig.log)
    assert judge.violations == []
    assert rig.driver.all_counts['repeats'] > 3
    if rig.state == 'IDLE':
        assert rig.arm.positions == pytest.approx([0.2] * 6, abs=HALF_UNIT)
    else:
        assert rig.state.startswith(('LATCHED', 'DISCONNECTED'))


def test_garbage_between_replies_changes_nothing(rig):
    rng = np.random.default_rng(1)
    rig.spoil = lambda data: rng.bytes(200).replace(b'\n', b'') + b'\n' + data
    rig.send((1.0, [0.3] * 6), (2.0, [0.2] * 6))
    rig.run(3.0)
    assert rig.state == 'IDLE'
    assert rig.arm.positions == pytest.approx([0.2] * 6, abs=HALF_UNIT)


def test_a_million_bytes_of_garbage_are_no_answer(rig):
    rng = np.random.default_rng(2)
    rig.spoil = lambda data: rng.bytes(20000)
    rig.run(0.25)
    assert rig.driver.all_counts['bad_lines'] > 1000
    rig.spoil = lambda data: data
    rig.run(2.0)
    assert rig.state == 'IDLE' or rig.state.startswith('LATCHED')
    rig.reset()
    assert rig.state == 'IDLE'


def test_wrong_positions_are_counted_not_believed(rig):
    rig.spoil = lambda data: b''.join(
        encode_line(line[:-6].decode().replace(' 0 0 0', '', 1)) if b'POS' in line else line
        for line in data.splitlines(True))
    rig.run(0.5)
    assert rig.driver.all_counts['bad_positions'] > 5


def script_of_a_session(rig):
    """Move in every way there is, stop, reset, move again."""
    rig.run(0.1)
    rig.send((0.4, [0.2] * 6))
    rig.run(0.2)
    rig.send((0.3, [0.1] * 6), (0.5, [0.0] * 6))
    rig.run(0.3)
    rig.driver.pause(True, rig.now_s)
    rig.run(0.05)
    rig.driver.pause(False, rig.now_s)
    rig.run(0.1)
    rig.driver.stop_now('a test')
    rig.run(0.05)


def operations_of_a_session():
    rig = Rig(step_s=0.02)
    script_of_a_session(rig)
    return rig.operations


def test_io_that_fails_at_the_k_th_call_never_hangs_and_never_moves_before_a_reset():
    """For every k of a session, reads and writes alike; the session itself ends in a stop."""
    for k in range(1, operations_of_a_session() + 1):
        rig, start = Rig(step_s=0.02, break_at=[k]), time.monotonic()
        script_of_a_session(rig)
        rig.run(1.5)
        assert rig.operations >= k and time.monotonic() - start < 20.0
        assert Judge().watch(rig.log).violations == []
        assert rig.state.startswith('LATCHED'), (k, rig.state)
        tried_s = rig.now_s
        assert 'latched' in rig.go([0.3] * 6).reason
        rig.run(0.1)
        assert not [line for line in rig.heard(tried_s) if line.startswith(('move', '!goto'))]
        rig.reset()
        assert rig.state == 'IDLE' and rig.go([0.05] * 6) is None, k


def test_no_turn_takes_long_while_the_line_fails_all_the_time():
    rig = Rig(step_s=0.01, break_at=range(1, 10000, 7))
    longest = 0.0
    for _ in range(2000):
        start = time.monotonic()
        rig.turn()
        longest = max(longest, time.monotonic() - start)
    assert longest < 1.0 and rig.state == 'DISCONNECTED' or rig.state.startswith('LATCHED')


@pytest.mark.parametrize('baud, rate, mean_s, least_s', [
    (1000000, 50.0, 0.005, 0.005), (115200, 50.0, 0.0073, 0.00582),
    (9600, 7.72, 0.1295, 0.0698), (1200, 0.966, 1.036, 0.558)])
def test_the_stream_fits_the_line(baud, rate, mean_s, least_s):
    assert rate_for(baud) == pytest.approx(rate, rel=1e-3)
    assert LineBudget(baud).mean_s == pytest.approx(mean_s, rel=1e-3)
    assert LineBudget(baud).least_s == pytest.approx(least_s, rel=1e-3)


def test_some_targets_may_go_out_early_but_not_many():
    budget, now_s, times_s = LineBudget(115200), 0.0, []
    for _ in range(200):
        now_s = max(now_s + 0.0002, budget.next_s())
        budget.sent(now_s)
        times_s.append(now_s)
    gaps_s = np.diff(times_s)
    assert gaps_s.min() == pytest.approx(budget.least_s)
    assert np.all(gaps_s[20:] == pytest.approx(budget.mean_s))
    budget.sent(now_s + 1.0)  # after a rest it may be early again
    assert budget.next_s() == pytest.approx(now_s + 1.0 + budget.least_s)


@pytest.mark.parametrize('baud', [115200, 9600])
def test_commands_that_keep_coming_leave_room_on_the_line(baud):
    rig = Rig(settings=DriverSettings(baud=baud), step_s=0.002).run(0.3)
    start_s = rig.now_s
    while rig.now_s < start_s + 3.0:
        rig.driver.offer(lambda now_s: rig.driver.go([0.9 * np.sin(now_s)] * 6, now_s))
        rig.turn()
    to_device = sum(len(data) for time_s, data in rig.log if time_s > start_s) / 3.0
    assert 0.3 * baud / 10.0 < to_device < LINE_SHARE * baud / 10.0
    assert Judge().watch(rig.log).violations == []


def test_at_9600_baud_it_moves_too():
    rig = Rig(settings=DriverSettings(baud=9600)).run(0.3)
    start_s = rig.now_s
    rig.send((1.0, [0.3] * 6), (2.0, [0.2] * 6))
    rig.run(3.0)
    down = sum(len(data) for time_s, data in rig.log if time_s > start_s) / 3.0
    assert rig.state == 'IDLE' and down < 960.0
    assert rig.arm.positions == pytest.approx([0.2] * 6, abs=HALF_UNIT)
    assert Judge().watch(rig.log).violations == []


def test_sequence_numbers_go_round_in_a_session():
    rig = Rig(first_seq=65500).run(0.2)
    rig.send((1.0, [0.3] * 6), (2.0, [0.2] * 6))
    rig.run(3.0)
    numbers = [int(text.split()[0]) for text, _ in decoded(rig.log)]
    assert 65535 in numbers and 1 in numbers and 0 not in numbers
    assert rig.state == 'IDLE'
    assert all(b == a + 1 or (a, b) == (65535, 1) for a, b in itertools.pairwise(numbers))


# --- while a command is judged ------------------------------------------------------------

def judged_while(rig, monkeypatch, happens, *points):
    """Let something happen in another thread while a command of these points is judged."""
    def slow(*args, **kwargs):
        thread = threading.Thread(target=happens)
        thread.start()
        thread.join()
        return accept(*args, **kwargs)
    monkeypatch.setattr('homography_servo.robot.driver.accept', slow)
    answers = []
    rig.driver.offer(lambda now_s: answers.append(rig.send(*points)))
    rig.turn()
    rig.run(0.3)
    return answers


@pytest.mark.parametrize('points', [1, 2])
def test_a_stop_while_a_command_is_judged_is_the_last_word(rig, monkeypatch, points):
    way = [(1.0, [0.3] * 6), (2.0, [0.5] * 6)][:points]
    (answer,) = judged_while(rig, monkeypatch, lambda: rig.driver.stop_now('a person'), *way)
    assert 'latched (a person)' in answer.reason and stands(rig)
    assert Judge().watch(rig.log).violations == []


def test_a_command_that_is_judged_while_motion_is_forbidden_is_refused(rig, monkeypatch):
    (answer,) = judged_while(rig, monkeypatch,
                             lambda: setattr(rig.driver, 'active', False), (1.0, [0.3] * 6))
    assert answer.reason == 'the node is not active' and rig.state == 'IDLE' and stands(rig)


def test_an_arm_whose_command_is_judged_is_not_called_at_rest(rig, monkeypatch):
    resting = []
    judged_while(rig, monkeypatch, lambda: resting.append(rig.driver.resting), (1.0, [0.3] * 6))
    assert resting == [False]


def test_nothing_that_waits_is_begun_after_a_deactivation(rig):
    moving(rig)
    answers = []
    rig.driver.offer(lambda now_s: answers.append(rig.send((1.0, [0.3] * 6), (9.0, [0.9] * 6))))
    rig.driver.deactivate(rig.now_s)
    rig.run(1.0)
    assert answers[0].reason == 'the node is not active' and rig.state == 'IDLE' and stands(rig)


def test_a_braked_move_ends_though_its_last_line_was_lost(rig):
    assert rig.go([0.6] * 6) is None
    rig.run(3.0)
    assert rig.driver.home(rig.now_s) is None
    rig.run(0.5)
    start_s = rig.now_s
    assert rig.driver.command((), (), rig.now_s) is None
    rig.turn()
    target = next(text.split()[0] for text, _ in decoded(
        [(time_s, data) for time_s, data in rig.log if time_s >= start_s]) if '!goto' in text)
    lost = lose_reply(rig, f'{target} DONE'.encode())
    rig.run(3.0)
    assert lost and rig.state == 'IDLE' and rig.driver.resting
