"""The emulator on real ptys: its program, its log, and each of its misbehaviours."""

import ast
import os
from pathlib import Path
import select
import signal
import subprocess
import sys
import threading
import time

from homography_servo.robot.arm_thread import ArmThread
from homography_servo.robot.device import Device
from homography_servo.robot.driver import ArmDriver
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.emulator import Emulator
from homography_servo.robot.emulator import PtyPort
from homography_servo.robot.emulator import RealPort
from homography_servo.robot.emulator_main import main
from homography_servo.robot.faults import Fault
from homography_servo.robot.faults import FAULTS
from homography_servo.robot.faults import FaultyLine
from homography_servo.robot.faults import parse_fault
from homography_servo.robot.link import Link
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.protocol import Request
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.transport import open_transport
from link_setup import decoded
from link_setup import Judge
from link_setup import NAMES
from link_setup import ROBOT
import pytest

ROOT = Path(__file__).parents[2]
LINES = [encode_line(f'{k} POS 1 2 3') for k in range(1, 201)]


# --- faults, without a port --------------------------------------------------------------

@pytest.mark.parametrize('text, fault', [
    ('drop=0.1', Fault('drop', 0.1)), ('unplug@5-8', Fault('unplug', 1.0, 5.0, 8.0)),
    ('silent@2', Fault('silent', 1.0, 2.0)), ('delay=0.25@1-2', Fault('delay', 0.25, 1.0, 2.0)),
])
def test_a_fault_is_read(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize('text', ['', 'explode', 'drop=x', 'drop@', 'drop=0.1.2', 'drop@1-'])
def test_a_bad_fault_is_a_sentence(text):
    with pytest.raises(ValueError, match='fault'):
        parse_fault(text)


def said(fault, at_s=0.0, lines=LINES, until_s=1e9):
    line = FaultyLine([parse_fault(fault)] if fault else [], seed=3)
    line.say(lines, at_s)
    return line.due(until_s)


def test_without_faults_everything_passes_at_once():
    line = FaultyLine([])
    line.say(LINES, 5.0)
    assert line.due(5.0) == b''.join(LINES) and not line.waiting
    assert line.hear(b'abc', 5.0) == b'abc'


@pytest.mark.parametrize('fault, good', [
    ('drop=0.5', (60, 140)), ('truncate=0.5', (0, 140)), ('corrupt=0.5', (60, 140)),
    ('duplicate=0.5', (260, 340)), ('silent', (0, 0)), ('baud', (0, 0)),
    ('drop=0.5@9', (200, 200)),
])
def test_a_share_of_the_replies_is_spoiled(fault, good):
    found = [text for text, _ in decoded([(0.0, said(fault))]) if text != 'STOP']
    assert good[0] <= len(found) <= good[1]


def test_wrong_numbers_come_with_a_right_crc():
    numbers = [int(text.split()[0]) for text, _ in decoded([(0.0, said('wrong_seq=0.5'))])]
    assert len(numbers) == 200 and 60 < sum(n > 1000 for n in numbers) < 140


def test_delay_and_split_are_by_the_clock():
    line = FaultyLine([parse_fault('delay=0.2')])
    line.say(LINES[:1], 1.0)
    assert line.due(1.19) == b'' and line.due(1.21) == LINES[0]
    line = FaultyLine([parse_fault('split=0.01')])
    line.say(LINES[:1], 1.0)
    assert line.due(1.035) == LINES[0][:3] and line.due(9.0) == LINES[0][3:]


def test_the_speed_of_a_line_is_imitated_in_both_directions():
    line = FaultyLine([], baud=9600)
    line.say(LINES[:20], 0.0)
    size = sum(map(len, LINES[:20]))
    assert len(line.due(0.1)) == pytest.approx(96, abs=1)
    assert line.due(size / 960.0 - 0.01) and line.waiting
    assert line.due(size / 960.0 + 0.001) and not line.waiting
    assert line.hear(b'x' * 96, 10.0) == b'' and len(line.hear(b'', 10.05)) == 48
    assert len(line.hear(b'', 10.2)) == 48


# --- the port ----------------------------------------------------------------------------

def read_until(transport, token, within_s=5.0):
    data, until = b'', time.monotonic() + within_s
    while token not in data and time.monotonic() < until:
        data += transport.read()
        time.sleep(0.001)
    return data


def test_the_log_holds_time_and_raw_bytes(tmp_path):
    port = PtyPort(tmp_path / 'robix')
    emulator = Emulator(Device(), port, log=tmp_path / 'log')
    emulator.start()
    start_s = time.monotonic()
    transport = open_transport(str(tmp_path / 'robix'), 115200)
    transport.write(b'\xff\x18' + Request(1, '!hello').encode())
    read_until(transport, b'HELLO')
    transport.close()
    emulator.stop()
    rows = [row.split(' ', 1) for row in (tmp_path / 'log').read_text().splitlines()]
    assert b''.join(ast.literal_eval(raw) for _, raw in rows) == \
        b'\xff\x18' + Request(1, '!hello').encode()
    assert start_s <= float(rows[0][0]) <= time.monotonic()
    assert not (tmp_path / 'robix').exists()


def test_the_port_goes_away_and_comes_back_under_its_name(tmp_path):
    clock = [0.0]
    port = PtyPort(tmp_path / 'robix')
    emulator = Emulator(Device(), port, [parse_fault('unplug@1-2')], clock=lambda: clock[0])
    emulator.turn()
    transport = open_transport(str(tmp_path / 'robix'), 115200)
    clock[0] = 1.5
    emulator.turn()
    with pytest.raises(Exception, match='gone'):
        transport.read()
    assert not (tmp_path / 'robix').exists()
    clock[0] = 2.5
    emulator.turn()
    transport.close()
    open_transport(str(tmp_path / 'robix'), 115200).close()
    port.close()


def test_it_serves_a_real_port_and_opens_it_again_when_it_comes_back(tmp_path):
    cable = PtyPort(tmp_path / 'tty')  # its other end is the host's
    emulator = Emulator(Device(), RealPort(str(tmp_path / 'tty'), 115200))

    def answer(request):
        data, until = b'', time.monotonic() + 5.0
        while b'HELLO' not in data and time.monotonic() < until:
            if b'READY' in data or not data:
                cable.write(request)
            emulator.turn()
            data += cable.read()
        return data

    assert b'HELLO RBX/1 6' in answer(Request(1, '!hello').encode())
    cable.unplug()
    emulator.turn()
    cable.plug()
    assert b'HELLO RBX/1 6' in answer(Request(2, '!hello').encode())
    now = time.monotonic() - emulator._start_s
    emulator.line.faults = [Fault('unplug', 1.0, now, now + 0.2)]
    assert b'HELLO RBX/1 6' in answer(Request(3, '!hello').encode())
    emulator.port.close()
    cable.close()


def test_a_full_disk_ends_the_log_only():
    port = PtyPort()
    emulator = Emulator(Device(), port, log='/dev/full')
    emulator.start()
    transport = open_transport(port.path, 115200)
    transport.write(Request(1, '!hello').encode())
    assert b'HELLO' in read_until(transport, b'HELLO')
    transport.close()
    emulator.stop()


# --- a driver against each fault, through a real pty -------------------------------------

class Bench:
    """A driver in its thread, an emulator in another, a pty between them."""

    def __init__(self, folder, faults=(), baud=0, settings=DriverSettings()):
        self.log = folder / 'heard'
        port = PtyPort(folder / 'robix')
        self.emulator = Emulator(Device(), port, [parse_fault(f) for f in faults], self.log,
                                 baud=baud)
        self.emulator.start()
        link = Link(lambda: open_transport(str(folder / 'robix'), settings.baud), settings.baud)
        self.driver = ArmDriver(ROBOT, link, settings)
        self.driver.active = True
        self.thread = ArmThread(self.driver)
        self.thread.start()

    def fault(self, *texts):
        """Begin faults now; their times count from now."""
        now = time.monotonic() - self.emulator._start_s
        found = [parse_fault(text) for text in texts]
        self.emulator.line.faults = [
            Fault(f.name, f.value, f.start_s + now, f.end_s + now) for f in found]

    def until(self, condition, within_s=10.0):
        start_s = time.monotonic()
        while not condition(self.driver.state):
            assert time.monotonic() - start_s < within_s, self.driver.state
            time.sleep(0.002)
        return time.monotonic() - start_s

    def move(self, scale=1.0):
        points = [TrajectoryPoint(1.5 * scale, [0.6 * scale] * 6),
                  TrajectoryPoint(4.0 * scale, [-0.6 * scale] * 6)]
        assert self.driver.command(NAMES, points, time.monotonic()) is None
        self.until(lambda state: state == 'MOVING')
        time.sleep(0.3)

    def heard(self):
        rows = [row.split(' ', 1) for row in self.log.read_text().splitlines()]
        return [(float(time_s), ast.literal_eval(raw)) for time_s, raw in rows]

    def judged(self):
        """Judge what was heard, but for speeds: times on a pty are those of reading."""
        found = Judge().watch(self.heard()).violations
        return [item for item in found if item[1] != 'speed']


@pytest.fixture
def bench(tmp_path):
    made = []

    def make(*faults, **kwargs):
        made.append(Bench(tmp_path, faults, **kwargs))
        made[0].until(lambda state: state == 'IDLE')
        return made[0]
    yield make
    for item in made:
        item.thread.stop()
        item.emulator.stop()


def positions(bench):
    return bench.emulator.device.machine.positions(time.monotonic())


def assert_latched_and_still(bench):
    bench.until(lambda state: state.startswith('LATCHED'))
    assert 'latched' in bench.driver.go([0.3] * 6, time.monotonic()).reason
    time.sleep(0.1)
    before = positions(bench)
    time.sleep(0.2)
    assert positions(bench) == before and bench.judged() == []


def reset(bench):
    problem = bench.driver.reset(3.0)
    assert problem is None, problem
    bench.until(lambda state: state == 'IDLE')


def test_unplugged_is_noticed_within_300_ms_and_back_within_6_s(bench):
    bench = bench()
    bench.move()
    bench.fault('unplug@0-1')
    assert bench.until(lambda state: state == 'DISCONNECTED') < 0.3
    assert bench.until(lambda state: state.startswith('LATCHED')) < 1.0 + 6.0
    assert_latched_and_still(bench)
    reset(bench)


@pytest.mark.parametrize('fault', ['silent@0-0.6', 'deaf@0-0.6', 'baud@0-0.6', 'drop@0-0.6',
                                   'corrupt@0-0.6', 'truncate@0-0.6', 'wrong_seq@0-0.6',
                                   'delay=0.5@0-0.6', 'stall@0-0.6'])
def test_a_line_that_fails_latches_within_300_ms_and_comes_back_latched(bench, fault):
    bench = bench()
    bench.move()
    bench.fault(fault)
    assert bench.until(lambda state: state == 'DISCONNECTED') < 0.35  # 0.05 s for a busy machine
    assert_latched_and_still(bench)
    reset(bench)


@pytest.mark.parametrize('faults', [('duplicate',), ('split=0.0002',), ('delay=0.02',),
                                    ('drop=0.05', 'duplicate=0.3'), ('corrupt=0.03',)])
def test_a_line_that_is_only_bad_is_lived_with(bench, faults):
    bench = bench()
    bench.fault(*faults)
    bench.move(0.3)
    bench.until(lambda state: state != 'MOVING', 20.0)
    if bench.driver.state == 'IDLE':
        assert bench.driver.snapshot(time.monotonic()).arm.positions == \
            pytest.approx([-0.18] * 6, abs=1e-3)
    else:
        bench.until(lambda state: state.startswith('LATCHED'))
    assert bench.judged() == []


def test_a_frozen_servo_is_noticed(bench):
    bench = bench()
    bench.fault('freeze=3')
    time.sleep(0.1)
    bench.driver.command(NAMES, [TrajectoryPoint(0.5, [0.3] * 6)], time.monotonic())
    bench.until(lambda state: 'joint3 did not follow' in state)


def test_a_slow_line_works_at_9600_baud(bench):
    bench = bench(baud=9600, settings=DriverSettings(baud=9600))
    bench.move(0.3)
    bench.until(lambda state: state == 'IDLE', 15.0)
    assert bench.driver.snapshot(time.monotonic()).arm.positions == \
        pytest.approx([-0.18] * 6, abs=1e-3)


def test_many_losses_leave_no_handles_and_no_threads_behind(tmp_path):
    def held():
        return len(os.listdir('/proc/self/fd')), threading.active_count()

    def one():
        port = PtyPort(tmp_path / 'robix')
        emulator = Emulator(Device(), port)
        emulator.start()
        link = Link(lambda: open_transport(str(tmp_path / 'robix'), 115200))
        thread = ArmThread(ArmDriver(ROBOT, link))
        thread.start()
        time.sleep(0.02)
        thread.stop()
        emulator.stop()
        for _ in range(5):
            port.plug()
            link.open_now()
            port.unplug()
            link.turn(time.monotonic() + 1000.0)
        link.close()

    one()
    before = held()
    for _ in range(10):
        one()
    assert held() == before


# --- the program -------------------------------------------------------------------------

def start(*args):
    process = subprocess.Popen(
        [sys.executable, '-m', 'homography_servo.robot.emulator_main', *args], cwd=ROOT,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, 'PYTHONPATH': str(ROOT)})
    ready = select.select([process.stdout], [], [], 20.0)[0]
    return process, process.stdout.readline().strip() if ready else ''


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_program_prints_its_pty_answers_and_ends_cleanly(tmp_path, number):
    process, path = start('--servos', '4', '--log', str(tmp_path / 'log'))
    try:
        transport = open_transport(path, 115200)
        transport.write(Request(1, '!hello').encode())
        assert b'HELLO RBX/1 4 robix_emulator' in read_until(transport, b'emulator*')
        transport.close()
    finally:
        process.send_signal(number)
        _, errors = process.communicate(timeout=5.0)
    assert (process.returncode, errors) == (0, '')
    assert '!hello' in (tmp_path / 'log').read_text()


@pytest.mark.parametrize('args, code, text', [
    (['--fault', 'explode'], 2, 'a fault is NAME'), (['--servos', '0'], 2, '--servos'),
    (['--tick', '0'], 2, '--tick'), (['--port', '/nowhere/tty'], 3, 'is not there'),
    (['--log', '/nowhere/log'], 3, '/nowhere/log'),
])
def test_bad_arguments_are_a_sentence_and_a_code(capsys, args, code, text):
    try:
        assert main(args) == code
    except SystemExit as ended:
        assert ended.code == code
    assert text in capsys.readouterr().err


def test_help_names_every_fault(capsys):
    with pytest.raises(SystemExit):
        main(['--help'])
    shown = capsys.readouterr().out
    assert all(name in shown for name in FAULTS) and 'example' in shown
