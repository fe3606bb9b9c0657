"""How far the servo is, as a message and back."""

from __future__ import annotations

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from homography_servo.nodes.kit import shown
from homography_servo.planning.servo_state import Progress


def progress_msg(name: str, level: bytes, sentence: str, progress: Progress) -> DiagnosticStatus:
    """Make a status whose values are the fields of the progress."""
    values = [KeyValue(key=key, value=shown(value))
              for key, value in progress._asdict().items()]
    return DiagnosticStatus(name=name, level=level, message=sentence, values=values)


def progress_from_msg(msg: DiagnosticStatus) -> Progress:
    """Read the progress; what is missing, or no number, is as if nothing were known."""
    values = {pair.key: pair.value for pair in msg.values}
    known: dict[str, Any] = {}
    for key, unknown in Progress._field_defaults.items():
        value = number(values.get(key))
        if isinstance(unknown, bool):
            known[key] = values.get(key) == 'true'
        elif isinstance(unknown, int):
            known[key] = unknown if value is None else int(value)
        else:
            known[key] = unknown if value is None else value
    return Progress(**known)


def number(text: str | None) -> float | None:
    """Read a finite number, None for anything else."""
    try:
        value = float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None
