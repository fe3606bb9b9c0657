"""
What the joints did lately: where they were at a time, and since when they stand.

Stamps are those of the messages and pair joints with images; they may jump with the
clock. Receipt times are steady and only tell how old the knowledge is.
"""

from __future__ import annotations

from collections import deque
import math

from homography_servo.result import Rejected
from homography_servo.result import required
import numpy as np

KEPT_S = 4.0
STILL_RAD = 2e-4  # half a unit of a hobby servo is 5e-4
CLOCK_JUMP_S = 1.0
MOST_KEPT = 8000  # stamps that hardly advance must not fill the memory


class JointTrack:
    """A short history of joint states."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, np.ndarray]] = deque(maxlen=MOST_KEPT)
        self.received_s = -math.inf
        self.clock_set_s = 0.0  # by which stamps were set forward, all in all
        self.still_since_s = math.inf  # stamp; infinite while moving or unknown
        self._rest_rad = np.zeros(0)  # where they were last seen to move

    @property
    def latest_rad(self) -> np.ndarray | None:
        """Newest joint positions, None before the first."""
        return self._samples[-1][1] if self._samples else None

    @property
    def known_rad(self) -> np.ndarray:
        """Newest joint positions; ValueError before the first."""
        return required(self.latest_rad, 'joint state')

    @property
    def latest_stamp_s(self) -> float:
        """Stamp of the newest positions."""
        return self._samples[-1][0] if self._samples else -math.inf

    @property
    def still(self) -> bool:
        """Tell whether the joints stand."""
        return not math.isinf(self.still_since_s)

    def add(self, joints_rad: np.ndarray, stamp_s: float, now_s: float) -> Rejected | None:
        """Take in a joint state; refuse what is late or repeated."""
        if self._samples:
            late_s = self.latest_stamp_s - stamp_s
            if abs(late_s) > CLOCK_JUMP_S:
                self.clock_set_s -= late_s
                self._samples.clear()  # the clock was set: old stamps mean nothing now
            elif late_s >= 0.0:
                return Rejected(f'joint state is {late_s:.3f} s older than the one before')
        self._note_motion(joints_rad, stamp_s)
        self._samples.append((stamp_s, joints_rad))
        while stamp_s - self._samples[0][0] > KEPT_S:
            self._samples.popleft()
        self.received_s = now_s
        return None

    @property
    def velocity_rad_s(self) -> np.ndarray:
        """Give the velocities between the two newest positions."""
        if len(self._samples) < 2:
            return np.zeros_like(self._samples[-1][1])
        (before_s, before_rad), (last_s, last_rad) = self._samples[-2], self._samples[-1]
        return (last_rad - before_rad) / max(last_s - before_s, 1e-3)

    def near(self, stamp_s: float, ahead_s: float) -> np.ndarray | None:
        """Give the joints at a time, extrapolated by their velocity for a moment."""
        late_s = stamp_s - self.latest_stamp_s
        if not 0.0 < late_s <= ahead_s:
            return self.at(stamp_s)
        return self.known_rad + late_s * self.velocity_rad_s

    def _note_motion(self, joints_rad: np.ndarray, stamp_s: float) -> None:
        if not self._samples or np.abs(joints_rad - self._rest_rad).max() > STILL_RAD:
            self.still_since_s, self._rest_rad = math.inf, joints_rad
        elif math.isinf(self.still_since_s):
            self.still_since_s = self.latest_stamp_s

    def at(self, stamp_s: float, ahead_s: float = 0.0) -> np.ndarray | None:
        """
        Give the joints at a time between samples.

        Parameters
        ----------
        stamp_s : float
            The time.
        ahead_s : float
            How much later than the newest sample it may be; then that one counts.

        Returns
        -------
        (n,) array or None
            None where the time is not covered.

        """
        if not self._samples or stamp_s < self._samples[0][0]:
            return None
        newest_s, newest_rad = self._samples[-1]
        if stamp_s >= newest_s:
            return newest_rad if stamp_s <= newest_s + ahead_s else None
        later_s, later_rad = self._samples[-1]
        for earlier_s, earlier_rad in reversed(self._samples):
            if earlier_s <= stamp_s:
                share = (stamp_s - earlier_s) / max(later_s - earlier_s, 1e-9)
                return earlier_rad + share * (later_rad - earlier_rad)
            later_s, later_rad = earlier_s, earlier_rad
        return None
