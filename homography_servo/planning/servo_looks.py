"""Which looks count, and at which joints: from the queue of looks into the filter."""

from __future__ import annotations

import math

from homography_servo.planning.look_filter import LookFilter
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_watch import Watch

AHEAD_S = 0.05  # how far joints are extrapolated to the time of an image


class Looks:
    """
    Feed a filter with the looks that come in.

    Parameters
    ----------
    watch : Watch
        Holds the queue and the joints.
    filter_ : LookFilter
        Averages the looks.

    """

    def __init__(self, watch: Watch, filter_: LookFilter) -> None:
        self._watch, self._filter = watch, filter_
        self._newest_s = -math.inf

    def clock_set(self) -> None:
        """Start anew with stamps."""
        self._newest_s = -math.inf

    def standing(self, due_stamp_s: float, settings: ServoSettings, apart_s: float = 0.0) -> int:
        """
        Take looks at the standing arm; count them.

        What is seen before the start counts too: if the arm stood at the goal to teach
        it, the model is right there already.

        Parameters
        ----------
        due_stamp_s : float
            When the last move was to end.
        settings : ServoSettings
            Time to settle.
        apart_s : float
            Least time between two looks.

        """
        joints, taken = self._watch.joints, 0
        stood_s = max(joints.still_since_s, due_stamp_s) + settings.settle_s
        while self._watch.sight.queue:
            stamp_s, look = self._watch.sight.queue.popleft()
            setpoint = joints.at(stamp_s, ahead_s=settings.joint_timeout_s)
            if stamp_s < max(stood_s, self._newest_s + apart_s) or setpoint is None:
                continue
            self._newest_s = stamp_s
            taken += self._filter.update(look, setpoint)
        return taken

    def moving(self, settings: ServoSettings) -> int:
        """Take looks at the moving arm, less sharp along its motion; count them."""
        joints, taken = self._watch.joints, 0
        while self._watch.sight.queue:
            stamp_s, look = self._watch.sight.queue.popleft()
            setpoint = joints.near(stamp_s, AHEAD_S)
            if setpoint is None:
                continue
            self._filter.update(look, setpoint, joints.velocity_rad_s * settings.sync_sigma_s)
            taken += 1
        return taken
