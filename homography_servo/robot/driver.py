"""
The arm behind a link: what may move, and what makes it stop.

`ArmDriver` holds the one state machine of the robot side: `Interlock` says what forbids
motion, `Mover` moves, `Dialogue` talks to the device. It has no thread and no port; time is
an argument. `turn` is called again and again by whoever owns the port; commands may come
from other threads. Nothing reaches the wire except through here.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
import math
import threading
from typing import Callable, NamedTuple, Sequence

from homography_servo.result import Rejected
from homography_servo.robot.dialogue import Dialogue
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.interlock import Interlock
from homography_servo.robot.link import Link
from homography_servo.robot.mover import Mover
from homography_servo.robot.robot_model import Robot
from homography_servo.robot.trajectory import accept
from homography_servo.robot.trajectory import go_to
from homography_servo.robot.trajectory import State
from homography_servo.robot.trajectory import Trajectory
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.trajectory import TrajectorySettings
from homography_servo.robot.wire import LineBudget
from homography_servo.robot.wire import rate_for
import numpy as np

POSITION_LOST_S = 1.0


class Snapshot(NamedTuple):
    """What others may know of the driver at one moment."""

    state: str
    arm: State | None


class ArmDriver:
    """
    Drive one arm over one link.

    Parameters
    ----------
    robot : Robot
        Geometry, limits and servo mapping.
    link : Link
        The connection.
    settings, trajectory_settings : DriverSettings, TrajectorySettings
        How.

    """

    def __init__(self, robot: Robot, link: Link, settings: DriverSettings = DriverSettings(),
                 trajectory_settings: TrajectorySettings = TrajectorySettings()) -> None:
        self.robot = robot
        self.link = link
        self.settings = settings
        self.trajectory_settings = trajectory_settings
        self._counts: Counter = Counter()
        self._lock = threading.RLock()
        self._answered = threading.Condition(self._lock)
        self._interlock = Interlock()
        self._mover = Mover(robot, link, settings.joint_margin_rad, 1.0 / rate_for(settings.baud),
                            LineBudget(settings.baud))
        self._dialogue = Dialogue(robot, link, self._mover, self._interlock, settings,
                                  self.stop_now)
        self._offered: Callable[[float], object] | None = None

    # --- what others see --------------------------------------------------------------

    @property
    def active(self) -> bool:
        """Tell whether whoever manages the driver allows motion."""
        return self._interlock.active

    @active.setter
    def active(self, active: bool) -> None:
        self._interlock.active = active

    def deactivate(self, now_s: float) -> None:
        """Allow no motion any more, and come to rest."""
        with self._lock:
            self.active = False
            self._brake(now_s)

    @property
    def limits(self):
        """Limits that commands have to keep."""
        return self._mover.limits

    @property
    def device(self) -> str:
        """Name the device that has greeted."""
        return self._dialogue.device

    @property
    def problem(self) -> str:
        """Say what is wrong with the connection, empty when nothing is."""
        return self._dialogue.misfit or self.link.problem

    @property
    def state(self) -> str:
        """One line: the state, and why."""
        return self._interlock.state(self._mover.busy)

    def snapshot(self, now_s: float) -> Snapshot:
        """Give the state, and where the arm is; None for the arm when that is not known."""
        with self._lock:
            arm = self._mover.estimate
            known = arm.known and arm.age_s(now_s) < POSITION_LOST_S
            return Snapshot(self.state, arm.at(now_s) if known else None)

    @property
    def all_counts(self) -> Counter:
        """Give the counters of driver and link."""
        with self._lock:
            gate = self._mover.governor
            own = {'targets_held_back': gate.held_back, 'targets_refused': gate.refused}
            return self._counts + self._dialogue.counts + self.link.all_counts + Counter(own)

    @property
    def resting(self) -> bool:
        """Tell whether nothing moves and nothing waits to move."""
        return not self._mover.busy and self._offered is None

    # --- commands; each gives a sentence of refusal, or None ----------------------------

    def command(self, names: Sequence[str], points: Sequence[TrajectoryPoint], now_s: float,
                stamp_s: float = 0.0, ros_now_s: float = 0.0) -> Rejected | None:
        """Take a JointTrajectory; no points means stop."""
        with self._lock:
            problem = self._refusal(now_s, paused_is_fine=not points)
            if problem is None and not points:
                self._brake(now_s)
            elif problem is None:
                problem = self._take(
                    accept(self.limits, names, points, self._mover.commanded(now_s),
                           self.trajectory_settings, stamp_s, ros_now_s), now_s)
            self._counts['commands_accepted' if problem is None else 'commands_rejected'] += 1
            return problem

    def go(self, joints_rad: Sequence[float], now_s: float) -> Rejected | None:
        """Go to a posture, in joint order, as fast as the limits allow."""
        points = [TrajectoryPoint(0.0, tuple(joints_rad))]
        return self.command(self.limits.names, points, now_s)

    def home(self, now_s: float) -> Rejected | None:
        """Go slowly to where all joints are zero."""
        with self._lock:
            problem = self._refusal(now_s)
            if problem is not None:
                return problem
            slow = np.minimum(self.limits.velocity_rad_s, self.settings.home_speed_rad_s)
            posture = np.clip(np.zeros(self.robot.count), self.limits.lower_rad,
                              self.limits.upper_rad)
            trajectory = go_to(replace(self.limits, velocity_rad_s=slow), posture,
                               self._mover.commanded(now_s), self.trajectory_settings)
            self._interlock.end_stream()
            return self._take(trajectory, now_s)

    def hold(self, reason: str, now_s: float, for_s: float = math.inf) -> None:
        """Come to rest and stay powered, for a time or until the next command."""
        with self._lock:
            self._interlock.hold(reason, now_s, for_s)
            self._brake(now_s)

    def pause(self, on: bool, now_s: float) -> Rejected | None:
        """Slow down and stand, or go on."""
        with self._lock:
            problem = self._refusal(now_s, paused_is_fine=True)
            if problem is None and on != self._interlock.paused:
                self._dialogue.pause(on)
                self._interlock.end_stream()
            return problem

    def power(self, on: bool) -> Rejected | None:
        """Switch the servos on or off; a motion ends."""
        with self._lock:
            if not self._interlock.ready:
                return Rejected('not connected')
            self._dialogue.power(on)
            return None

    def stop_now(self, reason: str) -> bool:
        """Send the stop byte before anything queued, and latch; from any thread."""
        # A thread that holds the lock does so for about a millisecond; should it be stuck,
        # the byte goes out all the same.
        owned = self._lock.acquire(timeout=0.01)
        try:
            self._interlock.latch(reason)
            sent = self.link.stop_now()
            self._dialogue.forget_motion()
            if self._interlock.ready:
                self.link.request('!stop')  # the byte has no reply; this has
            return sent
        finally:
            if owned:
                self._lock.release()

    def reset(self, wait_s: float = 0.3) -> Rejected | None:
        """Leave LATCHED; moves nothing. Waits for the device to say OK."""
        with self._answered:
            if not self._interlock.ready:
                return Rejected('not connected, nothing to reset')
            # A later stop takes it back, as it does with motion.
            done = self._dialogue.request('!reset', motion=True)
            self._answered.wait_for(lambda: bool(done.kind), wait_s)
            if not done.kind:
                self._dialogue.give_up(done)
                return Rejected(f'the robot did not answer within {wait_s:g} s; try again')
            return None if done.kind == 'OK' else Rejected('the robot refused !reset')

    def offer(self, command: Callable[[float], object]) -> None:
        """
        Leave a command for the next `turn`; it replaces one that still waits.

        Under a flood only as many commands are looked at as the arm has turns.
        """
        with self._lock:
            if self._offered is not None:
                self._counts['commands_replaced'] += 1
            self._offered = command

    # --- time ---------------------------------------------------------------------------

    def turn(self, now_s: float) -> None:
        """Do what is due; call it at least as often as `next_due_s` says."""
        with self._lock:
            self._listen(now_s)
            if self._offered is not None:
                try:
                    self._offered(now_s)
                finally:
                    self._offered = None  # only now: an arm about to move is not at rest
            if self._interlock.ready:
                self._supervise(now_s)
                self._mover.stream(now_s)
                self._dialogue.ask(now_s)
                self._listen(now_s)  # and send what was just asked for

    def next_due_s(self) -> float:
        """Give the time of the next thing to do by itself."""
        with self._lock:
            if self._offered is not None:
                return 0.0
            due = [self.link.next_due_s()]
            if self._interlock.ready:
                due += [self._dialogue.next_due_s]
                due += [self._mover.next_due_s] if self._mover.streaming else []
            return min(due)

    def quit(self, now_s: float, wait_s: float = 0.0) -> None:
        """
        Say farewell: a moving arm is stopped at once and latched.

        With an arm at rest the device's watchdog is switched off, or it would take our
        absence for a fault. Others must call `turn` while this waits for the answer.
        """
        with self._answered:
            if not self.resting:
                self.stop_now('the bridge ends')
            elif self._interlock.ready and not self._interlock.latched:
                done = self._dialogue.request('!watch 0')
                self._listen(now_s)  # lines before it may still be unanswered
                self._answered.wait_for(lambda: bool(done.kind), wait_s)

    def close(self) -> None:
        """Release the port."""
        with self._lock:
            self._interlock.ready = False
            self.link.close()

    # --- inside -------------------------------------------------------------------------

    def _refusal(self, now_s: float, paused_is_fine: bool = False) -> Rejected | None:
        return self._interlock.refusal(now_s, self._mover.estimate.known, paused_is_fine)

    def _take(self, trajectory: Trajectory | Rejected, now_s: float) -> Rejected | None:
        if isinstance(trajectory, Rejected):
            return trajectory
        # It may have taken a while, and a stop does not wait for the lock.
        problem = self._refusal(now_s)
        if problem is None:
            problem = self._mover.begin(trajectory, now_s)
        if problem is None:
            self._interlock.commanded(now_s, self.settings.command_timeout_s)
            self._counts['commands_slowed'] += bool(trajectory.note)
        return problem

    def _brake(self, now_s: float) -> None:
        self._interlock.end_stream()
        self._mover.brake(now_s)

    def _listen(self, now_s: float) -> None:
        self._dialogue.listen(now_s)
        self._answered.notify_all()

    def _supervise(self, now_s: float) -> None:
        """Hold when a stream of commands has ended, go on when a hold is over."""
        timeout_s = self.settings.command_timeout_s
        if self._interlock.stream_silent(now_s, timeout_s):
            self._counts['stream_timeouts'] += 1
            self.hold(f'no command for {timeout_s:g} s', now_s)
        self._interlock.end_hold(now_s)
