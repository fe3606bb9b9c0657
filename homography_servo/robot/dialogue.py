"""
What is said between driver and device: how it is set up, asked, and understood.

Nothing here has a thread or a lock: whoever calls holds the lock of the driver, all but a
stop that cannot wait for it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Callable

from homography_servo.errors import LinkError
from homography_servo.robot.driver_settings import DriverSettings
from homography_servo.robot.interlock import Interlock
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
from homography_servo.robot.wire import rate_for
from homography_servo.robot.wire import ServoWire

STATUS_PERIOD_S = 0.5
MOST_UNANSWERED = 3  # leaves room in the window of four for what is urgent
_CRIES = {'ESTOP': 'the device was stopped', 'WATCHDOG': 'the device heard nothing for too long'}


@dataclass(eq=False)
class Expected:
    """The answer to a line, which has come when it has a kind."""

    seq: int
    kind: str = ''
    then: Callable[[Answer], None] | None = None


class Dialogue:
    """
    Sets a device up, asks how it is, and tells mover and interlock what it says.

    Parameters
    ----------
    robot : Robot
        Whose servos the device drives.
    link : Link
        The connection.
    mover, interlock : Mover, Interlock
        What moves the arm, and what keeps it from moving.
    settings : DriverSettings
        How the arm is driven.
    stop : callable
        Stops the arm for the reason given, when the device says what must not be.

    """

    def __init__(self, robot: Robot, link: Link, mover: Mover, interlock: Interlock,
                 settings: DriverSettings, stop: Callable[[str], object]) -> None:
        self.device = ''
        self.misfit = ''  # why this device cannot drive this arm
        self.counts: Counter = Counter()
        self._robot, self._link, self._mover, self._interlock = robot, link, mover, interlock
        self._settings, self._stop = settings, stop
        self._period_s = 1.0 / rate_for(settings.baud)
        self._reply_s = LONGEST_REPLY * BITS_PER_BYTE / settings.baud
        self._was_ready = False
        self._next_position_s = self._next_status_s = 0.0
        self._asked_s: dict[int, float] = {}
        self._expected: dict[int, Expected] = {}
        self._switched_on: Expected | None = None

    @property
    def next_due_s(self) -> float:
        """Give the time of the next question."""
        return min(self._next_position_s, self._next_status_s)

    def request(self, line: str, then: Callable[[Answer], None] | None = None,
                motion: bool = False) -> Expected:
        """Send a line whose answer is awaited."""
        expected = Expected(self._link.request(line, motion=motion), then=then)
        self._expected[expected.seq] = expected
        return expected

    def give_up(self, expected: Expected) -> None:
        """Await an answer no longer."""
        self._expected.pop(expected.seq, None)

    def pause(self, on: bool) -> None:
        """Let the device slow down and stand, or go on."""
        self._link.request('!pause' if on else '!resume')
        self._paused(on)

    def power(self, on: bool) -> None:
        """Switch the servos; they have power when the device says so, and none at once."""
        if self._switched_on is not None:
            self.give_up(self._switched_on)
            self._switched_on = None
        if on:
            self._switched_on = self.request('!power on', self._switched)
        else:
            self.forget_motion()
            self._link.request('!power off')
            self._interlock.powered = False

    def _switched(self, answer: Answer) -> None:
        self._interlock.powered, self._switched_on = answer.kind != 'ERR', None

    def forget_motion(self) -> None:
        """Give up what is under way: the device does not follow it any more."""
        self._interlock.end_stream()
        self._mover.forget()

    def ask(self, now_s: float) -> None:
        """Ask where the arm is and how the device is, when it is time."""
        if self._link.backlog >= MOST_UNANSWERED:
            return
        if now_s >= self._next_position_s:
            self._next_position_s = now_s + self._period_s
            self._asked_s[self._link.request('?pos')] = now_s
        if now_s >= self._next_status_s:
            self._next_status_s = now_s + STATUS_PERIOD_S
            self._link.request('?')

    def listen(self, now_s: float) -> None:
        """Send what waits, and take in what has come."""
        for event in self._link.turn(now_s):
            if isinstance(event, Up):
                self._set_up(event)
            elif isinstance(event, Down):
                self._lost(event.reason)
            elif isinstance(event, Notice):
                self._stop_if('' if self._interlock.latched else _CRIES.get(event.name, ''))
            elif isinstance(event, Over):
                self._stop_if(self._mover.over(event.seq, event.how, now_s))
                self._next_position_s = 0.0  # where is it now?
            else:
                self._answer(event, now_s)

    def _stop_if(self, problem: str) -> None:
        if problem:
            self._stop(problem)

    # --- the device comes and goes ------------------------------------------------------

    def _set_up(self, event: Up) -> None:
        """Ask a device that has just greeted how it is, before anything else."""
        settings = self._settings
        try:
            wire = ServoWire(self._robot, event.servos, settings.tick_s)
        except LinkError as error:
            self.misfit = str(error)
            return
        self.misfit = ''
        self.device = f'{event.name}, {event.servos} servos'
        self._asked_s.clear()
        self._expected.clear()
        self._switched_on = None
        self._mover.attach(wire)
        first = ['!stop'] if self._was_ready else []
        for line in (*first, f'!watch {int(1000 * settings.watchdog_s)}'):
            self._link.request(line)
        self.request('?', self._found)

    def _found(self, answer: Answer) -> None:
        """Tell the device what it must know; what somebody else has begun ends first."""
        if _state(answer) == 'WORKING':
            self._stop('the arm was moving when the link came up')
        wire = self._mover.wire
        for line in ('!resume', *wire.setup(), '?pos'):
            self._link.request(line)
        self.request(wire.ask_power(), self._heard_power)
        self.request('?', self._first_status)

    def _heard_power(self, answer: Answer) -> None:
        if answer.kind != 'ERR':
            self._interlock.powered = answer.values[0] > 0

    def _first_status(self, answer: Answer) -> None:
        """Become ready; what stood or moved without us needs a reset by somebody."""
        if self._was_ready:
            self._interlock.latch('the link was lost and came back')
        elif _state(answer) == 'STOPPED':
            self._interlock.latch('the device had been stopped before')
        self._interlock.ready = self._was_ready = True
        self._interlock.let_go()
        self._paused(False)
        if _state(answer) == 'WORKING':
            self._stop('the arm was moving when the link came up')

    def _paused(self, on: bool) -> None:
        self._interlock.paused = self._mover.standing_by = on

    def _lost(self, reason: str) -> None:
        self._interlock.ready = False
        self.misfit = ''
        if self._was_ready:
            self._interlock.latch(f'the link was lost: {reason}')
        self.forget_motion()
        self._mover.estimate.clear()

    # --- what it answers ----------------------------------------------------------------

    def _answer(self, answer: Answer, now_s: float) -> None:
        self._mover.answered(answer.seq)
        asked_s = self._asked_s.pop(answer.seq, now_s)
        if answer.kind == 'ERR':
            code, _, token = answer.values
            self.counts['device_errors'] += 1
            self._stop(f'the device refused {answer.text.split(" ", 1)[0]}: '
                       f'error {code} {token}')
        elif answer.kind == 'POS':
            self._position(answer, asked_s, now_s)
        elif answer.kind == 'ST':
            self._status(answer, now_s)
        elif answer.text == '!reset':
            self._was_reset()
        expected = self._expected.pop(answer.seq, None)
        if expected is not None:
            expected.kind = answer.kind
            if expected.then is not None:
                expected.then(answer)

    def _position(self, answer: Answer, asked_s: float, now_s: float) -> None:
        units = self._mover.wire.heard(answer.values)
        if units is None:
            self.counts['bad_positions'] += 1
            return
        held_s = asked_s if answer.repeated else max(now_s - self._reply_s, asked_s)
        self._stop_if(self._mover.heard(units, held_s))

    def _status(self, answer: Answer, now_s: float) -> None:
        """Compare what the device says with what is believed here."""
        state, _, finished, _ = answer.values
        no_news = self._interlock.latched or self._expected or answer.repeated
        if state == 'STOPPED' and self._interlock.ready and not no_news:
            self._stop('the device is stopped')
        if state == 'IDLE':
            self._mover.rests(finished, now_s)

    def _was_reset(self) -> None:
        if not self._interlock.latched:
            return  # there was nothing to leave: a motion goes on
        self._interlock.unlatch()
        if self._interlock.paused:
            self.pause(False)  # what was paused is gone
        self.forget_motion()
        self.counts['resets'] += 1


def _state(answer: Answer) -> str:
    """Give the state that a device has told; empty where it has refused to."""
    return answer.values[0] if answer.kind == 'ST' else ''
