"""
What keeps an arm from moving, and since when nobody has told it to.

States: DISCONNECTED, IDLE, MOVING, HOLD (goes on by itself), LATCHED (until a reset).
"""

from __future__ import annotations

import math

from homography_servo.result import Rejected

STREAM_LENGTH = 3  # commands in a row, each soon after the last, are a stream


class Interlock:
    """Every reason to refuse a motion."""

    def __init__(self) -> None:
        self.active = False  # motion allowed by whoever manages the driver
        self.ready = False  # the device has greeted, and has been told the limits
        self.powered, self.paused = True, False
        self.latched = ''  # why, until a reset
        self._held, self._held_until_s = '', math.inf
        self._command_s, self._in_a_row = -math.inf, 0

    def state(self, moving: bool) -> str:
        """Give one line: the state, and why."""
        if not self.ready:
            return 'DISCONNECTED'
        if self.latched:
            return f'LATCHED: {self.latched}'
        held = self._hold_reason
        return f'HOLD: {held}' if held else 'MOVING' if moving else 'IDLE'

    @property
    def _hold_reason(self) -> str:
        if not self.powered:
            return 'power is off'
        return 'paused' if self.paused else self._held

    def refusal(self, now_s: float, position_known: bool,
                paused_is_fine: bool = False) -> Rejected | None:
        """Say why nothing may move now, whatever it is."""
        reasons = [
            (not self.ready, 'not connected'),
            (bool(self.latched), f'latched ({self.latched}); call ~/reset first'),
            (not self.active, 'the node is not active'),
            (self.locked_out(now_s), self._held),
            (not self.powered, 'power is off; call ~/power first'),
            (self.paused and not paused_is_fine, 'paused; call ~/pause with false first'),
            (not position_known, 'the position is not known yet'),
        ]
        return next((Rejected(reason) for applies, reason in reasons if applies), None)

    # --- latch and hold -----------------------------------------------------------------

    def latch(self, reason: str) -> None:
        """Forbid motion until a reset; the first reason stays."""
        self.latched = self.latched or reason

    def unlatch(self) -> None:
        """Forget latch and hold."""
        self.latched = self._held = ''

    def hold(self, reason: str, now_s: float, for_s: float = math.inf) -> None:
        """Forbid motion for a time, or until the next command."""
        if not self.locked_out(now_s) or for_s < math.inf:
            self._held, self._held_until_s = reason, now_s + for_s

    def let_go(self) -> None:
        """Forget a hold."""
        self._held = ''

    def locked_out(self, now_s: float) -> bool:
        """Tell whether a timed hold is in force."""
        return bool(self._held) and now_s < self._held_until_s < math.inf

    def end_hold(self, now_s: float) -> None:
        """Go on when a timed hold is over."""
        if self._held and now_s >= self._held_until_s:
            self._held, self._held_until_s = '', math.inf

    # --- the stream of commands ---------------------------------------------------------

    def commanded(self, now_s: float, timeout_s: float) -> None:
        """Take note of a command: it ends a hold, and may be one of a stream."""
        soon = now_s - self._command_s <= timeout_s
        self._in_a_row = self._in_a_row + 1 if soon else 1
        self._command_s = now_s
        self.let_go()

    def stream_silent(self, now_s: float, timeout_s: float) -> bool:
        """Tell whether commands came as a stream, and come no more."""
        return self._in_a_row >= STREAM_LENGTH and now_s - self._command_s > timeout_s

    def end_stream(self) -> None:
        """Expect no further command: what is under way has an end of its own."""
        self._in_a_row = 0
