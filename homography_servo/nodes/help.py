"""The text that a node prints for ``--help``."""

from __future__ import annotations

from inspect import cleandoc

from homography_servo.settings import defaults_of
from homography_servo.settings import Rule
from homography_servo.settings import rules_of


def _range_of(rule: Rule) -> str:
    if rule.choices:
        return f' one of {", ".join(rule.choices)};'
    return '' if rule.low is None else f' {rule.low:g} to {rule.high:g};'


def _shown(default) -> str:
    if isinstance(default, tuple):
        return '[' + ', '.join(str(item) for item in default) + ']'
    return repr(default) if isinstance(default, str) else str(default)


def parameter_lines(settings_types) -> list[str]:
    """Describe every parameter of a node in one line each."""
    lines = []
    for settings_type in settings_types:
        defaults = defaults_of(settings_type)
        for name, rule in rules_of(settings_type).items():
            fixed = ' (fixed at start)' if rule.read_only else ''
            lines.append(f'  {name}: {rule.description};{_range_of(rule)} '
                         f'default {_shown(defaults[name])}{fixed}')
    return lines


def help_text(node_type) -> str:
    """Say what a node does, with an example and its parameters."""
    name = node_type.NAME
    example = getattr(node_type, 'EXAMPLE', f'ros2 run homography_servo {name}')
    lines = [f'{name}: {cleandoc(node_type.__doc__)}', '', 'Example:', f'  {example}', '',
             'Parameters (--ros-args -p NAME:=VALUE, or --params-file FILE):']
    return '\n'.join([*lines, *parameter_lines(node_type.SETTINGS)])
