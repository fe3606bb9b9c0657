"""Whether the servo may go on: what it sees, what it knows of the joints, who paused it."""

from __future__ import annotations

from collections import deque
import math
from typing import NamedTuple

from homography_servo.planning.joint_track import JointTrack
from homography_servo.planning.look_filter import Look
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.result import Rejected
import numpy as np

KEPT_LOOKS = 64
IN_VAIN_S = 1.0
UNRESTING = 'the arm does not come to rest'
UNPAIRED = ('no image fits the joint_states of the arm at rest; do their time stamps come from '
            'one clock?')


class StampedLook(NamedTuple):
    """A look and when its image was taken."""

    stamp_s: float
    look: Look


class Sight:
    """The latest looks, and whether vision is lost."""

    def __init__(self) -> None:
        self.queue: deque[StampedLook] = deque(maxlen=KEPT_LOOKS)
        self.received_s = -math.inf
        self.tracker_lost = False  # what the tracker says of itself
        self._newest_s = -math.inf
        self._lost = True
        self._in_a_row = 0

    def add(self, look: Look, stamp_s: float, now_s: float, timeout_s: float) -> Rejected | None:
        """Take in a look; refuse what is late or repeated."""
        late_s = self._newest_s - stamp_s
        if stamp_s <= 0.0:
            return Rejected('the image has no time stamp')
        if 0.0 <= late_s < 1.0:
            return Rejected(f'the image is {late_s:.3f} s older than the one before')
        if late_s >= 1.0:  # the clock was set back
            self.queue.clear()
        if now_s - self.received_s > timeout_s:
            self._lost, self._in_a_row = True, 0
        self._in_a_row += 1
        self._newest_s, self.received_s = stamp_s, now_s
        self.queue.append(StampedLook(stamp_s, look))
        return None

    def trouble(self, now_s: float, settings: ServoSettings) -> str:
        """Say why the servo is blind, empty when it sees."""
        age_s = now_s - self.received_s
        if age_s > settings.image_timeout_s:
            self._lost = True
            return 'the object was never seen' if math.isinf(age_s) else \
                f'the object is out of sight for more than {settings.image_timeout_s:.2f} s'
        if self.tracker_lost:
            self._lost, self._in_a_row = True, 0
            return 'the tracker has lost the object'
        if self._lost and self._in_a_row < settings.found_looks:
            return f'the object is back in sight, waiting for {settings.found_looks} looks'
        self._lost = False
        return ''


class Watch:
    """All reasons to hold, the gravest first."""

    def __init__(self) -> None:
        self.sight = Sight()
        self.joints = JointTrack()
        self.paused = False
        self.arm_latched = ''  # why the bridge takes no command before a reset
        self.focal_px: float | None = None
        self._joints_lost = False
        self._before_loss_rad: np.ndarray | None = None

    def trouble(self, now_s: float, settings: ServoSettings) -> str:
        """Say why nothing may move now, empty when it may."""
        # A loss counts as one even where something graver hides it.
        unfelt, unseen = self._unfelt(now_s, settings), self.sight.trouble(now_s, settings)
        if self.arm_latched:
            return f'the arm is latched ({self.arm_latched}); call robix_bridge/reset'
        if self.paused:
            return 'paused by the operator'
        if self.focal_px is None:
            return 'no camera_info: the focal length is unknown'
        return unfelt or unseen

    def _unfelt(self, now_s: float, settings: ServoSettings) -> str:
        age_s = now_s - self.joints.received_s
        if age_s <= settings.joint_timeout_s:
            return ''
        if not self._joints_lost:
            self._joints_lost, self._before_loss_rad = True, self.joints.latest_rad
        return 'joint_states never came' if math.isinf(age_s) else \
            f'no joint_states for more than {settings.joint_timeout_s:.2f} s'

    def why_in_vain(self, since_s: float, now_s: float, settings: ServoSettings) -> str:
        """Say why no look has counted since the arm should stand, empty while one still may."""
        if now_s <= since_s + settings.settle_s + settings.image_timeout_s + IN_VAIN_S:
            return ''
        return UNPAIRED if self.joints.still else UNRESTING

    def moved_unseen_rad(self) -> float:
        """Tell, once after each loss of joint_states, how far the arm moved meanwhile."""
        lost, self._joints_lost = self._joints_lost, False
        if not lost or self._before_loss_rad is None or self.joints.latest_rad is None:
            return 0.0
        return float(np.abs(self.joints.latest_rad - self._before_loss_rad).max())
