"""
The arm behind a link: what may move, and what makes it stop.

`ArmDriver` holds the one state machine of the robot side. It has no thread and no port;
time is an argument. `turn` is called again and again by whoever owns the port; commands
may come from other threads. Nothing reaches the wire except through here.

States: DISCONNECTED, IDLE, MOVING, HOLD (goes on by itself), LATCHED (until `reset`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from dataclasses import replace
import math
import threading
from typing import Callable, NamedTuple, Sequence

from homography_servo.errors import LinkError
from homography_servo.result import Rejected
from homography_servo.robot.link import Down
from homography_servo.robot.link import Link
from homography_servo.robot.link import Up
from homography_servo.robot.mover import Mover
from homography_servo.robot.protocol import Notice
from homography_servo.robot.robot_model import Robot
from homography_servo.robot.session import Answer
from homography_servo.robot.session import BITS_PER_BYTE
from homography_servo.robot.session import LONGEST_REPLY
from homography_servo.robot.session import Over
from homography_servo.robot.trajectory import accept
from homography_servo.robot.trajectory import go_to
from homography_servo.robot.trajectory import State
from homography_servo.robot.trajectory import Trajectory
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.trajectory import TrajectorySettings
from homography_servo.robot.wire import LineBudget
from homography_servo.robot.wire import rate_for
from homography_servo.robot.wire import ServoWire
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import whole
import numpy as np

STATUS_PERIOD_S = 0.5
STREAM_LENGTH = 3  # commands in a row, each soon after the last, are a stream
POSITION_LOST_S = 1.0
MOST_UNANSWERED = 3  # leaves room in the window of four for what is urgent
_CRIES = {'ESTOP': 'the device was stopped', 'WATCHDOG': 'the device heard nothing for too long'}


@dataclass(frozen=True)
class DriverSettings(Settings):
    """How the bridge drives the arm."""

    baud: int = whole(115200, 1200, 4000000, 'baud', 'speed of the serial line',
                      read_only=True)
    tick_s: float = real(0.020, 0.001, 1.0, 's', 'interpolator tick of the device: its speeds '
                         'are in units per tick', read_only=True)
    joint_margin_rad: float = real(0.05, 0.0, 0.5, 'rad', 'distance to keep from the ends of '
                                   'every joint', read_only=True)
    command_timeout_s: float = real(0.25, 0.02, 10.0, 's', 'while commands come as a stream, a '
                                    'command older than this ends in HOLD')
    watchdog_s: float = real(0.5, 0.1, 10.0, 's', 'the device stops by itself when it hears '
                             'nothing for so long', read_only=True)
    home_speed_rad_s: float = real(0.3, 0.02, 2.0, 'rad/s', 'largest joint speed of ~/home')
    rival_hold_s: float = real(1.0, 0.1, 60.0, 's', 'how long two publishers who command at the '
                               'same time are locked out after the last sign of both')


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
        self.counts: Counter = Counter()
        self.active = False  # motion allowed by whoever manages the driver
        self.device = ''
        self._lock = threading.RLock()
        self._answered = threading.Condition(self._lock)
        self._period_s = 1.0 / rate_for(settings.baud)
        self._mover = Mover(robot, link, settings.joint_margin_rad, self._period_s,
                            LineBudget(settings.baud))
        self._ready = self._was_ready = False
        self._misfit = ''
        self._latch = self._hold = ''
        self._hold_until_s = math.inf
        self._paused, self._powered = False, True
        self._command_s, self._in_a_row = -math.inf, 0
        self._next_position_s = self._next_status_s = 0.0
        self._asked_s: dict[int, float] = {}
        self._on_answer: dict[int, Callable[[Answer], None]] = {}
        self._offered: Callable[[float], object] | None = None

    # --- what others see --------------------------------------------------------------

    @property
    def limits(self):
        """Limits that commands have to keep."""
        return self._mover.limits

    @property
    def problem(self) -> str:
        """Say what is wrong with the connection, empty when nothing is."""
        return self._misfit or self.link.problem

    @property
    def state(self) -> str:
        """One line: the state, and why."""
        if not self._ready:
            return 'DISCONNECTED'
        if self._latch:
            return f'LATCHED: {self._latch}'
        hold = self._hold_reason
        return f'HOLD: {hold}' if hold else 'MOVING' if self._mover.busy else 'IDLE'

    @property
    def _hold_reason(self) -> str:
        if not self._powered:
            return 'power is off'
        return 'paused' if self._paused else self._hold

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
            return self.counts + self.link.all_counts + Counter(own)

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
                self._mover.brake(now_s)
                self._in_a_row = 0
            elif problem is None:
                problem = self._take(
                    accept(self.limits, names, points, self._mover.commanded(now_s),
                           self.trajectory_settings, stamp_s, ros_now_s), now_s)
            self.counts['commands_accepted' if problem is None else 'commands_rejected'] += 1
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
            self._in_a_row = 0
            return self._take(trajectory, now_s)

    def hold(self, reason: str, now_s: float, for_s: float = math.inf) -> None:
        """Come to rest and stay powered, for a time or until the next command."""
        with self._lock:
            if not self.locked_out(now_s) or for_s < math.inf:
                self._hold, self._hold_until_s = reason, now_s + for_s
            self._in_a_row = 0
            self._mover.brake(now_s)

    def locked_out(self, now_s: float) -> bool:
        """Tell whether a timed hold is in force."""
        return bool(self._hold) and now_s < self._hold_until_s < math.inf

    def pause(self, on: bool, now_s: float) -> Rejected | None:
        """Slow down and stand, or go on."""
        with self._lock:
            problem = self._refusal(now_s, paused_is_fine=True)
            if problem is None and on != self._paused:
                self.link.request('!pause' if on else '!resume')
                self._set_paused(on)
                self._in_a_row = 0
            return problem

    def power(self, on: bool) -> Rejected | None:
        """Switch the servos on or off; a motion ends."""
        with self._lock:
            if not self._ready:
                return Rejected('not connected')
            if not on:
                self._forget_motion()
            self.link.request('!power on' if on else '!power off')
            self._powered = on
            return None

    def stop_now(self, reason: str) -> bool:
        """Send the stop byte before anything queued, and latch; from any thread."""
        # A thread that holds the lock does so for about a millisecond; should it be stuck,
        # the byte goes out all the same.
        owned = self._lock.acquire(timeout=0.01)
        try:
            self._latch = self._latch or reason
            sent = self.link.stop_now()
            self._forget_motion()
            if self._ready:
                self.link.request('!stop')  # the byte has no reply; this has
            return sent
        finally:
            if owned:
                self._lock.release()

    def reset(self, wait_s: float = 0.3) -> Rejected | None:
        """Leave LATCHED; moves nothing. Waits for the device to say OK."""
        done: list[str] = []
        with self._answered:
            if not self._ready:
                return Rejected('not connected, nothing to reset')
            seq = self.link.request('!reset', motion=True)  # a later stop takes it back
            self._on_answer[seq] = lambda a: done.append(a.kind)
            self._answered.wait_for(lambda: bool(done), wait_s)
            if not done:
                self._on_answer.pop(seq, None)
                return Rejected(f'the robot did not answer within {wait_s:g} s; try again')
            return None if done[0] == 'OK' else Rejected('the robot refused !reset')

    def offer(self, command: Callable[[float], object]) -> None:
        """
        Leave a command for the next `turn`; it replaces one that still waits.

        Under a flood only as many commands are looked at as the arm has turns.
        """
        with self._lock:
            if self._offered is not None:
                self.counts['commands_replaced'] += 1
            self._offered = command

    # --- time ---------------------------------------------------------------------------

    def turn(self, now_s: float) -> None:
        """Do what is due; call it at least as often as `next_due_s` says."""
        with self._lock:
            self._take_events(now_s)
            if self._offered is not None:
                command, self._offered = self._offered, None
                command(now_s)
            if self._ready:
                self._supervise(now_s)
                self._mover.stream(now_s)
                self._ask(now_s)
                self._take_events(now_s)  # and send what was just asked for

    def next_due_s(self) -> float:
        """Give the time of the next thing to do by itself."""
        with self._lock:
            if self._offered is not None:
                return 0.0
            due = [self.link.next_due_s()]
            if self._ready:
                due += [self._next_position_s, self._next_status_s]
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
            elif self._ready and not self._latch:
                done: list[str] = []
                self._on_answer[self.link.request('!watch 0')] = lambda a: done.append(a.kind)
                self._take_events(now_s)  # lines before it may still be unanswered
                self._answered.wait_for(lambda: bool(done), wait_s)

    def close(self) -> None:
        """Release the port."""
        with self._lock:
            self._ready = False
            self.link.close()

    # --- inside -------------------------------------------------------------------------

    def _refusal(self, now_s: float, paused_is_fine: bool = False) -> Rejected | None:
        """Say why nothing may move now, whatever it is."""
        reasons = [
            (not self._ready, 'not connected'),
            (bool(self._latch), f'latched ({self._latch}); call ~/reset first'),
            (not self.active, 'the node is not active'),
            (self.locked_out(now_s), self._hold),
            (not self._powered, 'power is off; call ~/power first'),
            (self._paused and not paused_is_fine, 'paused; call ~/pause with false first'),
            (not self._mover.estimate.known, 'the position is not known yet'),
        ]
        return next((Rejected(reason) for applies, reason in reasons if applies), None)

    def _take(self, trajectory: Trajectory | Rejected, now_s: float) -> Rejected | None:
        if isinstance(trajectory, Rejected):
            return trajectory
        problem = self._mover.begin(trajectory, now_s)
        if problem is None:
            soon = now_s - self._command_s <= self.settings.command_timeout_s
            self._in_a_row = self._in_a_row + 1 if soon else 1
            self._command_s = now_s
            self._hold = ''
            self.counts['commands_slowed'] += bool(trajectory.note)
        return problem

    def _supervise(self, now_s: float) -> None:
        """Hold when a stream of commands has ended, go on when a hold is over."""
        silent_s = now_s - self._command_s
        if self._in_a_row >= STREAM_LENGTH and silent_s > self.settings.command_timeout_s:
            self.counts['stream_timeouts'] += 1
            self.hold(f'no command for {self.settings.command_timeout_s:g} s', now_s)
        if self._hold and now_s >= self._hold_until_s:
            self._hold, self._hold_until_s = '', math.inf

    def _ask(self, now_s: float) -> None:
        if self.link.backlog >= MOST_UNANSWERED:
            return
        if now_s >= self._next_position_s:
            self._next_position_s = now_s + self._period_s
            self._asked_s[self.link.request('?pos')] = now_s
        if now_s >= self._next_status_s:
            self._next_status_s = now_s + STATUS_PERIOD_S
            self.link.request('?')

    def _set_paused(self, on: bool) -> None:
        self._paused = self._mover.standing_by = on

    def _forget_motion(self) -> None:
        self._in_a_row = 0
        self._mover.forget()

    # --- events -------------------------------------------------------------------------

    def _take_events(self, now_s: float) -> None:
        for event in self.link.turn(now_s):
            if isinstance(event, Up):
                self._set_up(event)
            elif isinstance(event, Down):
                self._lost(event.reason)
            elif isinstance(event, Notice):
                self._stop_if('' if self._latch else _CRIES.get(event.name, ''))
            elif isinstance(event, Over):
                self._stop_if(self._mover.over(event.seq, event.how, now_s))
                self._next_position_s = 0.0  # where is it now?
            else:
                self._answer(event, now_s)

    def _stop_if(self, problem: str) -> None:
        if problem:
            self.stop_now(problem)

    def _set_up(self, event: Up) -> None:
        """Tell a device that has just greeted what it must know, then ask how it is."""
        try:
            wire = ServoWire(self.robot, event.servos, self.settings.tick_s)
        except LinkError as error:
            self._misfit = str(error)
            return
        self._misfit = ''
        self.device = f'{event.name}, {event.servos} servos'
        self._asked_s.clear()
        self._on_answer.clear()
        self._mover.attach(wire)
        first = ['!stop'] if self._was_ready else []
        watch = f'!watch {int(1000 * self.settings.watchdog_s)}'
        for line in (*first, watch, '!resume', *wire.setup(), '?pos'):
            self.link.request(line)
        self._on_answer[self.link.request(wire.ask_power())] = self._heard_power
        self._on_answer[self.link.request('?')] = self._first_status

    def _heard_power(self, answer: Answer) -> None:
        self._powered = answer.values[0] > 0

    def _first_status(self, answer: Answer) -> None:
        """Become ready; what stood or moved without us needs a reset by somebody."""
        if self._was_ready:
            self._latch = self._latch or 'the link was lost and came back'
        elif answer.values[0] == 'STOPPED':
            self._latch = self._latch or 'the device had been stopped before'
        self._ready = self._was_ready = True
        self._hold = ''
        self._set_paused(False)
        if answer.values[0] == 'WORKING':
            self.stop_now('the arm was moving when the link came up')

    def _lost(self, reason: str) -> None:
        self._ready = False
        if self._was_ready:
            self._latch = self._latch or f'the link was lost: {reason}'
        self._forget_motion()
        self._mover.estimate.clear()
        self._answered.notify_all()

    def _answer(self, answer: Answer, now_s: float) -> None:
        self._mover.answered(answer.seq)
        asked_s = self._asked_s.pop(answer.seq, now_s)
        if answer.kind == 'ERR':
            code, _, token = answer.values
            self.counts['device_errors'] += 1
            self.stop_now(f'the device refused {answer.text.split(" ", 1)[0]}: '
                          f'error {code} {token}')
        elif answer.kind == 'POS':
            self._position(answer, asked_s, now_s)
        elif answer.kind == 'ST':
            self._status(answer, now_s)
        elif answer.text == '!reset':
            self._was_reset()
        hook = self._on_answer.pop(answer.seq, None)
        if hook:
            hook(answer)
            self._answered.notify_all()

    def _position(self, answer: Answer, asked_s: float, now_s: float) -> None:
        units = self._mover.wire.heard(answer.values)
        if units is None:
            self.counts['bad_positions'] += 1
            return
        wire_s = LONGEST_REPLY * BITS_PER_BYTE / self.settings.baud
        held_s = asked_s if answer.repeated else max(now_s - wire_s, asked_s)
        self._stop_if(self._mover.heard(units, held_s))

    def _status(self, answer: Answer, now_s: float) -> None:
        """Compare what the device says with what is believed here."""
        state, _, finished, _ = answer.values
        if state == 'STOPPED' and not (self._latch or self._on_answer or answer.repeated) \
                and self._ready:
            self.stop_now('the device is stopped')
        if state == 'IDLE':
            self._mover.rests(finished, now_s)

    def _was_reset(self) -> None:
        if not self._latch:
            return  # there was nothing to leave: a motion goes on
        self._latch = self._hold = ''
        if self._paused:
            self.link.request('!resume')  # what was paused is gone
            self._set_paused(False)
        self._forget_motion()
        self.counts['resets'] += 1
