"""A rejection is false and says why; what must be there is asked for by name."""

from homography_servo.result import Rejected
from homography_servo.result import required
import pytest


def test_a_rejection_is_false_and_reads_as_its_reason():
    assert not Rejected('too dark')
    assert f'{Rejected("too dark")}' == 'too dark'


def test_what_is_there_is_given_back_even_when_it_is_false():
    assert required(0.0, 'time') == 0.0
    assert required('', 'name') == ''


@pytest.mark.parametrize('value, said', [
    (None, '^there is no arm$'), (Rejected('unplugged'), '^there is no arm: unplugged$')])
def test_what_is_missing_is_named(value, said):
    with pytest.raises(ValueError, match=said):
        required(value, 'arm')
