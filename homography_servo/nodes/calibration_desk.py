"""Carry a calibration out for the servo node, and write the file that it was asked for."""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
from homography_servo.nodes.parameters import Parameters
from homography_servo.planning.calibration import Calibration
from homography_servo.planning.calibration import calibration_poses
from homography_servo.planning.calibration import CalibrationPoseSettings
from homography_servo.planning.calibration import CalibrationSettings
from homography_servo.planning.calibration_run import CalibrationRun
from homography_servo.planning.calibration_run import CalibrationRunSettings
from homography_servo.planning.command import Command
from homography_servo.planning.servo import Servo
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.robot_file import save_robot
from homography_servo.robot.robot_model import Robot


class CalibrationDesk:
    """
    One calibration at a time, with what the servo hears.

    Parameters
    ----------
    robot : Robot
        As believed.
    servo : Servo
        At rest meanwhile.
    settings : Parameters
        Of the node.

    """

    SETTINGS = (CalibrationRunSettings, CalibrationPoseSettings, CalibrationSettings)

    def __init__(self, robot: Robot, servo: Servo, settings: Parameters) -> None:
        self._robot, self._servo, self._settings = robot, servo, settings
        self._run: CalibrationRun | None = None
        self._ended_as = ''

    @property
    def open(self) -> bool:
        """Tell whether one is on the way, or its result has not been handed out."""
        return self._run is not None

    @property
    def over(self) -> bool:
        """Tell whether there is a result to hand out."""
        return self._run is not None and not self._run.active

    @property
    def state_text(self) -> str:
        """Give its state, or how the last one ended; empty where there was none."""
        return self._ended_as if self._run is None else self._run.state_text

    def clear(self) -> None:
        """Forget how the last one ended."""
        self._ended_as = ''

    def begin(self, camera: Camera | None, now_s: float) -> Rejected | None:
        """Choose postures in view and begin, or say why not."""
        watch, servo_settings = self._servo.watch, self._servo.settings
        trouble = watch.trouble(now_s, servo_settings)
        if trouble:
            return Rejected(trouble)
        settings, known = self._settings[CalibrationRunSettings], required(camera, 'camera_info')
        postures = calibration_poses(self._robot, known, settings.calibration_postures,
                                     start_rad=watch.joints.latest_rad,
                                     settings=self._settings[CalibrationPoseSettings])
        if isinstance(postures, Rejected):
            return postures
        self._run = CalibrationRun(self._robot, known, postures, watch, servo_settings, settings,
                                   self._settings[CalibrationSettings])
        return None

    def stop(self, reason: str) -> None:
        """Give one up that is on the way."""
        if self._run is not None:
            self._run.stop(reason)

    def tick(self, now_s: float) -> Command | None:
        """Go on as far as possible; give the command to send now, if any."""
        return required(self._run, 'calibration').tick(now_s)

    def result(self) -> tuple[bool, str]:
        """Hand the result out: whether it succeeded, and a sentence."""
        run, self._run = required(self._run, 'calibration'), None
        self._ended_as, result = run.state_text, run.result
        if not isinstance(result, Calibration):
            return False, str(result)
        sentence, file = result.sentence, self._settings[CalibrationRunSettings].calibration_file
        if not file:
            return True, sentence
        try:
            save_robot(file, result.robot, f'Calibrated: {sentence}.')
        except OSError as error:
            return False, f'{sentence}; {file} was not written: {error}'
        return True, f'{sentence}; written to {file}'
