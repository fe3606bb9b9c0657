"""The reference device: link.md, sentence by sentence."""

from homography_servo.robot.device import Device
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.protocol import Request
import numpy as np
import pytest


class Host:
    """Say a line, hear the answers; time passes only when told."""

    def __init__(self, greeted=True, **kwargs):
        self.device = Device(**kwargs)
        self.now_s, self.seq = 100.0, 0
        if greeted:
            self.say('!hello')

    def heard(self):
        return [line[:-6].decode() for line in self.device.take()]

    def raw(self, data):
        self.device.feed(data, self.now_s)
        return self.heard()

    def say(self, text, seq=None):
        self.seq = self.seq + 1 if seq is None else seq
        return [line.split(' ', 1)[1] if line.startswith(f'{self.seq} ') else line
                for line in self.raw(Request(self.seq, text).encode())]

    def wait(self, time_s, step_s=0.01):
        lines = []
        for _ in range(int(round(time_s / step_s))):
            self.now_s += step_s
            self.device.step(self.now_s)
            lines += self.heard()
        return lines

    def pos(self):
        return [int(v) for v in self.say('?pos')[-1].split()[1:]]


@pytest.fixture
def host():
    return Host()


def test_it_announces_itself_and_wants_to_be_greeted_first():
    host = Host(greeted=False)
    assert host.heard() == ['! READY']
    for text in ('?', 'move 1 to 5', '!goto 0 0 0 0 0 0', '!stop'):
        assert host.say(text)[0].startswith('ERR 130')
    assert host.say('!hello') == ['HELLO RBX/1 6 robix_emulator']
    assert host.say('?') == ['ST IDLE 0 0 0']


def test_bad_lines_get_900_901_902_and_run_nothing(host):
    assert host.raw(b'9 move 1 to 5*0000\n') == ['0 ERR 900 0 crc']
    assert host.raw(b'9 ' + b'x' * 300 + b'\n') == ['0 ERR 901 0 length']
    assert host.raw(b'9 \x80*0000\n') == ['0 ERR 902 0 ascii']
    assert host.raw(encode_line('nine ?')) == ['0 ERR 101 1 nine']
    assert host.raw(encode_line('0 ?')) == ['0 ERR 102 1 0']
    assert host.wait(0.5) == [] and host.pos() == [0] * 6


def test_a_line_seen_before_gets_its_old_reply_and_never_runs_twice(host):
    assert host.say('move 1 by 10') == ['OK']
    seq = host.seq
    assert host.say('move 1 by 10', seq) == ['OK']
    assert host.say('move 1 by 20', seq) == ['ERR 903 0 seq']
    assert host.wait(1.0) == [f'{seq} DONE']
    assert host.say('move 1 by 10', seq) == ['OK']
    assert host.wait(1.0) == [] and host.pos()[0] == 10


def test_a_new_greeting_begins_a_session_with_new_numbers(host):
    host.say('move 1 by 10', 2)
    host.wait(1.0)
    host.say('!hello', 1)
    assert host.say('move 1 by 20', 2) == ['OK']


def test_script_lines_run_one_after_the_other(host):
    assert host.say('move 1 to 100; wait 5; move 1 to 0') == ['OK']
    assert host.say('move 2 to 50') == ['OK']
    first, second = host.seq - 1, host.seq
    assert host.say('?') == ['ST WORKING 0 0 1']
    lines = host.wait(0.6)
    assert lines == [] and host.pos()[:2] == [100, 0]
    assert host.wait(2.0) == [f'{first} DONE', f'{second} DONE']
    assert host.pos()[:2] == [0, 50]
    assert host.say('?') == [f'ST IDLE 0 {second} 0']


@pytest.mark.parametrize('text, code', [
    ('move 1 to 1401', 102), ('move 1 to 0; move 1 to -1401', 102), ('move 1 by 1401', 102),
    ('maxpos 1 500; move 1 to 501', 102), ('move 1 to 900; move 1 by 600', 102),
    ('minpos 1 -2201', 102), ('maxpos 1 2401', 102), ('p0pos 1 799', 102),
    ('minpos 1 100; maxpos 1 50', 102), ('dance', 104), ('!dance', 104), ('?dance', 104),
    ('!goto 1 2 3', 101), ('!goto 1 2 3 4 5 6 7', 103), ('!goto 1 2 3 4 5 nan', 101),
    ('!goto 1 2 3 4 5 1e3', 101), ('!goto 0 0 0 0 0 1401', 102), ('!stop now', 103),
    ('!power', 101), ('!power dim', 110), ('!watch', 101), ('!watch -1', 102),
    ('!watch 60001', 102), ('?prop 7 pos', 503), ('?prop 1 mood', 109), ('?prop 1', 101),
    ('maxpos 1 -1400; initpos 1 99999', 102),
])
def test_what_is_wrong_is_refused_whole(host, text, code):
    assert host.say(text)[0].startswith(f'ERR {code} ')
    assert host.wait(0.5) == [] and host.pos() == [0] * 6
    assert host.say('?prop 1 maxpos') == ['VAL 1400']


