"""How often results go out, and how old their images are by then, for the diagnostics."""

from __future__ import annotations

from collections import deque

import numpy as np

KEPT = 300
WINDOW_S = 5.0
OLDEST_S = 10.0  # what seems older, or newer than now, has a stamp of another clock


class Pace:
    """
    Rate and latency of one kind of result over the last seconds.

    Parameters
    ----------
    what : str
        Beginning of the names that `facts` gives.

    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._notes: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def note(self, now_s: float, age_s: float) -> None:
        """Take down a result: a steady time, and the age of the stamp of its image."""
        self._notes.append((now_s, age_s))

    def facts(self, now_s: float) -> dict[str, float]:
        """Give rate (Hz) and latency (ms; median and 99 %); nothing where nothing was noted."""
        recent = [note for note in self._notes if now_s - note[0] <= WINDOW_S]
        if len(recent) < 2:
            return {}
        span_s = recent[-1][0] - recent[0][0]
        facts = {f'{self._what}_rate_hz': (len(recent) - 1) / max(span_s, 1e-3)}
        ages_s = [age_s for _, age_s in recent if 0.0 <= age_s < OLDEST_S]
        if ages_s:
            median_s, high_s = np.percentile(ages_s, (50.0, 99.0))
            facts[f'{self._what}_latency_ms'] = 1e3 * float(median_s)
            facts[f'{self._what}_latency_p99_ms'] = 1e3 * float(high_s)
        return facts
