"""
The arm behind a link: what may move, what moves, and what makes it stop.

`ArmDriver` holds the one state machine of the robot side. It has no thread and no port;
time is an argument. `turn` is called again and again by whoever owns the port; commands
may come from other threads. Nothing reaches the wire except through here.

States: DISCONNECTED, IDLE, MOVING, HOLD (goes on by itself), LATCHED (until `reset`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from dataclasses import replace
import threading
from typing import Callable, NamedTuple, Sequence

from homography_servo.errors import LinkError
from homography_servo.result import Rejected
from homography_servo.robot.estimate import ArmEstimate
from homography_servo.robot.governor import Governor
from homography_servo.robot.limits import limits_of
from homography_servo.robot.link import Down
from homography_servo.robot.link import Link
from homography_servo.robot.link import LinkEvent
from homography_servo.robot.link import Up
from homography_servo.robot.protocol import Notice
from homography_servo.robot.robot_file import Robot
from homography_servo.robot.servo_units import unit_range
from homography_servo.robot.session import Answer
from homography_servo.robot.session import BITS_PER_BYTE
from homography_servo.robot.session import LONGEST_REPLY
from homography_servo.robot.session import Over
from homography_servo.robot.streaming import TargetStream
from homography_servo.robot.trajectory import accept
from homography_servo.robot.trajectory import go_to
from homography_servo.robot.trajectory import State
from homography_servo.robot.trajectory import stop
from homography_servo.robot.trajectory import Trajectory
from homography_servo.robot.trajectory import TrajectoryPoint
from homography_servo.robot.trajectory import TrajectorySettings
from homography_servo.robot.wire import rate_for
from homography_servo.robot.wire import ServoWire
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import whole
import numpy as np

STATUS_PERIOD_S = 0.5
ARRIVED_UNITS = 2  # a servo further from its target after DONE has not followed
STREAM_LENGTH = 3  # commands in a row, each soon after the last, are a stream
POSITION_LOST_S = 1.0
ROUNDING_RAD = 2e-3  # about two servo units


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


class _Motion:
    """What the arm is doing: following a curve by a stream of targets, or one move."""

    def __init__(self, target: np.ndarray, seq: int = 0) -> None:
        self.target = target  # last one, in servo units
        self.seq = seq  # of the line whose DONE ends it; 0 while a stream still goes on
        self.streamed = seq == 0


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
        self.limits = limits_of(robot, settings.joint_margin_rad)
        self.counts: Counter = Counter()
        self.active = False  # motion allowed by whoever manages the driver
        self.device = ''
        self._lock = threading.RLock()
        self._estimate = ArmEstimate()
        self._governor = self._new_governor()
        self._targets = TargetStream(robot, np.zeros(robot.count), 0.0,
                                     settings.joint_margin_rad)
        self._wire: ServoWire | None = None
        self._ready = False
        self._was_ready = False
        self._latch = ''
        self._hold = ''
        self._hold_until_s = float('inf')
        self._motion: _Motion | None = None
        self._verify: np.ndarray | None = None
        self._paused_s: float | None = None
        self._powered = True
        self._pace: np.ndarray | None = None
        self._command_s = -1.0
        self._in_a_row = 0
        self._stream_seq = 0
        self._next_target_s = self._next_position_s = self._next_status_s = 0.0
        self._asked_s: dict[int, float] = {}
        self._period_s = 1.0 / rate_for(settings.baud)
        self._on_answer: dict[int, Callable[[Answer], None]] = {}
        self._answered = threading.Condition(self._lock)
        self._offered: Callable[[float], object] | None = None

    def _new_governor(self) -> Governor:
        low, high = unit_range(self.robot, self.settings.joint_margin_rad)
        speed = self.robot.velocity_rad_s * np.abs(self.robot.units_per_rad)
        return Governor(low, high, speed)

    # --- what others see --------------------------------------------------------------

    @property
    def state(self) -> str:
        """One line: the state, and why."""
        if not self._ready:
            return 'DISCONNECTED'
        if self._latch:
            return f'LATCHED: {self._latch}'
        if self._hold:
            return f'HOLD: {self._hold}'
        return 'IDLE' if self._motion is None and self._verify is None else 'MOVING'

    def snapshot(self, now_s: float) -> Snapshot:
        """Give the state, and where the arm is; None for the arm when that is not known."""
        with self._lock:
            known = self._estimate.known and self._estimate.age_s(now_s) < POSITION_LOST_S
            return Snapshot(self.state, self._estimate.at(now_s) if known else None)

    @property
    def all_counts(self) -> Counter:
        """Give the counters of driver and link."""
        with self._lock:
            own = {'held_back': self._governor.held_back, 'gate_refused': self._governor.refused}
            return self.counts + self.link.all_counts + Counter(own)

    # --- commands; each gives a sentence of refusal, or None ----------------------------

    def command(self, names: Sequence[str], points: Sequence[TrajectoryPoint], now_s: float,
                stamp_s: float = 0.0, ros_now_s: float = 0.0) -> Rejected | None:
        """Take a JointTrajectory; no points means stop."""
        with self._lock:
            problem = self._refusal(now_s)
            if problem is None and not points:
                self._rest(now_s)
                self._in_a_row = 0
                return self._judged(None)
            if problem is not None:
                return self._judged(problem)
            trajectory = accept(self.limits, names, points, self._commanded(now_s),
                                self.trajectory_settings, stamp_s, ros_now_s)
            return self._judged(self._take(trajectory, now_s))

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
                               self._commanded(now_s), self.trajectory_settings)
            self._in_a_row = 0
            return self._take(trajectory, now_s)

    def hold(self, reason: str, now_s: float, for_s: float = float('inf')) -> None:
        """Come to rest and stay powered, for a time or until the next command."""
        with self._lock:
            if not self.locked_out(now_s) or for_s < float('inf'):
                self._hold, self._hold_until_s = reason, now_s + for_s
            self._in_a_row = 0
            self._rest(now_s)

    def locked_out(self, now_s: float) -> bool:
        """Tell whether a timed hold is in force."""
        return bool(self._hold) and now_s < self._hold_until_s < float('inf')

    def pause(self, on: bool, now_s: float) -> Rejected | None:
        """Slow down and stand, or go on."""
        with self._lock:
            problem = self._refusal(now_s, paused_is_fine=True)
            if problem is not None:
                return problem
            if on and self._paused_s is None:
                self.link.request('!pause')
                self._paused_s = now_s
            elif not on and self._paused_s is not None:
                self.link.request('!resume')
                self._paused_s = None
            self._hold = 'paused' if on else ''
            self._in_a_row = 0
            return None

    def power(self, on: bool, now_s: float) -> Rejected | None:
        """Switch the servos on or off."""
        with self._lock:
            if not self._ready:
                return Rejected('not connected')
            self._forget_motion()
            self.link.request('!power on' if on else '!power off')
            self._powered = on
            self._hold = '' if on else 'power is off'
            return None

    def stop_now(self, reason: str) -> bool:
        """Send the stop byte before anything queued, and latch; from any thread."""
        # A thread that holds the lock does so for less than a millisecond; should it be
        # stuck, the byte goes out all the same.
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
            self._on_answer[self.link.request('!reset')] = lambda a: done.append(a.kind)
            self._answered.wait_for(lambda: bool(done), wait_s)
            if not done:
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
            for event in self.link.turn(now_s):
                self._take_event(event, now_s)
            if self._offered is not None:
                command, self._offered = self._offered, None
                command(now_s)
            if self._ready:
                self._supervise(now_s)
                self._stream(now_s)
                self._ask(now_s)
                for event in self.link.turn(now_s):  # send what was just asked for
                    self._take_event(event, now_s)

    def next_due_s(self) -> float:
        """Give the time of the next thing to do by itself."""
        with self._lock:
            if self._offered is not None:
                return 0.0
            due = [self.link.next_due_s()]
            if self._ready:
                due += [self._next_position_s, self._next_status_s]
                due += [self._next_target_s] if self._streaming else []
            return min(due)

    @property
    def resting(self) -> bool:
        """Tell whether nothing moves and nothing waits to move."""
        return self._motion is None and self._verify is None and self._offered is None

    def quit(self, now_s: float) -> None:
        """
        Say farewell: a moving arm is stopped at once and latched.

        With an arm at rest the device's watchdog is switched off, or it would take our
        absence for a fault.
        """
        with self._lock:
            if not self.resting:
                self.stop_now('the bridge ends')
            elif self._ready and not self._latch:
                self.link.request('!watch 0')
                self.link.turn(now_s)

    def close(self) -> None:
        """Release the port."""
        with self._lock:
            self._ready = False
            self.link.close()

    # --- inside -------------------------------------------------------------------------

    def _refusal(self, now_s: float, paused_is_fine: bool = False) -> Rejected | None:
        """Say why nothing may move now, whatever it is."""
        if not self._ready:
            return Rejected('not connected')
        if self._latch:
            return Rejected(f'latched ({self._latch}); call ~/reset first')
        if not self.active:
            return Rejected('the node is not active')
        if self.locked_out(now_s):
            return Rejected(self._hold)
        if not self._powered:
            return Rejected('power is off; call ~/power first')
        if self._paused_s is not None and not paused_is_fine:
            return Rejected('paused; call ~/pause with false first')
        return None if self._estimate.known else Rejected('the position is not known yet')

    def _judged(self, problem: Rejected | None) -> Rejected | None:
        self.counts['commands_accepted' if problem is None else 'commands_rejected'] += 1
        return problem

    def _commanded(self, now_s: float) -> State:
        """Give what the arm is told now: the start of whatever comes next."""
        if self._motion and self._motion.streamed:
            return self._targets.state
        state = self._estimate.at(now_s)
        return State(np.clip(state.positions, self.limits.lower_rad, self.limits.upper_rad),
                     state.velocities)

    @property
    def _outside(self) -> bool:
        """Tell whether the arm stands outside the limits, by more than rounding."""
        standing = self._estimate.last
        return bool(np.any(standing < self.limits.lower_rad - ROUNDING_RAD)
                    or np.any(standing > self.limits.upper_rad + ROUNDING_RAD))

    def _take(self, trajectory: Trajectory | Rejected, now_s: float) -> Rejected | None:
        if isinstance(trajectory, Rejected):
            return trajectory
        units = self._governor.whole(
            self._wire.units(trajectory.goal, self.settings.joint_margin_rad))
        if units is None:
            return Rejected('the goal rounds to a servo position outside the limits')
        alone = trajectory.single_point and self._motion is None and self._verify is None
        if not alone and self._outside:
            return Rejected('the arm stands outside its limits; call ~/home first')
        self._note_command(now_s)
        self._hold = ''
        if trajectory.note:
            self.counts['commands_slowed'] += 1
        if alone:
            self._move(trajectory, units, now_s)
            return None
        self._follow(trajectory, units, now_s)
        return None

    def _note_command(self, now_s: float) -> None:
        soon = now_s - self._command_s <= self.settings.command_timeout_s
        self._in_a_row = self._in_a_row + 1 if soon else 1
        self._command_s = now_s

    def _move(self, trajectory: Trajectory, units: np.ndarray, now_s: float) -> None:
        way = units - self._wire.units(self._estimate.at(now_s).positions, 0.0)
        if not way.any():
            return
        self._set_pace(self._wire.pace(way, trajectory.duration_s))
        seq = 0
        for line in self._wire.move(units):
            seq = self.link.request(line, motion=True)
        self._motion = _Motion(units, seq)
        self._governor.forget()

    def _follow(self, trajectory: Trajectory, units: np.ndarray, now_s: float) -> None:
        if self._governor.last is None:
            standing = self._wire.units(self._commanded(now_s).positions,
                                        self.settings.joint_margin_rad)
            self._governor.start(standing, now_s - self._period_s)
        if self._motion is None or not self._motion.streamed:
            self._targets.restart(self._governor.last, now_s)
            self._set_pace(self._wire.full_pace)
        self._targets.follow(trajectory, now_s)
        self._verify = None
        self._motion = _Motion(units)
        self._next_target_s = min(self._next_target_s, now_s + self._period_s)

    def _set_pace(self, pace: np.ndarray) -> None:
        if self._pace is None or np.any(pace != self._pace):
            for line in self._wire.maxspd(pace):
                self.link.request(line)
            self._pace = pace

    def _rest(self, now_s: float) -> None:
        """Brake on the way."""
        if self._motion is None or self._wire is None:
            return
        trajectory = stop(self.limits, self._commanded(now_s))
        self._follow(trajectory, self._wire.units(trajectory.goal,
                                                  self.settings.joint_margin_rad), now_s)

    @property
    def _streaming(self) -> bool:
        return self._motion is not None and self._motion.streamed and self._paused_s is None

    def _supervise(self, now_s: float) -> None:
        """Hold when a stream of commands has ended, go on when a hold is over."""
        silent_s = now_s - self._command_s
        if self._in_a_row >= STREAM_LENGTH and silent_s > self.settings.command_timeout_s:
            self._in_a_row = 0
            self.counts['stream_timeouts'] += 1
            self.hold(f'no command for {self.settings.command_timeout_s:g} s', now_s)
        if self._hold and now_s >= self._hold_until_s:
            self._hold, self._hold_until_s = '', float('inf')

    def _stream(self, now_s: float) -> None:
        """Send the next target when it is time and the last one was answered."""
        motion = self._motion
        if not self._streaming or now_s < self._next_target_s or self._stream_seq:
            return
        self._next_target_s = max(self._next_target_s + self._period_s, now_s)
        wanted = self._targets.step(now_s)
        target = self._governor.step(wanted.units, now_s)
        if target is not None:
            motion.seq = self._stream_seq = self.link.request(self._wire.goto(target),
                                                              motion=True)
        elif wanted.done and not motion.seq:
            self._motion = None  # all of it was too small for a servo step

    def _ask(self, now_s: float) -> None:
        if self.link.backlog >= 3:
            return
        if now_s >= self._next_position_s:
            self._next_position_s = now_s + self._period_s
            self._asked_s[self.link.request('?pos')] = now_s
        if now_s >= self._next_status_s:
            self._next_status_s = now_s + STATUS_PERIOD_S
            self.link.request('?')

    # --- events -------------------------------------------------------------------------

    def _take_event(self, event: LinkEvent, now_s: float) -> None:
        if isinstance(event, Up):
            self._set_up(event)
        elif isinstance(event, Down):
            self._lost(event.reason)
        elif isinstance(event, Notice):
            self._notice(event)
        elif isinstance(event, Over):
            self._over(event.seq, event.how)
        else:
            self._answer(event, now_s)

    def _set_up(self, event: Up) -> None:
        """Tell a device that has just greeted what it must know, then ask how it is."""
        try:
            self._wire = ServoWire(self.robot, event.servos, self.settings.tick_s)
        except LinkError as error:
            self._latch = str(error)
            return
        self.device = f'{event.name}, {event.servos} servos'
        self._pace = None
        self._asked_s.clear()
        self._on_answer.clear()
        self._estimate.clear()
        self.link.request(f'!watch {int(1000 * self.settings.watchdog_s)}')
        self.link.request('!resume')
        if self._was_ready:
            self.link.request('!stop')
        for line in self._wire.setup():
            self.link.request(line)
        self._pace = self._wire.full_pace
        self.link.request('?pos')
        self._on_answer[self.link.request('?')] = self._first_status

    def _first_status(self, answer: Answer) -> None:
        """Become ready; what stood or moved without us needs a reset by somebody."""
        if self._was_ready:
            self._latch = self._latch or 'the link was lost and came back'
        elif answer.values[0] == 'STOPPED':
            self._latch = 'the device had been stopped before'
        self._ready = self._was_ready = True
        self._powered, self._paused_s, self._hold = True, None, ''
        self._forget_motion()
        if answer.values[0] == 'WORKING':
            self.stop_now('the arm was moving when the link came up')

    def _lost(self, reason: str) -> None:
        self._ready = False
        if self._was_ready:
            self._latch = self._latch or f'the link was lost: {reason}'
        self._forget_motion()
        self._estimate.clear()
        self._answered.notify_all()

    def _notice(self, event: Notice) -> None:
        if not self._latch:
            self._latch = {'ESTOP': 'the device was stopped',
                           'WATCHDOG': 'the device heard nothing for too long'}[event.name]
        self._forget_motion()

    def _over(self, seq: int, how: str) -> None:
        motion = self._motion
        if motion is None or seq != motion.seq:
            return
        if how == 'STOPPED':
            self._motion = None
            self.stop_now('the device stopped a motion by itself')
        elif not motion.streamed or np.array_equal(self._governor.last, motion.target):
            self._motion, self._verify = None, motion.target
            self._next_position_s = 0.0

    def _answer(self, answer: Answer, now_s: float) -> None:
        if answer.seq == self._stream_seq:
            self._stream_seq = 0
        asked_s = self._asked_s.pop(answer.seq, None)
        hook = self._on_answer.pop(answer.seq, None)
        if answer.kind == 'ERR':
            self._refused(answer)
        elif answer.kind == 'POS':
            self._position(answer.values, asked_s, now_s)
        elif answer.kind == 'ST':
            self._status(answer.values)
        elif answer.text == '!reset':
            self._was_reset(now_s)
        if hook:
            hook(answer)
            self._answered.notify_all()

    def _refused(self, answer: Answer) -> None:
        code, _, token = answer.values
        self.counts['device_errors'] += 1
        self.stop_now(f'the device refused {answer.text.split(" ", 1)[0]}: error {code} {token}')

    def _position(self, values: tuple, asked_s: float | None, now_s: float) -> None:
        units = self._wire.heard(values)
        if units is None:
            self.counts['bad_positions'] += 1
            return
        wire_s = LONGEST_REPLY * BITS_PER_BYTE / self.settings.baud
        heard_s = max(now_s - wire_s, now_s if asked_s is None else asked_s)
        if self._verify is not None and self._motion is None and asked_s is not None:
            self._estimate.clear()  # DONE came before this was asked: it stands
            self._check_arrival(units)
        self._estimate.add(heard_s, self._wire.joints(units))

    def _check_arrival(self, units: np.ndarray) -> None:
        off = np.abs(units - self._verify)
        self._verify = None
        if off.max() > ARRIVED_UNITS:
            joint = self.limits.names[int(np.argmax(off))]
            self.stop_now(f'{joint} did not follow: {int(off.max())} units from its target')

    def _status(self, values: tuple) -> None:
        """Compare what the device says with what is believed here."""
        state, paused, finished, waiting = values
        if state == 'STOPPED' and not self._latch and self._ready and not self._on_answer:
            self.stop_now('the device is stopped')
        if state == 'IDLE' and self._motion and self._motion.seq == finished \
                and not self._stream_seq:
            self._over(finished, 'DONE')  # the line that said so was lost

    def _was_reset(self, now_s: float) -> None:
        if not self._latch:
            return  # there was nothing to leave: a motion goes on
        self._latch, self._hold = '', '' if self._powered else 'power is off'
        if self._paused_s is not None:
            self.link.request('!resume')  # what was paused is gone
        self._paused_s = None
        self._in_a_row = 0
        self._forget_motion()
        self.counts['resets'] += 1

    def _forget_motion(self) -> None:
        self._motion, self._verify = None, None
        self._stream_seq = 0
        self._in_a_row = 0
        self._governor.forget()
        self.link.drop_motion()
