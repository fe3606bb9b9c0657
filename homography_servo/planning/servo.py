"""
The servo's state machine: look, decide, move, until the last pose is reached.

It knows no clock, port or message: every input carries the time ``now_s`` of a
steady clock, images and joint states also carry their stamps. After every input and
at least every 20 ms call `Servo.tick`, and send the command that it gives.

What to do about a pose after a look is decided in `pursuit`; here is what may happen
around it: nothing is seen or felt any more, somebody pauses, the arm does not obey.

States: IDLE until started; MOVING while the arm carries out a step; LOOKING from the
moment it stands; HOLD with a reason, which ends by itself; DONE; FAILED with a reason.
"""

from __future__ import annotations

import math

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.command import Command
from homography_servo.planning.flow import Flow
from homography_servo.planning.joint_lead import JointLead
from homography_servo.planning.look_filter import look_from_pose
from homography_servo.planning.look_filter import LookFilter
from homography_servo.planning.pursuit import Decision
from homography_servo.planning.pursuit import Pursuit
from homography_servo.planning.servo_looks import Looks
from homography_servo.planning.servo_moves import Moves
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_state import ACTIVE
from homography_servo.planning.servo_state import DONE
from homography_servo.planning.servo_state import FAILED
from homography_servo.planning.servo_state import HOLD
from homography_servo.planning.servo_state import IDLE
from homography_servo.planning.servo_state import LOOKING
from homography_servo.planning.servo_state import MOVING
from homography_servo.planning.servo_state import Progress
from homography_servo.planning.servo_watch import UNRESTING
from homography_servo.planning.servo_watch import Watch
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.robot_file import Robot
import numpy as np

RETRY_S = 1.0
UNMOVED = 'the arm does not move; does the bridge take commands?'
FLOW_REFRESH_S = 0.1  # a stream goes on without looks until vision is lost
FLOW_LAST_S = 0.12  # the end of the way is left alone
IDLE_LOOK_S = 0.1  # while nothing moves, a look now and then keeps the model right
UNSEEN_RAD = 0.05  # by which the arm may overrun its move when its state is missing


