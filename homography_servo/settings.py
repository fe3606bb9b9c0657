"""
Settings are frozen dataclasses, the only home of a default.

A class that derives from `Settings` names its fields with the makers below. They
carry meaning, unit and range, so that nodes can declare them as parameters and
YAML files can be checked against them without ROS.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
import math
from typing import Any


@dataclass(frozen=True)
class Rule:
    """What a setting may hold: its kind, unit, range or choices, and meaning."""

    kind: str  # 'real', 'whole', 'flag', 'text', 'reals' or 'texts'
    about: str
    unit: str = ''
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    length: int | None = None
    read_only: bool = False

    @property
    def description(self) -> str:
        """Meaning and unit in one line, for ``ros2 param describe``."""
        return f'{self.about} [{self.unit}]' if self.unit else self.about

    def problem(self, value: Any) -> str | None:
        """Say what is wrong with a value, or None."""
        return _CHECKS[self.kind](self, value)


def _outside(rule: Rule, value: float) -> str | None:
    if not math.isfinite(value):
        return f'must be finite, got {value}'
    low = -math.inf if rule.low is None else rule.low
    high = math.inf if rule.high is None else rule.high
    if low <= value <= high:
        return None
    return f'must be in [{low:g}, {high:g}]{" " + rule.unit if rule.unit else ""}, got {value:g}'


def _real_problem(rule: Rule, value: Any) -> str | None:
    if isinstance(value, bool) or not isinstance(value, float):
        return f'must be a number with a decimal point (such as 1.0), got {value!r}'
    return _outside(rule, value)


def _whole_problem(rule: Rule, value: Any) -> str | None:
    if isinstance(value, bool) or not isinstance(value, int):
        return f'must be a whole number, got {value!r}'
    return _outside(rule, value)


def _flag_problem(rule: Rule, value: Any) -> str | None:
    return None if isinstance(value, bool) else f'must be true or false, got {value!r}'


def _text_problem(rule: Rule, value: Any) -> str | None:
    if not isinstance(value, str):
        return f'must be text (put it in quotes), got {value!r}'
    if rule.choices and value not in rule.choices:
        return f'must be one of {", ".join(rule.choices)}, got {value!r}'
    return None


def _list_problem(rule: Rule, value: Any, item_problem) -> str | None:
    if isinstance(value, str) or not hasattr(value, '__len__'):
        return f'must be a list, got {value!r}'
    if rule.length is not None and len(value) not in (0, rule.length):
        return f'must have {rule.length} items or none, got {len(value)}'
    problems = (item_problem(rule, item) for item in value)
    return next((problem for problem in problems if problem), None)


_CHECKS = {
    'real': _real_problem,
    'whole': _whole_problem,
    'flag': _flag_problem,
    'text': _text_problem,
    'reals': lambda rule, value: _list_problem(rule, value, _real_problem),
    'texts': lambda rule, value: _list_problem(rule, value, _text_problem),
}


def _make(default: Any, rule: Rule) -> Any:
    return field(default=default, metadata={'rule': rule})


def real(default: float, low: float, high: float, unit: str, about: str,
         read_only: bool = False) -> Any:
    """Make a floating-point setting with an inclusive range."""
    return _make(default, Rule('real', about, unit, low, high, read_only=read_only))


def whole(default: int, low: int, high: int, unit: str, about: str,
          read_only: bool = False) -> Any:
    """Make an integer setting with an inclusive range."""
    return _make(default, Rule('whole', about, unit, low, high, read_only=read_only))


def flag(default: bool, about: str, read_only: bool = False) -> Any:
    """Make a setting that is true or false."""
    return _make(default, Rule('flag', about, read_only=read_only))


def text(default: str, about: str, choices: tuple[str, ...] = (),
         read_only: bool = False) -> Any:
    """Make a text setting, optionally one of a few choices."""
    return _make(default, Rule('text', about, choices=choices, read_only=read_only))


def reals(default: tuple[float, ...], unit: str, about: str, length: int | None = None,
          low: float | None = None, high: float | None = None, read_only: bool = False) -> Any:
    """Make a list of floating-point numbers; an empty list means not set."""
    return _make(default, Rule('reals', about, unit, low, high, length=length,
                               read_only=read_only))


def texts(default: tuple[str, ...], about: str, read_only: bool = False) -> Any:
    """Make a list of texts."""
    return _make(default, Rule('texts', about, read_only=read_only))


@dataclass(frozen=True)
class Settings:
    """
    Base of all settings; a bad value raises ValueError that names it.

    Lists are kept as tuples, so instances stay hashable.
    """

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.metadata['rule'].kind in ('reals', 'texts') and hasattr(value, '__iter__') \
                    and not isinstance(value, str):
                object.__setattr__(self, item.name, tuple(value))
            problem = item.metadata['rule'].problem(getattr(self, item.name))
            if problem:
                raise ValueError(f'{item.name} {problem}')


def rules_of(settings_type: type[Settings]) -> dict[str, Rule]:
    """List the rules of a settings class by field name."""
    return {item.name: item.metadata['rule'] for item in fields(settings_type)}


def defaults_of(settings_type: type[Settings]) -> dict[str, Any]:
    """List the defaults of a settings class by field name."""
    return {item.name: item.default for item in fields(settings_type)}
