"""
Read YAML with line numbers, and trust nothing that YAML guesses.

PyYAML reads ``010`` as 8, ``1:30`` as 90, ``no`` as false and ``1e-3`` as text, and keeps
the last of two equal keys. Here every value stays the text that was written, next to its
line, until the reader says what it must be.
"""

from __future__ import annotations

import math
from pathlib import Path
import re

from homography_servo.errors import ConfigError
import yaml

_NUMBER = re.compile(r'[-+]?(0|[1-9][0-9]*)?(\.[0-9]*)?([eE][-+]?[0-9]+)?')
_SIZE_LIMIT = 1_000_000  # characters; a robot or camera file has a few thousand


class Value:
    """One value of the file: its YAML node, the file and the dotted key."""

    def __init__(self, node: yaml.Node, file: str | Path, key: str = '') -> None:
        self.node = node
        self.file = file
        self.key = key

    @property
    def line(self) -> int:
        """Line of the value, counted from 1."""
        return self.node.start_mark.line + 1

    def error(self, reason: str) -> ConfigError:
        """Make the error that names file, line, key and reason."""
        return ConfigError(self.file, self.line, self.key, reason)

    def mapping(self, required: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict:
        """Read key: value pairs; unknown, missing and repeated keys are refused."""
        if not isinstance(self.node, yaml.MappingNode):
            raise self.error(f'must hold the keys {", ".join(required)}, got {_shown(self.node)}')
        found: dict[str, Value] = {}
        for key_node, value_node in self.node.value:
            self._add(found, key_node, value_node, (*required, *optional))
        for name in required:
            if name not in found:
                raise self.error(f'key {name!r} is missing')
        return found

    def _add(self, found: dict, key_node: yaml.Node, value_node: yaml.Node, known: tuple) -> None:
        name = key_node.value if isinstance(key_node, yaml.ScalarNode) else _shown(key_node)
        path = f'{self.key}.{name}' if self.key else str(name)
        at_key = Value(key_node, self.file, path)
        if name not in known:
            raise at_key.error(f'unknown key, expected one of {", ".join(known)}')
        if name in found:
            raise at_key.error(f'given twice, first in line {found[name].line}')
        found[name] = Value(value_node, self.file, path)

    def items(self, length: int | None = None) -> list[Value]:
        """Read a list, of a given length if one is given."""
        if not isinstance(self.node, yaml.SequenceNode):
            raise self.error(f'must be a list, got {_shown(self.node)}')
        if length is not None and len(self.node.value) != length:
            raise self.error(f'must have {length} items, got {len(self.node.value)}')
        return [Value(node, self.file, f'{self.key}[{index}]')
                for index, node in enumerate(self.node.value)]

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """Read a finite decimal number in an inclusive range."""
        text = self._plain('a number')
        if not any(c.isdigit() for c in text) or not _NUMBER.fullmatch(text):
            raise self.error(f'must be a plain decimal number, got {text!r}')
        value = float(text)
        if not math.isfinite(value):
            raise self.error(f'must be finite, got {text!r}')
        if not low <= value <= high:
            raise self.error(f'must be in [{low:g}, {high:g}], got {text}')
        return value

    def whole(self, low: int, high: int) -> int:
        """Read a whole number in an inclusive range."""
        value = self.number(low, high)
        if value != int(value):
            raise self.error(f'must be a whole number, got {self.node.value}')
        return int(value)

    def numbers(self, length: int, low: float = -math.inf, high: float = math.inf) -> list[float]:
        """Read a list of numbers."""
        return [item.number(low, high) for item in self.items(length)]

    def text(self) -> str:
        """Read a text that YAML does not take for something else."""
        if not isinstance(self.node, yaml.ScalarNode):
            raise self.error(f'must be text, got {_shown(self.node)}')
        if self.node.tag != 'tag:yaml.org,2002:str' or not self.node.value.strip():
            raise self.error(f'must be text (put it in quotes), got {_shown(self.node)}')
        return self.node.value

    def _plain(self, wanted: str) -> str:
        if not isinstance(self.node, yaml.ScalarNode):
            raise self.error(f'must be {wanted}, got {_shown(self.node)}')
        if self.node.style is not None:
            raise self.error(f'must be {wanted} without quotes, got {_shown(self.node)}')
        return self.node.value


def _shown(node: yaml.Node) -> str:
    if isinstance(node, yaml.ScalarNode):
        if node.style is None:
            return node.value[:40] or 'nothing'
        return repr(node.value[:40])
    return 'a list' if isinstance(node, yaml.SequenceNode) else 'keys and values'


def read_values(path: str | Path) -> Value:
    """
    Read the one document of a YAML file.

    Raises
    ------
    ConfigError
        When the file cannot be opened, is not text, is not YAML, or is empty.

    """
    try:
        with open(path, encoding='utf-8') as file:
            text = file.read(_SIZE_LIMIT + 1)
    except (OSError, UnicodeDecodeError) as problem:
        reason = getattr(problem, 'strerror', None) or str(problem)
        raise ConfigError(path, 0, '', f'cannot be read: {reason}') from None
    if len(text) > _SIZE_LIMIT:
        raise ConfigError(path, 0, '', f'is larger than {_SIZE_LIMIT} characters')
    return _compose(path, text)


def _compose(path: str | Path, text: str) -> Value:
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as problem:
        mark = getattr(problem, 'problem_mark', None)
        line = 0 if mark is None else mark.line + 1
        reason = getattr(problem, 'problem', None) or str(problem)
        raise ConfigError(path, line, '', f'is not valid YAML: {reason}') from None
    except RecursionError:
        raise ConfigError(path, 0, '', 'is nested too deeply') from None
    if node is None:
        raise ConfigError(path, 0, '', 'is empty')
    return Value(node, path)
