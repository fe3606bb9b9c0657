"""
The servo's state machine: look, decide, move, until the last pose is reached.

It knows no clock, port or message: every input carries the time ``now_s`` of a
steady clock, images and joint states also carry their stamps. After every input and
at least every 20 ms call `Servo.tick`, and send the command that it gives.

States: IDLE until started; MOVING while the arm carries out a step; LOOKING from the
moment it stands; HOLD with a reason, which ends by itself; DONE; FAILED with a reason.
"""

from __future__ import annotations

import math

from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.command import Command
from homography_servo.planning.control import displacement
from homography_servo.planning.control import Errors
from homography_servo.planning.control import errors_of
from homography_servo.planning.control import joints_for
from homography_servo.planning.control import sigmas_of
from homography_servo.planning.control import Step
from homography_servo.planning.flow import Flow
from homography_servo.planning.joint_lead import JointLead
from homography_servo.planning.joint_track import CLOCK_JUMP_S
from homography_servo.planning.look_filter import look_from_pose
from homography_servo.planning.look_filter import LookFilter
from homography_servo.planning.servo_looks import Looks
from homography_servo.planning.servo_moves import Moves
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_state import ACTIVE
from homography_servo.planning.servo_state import Attempt
from homography_servo.planning.servo_state import DONE
from homography_servo.planning.servo_state import FAILED
from homography_servo.planning.servo_state import HOLD
from homography_servo.planning.servo_state import IDLE
from homography_servo.planning.servo_state import LOOKING
from homography_servo.planning.servo_state import MOVING
from homography_servo.planning.servo_state import Progress
from homography_servo.planning.servo_watch import Watch
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.robot_file import Robot
import numpy as np