def test_the_column_of_an_error_points_at_the_word(host):
    assert host.say('move 1 to 5; move 2 to 9999') == ['ERR 102 24 9999']
    assert host.say('!goto 0 0 0 0 0 1401') == ['ERR 102 17 1401']


def test_move_is_a_straight_line_that_arrives_together(host):
    host.say('move 1 to 1000, 2 to -500, 3 by 250')
    for _ in range(10):
        host.wait(0.04)
        a, b, c = host.pos()[:3]
        assert abs(b + 0.5 * a) <= 1 and abs(c - 0.25 * a) <= 1
    host.wait(1.0)
    assert host.pos()[:3] == [1000, -500, 250]


def test_speed_and_acceleration_are_per_tick():
    host = Host(tick_s=0.010)
    host.say('maxspd all 50; accdec all 5; move 1 to 1400')
    before, speeds = 0, []
    for _ in range(100):
        host.wait(0.01)
        speeds.append(host.pos()[0] - before)
        before += speeds[-1]
    assert max(speeds) in (50, 51)
    assert np.abs(np.diff(speeds)).max() <= 7  # 5 and rounding


def test_jump_has_no_ramp(host):
    host.say('maxspd 1 10; jump 1 to 100')
    host.wait(0.02)
    assert host.pos()[0] == 10


def test_goto_replaces_without_a_jerk_and_ends_done(host):
    host.say('!goto 1400 0 0 0 0 0')
    first = host.seq
    host.wait(0.2)
    before = host.pos()[0]
    assert host.say('!goto -100 200 0 0 0 0') == ['OK', f'{first} STOPPED']
    last = host.seq
    host.wait(0.01)
    assert host.pos()[0] > before  # it needs time to turn round
    assert host.wait(2.0) == [f'{last} DONE']
    assert host.pos()[:2] == [-100, 200]


def test_goto_flushes_the_queue(host):
    host.say('wait 50')
    host.say('move 1 to 100')
    waiting = [host.seq - 1, host.seq]
    lines = host.say('!goto 0 0 5 0 0 0')
    assert [line for line in lines if 'STOPPED' in line] == [f'{n} STOPPED' for n in waiting]
    host.wait(1.0)
    assert host.pos() == [0, 0, 5, 0, 0, 0]


def test_stop_slows_down_flushes_and_latches_until_reset(host):
    host.say('move 1 to 1400')
    moving = host.seq
    host.say('move 1 to 0')
    host.wait(0.3)
    at = host.pos()[0]
    assert set(host.say('!stop')) >= {'OK', f'{moving} STOPPED', f'{moving + 1} STOPPED'}
    host.wait(1.0)
    stood = host.pos()[0]
    assert at < stood <= at + 100 ** 2 / 20 + 1  # v^2 / 2a in units and ticks
    for text in ('move 1 to 0', '!goto 0 0 0 0 0 0', 'restart', 'jump 1 to 0',
                 'wait 1; move 1 by 1'):
        assert host.say(text)[0].startswith('ERR 130')
    assert host.say('maxspd 1 50') == ['OK', 'DONE']
    assert host.say('?')[0].startswith('ST STOPPED')
    assert host.say('!reset') == ['OK']
    assert host.wait(0.5) == [] and host.pos()[0] == stood
    assert host.say('move 1 to 0') == ['OK']


def test_the_stop_byte_stops_within_the_line_and_at_once(host):
    host.say('move 1 to 1400')
    moving = host.seq
    host.wait(0.3)
    at = host.pos()[0]
    line = Request(900, 'move 1 to 0').encode()
    assert host.raw(line[:7] + b'\x18') == ['! ESTOP', f'{moving} STOPPED']
    assert host.raw(line[7:]) == ['0 ERR 900 0 crc']
    host.wait(0.5)
    assert host.pos()[0] == at
    assert host.say('move 1 to 0')[0].startswith('ERR 130')


def test_pause_stands_and_resume_goes_on(host):
    host.say('move 1 to 1000, 2 to 1000; wait 3; move 1 to 0')
    seq = host.seq
    host.wait(0.1)
    host.say('!pause')
    host.wait(0.5)
    stood = host.pos()
    assert host.say('?')[0].startswith('ST WORKING 1')
    assert host.wait(1.0) == [] and host.pos() == stood and 0 < stood[0] < 1000
    host.say('!resume')
    assert host.wait(3.0) == [f'{seq} DONE'] and host.pos()[:2] == [0, 1000]


def test_pause_during_a_wait_keeps_the_rest_of_it(host):
    host.say('wait 10; move 1 to 5')
    host.wait(0.6)
    host.say('!pause')
    host.wait(5.0)
    host.say('!resume')
    host.wait(0.3)
    assert host.pos()[0] == 0
    host.wait(0.5)
    assert host.pos()[0] == 5


