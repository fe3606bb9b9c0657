"""
Drive the arm from posture to posture and look, for a calibration.

A state machine like `servo`, with the same watch: nothing moves without vision, joint
states and a camera; the reason is said. Postures come from `calibration_poses`, the
looks at each are averaged, `calibrate` makes the result.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from homography_servo.geometry.camera import Camera
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.calibration import calibrate
from homography_servo.planning.calibration import Calibration
from homography_servo.planning.calibration import CalibrationSettings
from homography_servo.planning.command import Command
from homography_servo.planning.control import corner_travel
from homography_servo.planning.control import move_time
from homography_servo.planning.servo_moves import ARRIVED_RAD
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.planning.servo_state import DONE
from homography_servo.planning.servo_state import FAILED
from homography_servo.planning.servo_state import HOLD
from homography_servo.planning.servo_state import IDLE
from homography_servo.planning.servo_state import LOOKING
from homography_servo.planning.servo_state import MOVING
from homography_servo.planning.servo_watch import Watch
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.robot_file import Robot
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole
import numpy as np

OVERDUE_S = 3.0
SHORTEST_MOVE_S = 0.1


@dataclass(frozen=True)
class CalibrationRunSettings(Settings):
    """How a calibration looks around, and where its result goes."""

    calibration_file: str = text(
        '', 'robot file that ~/calibrate writes; empty: it only reports')
    calibration_postures: int = whole(15, 12, 100, '', 'postures to look from')
    calibration_looks: int = whole(10, 1, 1000, '', 'looks averaged at each posture')
    calibration_lost_s: float = real(
        5.0, 0.1, 600.0, 's', 'how long the object may be out of sight before giving up')


class CalibrationRun:
    """
    One calibration, from the start to its result.

    Parameters
    ----------
    robot : Robot
        As believed.
    camera : Camera
        Exact.
    postures_rad : (K, n) array
        To look from, each reachable from the one before.
    watch : Watch
        What comes in; shared with the servo.

    """

    def __init__(self, robot: Robot, camera: Camera, postures_rad: np.ndarray, watch: Watch,
                 servo: ServoSettings = ServoSettings(),
                 settings: CalibrationRunSettings = CalibrationRunSettings(),
                 limits: CalibrationSettings = CalibrationSettings()) -> None:
        self.robot, self._camera, self._watch = robot, camera, watch
        self._postures_rad, self._servo = postures_rad, servo
        self._settings, self._limits = settings, limits
        self.state, self.reason = LOOKING, ''
        self.result: Calibration | Rejected | None = None
        self._model = ArmModel(robot)
        self._index = -1
        self._rays: list[np.ndarray] = []
        self._still_since_s = math.inf  # stamp from which on they were seen
        self._seen: list[tuple[np.ndarray, np.ndarray]] = []  # joints, mean rays
        self._due_s = self._due_unset_s = -math.inf  # the latter by stamps, were no clock set
        self._looked_s = -math.inf  # when a look counted last, or the arm came to stand
        self._blind_since_s = math.inf
        self._pending: Command | None = None
        self._go_next = True

    @property
    def active(self) -> bool:
        """Tell whether it is not finished."""
        return self.result is None

    @property
    def state_text(self) -> str:
        """Give the state with its reason."""
        return f'{self.state}: {self.reason}' if self.reason else self.state

    @property
    def position(self) -> tuple[int, int]:
        """Count the posture that is looked from now, of how many."""
        return self._index + 1, len(self._postures_rad)

    def stop(self, reason: str) -> None:
        """Give up."""
        self._finish(Rejected(reason))
        self.state, self.reason = IDLE, ''
        self._pending = Command()

    def tick(self, now_s: float) -> Command | None:
        """Go on as far as possible; give the command to send now, if any."""
        if self.active:
            self._advance(now_s)
        command, self._pending = self._pending, None
        return command

    def _advance(self, now_s: float) -> None:
        trouble = self._watch.trouble(now_s, self._servo)
        if self._watch.arm_latched:  # a reset moves nothing: somebody has to begin again
            self._pending = Command()
            self._finish(Rejected(trouble))
            return
        if trouble:
            self._hold(trouble, now_s)
            return
        if self.state == HOLD:  # go to the posture again, the arm may stand anywhere
            self._blind_since_s = math.inf
            self._watch.moved_unseen_rad()
            if self._go_next:
                self._next(now_s)
            else:
                self._move(now_s)
        elif self._go_next:
            self._next(now_s)
        elif self.state == MOVING:
            self._await_arrival(now_s)
        else:
            self._look(now_s)

    def _hold(self, reason: str, now_s: float) -> None:
        if self.state != HOLD:
            self._pending = Command()
        if self.state != HOLD or self._watch.paused:
            self._blind_since_s = now_s
        self.state, self.reason = HOLD, reason
        if now_s - self._blind_since_s > self._settings.calibration_lost_s:
            self._pending = Command()
            self._finish(Rejected(f'at posture {self._index + 1} of {len(self._postures_rad)}: '
                                  f'{reason}'))

    @property
    def _due_stamp_s(self) -> float:
        return self._due_unset_s + self._watch.joints.clock_set_s

    def _next(self, now_s: float) -> None:
        self._go_next = False
        self._index += 1
        if self._index == len(self._postures_rad):
            self._solve()
        else:
            self._move(now_s)

    def _move(self, now_s: float) -> None:
        joints, target = self._watch.joints, self._postures_rad[self._index]
        here = joints.known_rad
        travel_px = required(self._watch.focal_px, 'camera') * corner_travel(
            self._model, here, target, self.robot.object_points_m, self.robot.home_depth_m)
        time_s = max(SHORTEST_MOVE_S, move_time(self.robot, target - here)
                     / self._servo.speed_share, 1.5 * travel_px / self._servo.corner_speed_px_s)
        self._due_s = now_s + time_s
        self._due_unset_s = joints.latest_stamp_s + time_s - joints.clock_set_s
        self._rays = []
        self._watch.sight.queue.clear()
        self.state, self.reason = MOVING, ''
        self._pending = Command.to(target, time_s)

    def _await_arrival(self, now_s: float) -> None:
        joints = self._watch.joints
        away = np.abs(joints.known_rad - self._postures_rad[self._index]).max()
        if joints.still and away < ARRIVED_RAD and joints.latest_stamp_s >= self._due_stamp_s:
            self.state, self._looked_s = LOOKING, now_s
        elif now_s > self._due_s + OVERDUE_S:
            self._pending = Command()
            self._finish(Rejected(f'the arm does not reach posture {self._index + 1}, '
                                  f'{math.degrees(away):.1f} deg are left'))

    def _look(self, now_s: float) -> None:
        joints = self._watch.joints
        if joints.still_since_s != self._still_since_s:  # it sagged: another posture
            self._rays, self._still_since_s = [], joints.still_since_s
        stood_s = max(joints.still_since_s, self._due_stamp_s) + self._servo.settle_s
        while self._watch.sight.queue:
            stamp_s, look = self._watch.sight.queue.popleft()
            known = joints.at(stamp_s, ahead_s=self._servo.joint_timeout_s) is not None
            if stamp_s >= stood_s and known:
                self._rays.append(look.rays)
                self._looked_s = now_s
        if len(self._rays) >= self._settings.calibration_looks:
            rays = np.median(self._rays, axis=0) if len(self._rays) < 5 else _trimmed(self._rays)
            self._seen.append((joints.known_rad, rays))
            self._go_next = True
            return
        vain = self._watch.why_in_vain(self._looked_s, now_s, self._servo)
        if vain:
            self._finish(Rejected(f'at posture {self._index + 1}: {vain}'))

    def _solve(self) -> None:
        joints_rad = np.array([joints for joints, _ in self._seen])
        rays = np.array([rays for _, rays in self._seen]).reshape(len(joints_rad), -1, 2)
        corners_px = self._camera.project_rays(rays)
        self._finish(calibrate(self.robot, self._camera, joints_rad, corners_px, self._limits))

    def _finish(self, result: Calibration | Rejected) -> None:
        self.result = result
        self.state, self.reason = (FAILED, result.reason) if isinstance(result, Rejected) \
            else (DONE, '')


def _trimmed(rays: list[np.ndarray]) -> np.ndarray:
    """Average without the smallest and the largest of each coordinate."""
    return np.sort(rays, axis=0)[1:-1].mean(axis=0)
