"""
All that a planner knows at one time, and what it answers: the node without ROS.

Inputs that cannot be used come as `Rejected` and are handed back; every request is
answered by a result or by one sentence that says what is missing.
"""

from __future__ import annotations

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.pose import PoseEstimate
from homography_servo.planning.feasibility import goal_fault
from homography_servo.planning.feasibility import look
from homography_servo.planning.joint_track import CLOCK_JUMP_S
from homography_servo.planning.joint_track import STILL_RAD
from homography_servo.planning.model_learner import KnownLook
from homography_servo.planning.model_learner import learned
from homography_servo.planning.observer import Observer
from homography_servo.planning.observer import StillView
from homography_servo.planning.observer_settings import ObserverSettings
from homography_servo.planning.planner import Plan
from homography_servo.planning.planner import plan
from homography_servo.planning.settings import PlannerSettings
from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.robot.kinematics import inverse
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import Robot
import numpy as np

JOINTS_FRESH_S = 0.25
CLOCKS_APART_S = 2.0  # more than an image that was received lately can be late
_CLEARLY_WORSE = 9.0  # in chi-squared: three standard deviations
_NO_CAMERA = 'no camera_info yet: nothing can be measured or planned without the camera model'
_OTHER_CAMERA = 'camera_info is not that of the camera the goal was measured with: teach it anew'
_NO_GOAL = 'no goal: call ~/teach_goal or send goal/corners or goal/pose'