def test_the_watchdog_stops_a_host_that_went_silent(host):
    host.say('!watch 200')
    host.say('move 1 to 1400')
    assert host.wait(0.19) == []
    assert '! WATCHDOG' in host.wait(0.05)
    assert host.wait(2.0) == [] and host.pos()[0] < 1400
    assert host.say('!goto 0 0 0 0 0 0')[0].startswith('ERR 130')
    host.say('!reset')
    host.say('!watch 0')
    assert host.wait(5.0) == []
    host.raw(b'garbage\n')
    host.say('!watch 200')
    host.wait(0.15)
    host.raw(b'garbage\n')  # no valid line
    assert '! WATCHDOG' in host.wait(0.1)


def test_power_off_stands_and_refuses_motion(host):
    host.say('move 1 to 1400')
    host.wait(0.2)
    host.say('!power off')
    at = host.pos()[0]
    host.wait(0.5)
    assert host.pos()[0] == at and host.say('?prop 1 power') == ['VAL 0']
    assert host.say('move 1 to 0')[0].startswith('ERR 130')
    host.say('!power on')
    assert host.say('move 1 to 0') == ['OK']
    host.say('power 2 off')
    assert host.say('move 2 to 5')[0].startswith('ERR 130')


def test_macros_call_each_other_forwards_but_never_themselves(host):
    assert host.say('macro a; b; b; end') == ['OK', 'DONE']
    assert host.say('a')[0].startswith('ERR 104')
    assert host.say('macro b; move 1 by 10; end') == ['OK', 'DONE']
    host.say('a 3')
    host.wait(5.0)
    assert host.pos()[0] == 60
    assert host.say('macro c; d; end') == ['OK', 'DONE']
    assert host.say('macro d; c; end')[0].startswith('ERR 513')
    assert host.say('macro b; move 1 by 1000; end') == ['OK', 'DONE']  # the first one wins
    host.say('b')
    host.wait(1.0)
    assert host.pos()[0] == 70


def test_a_macro_over_the_limits_is_refused_when_called(host):
    host.say('macro far; move 1 by 500; end')
    assert host.say('far 3')[0].startswith('ERR 102')
    assert host.say('far 2') == ['OK']


def test_macros_without_commands_cannot_hang_it(host):
    host.say('macro e; end')
    for name, inner in zip('fgh', 'efg'):
        host.say(f'macro {name}; {inner} 10000; end')
    assert host.say('h 10000') == ['OK']
    assert host.wait(0.1) == [] and host.say('?')[0].startswith('ST WORKING')
    assert 'OK' in host.say('!stop')


def test_properties_and_what_p0pos_means(host):
    assert [host.say(f'?prop 2 {name}')[0] for name in (
        'pos', 'minpos', 'maxpos', 'initpos', 'p0pos', 'maxspd', 'accel', 'decel', 'invert',
        'power', 'pinned')] == [f'VAL {v}' for v in
                                (0, -1400, 1400, 0, 3000, 100, 10, 10, 0, 100, 0)]
    host.say('p0pos 2 3100')
    assert host.say('?prop 2 pos') == ['VAL -100'] and host.wait(0.1) == []
    host.say('move 2 to maxpos; initpos 2 77; invert 2 on')
    host.wait(1.0)
    assert host.say('?prop 2 pinned') == ['VAL 1'] and host.say('?prop 2 invert') == ['VAL 1']
    host.say('restart')
    host.wait(1.0)
    assert host.pos() == [0, 77, 0, 0, 0, 0]


def test_the_queue_is_bounded(host):
    answers = [host.say('wait 10')[0] for _ in range(80)]
    assert answers[0] == 'OK' and answers[-1].startswith('ERR 130')


def test_a_million_bytes_of_garbage_move_nothing(host):
    rng = np.random.default_rng(3)
    heard = []
    for _ in range(100):
        heard += host.raw(rng.bytes(10000).replace(b'\x18', b''))
    assert {line.split(' ', 2)[1] for line in heard} == {'ERR'}
    host.raw(b'\n')
    assert host.say('?pos') == ['POS 0 0 0 0 0 0']


def test_positions_never_leave_the_limits_whatever_is_said():
    rng = np.random.default_rng(11)
    host = Host()
    for _ in range(3000):
        servo, value = rng.integers(1, 7), rng.integers(-1500, 1500)
        text = rng.choice([f'move {servo} to {value}', f'jump {servo} by {value}', '!pause',
                           '!goto ' + ' '.join(map(str, rng.integers(-1400, 1401, 6))),
                           '!resume', '!stop', '!reset', 'restart', '!goto 0 0 0 0 0 0'])
        host.say(text)
        host.wait(rng.uniform(0.0, 0.1))
        assert all(-1400 <= v <= 1400 for v in host.device.machine.positions(host.now_s))
