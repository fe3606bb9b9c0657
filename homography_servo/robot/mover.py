"""Carry out trajectories over a link: one ``move``, or a stream of targets."""

from __future__ import annotations

from dataclasses import dataclass

from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.estimate import ArmEstimate
from homography_servo.robot.governor import Governor
from homography_servo.robot.limits import limits_of
from homography_servo.robot.link import Link
from homography_servo.robot.robot_model import Robot
from homography_servo.robot.servo_units import unit_range
from homography_servo.robot.servo_units import velocity_units_s
from homography_servo.robot.streaming import TargetStream
from homography_servo.robot.trajectory import State
from homography_servo.robot.trajectory import stop
from homography_servo.robot.trajectory import Trajectory
from homography_servo.robot.wire import LineBudget
from homography_servo.robot.wire import ServoWire
import numpy as np

ARRIVED_UNITS = 2  # a servo further from its target after DONE has not followed
ROUNDING_RAD = 2e-3  # about two servo units


@dataclass
class _Motion:
    """What the arm is doing."""

    target: np.ndarray  # last one, in servo units
    streamed: bool
    pace: np.ndarray  # that the device must have before it hears of the motion
    seq: int = 0  # of the line whose DONE may end it; 0 before the first target is sent
    ran: bool = False  # that line


