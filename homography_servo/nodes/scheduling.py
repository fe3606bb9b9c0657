"""
Who runs first where processes wait for each other: real-time priorities, if allowed.

With more processes ready than cores the kernel lets each wait for the others by whole
milliseconds, a command as long as a log message. Under SCHED_FIFO what lies between an
image and the arm runs at once, and the bridge before all. ``benchmark latency`` measures
what that is worth.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
import os

from homography_servo.settings import Settings
from homography_servo.settings import whole

_ABOUT = 'priority under SCHED_FIFO, if the system allows it; 0: none is asked for'


@dataclass(frozen=True)
class SchedulingSettings(Settings):
    """How a process is served by the kernel."""

    realtime_priority: int = whole(50, 0, 99, '', _ABOUT, read_only=True)


@dataclass(frozen=True)
class BridgeScheduling(SchedulingSettings):
    """The same, before the nodes that it obeys: a stop must not wait for them."""

    realtime_priority: int = whole(60, 0, 99, '', _ABOUT, read_only=True)


def run_first(priority: int) -> str:
    """
    Ask for a real-time priority for every thread of this process.

    Threads that they start later have it, too. One core alone is not asked for: a node that
    works without a pause would leave nothing to the rest of the machine.

    Parameters
    ----------
    priority : int
        1 to 99; 0 asks for none.

    Returns
    -------
    str
        How the process is scheduled now, and why.

    """
    if not priority:
        return 'as any other: realtime_priority is 0'
    if len(os.sched_getaffinity(0)) < 2:
        return 'as any other: there is one core only'
    for thread in os.listdir('/proc/self/task'):
        try:
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))
        except ProcessLookupError:  # it has ended
            continue
        except OSError as error:
            return f'as any other: the system allows no real-time priorities ({error.strerror})'
    return f'SCHED_FIFO {priority}'


def run_as_others() -> None:
    """Give a real-time priority back."""
    for thread in os.listdir('/proc/self/task'):
        with suppress(ProcessLookupError):
            os.sched_setscheduler(int(thread), os.SCHED_OTHER, os.sched_param(0))
