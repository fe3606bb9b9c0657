"""
Follow a trial by its topics, live or from a bag, and keep what the report needs.

Nothing here talks to ROS: messages are handed in one by one, so a live run and a
recording give the same report.
"""

from __future__ import annotations

from typing import Any, Callable

from homography_servo.experiments.trial_data import face_seen_at
from homography_servo.experiments.trial_data import PlanRecord
from homography_servo.experiments.trial_data import PoseRecord
from homography_servo.experiments.trial_data import Snapshot
from homography_servo.experiments.trial_data import snapshot_indices
from homography_servo.experiments.trial_data import TrialData
from homography_servo.experiments.trial_data import true_error
from homography_servo.nodes.conversions import camera_from_info
from homography_servo.nodes.conversions import corners_from_polygon
from homography_servo.nodes.conversions import image_path_from_msg
from homography_servo.nodes.conversions import pixels_from_image
from homography_servo.nodes.conversions import points_from_polygon
from homography_servo.nodes.conversions import transform_from_pose
from homography_servo.nodes.conversions import transforms_from_poses
from homography_servo.nodes.progress import progress_from_msg
from homography_servo.result import Rejected
import numpy as np

TAUGHT, STARTED, ENDED = 'taught', 'started', 'ended'
MOVING_RAD_S = 1e-4


def _usable(value: Any) -> Any:
    return None if isinstance(value, Rejected) else value


