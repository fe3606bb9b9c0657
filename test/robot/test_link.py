"""Opening, greeting, losing and coming back, by a clock that is set by hand."""

from homography_servo.errors import LinkError
from homography_servo.robot.device import Device
from homography_servo.robot.link import Down
from homography_servo.robot.link import Link
from homography_servo.robot.link import Phase
from homography_servo.robot.link import Up
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.transport import MemoryTransport
import numpy as np
import pytest


class Echo(MemoryTransport):
    """A line that gives back what was sent, as loop:// does."""

    def __init__(self):
        super().__init__(Device(), lambda: 0.0)
        self._heard = b''

    def write(self, data):
        self._heard += data
        return len(data)

    def read(self):
        data, self._heard = self._heard, b''
        return data


class Noise(Echo):
    """A device at another baud rate."""

    rng = np.random.default_rng(4)

    def read(self):
        return self.rng.bytes(len(super().read()))


class Rig:
    def __init__(self, opener=None, **kwargs):
        self.now_s, self.device, self.openings = 50.0, Device(), []
        self.present, self.events = True, []
        self._given = opener
        self.link = Link(self._open, **kwargs)

    def _open(self):
        self.openings.append(self.now_s)
        if not self.present:
            raise LinkError('not there')
        self.port = self._given() if self._given else \
            MemoryTransport(self.device, lambda: self.now_s)
        return self.port

    def run(self, time_s, step_s=0.01):
        for _ in range(int(round(time_s / step_s))):
            self.now_s += step_s
            self.events += self.link.turn(self.now_s)
        return self.events


def test_it_opens_and_greets():
    rig = Rig()
    assert rig.run(0.05) == [Up(6, 'robix_emulator')] and rig.link.phase is Phase.UP
    assert rig.link.problem == ''


def test_a_port_that_is_absent_is_tried_every_half_to_five_seconds():
    rig = Rig()
    rig.present = False
    rig.run(40.0)
    gaps = np.diff(rig.openings)
    assert gaps[0] == pytest.approx(0.5, abs=0.02) and gaps.max() == pytest.approx(5.0, abs=0.02)
    assert rig.events == [] and rig.link.problem == 'not there'
    rig.present = True
    rig.run(5.1)
    assert rig.events == [Up(6, 'robix_emulator')]


def test_a_loss_is_told_once_and_the_next_try_is_after_half_a_second():
    rig = Rig()
    rig.run(0.1)
    rig.port.close()
    rig.run(0.3)
    assert rig.events[1:] == [Down('the port is closed')] and not rig.link.open
    rig.run(0.5)
    assert rig.events[2:] == [Up(6, 'robix_emulator')]


@pytest.mark.parametrize('opener', [Echo, Noise])
def test_nobody_who_speaks_rbx_is_told_with_the_baud_rate(opener):
    rig = Rig(opener, baud=9600)
    rig.run(8.0)
    assert rig.events == [] and 'at 9600 baud' in rig.link.problem


def test_a_device_that_needs_time_to_start_is_greeted_again_on_the_open_port():
    rig = Rig(Echo)
    rig.run(2.0)
    port, device = rig.port, rig.device
    port.read = lambda: b''.join(device.take())
    port.write = lambda data: (device.feed(data, rig.now_s), len(data))[1]
    rig.run(1.0)
    assert rig.events == [Up(6, 'robix_emulator')] and len(rig.openings) == 1


def test_another_version_is_refused():
    rig = Rig(Echo)
    rig.run(0.01)
    rig.port.read = lambda: encode_line('1 HELLO RBX/2 6 x')
    rig.run(0.02)
    assert rig.events == [] and 'speaks RBX/2' in rig.link.problem


def test_a_line_that_takes_a_few_bytes_at_a_time_is_enough():
    rig = Rig()
    rig.run(0.01)
    whole = rig.port.write
    rig.port.write = lambda data: whole(data[:3])
    rig.link.request('?pos')
    rig.run(0.2)
    assert rig.events[-1].kind == 'POS'


def test_half_a_line_is_not_continued_after_the_stop_byte():
    rig = Rig()
    rig.run(0.05)
    whole, heard = rig.port.write, []
    rig.port.write = lambda data: (heard.append(data[:4]), whole(data[:4]))[1]
    rig.link.request('move 1 to 1000', motion=True)
    rig.run(0.01)
    rig.port.write = whole
    assert rig.link.stop_now()
    rig.run(1.0)
    assert rig.device.machine.positions(rig.now_s) == [0] * 6 and rig.device.machine.latched


def test_stop_without_a_port_says_so():
    rig = Rig()
    rig.present = False
    rig.run(0.1)
    assert rig.link.stop_now() is False
    rig = Rig()
    rig.run(0.1)
    rig.port.close()
    assert rig.link.stop_now() is False and rig.link.problem == 'the port is closed'


def test_closed_stays_closed():
    rig = Rig()
    rig.run(0.1)
    rig.link.close()
    assert len(rig.run(20.0)) == 1 and len(rig.openings) == 1
