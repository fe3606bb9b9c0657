"""Every error this package raises on purpose."""

from __future__ import annotations

from pathlib import Path


class ServoError(Exception):
    """Root of the package's errors; catch this at a node boundary."""


class LinkError(ServoError):
    """The robot did not answer, or answered nonsense."""


class ConfigError(ServoError):
    """
    A file holds something that cannot be used.

    Parameters
    ----------
    file : path
        The file that was read.
    line : int
        Line of the offending key, counted from 1; 0 when the whole file is meant.
    key : str
        Dotted path of the key inside the file; empty when the whole file is meant.
    reason : str
        What was expected and what was found.

    """

    def __init__(self, file: str | Path, line: int, key: str, reason: str) -> None:
        super().__init__(': '.join(p for p in (f'{file}:{line}', key, reason) if p))
        self.file = str(file)
        self.line = line
        self.key = key
        self.reason = reason


class HardwareError(ServoError):
    """A device is not there, or somebody else holds it; the program ends with code 3."""
