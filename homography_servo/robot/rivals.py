"""Notice that two publishers command at the same time."""

from __future__ import annotations

NEAR = 50  # numbers that a publisher may have lost between two messages


class Rivals:
    """
    Tell two interleaved publishers from one that was restarted.

    The middleware numbers the messages of every publisher, but does not say whose they
    are. One publisher counts up. A restarted one begins again at a low number, and the old
    numbers never go on; when they do go on, there are two.
    """

    def __init__(self, memory_s: float = 1.0) -> None:
        self._memory_s = memory_s
        self._current: tuple[int, float] | None = None
        self._other: tuple[int, float] | None = None

    def meet(self, number: int, now_s: float) -> bool:
        """Take the number of a message; True when it shows a second publisher."""
        other = self._recent(self._other, now_s)
        current = self._recent(self._current, now_s)
        if current is None or current < number <= current + NEAR and not \
                (other is not None and other < number <= other + NEAR
                 and number - other < number - current):
            self._current = (number, now_s)
            return False
        if other is not None and other <= number <= other + NEAR or number == current:
            self._other, self._current = self._current, (number, now_s)
            return True
        self._other, self._current = self._current, (number, now_s)
        return False

    def _recent(self, seen: tuple[int, float] | None, now_s: float) -> int | None:
        return seen[0] if seen and now_s - seen[1] <= self._memory_s else None


class Turns:
    """Notice commands on two topics that take turns: back to the first within a moment."""

    def __init__(self, memory_s: float = 0.5) -> None:
        self._memory_s = memory_s
        self._now, self._since_s = '', 0.0
        self._before, self._until_s = '', 0.0

    def meet(self, topic: str, now_s: float) -> bool:
        """Take the topic of a command; True when it was another one in between."""
        if topic == self._now:
            self._since_s = now_s
            return False
        back = topic == self._before and now_s - self._until_s <= self._memory_s
        self._before, self._until_s = self._now, self._since_s
        self._now, self._since_s = topic, now_s
        return back
