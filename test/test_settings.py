"""Settings refuse what breaks their rules, by name."""

from dataclasses import dataclass
from dataclasses import FrozenInstanceError
import math

from homography_servo.settings import defaults_of
from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import reals
from homography_servo.settings import rules_of
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import texts
from homography_servo.settings import whole
import pytest


@dataclass(frozen=True)
class Example(Settings):
    """One setting of each kind."""

    size_m: float = real(1.0, 0.0, 2.0, 'm', 'a length')
    count: int = whole(3, 1, 5, '', 'a number of things')
    enabled: bool = flag(True, 'a switch')
    mode: str = text('slow', 'a choice', choices=('slow', 'fast'))
    corners_px: tuple = reals((), 'px', 'two numbers', length=2, low=0.0)
    names: tuple = texts(('a',), 'names', read_only=True)


@pytest.mark.parametrize('name, value, said', [
    ('size_m', 2.0000001, r'size_m must be in \[0, 2\] m, got 2'),
    ('size_m', math.nan, 'size_m must be finite'),
    ('size_m', 1, 'size_m must be a number with a decimal point'),
    ('size_m', True, 'size_m must be a number'),
    ('count', 6, r'count must be in \[1, 5\], got 6'),
    ('count', 2.0, 'count must be a whole number'),
    ('count', True, 'count must be a whole number'),
    ('enabled', 1, 'enabled must be true or false'),
    ('mode', 'quick', "mode must be one of slow, fast, got 'quick'"),
    ('mode', False, 'mode must be text'),
    ('corners_px', (1.0,), 'corners_px must have 2 items or none, got 1'),
    ('corners_px', (1.0, -1.0), 'corners_px must be in'),
    ('corners_px', (1.0, 2), 'corners_px must be a number'),
    ('corners_px', 'ab', 'corners_px must be a list'),
    ('names', ('a', 1), 'names must be text'),
])
def test_bad_values_are_refused_by_name(name, value, said):
    with pytest.raises(ValueError, match=said):
        Example(**{name: value})


def test_ends_of_a_range_belong_to_it():
    assert Example(size_m=0.0, count=5).size_m == 0.0
    assert Example(size_m=2.0, count=1).count == 1


def test_lists_become_tuples_and_instances_stay_frozen():
    example = Example(corners_px=[1.0, 2.0])
    assert example.corners_px == (1.0, 2.0)
    assert hash(example) == hash(Example(corners_px=(1.0, 2.0)))
    with pytest.raises(FrozenInstanceError):
        example.size_m = 0.5


def test_rules_and_defaults_can_be_listed():
    assert list(rules_of(Example)) == list(defaults_of(Example))
    assert rules_of(Example)['size_m'].description == 'a length [m]'
    assert rules_of(Example)['names'].read_only
    assert defaults_of(Example)['mode'] == 'slow'
