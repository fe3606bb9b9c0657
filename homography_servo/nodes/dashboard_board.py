"""What the dashboard shows: written by the ROS thread, read by the web server's thread."""

from __future__ import annotations

from collections import deque
import math
import threading
from typing import Any, NamedTuple


class News(NamedTuple):
    """What a browser does not have yet."""

    facts: dict[str, Any]
    version: int
    samples: list[list]
    sample: int


class Board:
    """
    The latest facts by name, each with the version at which it changed, and a history.

    Parameters
    ----------
    length : int
        How many samples of the curves are kept.

    """

    def __init__(self, length: int) -> None:
        self._lock = threading.Lock()
        self._facts: dict[str, tuple[int, Any]] = {}
        self._samples: deque = deque(maxlen=length)
        self._version = 0
        self._sample = 0

    def put(self, name: str, fact: Any) -> None:
        """Replace a fact; nothing happens when it is the same as before."""
        fact = for_json(fact)
        with self._lock:
            if name in self._facts and self._facts[name][1] == fact:
                return
            self._version += 1
            self._facts[name] = (self._version, fact)

    def get(self, name: str) -> Any:
        """Give a fact, None where there is none."""
        with self._lock:
            return self._facts.get(name, (0, None))[1]

    def add(self, sample: list) -> None:
        """Add a sample of the curves."""
        with self._lock:
            self._sample += 1
            self._samples.append(for_json(sample))

    def resize(self, length: int) -> None:
        """Keep another number of samples from now on."""
        with self._lock:
            self._samples = deque(self._samples, maxlen=length)

    def news(self, version: int, sample: int) -> News | None:
        """Give what is newer than a version and a sample, None where nothing is."""
        with self._lock:
            if version >= self._version and sample >= self._sample:
                return None
            facts = {name: fact for name, (changed, fact) in self._facts.items()
                     if changed > version}
            missing = min(max(self._sample - sample, 0), len(self._samples))
            samples = list(self._samples)[len(self._samples) - missing:]
            return News(facts, self._version, samples, self._sample)


def for_json(value: Any) -> Any:
    """Replace what JSON cannot hold: numbers that are not finite become None."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): for_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [for_json(item) for item in value]
    return value