RETRY_S = 1.0
GROWN = 1.2  # an error counts as larger than before from this factor on
FLOW_REFRESH_S = 0.1  # a stream goes on without looks until vision is lost
FLOW_LAST_S = 0.12  # the end of the way is left alone
IDLE_LOOK_S = 0.1  # while nothing moves, a look now and then keeps the model right
PASSED_OVER = 12  # poses that a joint limit may keep out of reach, one after the other
STUCK_SHARE = 0.02  # less of a step than this is no progress
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
        self.progress = Progress()
        self.passed_over = 0  # poses left out because a joint limit was in the way
        self._path: np.ndarray | None = None
        self._lead = JointLead()
        self._veto = 'no path was planned yet'
        self._attempt = Attempt(0)
        self._flow: Flow | None = None
        self._moves = Moves(robot, self.watch)
        self._looks = Looks(self.watch, self.filter)
        self._retry_s = -math.inf
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
    def _poses(self) -> np.ndarray:
        return required(self._path, 'path')

    # Inputs.

    def set_focal(self, focal_px: float | None) -> None:
        """Tell the focal length of the camera, None when it is unknown."""
        self.watch.focal_px = focal_px

    def set_path(self, poses: np.ndarray, ok: bool, sentence: str,
                 lead: JointLead | None = None) -> None:
        """Take a path (N, 4, 4) in home, or its veto; in mid-motion it is taken over."""
        self._lead = lead or JointLead()
        self._veto = '' if ok and len(poses) else sentence or 'the path is empty'
        self._path = np.array(poses, dtype=float) if not self._veto else None
        if not self.active:
            return
        if self._path is None:
            self._end(FAILED, f'the new path is vetoed: {self._veto}')
            return
        standing = self._flow is not None or self.state != MOVING
        joints_rad = self.watch.joints.known_rad if standing else self._moves.goal_rad
        self._aim_at(self._nearest_pose(self.filter.pose(joints_rad)))
        if self._flow is not None:
            self._flow.follow(self._path, self._attempt.index)
        self._lead_from_here(joints_rad)

    def add_joints(self, joints_rad: np.ndarray, stamp_s: float, now_s: float
                   ) -> Rejected | None:
        """Take in a joint state."""
        if not np.isfinite(joints_rad).all():
            return Rejected('a joint position is not a finite number')
        joints = self.watch.joints
        before_s = joints.latest_stamp_s
        rejected = joints.add(np.array(joints_rad, dtype=float), stamp_s, now_s)
        if not rejected and abs(stamp_s - before_s) > CLOCK_JUMP_S:
            self._moves.clock_set(stamp_s - before_s)
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
        if self._path is None:
            return Rejected(self._veto)
        trouble = self.watch.trouble(now_s, self.settings)
        if trouble:
            return Rejected(trouble)
        self.watch.moved_unseen_rad()
        self._enter_looking()
        self._aim_at(-1)
        return f'on the way along {len(self._path)} poses'

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
        if self.state == LOOKING and self._take_looks():
            self._decide(now_s)

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
            self._enter_looking()

    def _await_arrival(self, now_s: float) -> None:
        if self._moves.arrived or self._moves.stopped_short(now_s):
            self._enter_looking()  # wherever it stands: look where that is
        elif self._moves.overdue(now_s):
            self._retry_s = now_s + RETRY_S
            self._hold('the arm does not move; does the bridge take commands?'
                       if self.watch.joints.still else 'the arm does not come to rest')

    def _enter_looking(self) -> None:
        self.state, self.reason = LOOKING, ''

    def _take_looks(self) -> bool:
        taken = self._looks.standing(self._moves.due_stamp_s, self.settings)
        self._attempt.looks += taken
        return taken > 0

    def _decide(self, now_s: float) -> None:
        joints_rad, path = self.watch.joints.known_rad, self._poses
        here = self.filter.pose(joints_rad)
        if self._attempt.index < 0:
            self._begin(here)
            if self.state != LOOKING:
                return
        if self._lead.passes(self._attempt.index):
            self._pass_by(joints_rad, here, now_s)
            return
        last = self._attempt.index == len(path) - 1
        allowed = self._allowed(last)
        twist = displacement(here, path[self._attempt.index])
        over = errors_of(twist).over(allowed)
        unsure = sigmas_of(self.filter.covariance(joints_rad)).over(allowed)
        self._report(twist, unsure)
        # Looks that contradict each other come from an arm or a camera that lags behind.
        agrees = self.filter.agrees
        sure = agrees and unsure <= self.settings.sure_share
        enough = self._attempt.looks >= (self.settings.final_looks if last else 1)
        if over <= 1.0 and sure and enough:
            self._reached(now_s)
        elif agrees and (over > 1.0 + 2.0 * unsure or (over > 1.0 and sure)):
            self._move(now_s, over)
        elif self._attempt.looks >= self.settings.looks_max:
            self._give_up(unsure, agrees)

    def _pass_by(self, joints_rad: np.ndarray, here: np.ndarray, now_s: float) -> None:
        """Go through a singularity as planned; what looks say about it cannot be acted on."""
        index = self._attempt.index
        self._report(displacement(here, self._poses[index]), math.nan)
        if self._lead.arrived(index, joints_rad):
            self._reached(now_s)
        else:
            self._move(now_s, math.inf)

    def _lead_from_here(self, joints_rad: np.ndarray) -> None:
        if not self._lead.note(self._attempt.index, joints_rad):
            self._end(FAILED, 'the arm holds the object in another posture than the plan '
                      'begins with; plan again')

    def _allowed(self, last: bool) -> Errors:
        scale = 1.0 if last else self.settings.via_scale
        return Errors(*(scale * value for value in self.settings.tolerance))

    def _report(self, twist: np.ndarray, unsure: float) -> None:
        index = self._attempt.index
        self.progress = Progress(
            index + 1, len(self._poses), False, float(np.linalg.norm(twist[:3])),
            float(np.linalg.norm(twist[3:])), self._attempt.moves, self._attempt.looks, unsure)

    def _begin(self, here: np.ndarray) -> None:
        index = self._nearest_pose(here)
        away = displacement(here, self._poses[index])
        far_m, far_rad = np.linalg.norm(away[:3]), np.linalg.norm(away[3:])
        if far_m > self.settings.start_distance_m \
                or far_rad > math.radians(self.settings.start_angle_deg):
            self._end(FAILED, f'the object is {1000 * far_m:.0f} mm and '
                      f'{math.degrees(far_rad):.0f} deg away from the path; plan again')
            return
        self._attempt = Attempt(index, looks=self._attempt.looks)
        self._lead_from_here(self.watch.joints.known_rad)

    def _nearest_pose(self, here: np.ndarray) -> int:
        """Find the pose of the path to go on from: the first one unless another is nearer."""
        away = np.array([displacement(here, pose) for pose in self._poses])
        far = np.hypot(np.linalg.norm(away[:, :3], axis=1) / 0.1,
                       np.linalg.norm(away[:, 3:], axis=1))
        spacing = np.median(np.abs(np.diff(far))) if len(far) > 1 else 0.0
        nearest = int(np.argmin(far))
        return 0 if far[0] <= far[nearest] + 1.5 * spacing else nearest

    def _aim_at(self, index: int) -> None:
        self._attempt = Attempt(index)

    def _reached(self, now_s: float) -> None:
        self.progress = self.progress._replace(reached=True)
        if self._attempt.index == len(self._poses) - 1:
            self._end(DONE, '', stop=False)
            return
        if not self._lead.passes(self._attempt.index):
            self._lead.note(self._attempt.index, self.watch.joints.known_rad)
        self._aim_at(self._attempt.index + 1)
        if self.settings.mode == 'continuous' and not self._lead.needed:
            flow = Flow(self.robot, self._poses, self._attempt.index,
                        self.settings.servo_margin_rad)
            self._flow, self.state = flow, MOVING
            self._send_flow(flow, now_s)
        else:
            self._move(now_s, math.inf)

    def _flow_on(self, flow: Flow, now_s: float) -> None:
        """Keep the stream of commands going; at its end wait for rest, then look."""
        flow.advance(now_s)
        if flow.index != self._attempt.index:
            self._aim_at(flow.index)
        seen = self._look_on_the_way()
        if flow.ends and now_s > flow.ends_s - FLOW_LAST_S:
            self._flow = None
        elif seen or now_s > flow.sent_s + FLOW_REFRESH_S:
            self._send_flow(flow, now_s)

    def _send_flow(self, flow: Flow, now_s: float) -> None:
        settings, focal_px = self.settings, required(self.watch.focal_px, 'camera')
        command = flow.command(
            self.filter.model, self.watch.joints.known_rad, settings.speed_share, focal_px,
            settings.corner_speed_px_s, now_s)
        if command is None:  # look there; the step to the pose will name the joint
            self._flow, self._pending = None, Command()
            self._enter_looking()
            return
        self._pending = self._moves.follow(command, now_s)

    def _look_on_the_way(self) -> bool:
        taken = self._looks.moving(self.settings)
        self._attempt.looks += taken
        if taken:
            here = self.filter.pose(self.watch.joints.known_rad)
            self._report(displacement(here, self._poses[self._attempt.index]), math.nan)
        return taken > 0

    def _move(self, now_s: float, over: float) -> None:
        attempt = self._attempt
        attempt.grown = attempt.grown + 1 if over > GROWN * attempt.last_over else 0
        attempt.last_over = over
        if attempt.grown >= self.settings.growth_max:
            self._end(FAILED, f'the error at pose {attempt.index + 1} grew in '
                      f'{attempt.grown} moves in a row')
        elif attempt.moves >= self.settings.iterations_max:
            self._end(FAILED, f'pose {attempt.index + 1} was not reached in {attempt.moves} '
                      f'moves; {over:.1f} times the tolerance is left')
        else:
            self._step(now_s)

    def _step(self, now_s: float) -> None:
        index = self._attempt.index
        step = self._step_to(index, self._attempt.moves)
        last = index == len(self._poses) - 1
        if _blocked(step) or _shortened(step) and self._attempt.moves >= 2 and not last:
            later = self._next_open(index)
            if later is None:
                self._end(FAILED, f'{self._at_limit(step.limited_by)} before pose {index + 1}')
                return
            self.passed_over += later - index
            self._aim_at(later)
            step = self._step_to(later, 0)
        self._attempt.moves += 1
        self.state, self.reason = MOVING, ''
        self._pending = self._moves.go(self.filter.model, step.joints_rad, self.settings, now_s)

    def _step_to(self, index: int, moves: int) -> Step:
        model = self.filter.model
        if self._lead.passes(index) or self._lead.leads(index) and not moves:
            wanted_rad = self._lead.target(index)
        else:
            wanted_rad = joints_for(model, self.watch.joints.known_rad, self._poses[index])
        return self._moves.step_to(model, wanted_rad, self.settings)

    def _next_open(self, index: int) -> int | None:
        """
        Find a pose further on that can be moved to from a joint limit.

        With a wrong model the way between two good poses may brush a limit; it is left
        out then. The last pose never is.
        """
        for later in range(index + 1, min(index + 1 + PASSED_OVER, len(self._poses))):
            if not _blocked(self._step_to(later, 0)):
                return later
        return None

    def _at_limit(self, joint: str) -> str:
        angle = self.watch.joints.known_rad[self.robot.joint_names.index(joint)]
        return f'{joint} is at its limit ({math.degrees(angle):.1f} deg)'

    def _give_up(self, unsure: float, agrees: bool) -> None:
        where = f'pose {self._attempt.index + 1}'
        looks, share = self._attempt.looks, self.settings.sure_share
        self._end(FAILED, (
            f'{where} is known only to {unsure:.2f} of the tolerance after {looks} looks, '
            f'{share:.2f} is asked: the tolerance cannot be reached with this noise')
            if agrees else (
            f'{looks} looks at {where} contradict each other although the arm stands: the '
            'camera lags behind, or something else moves the object'))

    def _end(self, state: str, reason: str, stop: bool = True) -> None:
        self._flow = None
        self.state, self.reason = state, reason
        self._retry_s = -math.inf
        if stop:
            self._pending = Command()


def _blocked(step: Step) -> bool:
    return step.share < STUCK_SHARE and _shortened(step)


def _shortened(step: Step) -> bool:
    return step.limited_by not in ('', 'step')