class Servo:
    """
    Bring the object along a checked path.

    Parameters
    ----------
    robot : Robot
        The believed arm.
    settings : ServoSettings
        Tolerances, limits and time-outs; may be replaced at any time.

    """

    def __init__(self, robot: Robot, settings: ServoSettings = ServoSettings()) -> None:
        self.robot, self.settings = robot, settings
        self.watch = Watch()
        self.filter = LookFilter(ArmModel(robot), robot.object_points_m, robot.home_depth_m,
                                 settings.prior, settings.drift)
        self.state, self.reason = IDLE, ''
        self._veto = 'no path was planned yet'
        self._flow: Flow | None = None
        self._moves = Moves(robot, self.watch)
        self._looks = Looks(self.watch, self.filter)
        self._pursuit = Pursuit(robot, self.watch, self.filter, self._moves)
        self._retry_s = self._looking_s = -math.inf
        self._pending: Command | None = None

    @property
    def state_text(self) -> str:
        """Give the state with its reason."""
        return f'{self.state}: {self.reason}' if self.reason else self.state

    @property
    def active(self) -> bool:
        """Tell whether the servo is on its way (or holding on it)."""
        return self.state in ACTIVE

    @property
    def progress(self) -> Progress:
        """Give how far the servo is."""
        return self._pursuit.progress

    @property
    def passed_over(self) -> int:
        """Count the poses that were left out because the arm does not get there."""
        return self._pursuit.passed_over

    # Inputs.

    def set_focal(self, focal_px: float | None) -> None:
        """Tell the focal length of the camera, None when it is unknown."""
        self.watch.focal_px = focal_px

    def set_path(self, poses: np.ndarray, ok: bool, sentence: str,
                 lead: JointLead | None = None) -> None:
        """Take a path (N, 4, 4) in home, or its veto; in mid-motion it is taken over."""
        self._veto = '' if ok and len(poses) else sentence or 'the path is empty'
        self._pursuit.take(None if self._veto else np.array(poses, dtype=float),
                           lead or JointLead())
        if not self.active:
            return
        if self._veto:
            self._end(FAILED, f'the new path is vetoed: {self._veto}')
            return
        if self._pursuit.index < 0:  # the first look chooses, and tells how far it is
            return
        if self._flow is not None and self._pursuit.led:  # joints lead from rest to rest
            self._flow, self._pending = None, Command()
            self._enter_looking()
            self._pursuit.aim_at(-1)
            return
        standing = self._flow is not None or self.state != MOVING
        aimed = self._pursuit.aim_from(
            self.watch.joints.known_rad if standing else self._moves.goal_rad, self.settings)
        if self._flow is not None:
            self._flow.follow(self._pursuit.poses, self._pursuit.index)
        if aimed.state == FAILED:
            self._end(FAILED, aimed.reason)

    def add_joints(self, joints_rad: np.ndarray, stamp_s: float, now_s: float
                   ) -> Rejected | None:
        """Take in a joint state."""
        if not np.isfinite(joints_rad).all():
            return Rejected('a joint position is not a finite number')
        joints = self.watch.joints
        before_s = joints.clock_set_s
        rejected = joints.add(np.array(joints_rad, dtype=float), stamp_s, now_s)
        if joints.clock_set_s != before_s:
            self._looks.clock_set()
        return rejected

    def add_look(self, home_from_object: np.ndarray, covariance: np.ndarray, stamp_s: float,
                 now_s: float) -> Rejected | None:
        """Take in a measured pose with its covariance and the stamp of its image."""
        look = look_from_pose(home_from_object, covariance, self.robot.object_points_m,
                              self.robot.home_depth_m)
        if isinstance(look, Rejected):
            return look
        return self.watch.sight.add(look, stamp_s, now_s, self.settings.image_timeout_s)

    def start(self, now_s: float) -> Rejected | str:
        """Begin to servo along the path; a sentence either way."""
        if self.active:
            return Rejected('already on the way; stop first')
        if self._veto:
            return Rejected(self._veto)
        trouble = self.watch.trouble(now_s, self.settings)
        if trouble:
            return Rejected(trouble)
        self.watch.moved_unseen_rad()
        self._enter_looking(now_s)
        self._pursuit.aim_at(-1)
        return f'on the way along {len(self._pursuit.poses)} poses'

    def stop(self) -> str:
        """Stop now and forget where to go; the path stays."""
        was_active = self.active
        self._end(IDLE, '')
        return 'stopped' if was_active else 'was not moving; a stop was sent all the same'

    def pause(self, wanted: bool) -> str:
        """Hold until pause is taken back."""
        self.watch.paused = wanted
        return 'paused' if wanted else 'not paused'

    def fail(self, reason: str) -> None:
        """Stop for good, for a reason found outside."""
        self._end(FAILED, reason)

    # The machine.

    def tick(self, now_s: float) -> Command | None:
        """Go on as far as possible; give the command to send now, if any."""
        if not self.active:
            self._looks.standing(self._moves.due_stamp_s, self.settings, IDLE_LOOK_S)
        elif self._pending is None:
            self._advance(now_s)
        command, self._pending = self._pending, None
        return command

    def _advance(self, now_s: float) -> None:
        trouble = self.watch.trouble(now_s, self.settings)
        if self.watch.arm_latched:  # a reset moves nothing: somebody has to start again
            self._end(FAILED, trouble)
        elif trouble:
            self._hold(trouble)
        elif self.state == HOLD:
            self._resume(now_s)
        elif self._flow is not None:
            self._flow_on(self._flow, now_s)
        elif self.state == MOVING:
            self._await_arrival(now_s)
        if self.state == LOOKING:
            self._look(now_s)

    def _hold(self, reason: str) -> None:
        if self.state != HOLD:
            self._pending = Command()
        self._flow = None
        self.state, self.reason = HOLD, reason

    def _resume(self, now_s: float) -> None:
        if now_s < self._retry_s:
            return
        moved_rad = self.watch.moved_unseen_rad()
        if moved_rad > self._moves.length_rad + UNSEEN_RAD:
            self._end(FAILED, f'the arm moved by {math.degrees(moved_rad):.1f} deg while '
                      'joint_states were missing; start again')
        else:
            self._enter_looking(now_s)

    def _await_arrival(self, now_s: float) -> None:
        if self._moves.arrived or self._moves.stopped_short(now_s):
            self._enter_looking(now_s)  # wherever it stands: look where that is
        elif self._moves.overdue(now_s):
            if not self._moves.began:
                self._pursuit.take_back_move()
            self._hold_for_a_while(UNMOVED if self.watch.joints.still else UNRESTING, now_s)

    def _hold_for_a_while(self, reason: str, now_s: float) -> None:
        """Hold for a reason that only trying again can tell to be gone."""
        self._retry_s = now_s + RETRY_S
        self._hold(reason)

    def _enter_looking(self, now_s: float = -math.inf) -> None:
        self.state, self.reason, self._looking_s = LOOKING, '', now_s

    def _look(self, now_s: float) -> None:
        taken = self._looks.standing(self._moves.due_stamp_s, self.settings)
        if taken:
            self._looking_s = now_s
            self._pursuit.count_looks(taken)
            self._carry_out(self._pursuit.decide(self.settings), now_s)
            return
        since_s = max(self._looking_s, self._moves.due_s)
        vain = self.watch.why_in_vain(since_s, now_s, self.settings)
        if vain:
            self._hold_for_a_while(vain, now_s)

    def _carry_out(self, decision: Decision, now_s: float) -> None:
        if decision.state in (DONE, FAILED):
            self._end(decision.state, decision.reason, stop=decision.state == FAILED)
        elif decision.state == MOVING:
            self.state, self.reason = MOVING, ''
            if decision.joints_rad is None:
                self._flow = Flow(self.robot, self._pursuit.poses, self._pursuit.index,
                                  self.settings.servo_margin_rad)
                self._send_flow(self._flow, now_s)
            else:
                self._pending = self._moves.go(self.filter.model, decision.joints_rad,
                                               self.settings, now_s)

    def _flow_on(self, flow: Flow, now_s: float) -> None:
        """Keep the stream of commands going; at its end wait for rest, then look."""
        flow.advance(now_s)
        self._pursuit.go_on_to(flow.index)
        seen = self._look_on_the_way()
        if flow.unheeded(now_s):
            self._hold_for_a_while(UNMOVED, now_s)
        elif self.settings.mode != 'continuous' or \
                flow.ends and now_s > flow.ends_s - FLOW_LAST_S:
            self._flow = None
            self._pursuit.go_on_to(flow.last)
        elif seen or now_s > flow.sent_s + FLOW_REFRESH_S:
            self._send_flow(flow, now_s)

    def _send_flow(self, flow: Flow, now_s: float) -> None:
        settings, focal_px = self.settings, required(self.watch.focal_px, 'camera')
        command = flow.command(
            self.filter.model, self.watch.joints.known_rad, settings.speed_share, focal_px,
            settings.corner_speed_px_s, now_s)
        if command is None:  # look there; the step to the pose will name the joint
            self._flow, self._pending = None, Command()
            self._enter_looking(now_s)
            return
        self._pending = self._moves.follow(command, now_s)

    def _look_on_the_way(self) -> bool:
        taken = self._looks.moving(self.settings)
        self._pursuit.count_looks(taken, passing=True)
        if taken:
            self._pursuit.report()
        return taken > 0

    def _end(self, state: str, reason: str, stop: bool = True) -> None:
        self._flow = None
        self.state, self.reason = state, reason
        self._retry_s = -math.inf
        if stop:
            self._pending = Command()