class Mover:
    """
    One motion at a time, from its acceptance to the proof that the arm has arrived.

    Parameters
    ----------
    robot : Robot
        The arm.
    link : Link
        Where lines go.
    margin_rad : float
        Distance to keep from the ends of every joint.
    period_s : float
        Time between two targets of a stream.
    budget : LineBudget
        When targets may follow each other sooner: when a new trajectory comes, or when the
        last one did not differ by a whole servo unit.

    """

    def __init__(self, robot: Robot, link: Link, margin_rad: float, period_s: float,
                 budget: LineBudget) -> None:
        self.limits = limits_of(robot, margin_rad)
        self.estimate = ArmEstimate()
        self.governor = Governor(*unit_range(robot, margin_rad), velocity_units_s(robot),
                                 budget.least_s)
        self.standing_by = False  # the device was told to pause
        self.next_due_s = 0.0
        self._link = link
        self._margin_rad = margin_rad
        self._period_s, self._budget = period_s, budget
        self._targets = TargetStream(robot, np.zeros(robot.count), 0.0, margin_rad, period_s,
                                     budget.least_s)
        self._wire: ServoWire | None = None
        self._pace: np.ndarray | None = None
        self._motion: _Motion | None = None
        self._arriving: np.ndarray | None = None  # told DONE, not seen there yet
        self._arrived_s = 0.0  # when it was told
        self._unanswered_seq = 0
        self._pace_seq = 0  # of the last line that sets the pace, until it has run

    def attach(self, wire: ServoWire) -> None:
        """Begin with a device that has been told the limits of the arm."""
        self._wire = wire
        self.estimate.clear()
        self.forget()
        self._pace = wire.full_pace

    @property
    def wire(self) -> ServoWire:
        """Give how the device is spoken to."""
        return required(self._wire, 'device that has greeted')

    def forget(self) -> None:
        """Give up the motion: the device does not follow it any more."""
        self._motion = self._arriving = None
        if self._pace_seq:
            self._pace = None  # whether the device has taken it will not be known
        self._unanswered_seq = self._pace_seq = 0
        self.governor.forget()
        self._link.drop_motion()

    @property
    def busy(self) -> bool:
        """Tell whether the arm moves, or has not been seen at its target yet."""
        return self._motion is not None or self._arriving is not None

    @property
    def streaming(self) -> bool:
        """Tell whether targets have to be sent."""
        return self._motion is not None and self._motion.streamed and not self.standing_by

    # --- beginning and ending -----------------------------------------------------------

    def commanded(self, now_s: float) -> State:
        """Give what the arm is told now: the start of whatever comes next."""
        if self._motion and self._motion.streamed:
            return self._targets.state_at(now_s)
        state = self.estimate.at(now_s)
        return State(np.clip(state.positions, self.limits.lower_rad, self.limits.upper_rad),
                     state.velocities)

    def begin(self, trajectory: Trajectory, now_s: float) -> Rejected | None:
        """Replace the motion by another."""
        units = self.governor.whole(self.wire.units(trajectory.goal, self._margin_rad))
        if units is None:
            return Rejected('the goal rounds to a servo position outside the limits')
        if trajectory.single_point and not self.busy:
            self._move(trajectory, units, now_s)
        elif self._outside:
            return Rejected('the arm stands outside its limits; call ~/home first')
        else:
            self._follow(trajectory, units, now_s)
        return None

    def brake(self, now_s: float) -> None:
        """Come to rest on the way."""
        if self._motion is None:
            return
        told = self._targets.state if self._motion.streamed else self.commanded(now_s)
        trajectory = stop(self.limits, told)
        self._follow(trajectory, self.wire.units(trajectory.goal, self._margin_rad), now_s)

    @property
    def _outside(self) -> bool:
        """Tell whether the arm stands outside the limits, by more than rounding."""
        standing = self.estimate.last
        return bool(np.any(standing < self.limits.lower_rad - ROUNDING_RAD)
                    or np.any(standing > self.limits.upper_rad + ROUNDING_RAD))

    def _move(self, trajectory: Trajectory, units: np.ndarray, now_s: float) -> None:
        way = units - self.wire.units(self.estimate.at(now_s).positions, 0.0)
        if not way.any():
            return
        self._motion = _Motion(units, False, self.wire.pace(way, trajectory.duration_s))
        self.governor.forget()

    def _follow(self, trajectory: Trajectory, units: np.ndarray, now_s: float) -> None:
        seq = 0
        if self._motion is not None and not self._motion.streamed and self._motion.seq:
            seq = self._end_move(now_s)
        last = self.governor.last
        if last is None:
            last = self.wire.units(self.commanded(now_s).positions, self._margin_rad)
            self.governor.start(last, now_s - self._period_s)
        if self._motion is None or not self._motion.streamed:
            self._targets.restart(last, now_s)
        self._targets.follow(trajectory, now_s)
        self._arriving = None
        self._motion = _Motion(units, True, self.wire.full_pace, seq)
        self.next_due_s = min(self.next_due_s, max(now_s, self._budget.next_s()))

    def _end_move(self, now_s: float) -> int:
        """
        Steer to where the arm can stand: only a target ends a move of the device.

        It goes out even if it is where the arm is now, at once, and before any pace: a line
        of script would wait for the end of the move.
        """
        rest = stop(self.limits, self.commanded(now_s)).goal
        target = self.wire.units(rest, self._margin_rad)
        self.governor.start(target, now_s)
        self._unanswered_seq = self._link.request(self.wire.goto(target), motion=True)
        return self._unanswered_seq

    def _paced(self, pace: np.ndarray) -> bool:
        """
        Tell whether the device has a pace, and tell the device where it has not.

        What is to move so fast waits for that: a line that is lost is overtaken by those
        behind it, and a target throws lines out of the queue of the device.
        """
        if self._pace_seq:
            return False
        if self._pace is not None and np.array_equal(pace, self._pace):
            return True
        for line in self.wire.maxspd(pace):
            self._pace_seq = self._link.request(line, motion=True)
        self._pace = pace
        return False

    # --- going on -----------------------------------------------------------------------

    def stream(self, now_s: float) -> None:
        """Send what is next when it is time and what was before has been answered."""
        motion = self._motion
        if motion is None or self.standing_by or self._unanswered_seq \
                or not self._paced(motion.pace):
            return
        if motion.streamed:
            self._next_target(motion, now_s)
        elif not motion.seq:
            motion.seq = self._link.request(self.wire.move(motion.target), motion=True)

    def _next_target(self, motion: _Motion, now_s: float) -> None:
        if now_s < self.next_due_s:
            return
        wanted = self._targets.step(now_s)
        target = self.governor.step(wanted.units, now_s)
        due_s, self.next_due_s = self.next_due_s, now_s + self._budget.least_s
        if target is not None:
            self._budget.sent(now_s)
            self.next_due_s = max(due_s + self._period_s, self._budget.next_s())
            seq = self._link.request(self.wire.goto(target), motion=True)
            motion.seq = self._unanswered_seq = seq
            motion.ran = False
        elif wanted.done and not motion.seq:
            self._motion = None  # all of it was too small for a servo step
        elif wanted.done and motion.ran:
            self._arrive(motion, now_s)

    def answered(self, seq: int) -> None:
        """Take note that a line was answered."""
        if seq == self._unanswered_seq:
            self._unanswered_seq = 0

    def over(self, seq: int, how: str, now_s: float) -> str:
        """Take note that a line has run; give a sentence when that is not as it should be."""
        self.answered(seq)  # its OK may have been lost
        motion = self._motion
        if seq == self._pace_seq:
            self._pace_seq = 0
            self._pace = self._pace if how == 'DONE' else None  # told again before it is needed
            if how == 'DONE' and motion is not None and motion.seq:
                seq = motion.seq  # what was sent before it has run, too: its DONE was lost
        if motion is None or seq != motion.seq:
            return ''
        if how == 'STOPPED':
            return 'the device stopped a motion by itself'
        motion.ran = True
        if not motion.streamed or self._targets.trajectory is None:
            self._arrive(motion, now_s)
        return ''

    def _arrive(self, motion: _Motion, now_s: float) -> None:
        """End a motion at its goal; a stream may stand there on its way, too."""
        last = self.governor.last
        if not motion.streamed or (last is not None and np.array_equal(last, motion.target)):
            self._motion, self._arriving, self._arrived_s = None, motion.target, now_s

    def rests(self, finished_seq: int, now_s: float) -> None:
        """Take note that the device is idle; the line that said so may have been lost."""
        if self._pace_seq and finished_seq == self._pace_seq:
            self.over(finished_seq, 'DONE', now_s)
        if self._motion and self._motion.seq == finished_seq and not self._unanswered_seq:
            self.over(finished_seq, 'DONE', now_s)

    def heard(self, units: np.ndarray, time_s: float) -> str:
        """Take a position; give a sentence when the arm is not where it has arrived."""
        off = np.zeros(1)
        if self._arriving is not None and time_s >= self._arrived_s:
            off = np.abs(units - self._arriving)
            self._arriving = None
            self.estimate.clear()  # it stands
        self.estimate.add(time_s, self.wire.joints(units))
        if off.max() <= ARRIVED_UNITS:
            return ''
        name = self.limits.names[int(np.argmax(off))]
        return f'{name} did not follow: {int(off.max())} units from its target'
