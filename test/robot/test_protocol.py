"""RBX/1 lines: any cut, any noise, only what is to the letter gets through."""

from homography_servo.result import Rejected
from homography_servo.robot.protocol import BAD_ASCII
from homography_servo.robot.protocol import BAD_CRC
from homography_servo.robot.protocol import BAD_LENGTH
from homography_servo.robot.protocol import BadLine
from homography_servo.robot.protocol import checksum
from homography_servo.robot.protocol import encode_line
from homography_servo.robot.protocol import error_text
from homography_servo.robot.protocol import goto_text
from homography_servo.robot.protocol import Line
from homography_servo.robot.protocol import LineDecoder
from homography_servo.robot.protocol import MAX_LINE
from homography_servo.robot.protocol import next_seq
from homography_servo.robot.protocol import Notice
from homography_servo.robot.protocol import parse_reply
from homography_servo.robot.protocol import parse_request
from homography_servo.robot.protocol import Reply
from homography_servo.robot.protocol import Request
from homography_servo.robot.protocol import StopByte
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
import numpy as np
import pytest

TEXTS = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1,
                max_size=MAX_LINE - 5)


def crc_by_bits(data):
    """Compute CRC-16/CCITT-FALSE the long way, independent of binascii."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


@settings(deadline=None)
@given(st.binary(max_size=60))
def test_checksum_is_the_one_of_the_standard(data):
    assert checksum(b'123456789') == b'29B1'
    assert checksum(data) == b'%04X' % crc_by_bits(data)


@settings(deadline=None)
@given(TEXTS)
def test_a_line_is_read_back(text):
    assert LineDecoder().feed(encode_line(text)) == [Line(text)]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.one_of(TEXTS.map(encode_line), st.binary(max_size=40),
                          st.just(b'x' * 300 + b'\n')), max_size=8), st.data())
def test_it_does_not_matter_where_the_stream_is_cut(parts, data):
    stream = b''.join(parts)
    whole = LineDecoder().feed(stream)
    decoder, found, start = LineDecoder(), [], 0
    for end in sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12))):
        found += decoder.feed(stream[start:end])
        start = end
    assert found + decoder.feed(stream[start:]) == whole
    single = LineDecoder()
    assert [item for i in range(len(stream)) for item in single.feed(stream[i:i + 1])] == whole


@settings(deadline=None)
@given(TEXTS, st.integers(0, 7), st.data())
def test_one_wrong_bit_never_passes(text, bit, data):
    line = encode_line(text)
    place = data.draw(st.integers(0, len(line) - 2))
    wrong = line[:place] + bytes([line[place] ^ 1 << bit]) + line[place + 1:]
    assert Line(text) not in LineDecoder().feed(wrong)


@pytest.mark.parametrize('raw, found', [
    (b'17 ?*5FF2\n', Line('17 ?')),
    (b'17 ?*5FF2\r\n', Line('17 ?')),
    (b'17\r ?*5FF2\n', Line('17 ?')),
    (b'17 ?*5ff2\n', BadLine(BAD_CRC)),
    (b'17 ?*5FF3\n', BadLine(BAD_CRC)),
    (b'17 ?\n', BadLine(BAD_CRC)),
    (b'x' * 250 + b'\n', BadLine(BAD_CRC)),
    (b'x' * 251 + b'\n', BadLine(BAD_LENGTH)),
    (b'17 \xff*0000\n', BadLine(BAD_ASCII)),
    (b'17 \x07*0000\n', BadLine(BAD_ASCII)),
])
def test_a_bad_line_is_named(raw, found):
    assert LineDecoder().feed(raw) == [found]


def test_the_longest_line_has_250_characters():
    assert len(encode_line('x' * 245)) == 251
    assert LineDecoder().feed(encode_line('x' * 245)) == [Line('x' * 245)]
    with pytest.raises(ValueError, match='at most 245'):
        encode_line('x' * 246)
    for text in ('a\nb', 'caf\u00e9', 'a\x18b'):
        with pytest.raises(ValueError, match='printable ASCII'):
            encode_line(text)


def test_the_stop_byte_works_anywhere_and_clears_the_line():
    good = encode_line('1 !goto 1 2 3')
    for cut in range(len(good)):
        found = LineDecoder().feed(good[:cut] + b'\x18' + encode_line('2 ?'))
        assert found == [StopByte(), Line('2 ?')]
        assert Line('1 !goto 1 2 3') not in LineDecoder().feed(
            good[:cut] + b'\x18' + good[cut:]) or cut == 0
    assert LineDecoder().feed(b'x' * 300 + b'\x18' + encode_line('2 ?'))[-1] == Line('2 ?')


def test_a_million_bytes_of_garbage_give_no_line_and_the_next_good_one_is_understood():
    rng = np.random.default_rng(5)
    decoder, good = LineDecoder(), 0
    for _ in range(250):
        for item in decoder.feed(rng.bytes(4000)):
            good += isinstance(item, Line)
    decoder.feed(b'\n')
    assert good == 0  # by chance one line in 65536 of those with '*' in the right place
    assert decoder.feed(encode_line('17 OK')) == [Line('17 OK')]


def test_sequence_numbers_go_round_without_zero():
    assert [next_seq(n) for n in (1, 65534, 65535)] == [2, 65535, 1]
    for seq in (0, 65536):
        with pytest.raises(ValueError, match='seq'):
            Request(seq, '?').encode()


@pytest.mark.parametrize('text, request_', [
    ('17 ?', Request(17, '?')), ('  17   ?pos ', Request(17, '?pos')), ('9', Request(9, '')),
    ('65535 !goto 1 -2', Request(65535, '!goto 1 -2')),
])
def test_requests_are_read(text, request_):
    assert parse_request(text) == request_


@pytest.mark.parametrize('text', ['', '?', '0 ?', '65536 ?', '-1 ?', '1.5 ?', '123456 ?', 'x 1'])
def test_bad_requests_have_a_reason(text):
    assert isinstance(parse_request(text), Rejected)
    assert 'sequence number' in parse_request(text).reason


@pytest.mark.parametrize('text, reply', [
    ('17 OK', Reply(17, 'OK')), ('17 DONE', Reply(17, 'DONE')),
    ('17 STOPPED', Reply(17, 'STOPPED')),
    ('17 HELLO RBX/1 6 robix arm', Reply(17, 'HELLO', ('RBX/1', 6, 'robix arm'))),
    ('17 ERR 102 8 1500', Reply(17, 'ERR', (102, 8, '1500'))),
    ('0 ERR 900 0 crc', Reply(0, 'ERR', (900, 0, 'crc'))),
    ('17 ST WORKING 0 16 3', Reply(17, 'ST', ('WORKING', 0, 16, 3))),
    ('17 POS 1 -2 3', Reply(17, 'POS', (1, -2, 3))),
    ('17 VAL -1400', Reply(17, 'VAL', (-1400,))),
    ('! READY', Notice('READY')), ('! ESTOP', Notice('ESTOP')),
    ('! WATCHDOG', Notice('WATCHDOG')),
])
def test_replies_are_read(text, reply):
    assert parse_reply(text) == reply


@pytest.mark.parametrize('text', [
    '', 'OK', '17', '17 ok', '17 OK 1', '0 OK', '65536 OK', '-1 OK', '17 DONE x', '17 POS',
    '17 POS 1.5', '17 POS nan', '17 POS 1 x', '17 VAL', '17 VAL 1 2', '17 ST IDLE 0 1',
    '17 ST BUSY 0 1 0', '17 ST IDLE 2 1 0', '17 ST IDLE 0 x 0', '17 ERR', '17 ERR x 1 y',
    '17 HELLO RBX/1', '17 HELLO RBX/1 six x', '! HELP', '! READY now', '17 GO', '1e3 OK',
    '17 POS 99999999999999999999',
])
def test_replies_that_are_not_to_the_letter_are_refused(text):
    assert isinstance(parse_reply(text), Rejected)


@settings(deadline=None)
@given(st.text(max_size=60))
def test_no_text_makes_the_readers_fail(text):
    parse_request(text)
    parse_reply(text)


def test_texts_that_are_written():
    assert goto_text([1, -2, 3]) == '!goto 1 -2 3'
    assert error_text(7, 104, 3, 'dance') == '7 ERR 104 3 dance'
    assert error_text(7, 104, 3, 'a b\n' + 'x' * 99) == '7 ERR 104 3 a?b?' + 'x' * 28
    assert error_text(7, 104, 3, '') == '7 ERR 104 3 -'
