"""
The control step: from pose to pose along the path, one decision after each look.

A pose is reached when the looks say so and are sure of it; otherwise the arm moves
towards it, looks on, or gives up for a reason. Knows nothing of time: the state machine
(`servo`) says when the arm stands and has been seen, and carries out what is decided.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from homography_servo.planning.control import displacement
from homography_servo.planning.control import Errors
from homography_servo.planning.control import errors_of
from homography_servo.planning.control import joints_for
from homography_servo.planning.control import next_pose
from homography_servo.planning.control import sigmas_of
from homography_servo.planning.control import Step
from homography_servo.planning.joint_lead import JointLead
from homography_servo.planning.look_filter import LookFilter
from homography_servo.planning.servo_moves import Moves
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_state import Attempt
from homography_servo.planning.servo_state import DONE
from homography_servo.planning.servo_state import FAILED
from homography_servo.planning.servo_state import LOOKING
from homography_servo.planning.servo_state import MOVING
from homography_servo.planning.servo_state import Progress
from homography_servo.planning.servo_watch import Watch
from homography_servo.result import required
from homography_servo.robot.robot_file import Robot
import numpy as np

GROWN = 1.2  # an error counts as larger than before from this factor on
PASSED_OVER = 12  # poses that may be left out, one after the other
TRIES = 2  # moves towards a pose on the way that cannot be met before it is left out
STUCK_SHARE = 0.02  # less of a step than this is no progress
REACH = 'reach'  # what limits a step when no joints at all bring the object to the pose


class Decision(NamedTuple):
    """
    What follows from a look, as the state that the servo goes into.

    LOOKING asks for more looks, MOVING comes with joints to go to, or with none where
    the arm may go on without stops.
    """

    state: str
    reason: str = ''
    joints_rad: np.ndarray | None = None


MORE_LOOKS = Decision(LOOKING)


class Pursuit:
    """
    Bring the object to one pose of a path after the other.

    Parameters
    ----------
    robot : Robot
        The believed arm.
    watch : Watch
        Where the joints are.
    filter_ : LookFilter
        Where the object is.
    moves : Moves
        Shortens steps to what limits and tracker allow.

    """

    def __init__(self, robot: Robot, watch: Watch, filter_: LookFilter, moves: Moves) -> None:
        self._robot, self._watch, self._filter, self._moves = robot, watch, filter_, moves
        self._path: np.ndarray | None = None
        self._lead = JointLead()
        self._attempt = Attempt(-1)
        self.progress = Progress()
        self.passed_over = 0  # poses left out because the arm does not get there

    @property
    def poses(self) -> np.ndarray:
        """Give the path (N, 4, 4); ValueError without one."""
        return required(self._path, 'path')

    @property
    def index(self) -> int:
        """Give the pose that is aimed at, counted from 0; -1 before the first look."""
        return self._attempt.index

    @property
    def at_last(self) -> bool:
        """Tell whether the last pose is aimed at."""
        return self.index == len(self.poses) - 1

    @property
    def led(self) -> bool:
        """Tell whether the path has to be gone from rest to rest, led by planned joints."""
        return self._lead.needed

    def take(self, poses: np.ndarray | None, lead: JointLead) -> None:
        """Take a path (N, 4, 4), or none."""
        self._path, self._lead = poses, lead

    def aim_at(self, index: int) -> None:
        """Go for a pose with all tries left; -1 chooses one after the next look."""
        self._attempt = Attempt(index)

    def go_on_to(self, index: int) -> None:
        """Go for a pose; if it is aimed at already, what was seen and tried counts on."""
        if index != self.index:
            self.aim_at(index)

    def take_back_move(self) -> None:
        """Note that the arm did not carry out the last move: it is no try to get there."""
        self._attempt.moves = max(self._attempt.moves - 1, 0)

    def aim_from(self, joints_rad: np.ndarray, settings: ServoSettings) -> Decision:
        """Go for the pose that is to be met next from joints (n,) on a new path."""
        index, far = self._nearest(joints_rad, settings)
        self.aim_at(index)
        return far or self._lead_from(joints_rad)

    def count_looks(self, taken: int, passing: bool = False) -> None:
        """Note looks that the filter has taken, at rest or in passing."""
        self._attempt.looks += taken
        self._attempt.passing += taken if passing else 0

    def report(self, unsure: float = math.nan) -> np.ndarray:
        """Bring the progress up to date; gives the displacement (6,) that is left."""
        here = self._filter.pose(self._watch.joints.known_rad)
        twist = displacement(here, self.poses[self.index])
        self.progress = Progress(
            self.index + 1, len(self.poses), False, float(np.linalg.norm(twist[:3])),
            float(np.linalg.norm(twist[3:])), self._attempt.moves, self._attempt.looks, unsure)
        return twist

    def decide(self, settings: ServoSettings) -> Decision:
        """Say what to do after a look at the standing arm."""
        joints_rad = self._watch.joints.known_rad
        if self.index < 0:
            begun = self._begin(joints_rad, settings)
            if begun.state == FAILED:
                return begun
        if self._lead.passes(self.index):
            return self._pass_by(joints_rad, settings)
        last, attempt = self.at_last, self._attempt
        allowed = _allowed(settings, last)
        unsure = sigmas_of(self._filter.covariance(joints_rad)).over(allowed)
        over = errors_of(self.report(unsure)).over(allowed)
        # Looks that contradict each other come from an arm or a camera that lags behind.
        agrees = self._filter.agrees
        sure = agrees and unsure <= settings.sure_share
        enough = attempt.looks >= (settings.final_looks if last else 1)
        if over <= 1.0 and sure:
            return self._reached(settings) if enough else MORE_LOOKS
        if agrees and (over > 1.0 + 2.0 * unsure or (over > 1.0 and sure)):
            return self._move(settings, over)
        if attempt.looks - attempt.passing >= settings.looks_max:
            return self._give_up(settings, unsure, agrees)
        return MORE_LOOKS

    def _begin(self, joints_rad: np.ndarray, settings: ServoSettings) -> Decision:
        index, far = self._nearest(joints_rad, settings)
        if far is not None:
            return far
        self._attempt = Attempt(index, looks=self._attempt.looks)
        return self._lead_from(joints_rad)

    def _nearest(self, joints_rad: np.ndarray, settings: ServoSettings
                 ) -> tuple[int, Decision | None]:
        """Choose the pose to be met next; refuse a way to it that nobody has checked."""
        here = self._filter.pose(joints_rad)
        index = next_pose(self.poses, here)
        away = displacement(here, self.poses[index])
        far_m, far_rad = np.linalg.norm(away[:3]), np.linalg.norm(away[3:])
        if far_m > settings.start_distance_m or far_rad > math.radians(settings.start_angle_deg):
            return index, Decision(
                FAILED, f'the object is {1000 * far_m:.0f} mm and '
                f'{math.degrees(far_rad):.0f} deg away from the path; plan again')
        return index, None

    def _lead_from(self, joints_rad: np.ndarray) -> Decision:
        if self._lead.note(self.index, joints_rad):
            return MORE_LOOKS
        return Decision(FAILED, 'the arm holds the object in another posture than the plan '
                        'begins with; plan again')

    def _pass_by(self, joints_rad: np.ndarray, settings: ServoSettings) -> Decision:
        """Go through a singularity as planned; what looks say about it cannot be acted on."""
        self.report()
        if self._lead.arrived(self.index, joints_rad):
            return self._reached(settings)
        return self._move(settings, math.inf)

    def _reached(self, settings: ServoSettings) -> Decision:
        self.progress = self.progress._replace(reached=True)
        if self.at_last:
            return Decision(DONE)
        if not self._lead.passes(self.index):
            self._lead.note(self.index, self._watch.joints.known_rad)
        self.aim_at(self.index + 1)
        if settings.mode == 'continuous' and not self.led:
            return Decision(MOVING)
        return self._move(settings, math.inf)

    def _move(self, settings: ServoSettings, over: float) -> Decision:
        attempt = self._attempt
        attempt.grown = attempt.grown + 1 if over > GROWN * attempt.last_over else 0
        attempt.last_over = over
        if attempt.grown >= settings.growth_max:
            return Decision(FAILED, f'the error at pose {attempt.index + 1} grew in '
                            f'{attempt.grown} moves in a row')
        if attempt.moves >= settings.iterations_max:
            step = self._step_to(self.index, settings)
            why = f': {self._hindrance(step, self.index)}' if _shortened(step) else ''
            return Decision(FAILED, f'pose {attempt.index + 1} was not reached in '
                            f'{attempt.moves} moves; {over:.1f} times the tolerance is left{why}')
        return self._step(settings)

    def _step(self, settings: ServoSettings) -> Decision:
        index = self.index
        step = self._step_to(index, settings)
        last = index == len(self.poses) - 1
        if _blocked(step) or _shortened(step) and self._attempt.moves >= TRIES and not last:
            step_on = self._step_past(index, settings)
            if step_on is None:
                return Decision(FAILED, self._hindrance(step, index))
            step = step_on
        self._attempt.moves += 1
        return Decision(MOVING, joints_rad=step.joints_rad)

    def _step_to(self, index: int, settings: ServoSettings) -> Step:
        model, attempt = self._filter.model, self._attempt
        if self._lead.passes(index) or self._lead.leads(index) and not attempt.moves:
            return self._moves.step_to(model, self._lead.target(index), settings)
        planned_rad = self._lead.planned(index) if attempt.past else None
        near_rad = self._watch.joints.known_rad if planned_rad is None else planned_rad
        wanted_rad = joints_for(model, near_rad, self.poses[index])
        step = self._moves.step_to(model, wanted_rad, settings)
        left = errors_of(displacement(model.pose(wanted_rad), self.poses[index]))
        out_of_reach = left.over(_allowed(settings, index == len(self.poses) - 1)) > 1.0
        return step._replace(limited_by=REACH) if out_of_reach and not _at_joint(step) else step

    def _step_past(self, index: int, settings: ServoSettings) -> Step | None:
        """
        Aim at the next pose further on that can be moved to, None if there is none.

        The arm is not the one that was planned for: the way between two good poses may
        brush a limit or go beyond its reach, and is left out then. The last pose never
        is. Where the arm is stretched out its postures meet; the planned joints tell
        in which one to go on.
        """
        attempt = self._attempt
        for later in range(index + 1, min(index + 1 + PASSED_OVER, len(self.poses))):
            self._attempt = Attempt(later, past=True)
            step = self._step_to(later, settings)
            if not _blocked(step) and step.limited_by != REACH:
                self.passed_over += later - index
                return step
        self._attempt = attempt
        return None

    def _hindrance(self, step: Step, index: int) -> str:
        if step.limited_by == REACH:
            return f'pose {index + 1} is beyond what the arm reaches'
        angle = self._watch.joints.known_rad[self._robot.joint_names.index(step.limited_by)]
        return (f'{step.limited_by} is at its limit ({math.degrees(angle):.1f} deg) before pose '
                f'{index + 1}')

    def _give_up(self, settings: ServoSettings, unsure: float, agrees: bool) -> Decision:
        where = f'pose {self.index + 1}'
        looks, share = self._attempt.looks, settings.sure_share
        return Decision(FAILED, (
            f'{where} is known only to {unsure:.2f} of the tolerance after {looks} looks, '
            f'{share:.2f} is asked: the tolerance cannot be reached with this noise')
            if agrees else (
            f'{looks} looks at {where} contradict each other although the arm stands: the '
            'camera lags behind, or something else moves the object'))


def _allowed(settings: ServoSettings, last: bool) -> Errors:
    scale = 1.0 if last else settings.via_scale
    return Errors(*(scale * value for value in settings.tolerance))


def _blocked(step: Step) -> bool:
    return step.share < STUCK_SHARE and _shortened(step)


def _shortened(step: Step) -> bool:
    return step.limited_by not in ('', 'step')


def _at_joint(step: Step) -> bool:
    return _shortened(step) and step.limited_by != REACH
