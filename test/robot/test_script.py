"""The script language: what it means, and every error code."""

from homography_servo.robot.script import Assign
from homography_servo.robot.script import Call
from homography_servo.robot.script import Clause
from homography_servo.robot.script import Move
from homography_servo.robot.script import parse
from homography_servo.robot.script import Restart
from homography_servo.robot.script import ScriptError
from homography_servo.robot.script import Wait
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import pytest

ALL = tuple(range(6))


def one(text):
    command, = parse(text, 6).commands
    return command


@pytest.mark.parametrize('text, command', [
    ('move 1 to 100', Move((Clause((0,), to=100),))),
    ('MOVE 1,2,4 TO +7', Move((Clause((0, 1, 3), to=7),))),
    ('move all by -5', Move((Clause(ALL, by=-5),))),
    ('move 1 to minpos, 2, 3 by 8', Move((Clause((0,), to='minpos'), Clause((1, 2), by=8)))),
    ('jump 2 to initpos', Move((Clause((1,), to='initpos'),), jump=True)),
    ('maxspd all 10000', Assign(('maxspd',), ALL, 10000)),
    ('accdec 1 5', Assign(('accel', 'decel'), (0,), 5)),
    ('minpos 3 -900', Assign(('minpos',), (2,), -900)),
    ('p0pos 3 default', Assign(('p0pos',), (2,), 'default')),
    ('invert 6 on', Assign(('invert',), (5,), 1)),
    ('power 1 off', Assign(('power',), (0,), 0)),
    ('power 1 50', Assign(('power',), (0,), 50)),
    ('wait 12', Wait(12)),
    ('pause 12', Wait(12)),
    ('restart', Restart()),
    ('wave', Call('wave')),
    ('Wave_2 3', Call('wave_2', 3)),
])
def test_a_command_is_understood(text, command):
    assert one(text) == command


def test_separators_comments_and_white_space():
    script = parse('wait 1; ;wait 2 # no; wait 9\n\r\twait 3\r\n;', 6)
    assert script.commands == (Wait(1), Wait(2), Wait(3))
    assert parse('# nothing', 6).commands == ()


@pytest.mark.parametrize('text, code, column', [
    ('move 1 to ' + '1' * 33, 100, 11),
    ('wait 1.5', 101, 6), ('wait -1', 101, 6), ('wait x', 101, 6), ('wait', 101, 5),
    ('accel 1 ten', 101, 9), ('move 1 to 1.5', 101, 11),
    ('accel 1 0', 102, 9), ('maxspd 1 10001', 102, 10), ('power 1 101', 102, 9),
    ('wait 65536', 102, 6), ('wave 0', 102, 6), ('move 1 to 123456', 102, 11),
    ('wait 1 2', 103, 8), ('restart now', 103, 9), ('move 1 to 5 6', 103, 13),
    ('to 1', 104, 1), ('all', 104, 1),
    ('move 1,2,1 to 5', 106, 10), ('move 1 to 5, 1 to 6', 106, 14),
    ('move 1 5', 107, 8), ('move 1', 107, 7),
    ('move 1 by minpos', 108, 11),
    ('move 1 to p0pos', 109, 11), ('minpos 1 low', 109, 10), ('power 1 dim', 109, 9),
    ('invert 1 yes', 110, 10), ('invert 1', 110, 9),
    ('pos 1 5', 111, 1), ('pinned 1 5', 111, 1),
    ('5 to 3', 501, 1), ('%', 501, 1), ('macro 7', 501, 7), ('macro move', 501, 7),
    ('move 7 to 0', 503, 6), ('move 0 to 0', 503, 6), ('move 1,x to 0', 503, 8),
    ('move to 5', 508, 6), ('move ,1 to 5', 508, 6),
    ('end', 511, 1), ('macro a; end; end', 511, 15),
    ('macro a; macro b', 512, 10),
])
def test_every_error_names_code_and_column(text, code, column):
    with pytest.raises(ScriptError) as caught:
        parse(text, 6)
    assert (caught.value.code, caught.value.column) == (code, column)


def test_the_first_error_counts_and_nothing_else_is_read():
    with pytest.raises(ScriptError) as caught:
        parse('wait 1; wait x; dance 0', 6)
    assert (caught.value.code, caught.value.token) == (101, 'x')


def test_macros_may_span_texts():
    first = parse('wait 1; macro a; wait 2', 6)
    assert first.commands == (Wait(1),) and first.macros == ()
    second = parse('b 2', 6, first.open_macro)
    third = parse('end; wait 3', 6, second.open_macro)
    assert third.commands == (Wait(3),) and third.open_macro is None
    macro, = third.macros
    assert (macro.name, macro.body) == ('a', (Wait(2), Call('b', 2)))


WORDS = st.sampled_from(['move', 'jump', 'to', 'by', 'all', '1', '2', '-5', ',', ';', '\n', 'end',
                         'macro', 'a', 'wait', 'power', 'on', 'minpos', 'default', '#', '%', '1.5',
                         'invert', '99999999999999999999'])


@settings(deadline=None)
@given(st.lists(WORDS, max_size=15).map(' '.join))
def test_any_text_is_read_or_refused_with_a_place_in_it(text):
    try:
        parse(text, 6)
    except ScriptError as error:
        assert 100 <= error.code <= 513 and 1 <= error.column <= len(text) + 1
