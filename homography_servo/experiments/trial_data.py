"""What a servo trial leaves behind: plain numbers, with or without ROS."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

SNAPSHOT_FRACTIONS = (0.0, 13 / 30, 22 / 30, 1.0)  # p_1, p_14, p_23, p_31 of the paper


@dataclass
class PoseRecord:
    """How one pose of the path was reached."""

    index: int  # from 1
    iterations: int
    joints_rad: list[float]
    position_error_m: float
    rotation_error_rad: float
    reached: bool = False
    time_s: float = 0.0


@dataclass
class PlanRecord:
    """The path as it was planned and shown."""

    home_from_object: np.ndarray  # (N, 4, 4)
    corners_px: np.ndarray  # (N, 4, 2)
    joint_names: list[str]
    joints_rad: np.ndarray  # (N, n), empty without a robot
    verdict: list[dict[str, str]] = field(default_factory=list)  # per pose, text for people


@dataclass
class Snapshot:
    """What the camera saw when a pose was reached."""

    index: int
    image: np.ndarray  # (H, W) or (H, W, 3) uint8
    corners_px: np.ndarray | None
    contour_px: np.ndarray | None


@dataclass
class TrialData:
    """One trial, complete."""

    converged: bool = False
    verdict: str = ''
    plan_sentence: str = ''
    poses: list[PoseRecord] = field(default_factory=list)
    plan: PlanRecord | None = None
    snapshots: list[Snapshot] = field(default_factory=list)
    errors: list[tuple[float, int, float, float]] = field(default_factory=list)
    joint_names: list[str] = field(default_factory=list)
    joint_track: list[tuple[float, list[float]]] = field(default_factory=list)
    home_corners_px: np.ndarray | None = None
    final_true_error: dict[str, float] | None = None
    duration_s: float = 0.0
    motion_s: float = 0.0
    looks: int = 0
    states: list[tuple[float, str]] = field(default_factory=list)


def snapshot_indices(count: int) -> list[int]:
    """Choose the poses (from 1) to show, as the paper does for its 31."""
    return sorted({1 + round((count - 1) * fraction) for fraction in SNAPSHOT_FRACTIONS})


def true_error(goal: np.ndarray, final: np.ndarray) -> dict[str, float]:
    """
    Compare two true poses of the object.

    Parameters
    ----------
    goal, final : (4, 4) array
        home_from_object when the goal was taught, and at the end.

    Returns
    -------
    dict
        ``lateral_m`` across the optical axis, ``depth_m`` along it, ``gamma_rad``
        about it, ``tilt_rad`` about the axes across it; all without sign.

    """
    shift = final[:3, 3] - goal[:3, 3]
    turn = Rotation.from_matrix(final[:3, :3] @ goal[:3, :3].T).as_rotvec()
    return {'lateral_m': float(np.hypot(shift[0], shift[1])), 'depth_m': float(abs(shift[2])),
            'gamma_rad': float(abs(turn[2])), 'tilt_rad': float(np.hypot(turn[0], turn[1]))}


def face_seen_at(home_from_object: np.ndarray, rays: np.ndarray,
                 home_depth_m: float) -> np.ndarray:
    """
    Find the points of the face from where they are seen at a known pose.

    Parameters
    ----------
    home_from_object : (4, 4) array
        The pose.
    rays : (N, 2) array
        Undistorted normalised image coordinates of the points.
    home_depth_m : float
        Depth of home.

    Returns
    -------
    (N, 3) array
        The points in the object frame [m], where the rays meet the plane z = 0.

    """
    directions = np.column_stack([rays, np.ones(len(rays))]) @ home_from_object[:3, :3]
    camera_in_object = -(home_from_object[:3, 3] + (0.0, 0.0, home_depth_m)) \
        @ home_from_object[:3, :3]
    return camera_in_object - directions * (camera_in_object[2] / directions[:, 2])[:, None]


def as_json(trial: TrialData) -> dict[str, Any]:
    """Give the numbers of a trial in the form of ``report/trial.json``."""
    plan = trial.plan
    return {
        'verdict': trial.verdict,
        'converged': trial.converged,
        'plan': trial.plan_sentence,
        'poses_planned': 0 if plan is None else len(plan.home_from_object),
        'poses': [vars(pose) for pose in trial.poses],
        'joint_names': trial.joint_names,
        'planned_joints_rad': [] if plan is None else plan.joints_rad.tolist(),
        'planned_corners_px': [] if plan is None else plan.corners_px.tolist(),
        'final_true_error': trial.final_true_error,
        'duration_s': trial.duration_s,
        'motion_s': trial.motion_s,
        'looks': trial.looks,
        'states': [{'time_s': time_s, 'state': state} for time_s, state in trial.states],
        'errors': [dict(zip(('time_s', 'pose', 'position_error_m', 'rotation_error_rad'), row))
                   for row in trial.errors],
    }


def save_json(trial: TrialData, folder: Path) -> Path:
    """Write ``trial.json`` into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / 'trial.json'
    path.write_text(json.dumps(as_json(trial), indent=1, allow_nan=False) + '\n')
    return path
