"""An arm is opened and closed as one, with its emulated device, thread and logs."""

import dataclasses
import os
import threading
import time

from homography_servo.errors import LinkError
from homography_servo.robot.arm import Arm
from homography_servo.robot.arm_thread import ArmThread
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.port import Port
from homography_servo.robot.port import PortSettings
from homography_servo.robot.protocol import ESTOP_BYTE
from homography_servo.robot.trajectory import TrajectorySettings
from link_setup import ROBOT
import pytest

PATIENCE_S = 20.0


def opened(**changes) -> Arm:
    return Arm(ROBOT, PortSettings(**changes), DriverSettings(), TrajectorySettings())


def await_state(arm: Arm, wanted: str) -> None:
    """Wait until the driver says so."""
    until_s = time.monotonic() + PATIENCE_S
    while arm.driver.state != wanted and time.monotonic() < until_s:
        arm.wake()
        time.sleep(0.01)
    assert arm.driver.state == wanted


def held() -> tuple[int, int]:
    return len(os.listdir('/proc/self/fd')), threading.active_count()


def test_an_emulated_arm_moves_and_leaves_nothing_behind(tmp_path):
    before = held()
    arm = opened(session_log=str(tmp_path / 'session'), fake_log=str(tmp_path / 'device'))
    try:
        assert arm.url.startswith('/dev/pts/')
        await_state(arm, 'IDLE')
        arm.driver.active = True
        assert arm.driver.go([0.2] * ROBOT.count, time.monotonic()) is None
        await_state(arm, 'MOVING')
        await_state(arm, 'IDLE')
        standing = arm.driver.snapshot(time.monotonic()).arm.positions
        assert standing == pytest.approx([0.2] * ROBOT.count, abs=2e-3)
        assert 0.0 < arm.take_longest_turn_s() and arm.take_longest_turn_s() < PATIENCE_S
    finally:
        arm.close()
    assert held() == before
    session = (tmp_path / 'session').read_text()
    assert '!hello' in session and ' > ' in session and ' < ' in session
    assert '!watch 0' in (tmp_path / 'device').read_text()  # a farewell, the arm was at rest


def test_the_farewell_is_said_even_if_the_device_is_slow_to_answer(tmp_path):
    """As many lines as may be unanswered are under way; it has to wait for one of them."""
    for index in range(3):
        log = tmp_path / f'device{index}'
        arm = opened(fake_log=str(log), fake_faults=['delay=0.04'])
        try:
            await_state(arm, 'IDLE')
            for _ in range(4):
                arm.driver.link.request('?')
        finally:
            arm.close()
        assert '!watch 0' in log.read_text()


def test_a_moving_arm_is_stopped_when_it_is_closed(tmp_path):
    arm = opened(session_log=str(tmp_path / 'session'))
    try:
        await_state(arm, 'IDLE')
        arm.driver.active = True
        assert arm.driver.go([1.0] * ROBOT.count, time.monotonic()) is None
        await_state(arm, 'MOVING')
    finally:
        arm.close()
    said = [line.split(' ', 1)[1] for line in (tmp_path / 'session').read_text().splitlines()]
    sent = [line for line in said if line[0] == '>']
    assert f'> {ESTOP_BYTE!r}' in sent
    # A turn that was under way may ask the device to confirm; nothing moves it any more.
    after = sent[sent.index(f'> {ESTOP_BYTE!r}'):]
    assert not any(word in line for line in after for word in ('goto', 'move'))


@pytest.mark.parametrize('changes, said', [
    ({'port': '/nowhere/tty'}, 'is not there'),
    ({'session_log': '/nowhere/log'}, 'the session log /nowhere/log cannot be written'),
    ({'fake_log': '/nowhere/log'}, 'the log /nowhere/log cannot be written')])
def test_what_cannot_be_opened_is_a_sentence_and_holds_nothing(changes, said):
    before = held()
    with pytest.raises(LinkError, match=said):
        opened(**changes)
    assert held() == before


def test_a_fault_that_is_none_is_refused():
    with pytest.raises(ValueError, match='a fault is NAME'):
        opened(fake_faults=('explode',))


def test_a_failing_turn_stops_the_arm_and_not_the_thread(monkeypatch):
    arm = opened()
    try:
        await_state(arm, 'IDLE')
        whole, failures = arm.driver.turn, iter([RuntimeError('a bug')])

        def turn(now_s):
            for failure in failures:
                raise failure
            return whole(now_s)

        monkeypatch.setattr(arm.driver, 'turn', turn)
        await_state(arm, 'LATCHED: internal error: a bug')
    finally:
        arm.close()


class Blind:
    """A driver whose port gives no descriptor, or one that is closed."""

    def __init__(self, handle):
        self.link, self.open, self.turns, self.closed = self, True, 0, False
        self._handle = handle

    def fileno(self):
        return self._handle

    def next_due_s(self):
        return time.monotonic() + 1.0

    def turn(self, now_s):
        self.turns += 1

    def close(self):
        self.closed = True


@pytest.mark.parametrize('handle', [None, -1], ids=['none', 'closed'])
def test_a_port_that_cannot_be_waited_for_is_looked_at_often(handle):
    driver = Blind(handle)
    thread = ArmThread(driver)
    thread.start()
    until_s = time.monotonic() + PATIENCE_S
    while driver.turns < 20 and time.monotonic() < until_s:
        time.sleep(0.005)
    thread.stop()
    thread.wake()  # after the end it does nothing
    assert driver.turns >= 20 and driver.closed


def test_a_wide_arm_gets_an_emulated_device_of_its_size():
    joints = (*ROBOT.joints[:-1], dataclasses.replace(ROBOT.joints[-1], channel=9))
    arm = Arm(dataclasses.replace(ROBOT, joints=joints), PortSettings(), DriverSettings(),
              TrajectorySettings())
    try:
        await_state(arm, 'IDLE')
        assert '9 servos' in arm.driver.device
    finally:
        arm.close()


def test_a_port_without_log_gives_the_bare_transport():
    port = Port(PortSettings(), 115200)
    try:
        transport = port.open()
        assert transport.write(b'?\n') == 2
        transport.close()
    finally:
        port.close()