class TrialLog:
    """Collects a `TrialData` from messages; `latest` holds the last one of each topic."""

    def __init__(self) -> None:
        self.data = TrialData()
        self.latest: dict[str, Any] = {}
        self.running = False
        self._start_s = 0.0
        self._goal_true: np.ndarray | None = None
        self._last_true: np.ndarray | None = None
        self._joints: np.ndarray | None = None
        self._joints_s: float | None = None
        self._joints_moving = False
        self._handlers: dict[str, Callable[[Any, float], None]] = {
            'joint_states': self._on_joints,
            'object/true_pose': self._on_true_pose,
            'path/poses': self._on_path,
            'path/image': self._on_path_image,
            'path/joint_trajectory': self._on_path_joints,
            'path/verdict': self._on_verdict,
            'visual_servo/progress': self._on_progress,
            'visual_servo/state': self._on_state,
            'servo_trial/events': self._on_event,
        }

    def feed(self, topic: str, msg: Any, time_s: float) -> None:
        """Take one message with the time at which it came."""
        self.latest[topic] = msg
        handler = self._handlers.get(topic)
        if handler is not None:
            handler(msg, time_s)

    @property
    def plan(self) -> PlanRecord:
        """Give the plan's record, made on first use."""
        if self.data.plan is None:
            self.data.plan = PlanRecord(np.zeros((0, 4, 4)), np.zeros((0, 4, 2)), [],
                                        np.zeros((0, 0)))
        return self.data.plan

    def _on_joints(self, msg: Any, time_s: float) -> None:
        position = np.array(msg.position, dtype=float)
        if not len(position) or not np.isfinite(position).all():
            return
        if len(msg.velocity) == len(position):
            speed_rad_s = float(np.max(np.abs(np.array(msg.velocity, dtype=float))))
            moving = speed_rad_s > MOVING_RAD_S
        else:
            moving = self._joints is not None and bool(np.any(position != self._joints))
        if self.running and self._joints_s is not None and self._joints_moving:
            self.data.motion_s += time_s - self._joints_s
        self._joints, self._joints_s, self._joints_moving = position, time_s, moving
        self.data.joint_names = list(msg.name)
        if self.running:
            self.data.joint_track.append((time_s - self._start_s, position.tolist()))

    def _on_true_pose(self, msg: Any, time_s: float) -> None:
        self._last_true = _usable(transform_from_pose(msg.pose))

    def _on_path(self, msg: Any, time_s: float) -> None:
        poses = _usable(transforms_from_poses(msg))
        if poses is not None:
            self.plan.home_from_object = poses

    def _on_path_image(self, msg: Any, time_s: float) -> None:
        corners_px = _usable(image_path_from_msg(msg))
        if corners_px is not None:
            self.plan.corners_px = corners_px

    def _on_path_joints(self, msg: Any, time_s: float) -> None:
        self.plan.joint_names = list(msg.joint_names)
        self.plan.joints_rad = np.array([point.positions for point in msg.points], dtype=float)

    def _on_verdict(self, msg: Any, time_s: float) -> None:
        self.plan.verdict = [
            {'name': status.name, 'message': status.message,
             'level': str(_level(status)), **{pair.key: pair.value for pair in status.values}}
            for status in msg.status]

    def _on_progress(self, msg: Any, time_s: float) -> None:
        now = progress_from_msg(msg)
        errors = now.position_error_m, now.rotation_error_rad
        if not self.running or now.pose < 1 or not np.isfinite(errors).all():
            return
        record = PoseRecord(now.pose, now.iterations, self._joints_now(), *errors,
                            reached=now.reached, time_s=time_s - self._start_s)
        self.data.errors.append((record.time_s, now.pose, *errors))
        self._keep(record)

    def _keep(self, record: PoseRecord) -> None:
        """Replace the record of the same pose, or close the one before it."""
        poses = self.data.poses
        if poses and poses[-1].index == record.index:
            poses[-1] = record
        else:
            if poses and poses[-1].index < record.index:
                poses[-1].reached = True
            poses.append(record)
        if record.reached:
            self._take_snapshot(record.index)

    def _joints_now(self) -> list[float]:
        return [] if self._joints is None else self._joints.tolist()

    def _take_snapshot(self, index: int) -> None:
        count = len(self.plan.home_from_object)
        known = {shot.index for shot in self.data.snapshots}
        if index in known or index not in snapshot_indices(count) or 'image' not in self.latest:
            return
        image = _usable(pixels_from_image(self.latest['image']))
        corners, contour = (self.latest.get(f'object/{what}') for what in ('corners', 'contour'))
        if image is not None:
            self.data.snapshots.append(Snapshot(
                index, image.copy(),
                None if corners is None else _usable(corners_from_polygon(corners)),
                None if contour is None else _usable(points_from_polygon(contour))))

    def _on_state(self, msg: Any, time_s: float) -> None:
        if self.running:
            self.data.states.append((time_s - self._start_s, msg.data))

    def _on_event(self, msg: Any, time_s: float) -> None:
        event, _, text = msg.data.partition(': ')
        if event == TAUGHT:
            self._goal_true = self._last_true
        elif event == STARTED:
            self.running, self._start_s, self.data.plan_sentence = True, time_s, text
        elif event == ENDED:
            self.finish(text, time_s)

    def _home_corners(self) -> np.ndarray | None:
        """Find p_0: where the face would be seen at the virtual home pose."""
        camera, plan = self.camera(), self.plan
        if camera is None or not plan.verdict or not len(plan.home_from_object) \
                or plan.corners_px.shape[:2] != (len(plan.home_from_object), 4):
            return None
        depth_m = float(plan.verdict[0].get('home_depth_m', 'nan'))
        home = face_seen_at(plan.home_from_object[0], camera.rays(plan.corners_px[0]), depth_m)
        return camera.project(home + (0.0, 0.0, depth_m)) if np.isfinite(home).all() else None

    def finish(self, text: str, time_s: float) -> None:
        """End the trial with `converged: ...` or `failed: ...`."""
        was_running, self.running = self.running, False
        word, _, sentence = text.partition(': ')
        self.data.converged, self.data.verdict = word == 'converged', sentence or text
        self.data.duration_s = time_s - self._start_s if was_running else 0.0
        self.data.looks = sum(pose.iterations for pose in self.data.poses)
        if self.data.converged and self.data.poses:
            self.data.poses[-1].reached = True
            self._take_snapshot(self.data.poses[-1].index)
        self.data.home_corners_px = self._home_corners()
        if self._goal_true is not None and self._last_true is not None:
            self.data.final_true_error = true_error(self._goal_true, self._last_true)

    def camera(self) -> Any:
        """Give the camera that was announced, or None."""
        msg = self.latest.get('camera_info')
        return None if msg is None else _usable(camera_from_info(msg))


def _level(status: Any) -> int:
    level = status.level
    return level[0] if isinstance(level, (bytes, bytearray)) else int(level)
