"""Ports: missing, busy, hung up, full; never a wait, always a sentence."""

import fcntl
import os
import pty
import time
import tty

from homography_servo.errors import LinkError
from homography_servo.robot.port import LoggedTransport
from homography_servo.robot.port import Port
from homography_servo.robot.port import PortSettings
from homography_servo.robot.port import SessionLog
from homography_servo.robot.transport import open_transport
from homography_servo.robot.transport import PortBusy
from homography_servo.robot.transport import PortMissing
import pytest


@pytest.fixture
def line():
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    yield master, os.ttyname(slave)
    for handle in (master, slave):
        try:
            os.close(handle)
        except OSError:
            pass


def heard(transport, count=1, within_s=1.0):
    data, until = b'', time.monotonic() + within_s
    while len(data) < count and time.monotonic() < until:
        data += transport.read()
    return data


def test_bytes_pass_both_ways(line):
    transport = open_transport(line[1], 9600)
    assert transport.read() == b'' and transport.write(b'abc\x18\r\n\x00') == 7
    assert os.read(line[0], 100) == b'abc\x18\r\n\x00'
    os.write(line[0], b'\x00\xff\n\r')
    assert heard(transport, 4) == b'\x00\xff\n\r' and transport.fileno() is not None
    transport.close()
    transport.close()
    for action in (transport.read, lambda: transport.write(b'x'),
                   lambda: transport.write_now(b'x')):
        with pytest.raises(LinkError):
            action()


def test_a_missing_port_says_what_to_do(tmp_path):
    with pytest.raises(PortMissing, match='is not there: plug the robot in'):
        open_transport(str(tmp_path / 'ttyUSB0'), 115200)
    (tmp_path / 'file').write_text('')
    with pytest.raises(PortMissing, match='cannot be opened'):
        open_transport(str(tmp_path / 'file'), 115200)
    with pytest.raises(PortMissing, match='cannot be opened'):
        open_transport('teapot://x', 115200)
    with pytest.raises(PortMissing):
        open_transport('socket://127.0.0.1:9', 115200)


def test_a_port_is_opened_exclusively(line):
    first = open_transport(line[1], 115200)
    with pytest.raises(PortBusy, match='another program'):
        open_transport(line[1], 115200)
    first.close()
    open_transport(line[1], 115200).close()


def test_a_port_locked_by_another_program_is_busy(line):
    other = os.open(line[1], os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with pytest.raises(PortBusy, match='fuser'):
        open_transport(line[1], 115200)
    os.close(other)


def test_a_hang_up_is_seen_by_reads_and_writes(line):
    transport = open_transport(line[1], 115200)
    os.close(line[0])
    for action in (transport.read, lambda: transport.write(b'x'),
                   lambda: transport.write_now(b'x')):
        with pytest.raises(LinkError, match='the line is gone'):
            action()
    transport.close()


def test_a_full_line_takes_nothing_and_nobody_waits(line):
    transport = open_transport(line[1], 115200)
    start, total = time.monotonic(), 0
    for _ in range(200):
        total += transport.write(b'x' * 4096)
    assert transport.write(b'x') == 0 and time.monotonic() - start < 1.0
    assert 1000 < total < 200 * 4096
    transport.write_now(b'\x18')
    left = b''
    while True:
        try:
            left += os.read(line[0], 65536)
        except BlockingIOError:
            break
    assert left.endswith(b'\x18') and left.count(b'x') < total  # what waited is gone
    transport.write(b'x' * 4096)
    start = time.monotonic()
    transport.close()
    assert time.monotonic() - start < 0.5


def test_a_stop_just_before_the_end_is_heard_by_a_slow_device(line):
    for _ in range(20):
        transport = open_transport(line[1], 115200)
        transport.write_now(b'\x18')
        transport.close()
        time.sleep(0.005)
        assert os.read(line[0], 100) == b'\x18'


def test_loop_url_gives_back_what_was_sent():
    transport = open_transport('loop://', 115200)
    assert transport.read() == b'' and transport.fileno() is None
    assert transport.write(b'hello\n') == 6
    assert heard(transport, 6) == b'hello\n'
    transport.write_now(b'\x18')
    assert heard(transport) == b'\x18'
    transport.close()
    with pytest.raises(LinkError):
        transport.write(b'x')


def test_the_session_log_holds_both_directions(tmp_path, line):
    log = SessionLog(tmp_path / 'log')
    transport = LoggedTransport(open_transport(line[1], 115200), log)
    transport.write(b'17 ?\n')
    os.write(line[0], b'17 OK\n')
    heard(transport, 6)
    transport.write_now(b'\x18')
    transport.close()
    log.close()
    arrows = [(row.split(' ', 2)[1], row.split(' ', 2)[2])
              for row in (tmp_path / 'log').read_text().splitlines()]
    assert ('>', "b'17 ?\\n'") in arrows and arrows[-1] == ('>', "b'\\x18'")
    assert any(arrow == '<' for arrow, _ in arrows)


def test_a_full_disk_ends_the_log_and_nothing_else(line):
    log = SessionLog('/dev/full')
    transport = LoggedTransport(open_transport(line[1], 115200), log)
    for _ in range(3):
        assert transport.write(b'17 ?\n') == 5
    transport.close()


def test_a_log_that_cannot_be_written_is_a_sentence(tmp_path):
    with pytest.raises(LinkError, match='cannot be written'):
        SessionLog(tmp_path / 'no' / 'log')


def test_the_fake_port_is_a_pty_with_an_emulator():
    port = Port(PortSettings(), 115200)
    assert port.url.startswith('/dev/')
    transport = port.open()
    transport.close()
    port.close()
    with pytest.raises(ValueError, match='a fault is NAME'):
        Port(PortSettings(fake_faults=('explode',)), 115200)
