"""Requests and replies: time-outs, one repeat, four at most, nothing believed twice."""

from homography_servo.errors import LinkError
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.protocol import Notice
from homography_servo.robot.session import Answer
from homography_servo.robot.session import Over
from homography_servo.robot.session import Session
from link_setup import decoded
import numpy as np
import pytest


def lines(data):
    return [text for text, _ in decoded([(0.0, data)])]


def reply(*texts):
    return b''.join(encode_line(text) for text in texts)


def looked(session, start_s, end_s):
    """Look every 10 ms, as a thread that is not held up does."""
    out, now_s = b'', start_s
    while now_s < end_s:
        now_s = min(now_s + 0.01, end_s)
        out += session.due(now_s)
    return out


@pytest.fixture
def session():
    return Session(115200)


def test_requests_are_numbered_and_at_most_four_wait_for_an_answer(session):
    assert [session.request(f'wait {k}') for k in range(6)] == [1, 2, 3, 4, 5, 6]
    assert lines(session.due(0.0)) == ['1 wait 0', '2 wait 1', '3 wait 2', '4 wait 3']
    assert session.due(0.01) == b'' and session.backlog == 6
    assert session.feed(reply('2 OK')) == [Answer(2, 'wait 1', 'OK', ())]
    assert lines(session.due(0.02)) == ['5 wait 4']
    session.feed(reply('1 OK', '3 OK', '4 OK', '5 OK'))
    assert lines(session.due(0.03)) == ['6 wait 5']
    assert not session.idle and session.feed(reply('6 OK')) and session.idle


def test_an_order_waits_for_the_answer_of_the_one_before_it_and_motion_does_not(session):
    for text in ('!pause', '?', '!resume', '?pos'):
        session.request(text)
    session.request('!goto 1 2', motion=True)
    assert lines(session.due(0.0)) == ['1 !pause', '2 ?', '5 !goto 1 2']
    assert lines(looked(session, 0.0, 0.1)) == ['1 !pause', '2 ?', '5 !goto 1 2']
    session.feed(reply('1 OK'))
    assert lines(session.due(0.1)) == ['3 !resume', '4 ?pos']


def test_silence_means_one_repeat_and_then_death(session):
    session.request('?')
    assert lines(session.due(0.0)) == ['1 ?']
    assert looked(session, 0.0, 0.099) == b'' and session.next_due_s() == pytest.approx(0.1)
    assert lines(session.due(0.1)) == ['1 ?']
    assert looked(session, 0.1, 0.199) == b''
    with pytest.raises(LinkError, match='asked twice'):
        session.due(0.2)


def test_time_in_which_nobody_looked_is_not_silence(session):
    session.request('?')
    session.due(0.0)
    assert session.due(0.12) == b'' and session.counts['late_looks'] == 1
    assert lines(looked(session, 0.12, 0.20)) == ['1 ?']
    assert session.due(0.45) == b'' and session.backlog == 1
    with pytest.raises(LinkError):  # but it does not excuse everything
        session.due(60.0)


def test_an_answer_to_the_repeat_is_enough_and_a_second_one_is_stray(session):
    session.request('?pos')
    session.due(0.0)
    looked(session, 0.0, 0.1)
    assert session.feed(reply('1 POS 1 2')) == [Answer(1, '?pos', 'POS', (1, 2), repeated=True)]
    assert session.feed(reply('1 POS 1 2')) == [] and session.counts['stray_replies'] == 1


@pytest.mark.parametrize('text, answers', [
    ('?', ['1 OK', '1 POS 1', '1 DONE', '2 ST IDLE 0 0 0', '0 ERR 900 0 crc']),
    ('?pos', ['1 OK', '1 VAL 1', '1 ST IDLE 0 0 0', '1 STOPPED']),
    ('move 1 to 5', ['1 POS 1', '1 HELLO RBX/1 6 x', '2 OK', '65535 OK', '1001 OK']),
    ('!hello', ['1 OK', '1 DONE']),
])
def test_a_reply_that_does_not_fit_is_no_answer(session, text, answers):
    session.request(text)
    session.due(0.0)
    assert session.feed(reply(*answers)) == [] and not session.idle


def test_errors_answer_anything(session):
    for text in ('?', '?pos', 'dance', '!hello'):
        session.request(text)
    session.due(0.0)
    events = session.feed(reply(*(f'{k} ERR 130 0 x' for k in (1, 2, 3, 4))))
    assert [event.kind for event in events] == ['ERR'] * 4


def test_done_and_stopped_belong_to_what_was_accepted(session):
    session.request('move 1 to 5', motion=True)
    session.due(0.0)
    assert session.feed(reply('1 OK', '1 DONE')) == [
        Answer(1, 'move 1 to 5', 'OK', ()), Over(1, 'DONE')]
    assert session.feed(reply('1 DONE', '9 STOPPED')) == []


def test_done_without_ok_says_that_it_ran(session):
    session.request('move 1 to 5', motion=True)
    session.due(0.0)
    assert session.feed(reply('1 DONE')) == [Over(1, 'DONE')] and session.idle


def test_dropped_motion_is_neither_sent_nor_repeated(session):
    session.request('?')
    for k in range(6):
        session.request(f'!goto {k}', motion=True)
    session.due(0.0)
    session.drop_motion()
    assert lines(looked(session, 0.0, 0.1)) == ['1 ?'] and session.backlog == 1


def test_the_time_for_a_reply_grows_on_a_slow_line():
    waits = []
    for baud in (115200, 9600, 1200):
        session = Session(baud)
        session.request('!goto -1400 -1400 -1400 -1400 -1400 -1400')
        session.due(0.0)
        waits.append(session.next_due_s())
    assert waits[0] == 0.1 and 0.3 < waits[1] < 0.6 and waits[2] == pytest.approx(8 * waits[1])


def test_notices_pass_and_numbers_go_round(session):
    assert session.feed(reply('! ESTOP')) == [Notice('ESTOP')]
    session = Session(first_seq=65535)
    assert [session.request('?'), session.request('?')] == [65535, 1]


def test_a_million_bytes_of_garbage_are_no_false_ok(session):
    rng = np.random.default_rng(8)
    session.request('move 1 to 5', motion=True)
    session.due(0.0)
    for _ in range(100):
        assert session.feed(rng.bytes(10000)) == []
    assert session.feed(b'\n' + reply('1 OK')) == [Answer(1, 'move 1 to 5', 'OK', ())]
