"""Macros of the script language: definitions, calls, and what they lead to."""

from __future__ import annotations

from typing import Iterator, Sequence

from homography_servo.robot.protocol import NOT_NOW
from homography_servo.robot.script import Call
from homography_servo.robot.script import CALLS_ITSELF
from homography_servo.robot.script import Command
from homography_servo.robot.script import Macro
from homography_servo.robot.script import Script
from homography_servo.robot.script import UNKNOWN

MAX_MACROS = 100


def with_macros(known: dict[str, Macro], script: Script) -> dict[str, Macro]:
    """
    Add the macros of a script (the first definition wins) and check all calls.

    Raises
    ------
    ScriptError
        For a macro that calls itself by whatever detour, and for a call that leads to a
        name without a macro.

    """
    macros = dict(known)
    for macro in script.macros:
        if len(macros) >= MAX_MACROS:
            raise macro.at.error(NOT_NOW)
        macros.setdefault(macro.name, macro)
    for macro in script.macros:
        for call in _calls(macro.body):
            if macro.name in _reached(call.name, macros):
                raise call.at.error(CALLS_ITSELF)
    for call in _calls(script.commands):
        if not _reached(call.name, macros) <= macros.keys():
            raise call.at.error(UNKNOWN)
    return macros


def expanded(commands: Sequence[Command], macros: dict[str, Macro]) -> Iterator[Command]:
    """Walk over commands, calls and what they call."""
    for command in commands:
        if not isinstance(command, Call):
            yield command
            continue
        for _ in range(command.count):
            yield command  # counts as a step, so that empty macros cannot run for ever
            yield from expanded(macros[command.name].body, macros)


def _calls(commands: Sequence[Command]) -> list[Call]:
    return [command for command in commands if isinstance(command, Call)]


def _reached(name: str, macros: dict[str, Macro]) -> set[str]:
    """Give the names that a call leads to; names without a macro may be defined later."""
    seen, todo = set(), [name]
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += [call.name for call in _calls(macros[name].body)] if name in macros else []
    return seen
