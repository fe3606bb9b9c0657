"""Decide from time stamps alone which pictures are news."""

from __future__ import annotations

from homography_servo.result import Rejected

LATE_S = 1.0  # a picture older than the last one by up to this is late
PAUSE_S = 10.0  # a longer step ahead is a clock jump until the next picture agrees
UNSTAMPED_PERIOD_S = 1.0 / 30.0


class FrameOrder:
    """
    Filters repeated, late and wrongly stamped pictures.

    A step of the clock, backwards or by more than `PAUSE_S`, is believed when a second
    picture in a row confirms it. A camera that never stamps its pictures is taken to
    run at 30 Hz.
    """

    def __init__(self) -> None:
        self._last_s: float | None = None
        self._suspect_s: float | None = None
        self._unstamped = 0

    def accept(self, stamp_s: float) -> float | Rejected:
        """Give the time to use for a picture [s], or the reason to leave it out."""
        if stamp_s <= 0.0:
            return self._without_stamp()
        if self._last_s is None or self._follows(stamp_s, self._last_s):
            return self._believe(stamp_s)
        if stamp_s == self._last_s:
            return Rejected('repeated picture: the same stamp again')
        if 0.0 < self._last_s - stamp_s <= LATE_S:
            return Rejected('late picture: a newer one has come before')
        if self._suspect_s is not None and self._follows(stamp_s, self._suspect_s):
            return self._believe(stamp_s)
        self._suspect_s = stamp_s
        return Rejected('the stamp jumped; believed if the next picture agrees')

    def _follows(self, stamp_s: float, before_s: float) -> bool:
        return 0.0 < stamp_s - before_s <= PAUSE_S

    def _believe(self, stamp_s: float) -> float:
        self._last_s, self._suspect_s, self._unstamped = stamp_s, None, 0
        return stamp_s

    def _without_stamp(self) -> float | Rejected:
        if self._last_s is not None:
            return Rejected('a picture without a stamp among stamped ones')
        self._unstamped += 1
        return self._unstamped * UNSTAMPED_PERIOD_S
