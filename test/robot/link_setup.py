"""A driver with a device in memory and a clock that is set by hand; a separate decoder."""

from pathlib import Path
import re

from homography_servo.errors import LinkError
from homography_servo.robot.device import Device
from homography_servo.robot.driver import ArmDriver
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.link import Link
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.transport import MemoryTransport

ROBOT = load_robot(Path(__file__).parents[2] / 'config' / 'robots' / 'robix_rcs6.yaml')
NAMES = ROBOT.joint_names


class Wire(MemoryTransport):
    """Memory transport that writes down what passes, and breaks when told."""

    def __init__(self, rig):
        super().__init__(rig.device, lambda: rig.now_s)
        self.rig = rig

    def _passes(self):
        self.rig.operations += 1
        if self.rig.operations in self.rig.break_at:
            raise LinkError('broken on purpose')

    def write(self, data):
        self._passes()
        if self.rig.blocked:
            return 0
        self.rig.log.append((self.rig.now_s, bytes(data)))
        return super().write(data)

    def write_now(self, data):
        self.write(data)

    def read(self):
        self._passes()
        data = super().read()
        return b'' if self.rig.silent else self.rig.spoil(data)


class Rig:
    """The whole robot side without port, thread or ROS."""

    def __init__(self, device=None, settings=DriverSettings(), break_at=(), step_s=0.005,
                 first_seq=1):
        self.device = device or Device()
        self.now_s, self.step_s = 1000.0, step_s
        self.log, self.operations, self.break_at = [], 0, set(break_at)
        self.blocked = self.silent = self.absent = False
        self.spoil = lambda data: data
        self.link = Link(self._open, settings.baud, first_seq)
        self.driver = ArmDriver(ROBOT, self.link, settings)
        self.driver.active = True
        self.states = []

    def _open(self):
        if self.absent:
            raise LinkError('absent on purpose')
        return Wire(self)

    @property
    def state(self):
        return self.driver.state

    def turn(self):
        self.now_s += self.step_s
        self.driver.turn(self.now_s)
        if not self.states or self.states[-1][1] != self.state:
            self.states.append((self.now_s, self.state))

    def run(self, time_s):
        for _ in range(int(round(time_s / self.step_s))):
            self.turn()
        return self

    def go(self, joints_rad):
        return self.driver.go(joints_rad, self.now_s)

    def send(self, *points):
        """Send a trajectory of (time, positions) points."""
        return self.driver.command(NAMES, [TrajectoryPoint(*p) for p in points], self.now_s)

    def reset(self):
        """Reset without waiting for the answer, then let it come."""
        self.driver.reset(wait_s=0.0)
        self.run(0.1)

    @property
    def arm(self):
        return self.driver.snapshot(self.now_s).arm

    def heard(self, after_s=0.0):
        """Give the lines the device was sent, without numbers and CRC."""
        stream = b''.join(data for time_s, data in self.log if time_s > after_s)
        return [line.partition(' ')[2] for line, _ in decoded([(0.0, stream)])]


# --- a decoder of its own: nothing of the package's protocol is used from here on ----------

def _crc_table():
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        table.append(crc & 0xFFFF)
    return table


_TABLE = _crc_table()


def crc16(data):
    """Compute CRC-16/CCITT-FALSE."""
    crc = 0xFFFF
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _TABLE[crc >> 8 ^ byte]
    return crc


def decoded(log):
    """Give (text, time) of all good lines, and ('STOP', time) for stop bytes."""
    found, line = [], bytearray()
    for time_s, data in log:
        for byte in data:
            if byte == 0x18:
                found.append(('STOP', time_s))
                line.clear()
            elif byte == 10:
                text, star, digits = bytes(line).rpartition(b'*')
                if star and digits == b'%04X' % crc16(text):
                    found.append((text.decode(), time_s))
                line.clear()
            else:
                line.append(byte)
    return found


_MOTION = re.compile(r'move|jump|restart|!goto')
_CLAUSE = re.compile(r'(\d+) to (-?\d+)')


class Judge:
    """
    Judge what reached the wire by the robot file alone.

    ``violations`` lists targets outside the limits, steps faster than the velocity limit,
    numbers that are none, and motion while latched.
    """

    def __init__(self, margin_rad=0.05, tick_s=0.020):
        self.limits = {}
        for joint in ROBOT.joints:
            ends = [joint.zero_units + joint.sign * joint.units_per_rad * angle for angle in
                    (joint.lower_rad + margin_rad, joint.upper_rad - margin_rad)]
            self.limits[joint.channel] = (min(ends), max(ends),
                                          joint.velocity_rad_s * joint.units_per_rad)
        self.tick_s = tick_s
        self.violations, self.targets, self.latched = [], 0, False
        self.last, self.last_s = None, 0.0
        self.seen = set()

    def watch(self, log):
        """Judge a log of (time, bytes)."""
        for text, time_s in decoded(log):
            if text == 'STOP':
                self.latched, self.last = True, None
                continue
            seq, _, line = text.partition(' ')
            if line == '!hello':
                self.seen.clear()
            if (seq, line) not in self.seen:  # a repeat runs no second time
                self.seen.add((seq, line))
                self._line(line, time_s)
        return self

    def _line(self, line, time_s):
        if line in ('!stop', '!power off'):  # the arm stands somewhere on its way
            self.latched, self.last = self.latched or line == '!stop', None
        elif line == '!reset':
            self.latched = False
        if line.startswith('maxspd'):
            for servo, value in re.findall(r'maxspd (\d+) (\S+?)(?:;|$)', line):
                if float(value) / self.tick_s > self.limits[int(servo)][2]:
                    self.violations.append((time_s, 'device speed', line))
        if not _MOTION.match(line):
            return
        self.targets += 1
        if self.latched:
            self.violations.append((time_s, 'latched', line))
        self._target(line, time_s)

    def _target(self, line, time_s):
        verb, _, rest = line.partition(' ')
        if verb == '!goto' and re.fullmatch(r'(-?\d+ ){5}-?\d+', rest):
            target = dict(enumerate(map(int, rest.split()), 1))
        elif verb == 'move' and re.fullmatch(r'(\d+ to -?\d+,){5}\d+ to -?\d+', rest):
            target = {int(s): int(v) for s, v in _CLAUSE.findall(rest)}
        else:
            self.violations.append((time_s, 'form', line))
            return
        for servo, value in target.items():
            low, high, speed = self.limits[servo]
            if not low - 1e-6 <= value <= high + 1e-6:
                self.violations.append((time_s, 'limit', line))
            if verb == '!goto' and self.last is not None and \
                    abs(value - self.last[servo]) > speed * (time_s - self.last_s) + 1e-6:
                self.violations.append((time_s, 'speed', line))
        self.last, self.last_s = (target, time_s) if verb == '!goto' else (None, 0.0)
