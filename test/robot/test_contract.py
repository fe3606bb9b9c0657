"""
One contract for every way to a robot: memory, a pty, and a network URL.

The emulator answers behind all of them; `loop://` has nobody at the other end, so there
only the first sentence of the contract applies.
"""

from contextlib import contextmanager
import socket
import time

from homography_servo.errors import LinkError
from homography_servo.robot.device import Device
from homography_servo.robot.driver import ArmDriver
from homography_servo.robot.emulator import Emulator
from homography_servo.robot.emulator import PtyPort
from homography_servo.robot.link import Link
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.protocol import Line
from homography_servo.robot.protocol import LineDecoder
from homography_servo.robot.protocol import Request
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.transport import MemoryTransport
from homography_servo.robot.transport import open_transport
from link_setup import NAMES
from link_setup import ROBOT
import pytest

PATIENCE_S = 10.0  # of a busy machine; the rules of time are tested with a clock set by hand


class SocketPort:
    """The device's end of a network connection."""

    def __init__(self):
        self._server = socket.create_server(('127.0.0.1', 0))
        self._server.setblocking(False)
        self._peer = None
        self.url = 'socket://127.0.0.1:{}'.format(self._server.getsockname()[1])

    def write(self, data):
        if self._peer:
            self._peer.sendall(data)
        return len(data)

    def read(self):
        try:
            if self._peer is None:
                self._peer, _ = self._server.accept()
                self._peer.setblocking(False)
            return self._peer.recv(4096)
        except BlockingIOError:
            return b''

    def fileno(self):
        return None

    def close(self):
        for item in (self._peer, self._server):
            if item:
                item.close()


@contextmanager
def memory():
    device = Device()
    yield lambda: MemoryTransport(device, time.monotonic)


@contextmanager
def served(port, url):
    emulator = Emulator(Device(), port)
    emulator.start()
    try:
        yield lambda: open_transport(url, 115200)
    finally:
        emulator.stop()


def on_pty():
    port = PtyPort()
    return served(port, port.path)


def on_socket():
    port = SocketPort()
    return served(port, port.url)


WAYS = {'memory': memory, 'pty': on_pty, 'socket': on_socket}


@pytest.fixture(params=sorted(WAYS))
def way(request):
    with WAYS[request.param]() as opener:
        yield opener


class Talk:
    """Say lines and wait for what was asked for."""

    def __init__(self, transport):
        self.transport, self.decoder, self.heard, self.seq = transport, LineDecoder(), [], 0

    def wait(self, condition):
        until = time.monotonic() + PATIENCE_S
        while not condition(self.heard):
            assert time.monotonic() < until, self.heard
            items = self.decoder.feed(self.transport.read())
            self.heard += [item.text for item in items if isinstance(item, Line)]
            time.sleep(0.001)
        return self.heard

    def say(self, text, seq=None):
        self.seq = self.seq + 1 if seq is None else seq
        before = len(self.heard)
        self.transport.write(Request(self.seq, text).encode())
        own = f'{self.seq} '
        self.wait(lambda heard: any(line.startswith(own) for line in heard[before:]))
        return next(line for line in self.heard[before:] if line.startswith(own))[len(own):]


@pytest.fixture
def talk(way):
    transport = way()
    talk = Talk(transport)
    assert talk.say('!hello') == 'HELLO RBX/1 6 robix_emulator'
    yield talk
    transport.close()


@pytest.mark.parametrize('kind', [*sorted(WAYS), 'loop'])
def test_a_transport_reads_without_waiting_and_closes_twice(kind):
    with (WAYS[kind]() if kind in WAYS else memory()) as opener:
        transport = opener() if kind in WAYS else open_transport('loop://', 115200)
        start = time.monotonic()
        for _ in range(10):
            assert isinstance(transport.read(), bytes)
        assert transport.write(b'\n') == 1 and time.monotonic() - start < 1.0
        transport.close()
        transport.close()
        for action in (transport.read, lambda: transport.write(b'\n'),
                       lambda: transport.write_now(b'\x18')):
            with pytest.raises(LinkError):
                action()


def test_a_motion_is_accepted_run_and_reported(talk):
    assert talk.say('move 1 to 100, 2 to -50') == 'OK'
    seq = talk.seq
    talk.wait(lambda heard: f'{seq} DONE' in heard)
    assert talk.say('?pos') == 'POS 100 -50 0 0 0 0'
    assert talk.say('?') == f'ST IDLE 0 {seq} 0'


def test_bad_lines_are_named_and_run_nothing(talk):
    talk.transport.write(b'7 move 1 to 5*0000\n8 \x80\n' + b'9 ' + b'x' * 300 + b'\n')
    talk.wait(lambda heard: '0 ERR 901 0 length' in heard)
    assert {'0 ERR 900 0 crc', '0 ERR 902 0 ascii'} <= set(talk.heard)
    assert talk.say('?pos') == 'POS 0 0 0 0 0 0'


def test_a_repeated_line_runs_once(talk):
    assert talk.say('move 1 by 10') == 'OK'
    seq = talk.seq
    assert talk.say('move 1 by 10', seq) == 'OK'
    assert talk.say('move 1 by 11', seq) == 'ERR 903 0 seq'
    talk.wait(lambda heard: f'{seq} DONE' in heard)
    assert talk.say('?pos', 900) == 'POS 10 0 0 0 0 0'


def test_the_stop_byte_stops_before_what_follows_it(talk):
    assert talk.say('move all to 1400') == 'OK'
    talk.transport.write_now(b'\x18')
    talk.wait(lambda heard: '! ESTOP' in heard)
    assert talk.say('move all to 0').startswith('ERR 130')
    assert talk.say('?').startswith('ST STOPPED')
    stood = talk.say('?pos')
    assert talk.say('!reset') == 'OK' and talk.say('?pos') == stood


def test_lines_may_come_in_any_pieces(talk):
    for byte in Request(500, '?prop 1 maxpos').encode():
        talk.transport.write(bytes([byte]))
        time.sleep(0.0005)
    talk.wait(lambda heard: '500 VAL 1400' in heard)


def test_noise_is_survived(talk):
    talk.transport.write(bytes(range(25, 256)) * 10 + b'\n')
    talk.transport.write(encode_line('600 ?pos'))
    talk.wait(lambda heard: '600 POS 0 0 0 0 0 0' in heard)


def test_the_driver_moves_stops_and_goes_on(way):
    driver = ArmDriver(ROBOT, Link(way))
    driver.active = True

    def turn_until(condition):
        until = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < until, driver.state
            driver.turn(time.monotonic())
            time.sleep(0.001)

    def position():
        return driver.snapshot(time.monotonic()).arm.positions

    turn_until(lambda: driver.state == 'IDLE')
    points = [TrajectoryPoint(0.3, [0.1] * 6), TrajectoryPoint(0.6, [0.2] * 6)]
    assert driver.command(NAMES, points, time.monotonic()) is None
    turn_until(lambda: driver.state == 'IDLE')
    assert position() == pytest.approx([0.2] * 6, abs=1e-3)
    assert driver.go([-0.8] * 6, time.monotonic()) is None
    turn_until(lambda: position()[0] < 0.1)
    assert driver.stop_now('a test')
    assert driver.go([0.0] * 6, time.monotonic()).reason.startswith('latched')
    for _ in range(20):
        driver.turn(time.monotonic())
        time.sleep(0.005)
    assert driver.state == 'LATCHED: a test' and position()[0] > -0.7
    driver.reset(0.0)
    turn_until(lambda: driver.state == 'IDLE')
    driver.close()