class PlanningDesk:
    """
    Collects camera, joints, looks and a goal, and plans.

    Parameters
    ----------
    object_points_m : (M, 3) array
        The points whose images arrive as corners.
    robot : Robot or None
        The arm; None for an object that flies freely.
    settings, observer : PlannerSettings, ObserverSettings
        Limits, and how corners become poses.

    """

    def __init__(self, object_points_m: np.ndarray, robot: Robot | None,
                 settings: PlannerSettings = PlannerSettings(),
                 observer: ObserverSettings = ObserverSettings()) -> None:
        self.object_points_m = np.asarray(object_points_m, dtype=float)
        self._robot = robot
        self._settings = settings
        self.camera: Camera | None = None
        self._last_camera: Camera | None = None  # that looks and goal were measured with
        self._joints: tuple[np.ndarray, float] | None = None
        self._rest_rad: np.ndarray | None = None  # joints when they were last seen to move
        self._moved_stamp_s = self._seen_stamp_s = self._joints_stamp_s = -np.inf
        self.goal: np.ndarray | Rejected = Rejected(_NO_GOAL)
        self._goal_measured = False  # rather than told as a pose
        self._goal_joints_rad: np.ndarray | None = None  # where the arm stood at the goal
        self._goal_look: KnownLook | None = None  # what was seen there
        self._observer = Observer(self.object_points_m, self.home_depth_m,
                                  settings.corner_sigma_px, observer)

    @property
    def home_depth_m(self) -> float:
        """Depth of the virtual home pose."""
        return self._settings.home_depth_m if self._robot is None else self._robot.home_depth_m

    @property
    def home_corners_px(self) -> np.ndarray:
        """Where the points would be seen at the virtual home pose."""
        home = np.eye(4)[None]
        camera = required(self.camera, 'camera')
        return look(home, camera, self.object_points_m, self.home_depth_m).points_px[0]

    @property
    def noise_px(self) -> float:
        """Noise of a corner coordinate that covariances are based on."""
        return self._observer.noise_px

    def change(self, settings: PlannerSettings, observer: ObserverSettings) -> None:
        """Take over new settings; what was measured stays."""
        self._settings = settings
        self._observer.settings = observer
        self._observer.sigma_px = settings.corner_sigma_px
        self._observer.home_depth_m = self.home_depth_m

    def set_camera(self, camera: Camera | Rejected) -> Rejected | None:
        """Take in a camera model; another one makes worthless what was measured before."""
        if isinstance(camera, Rejected):
            self.camera = None
            return camera
        if self._last_camera not in (None, camera):
            self._observer.forget()
            if self._goal_measured:
                self._refuse_goal(_OTHER_CAMERA)
        self.camera = self._last_camera = camera
        return None

    def set_joints(self, joints_rad: np.ndarray | Rejected, now_s: float,
                   stamp_s: float = -np.inf) -> Rejected | None:
        """
        Take in the joints as the arm reports them.

        ``stamp_s`` is when they were there, by the clock of the images' stamps: pictures
        may come late, and one from before the arm stopped is no look at rest.
        """
        if isinstance(joints_rad, Rejected):
            return joints_rad
        if stamp_s <= self._joints_stamp_s < stamp_s + CLOCK_JUMP_S:
            late_s = self._joints_stamp_s - stamp_s
            return Rejected(f'joint state is {late_s:.3f} s older than the one before')
        self._joints_stamp_s = stamp_s
        # A clock that was set back must not leave the motion in the future.
        self._moved_stamp_s = min(self._moved_stamp_s, stamp_s)
        if self._rest_rad is None:
            self._rest_rad = joints_rad
        elif np.abs(joints_rad - self._rest_rad).max() > STILL_RAD:
            self._rest_rad, self._moved_stamp_s = joints_rad, stamp_s
        self._joints = (joints_rad, now_s)
        return None

    def lose_sight(self) -> None:
        """Note that the tracker has no measurement."""
        self._observer.lose_sight()

    def see(self, corners_px: np.ndarray | Rejected, now_s: float,
            stamp_s: float = np.inf,
            covariance_px2: np.ndarray | None = None) -> PoseEstimate | Rejected:
        """
        Take in a look, made at ``stamp_s``, and give the pose of the object.

        ``covariance_px2`` (2M, 2M) is the tracker's word on how well it knows the corners;
        without it their scatter is taken.
        """
        if stamp_s <= self._moved_stamp_s:
            self._observer.lose_sight()
        if isinstance(corners_px, Rejected):
            return corners_px
        if self.camera is None:
            return Rejected(_NO_CAMERA)
        self._seen_stamp_s = stamp_s
        return self._observer.see(corners_px, self.camera, now_s, self._arm_pose(now_s),
                                  covariance_px2)

    def missing(self, now_s: float) -> str:
        """Say what a plan would still need, empty when nothing."""
        if self.camera is None:
            return _NO_CAMERA
        view = self._observer.still_view(now_s)
        if isinstance(view, Rejected):
            return view.reason
        if self._robot is not None and self._fresh_joints(now_s) is None:
            return self._no_joints(now_s)
        return self.goal.reason if isinstance(self.goal, Rejected) else ''

    def teach(self, now_s: float) -> str | Rejected:
        """Make what is seen now the goal; several looks at rest are averaged."""
        if self.camera is None:
            return Rejected(_NO_CAMERA)
        view = self._view_of(self._observer.settings.looks_min, now_s)
        if isinstance(view, Rejected):
            return view
        estimate = self._observer.view_pose(view, self.camera, now_s, self._arm_pose(now_s))
        if isinstance(estimate, Rejected):
            return estimate
        joints_rad = self._fresh_joints(now_s)
        answer = self._take_goal(estimate.home_from_object, joints_rad, measured=True)
        if not isinstance(answer, Rejected) and joints_rad is not None:
            self._goal_look = KnownLook(
                estimate.home_from_object, estimate.covariance, joints_rad)
        return answer if isinstance(answer, Rejected) else \
            f'goal taught from {view.looks} looks, {_quality(view, estimate)}'

    def set_goal_corners(self, corners_px: np.ndarray | Rejected,
                         now_s: float) -> str | Rejected:
        """Make corners in the image the goal; of two minima one that the arm can reach."""
        if isinstance(corners_px, Rejected):
            return self._refuse_goal(corners_px.reason)
        if self.camera is None:
            return self._refuse_goal(_NO_CAMERA)
        estimate = self._observer.pose_of(corners_px, self.camera)
        if isinstance(estimate, Rejected):
            return self._refuse_goal(estimate.reason)
        best = estimate.candidates[0]
        likely = [c.home_from_object for c in estimate.candidates
                  if c.chi2 < best.chi2 + _CLEARLY_WORSE]
        reached = [pose for pose in likely if self._reachable(pose)]
        return self._take_goal((reached or likely or [best.home_from_object])[0], measured=True)

    def set_goal_pose(self, goal: np.ndarray | Rejected) -> str | Rejected:
        """Make a pose ``home_from_object`` the goal."""
        return self._refuse_goal(goal.reason) if isinstance(goal, Rejected) \
            else self._take_goal(goal)

    def plan(self, now_s: float) -> Plan | Rejected:
        """Plan from what is seen now to the goal."""
        missing = self.missing(now_s)
        if missing:
            return Rejected(missing)
        view = self._view_of(self._observer.settings.plan_looks_min, now_s)
        if isinstance(view, Rejected):
            return view
        camera, goal = required(self.camera, 'camera'), required(self.goal, 'goal')
        start = self._observer.view_pose(view, camera, now_s, self._arm_pose(now_s))
        if isinstance(start, Rejected):
            return start
        joints_rad = self._fresh_joints(now_s)
        robot = self._learned(start, joints_rad)
        return plan(start.home_from_object, goal, camera, robot, joints_rad,
                    self._settings, self.object_points_m, self._goal_joints_rad)

    def _view_of(self, wanted: int, now_s: float) -> StillView | Rejected:
        """Average the looks at rest, of which some number is wanted."""
        view = self._observer.still_view(now_s)
        if isinstance(view, Rejected):
            return view
        behind_s = self._moved_stamp_s - self._seen_stamp_s
        if behind_s > CLOCKS_APART_S:
            return Rejected(f'images are stamped {behind_s:.1f} s before joint_states that came '
                            'no later; do their time stamps come from one clock?')
        if behind_s > 0.0:
            return Rejected('the arm has moved since the object was last seen; hold it still '
                            'and ask again')
        if view.looks >= wanted:
            return view
        return Rejected(f'only {view.looks} of {wanted} good looks at the object at rest so '
                        'far; hold it still and ask again')

    def _learned(self, start: PoseEstimate, joints_rad: np.ndarray | None) -> Robot | None:
        """Correct the arm's model by what is seen now and was seen at the taught goal."""
        if self._robot is None or joints_rad is None:
            return self._robot
        looks = [KnownLook(start.home_from_object, start.covariance, joints_rad)]
        looks += [] if self._goal_look is None else [self._goal_look]
        return learned(self._robot, looks, self._settings.disagreement_max_m,
                       self._settings.disagreement_max_rad)

    def _take_goal(self, goal: np.ndarray, joints_rad: np.ndarray | None = None,
                   measured: bool = False) -> str | Rejected:
        depth_m = goal[2, 3] + self.home_depth_m
        if depth_m <= 0.0:
            return self._refuse_goal(f'it is behind the camera (depth {depth_m:.3f} m)')
        if self.camera is not None:
            fault = goal_fault(goal, self.camera, self.object_points_m, self.home_depth_m,
                               self._settings, joints_rad is not None)
            if fault:
                return self._refuse_goal(fault)
        self.goal, self._goal_joints_rad = np.array(goal, dtype=float), joints_rad
        self._goal_look, self._goal_measured = None, measured
        x, y, z = 1000.0 * self.goal[:3, 3]
        return f'goal set to x {x:.1f}, y {y:.1f}, z {z:.1f} mm in home'

    def _refuse_goal(self, reason: str) -> Rejected:
        self.goal = Rejected(f'the goal was refused: {reason}')
        return self.goal

    def _reachable(self, goal: np.ndarray) -> bool:
        return self._robot is None or len(inverse(self._robot, goal)) > 0

    def _fresh_joints(self, now_s: float) -> np.ndarray | None:
        if self._joints is None or now_s - self._joints[1] > JOINTS_FRESH_S:
            return None
        return self._joints[0]

    def _no_joints(self, now_s: float) -> str:
        if self._joints is None:
            return 'no joint_states yet: a path cannot be checked without the joints'
        return (f'no joint_states for {now_s - self._joints[1]:.1f} s: a path cannot be checked '
                'without the joints')

    def _arm_pose(self, now_s: float) -> np.ndarray | None:
        joints_rad = self._fresh_joints(now_s)
        if self._robot is None or joints_rad is None:
            return None
        return object_pose(self._robot, joints_rad)


def _quality(view: StillView, estimate: PoseEstimate) -> str:
    sigma = np.sqrt(np.diag(estimate.covariance))
    return (f'corner noise {view.noise_px:.3f} px; one standard deviation of the goal is '
            f'{1e3 * np.hypot(*sigma[:2]):.2f} mm sideways, {1e3 * sigma[2]:.2f} mm in depth, '
            f'{np.degrees(sigma[5]):.2f} deg about the axis and '
            f'{np.degrees(np.hypot(*sigma[3:5])):.2f} deg in tilt')
