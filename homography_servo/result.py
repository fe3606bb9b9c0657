"""An expected miss is a value with a reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

Value = TypeVar('Value')


@dataclass(frozen=True)
class Rejected:
    """Input that cannot be used, and why; false, so ``if not result`` finds it."""

    reason: str

    def __bool__(self) -> bool:
        return False

    def __str__(self) -> str:
        return self.reason


def required(value: Value | Rejected | None, what: str) -> Value:
    """
    Give a value that must be there by now.

    Parameters
    ----------
    value
        Anything, or what stands for its absence.
    what : str
        What it is, for the message.

    Raises
    ------
    ValueError
        It is not there: a call came before what it builds on.

    """
    if value is None:
        raise ValueError(f'there is no {what}')
    if isinstance(value, Rejected):
        raise ValueError(f'there is no {what}: {value.reason}')
    return value
