"""Figures 2 and 3 of the paper, and the error against time, from the data of a trial."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

from homography_servo.experiments.trial_data import snapshot_indices
from homography_servo.experiments.trial_data import TrialData
from homography_servo.geometry.camera import Camera
from matplotlib.figure import Figure
import numpy as np

PATH, HOME, NOW, PLAN = '#2a78c2', '#7a5195', '#d1495b', '#8a8f98'
JOINT_COLOURS = ('#1b6ca8', '#d1495b', '#2e933c', '#edae49', '#7a5195', '#00798c')
DPI = 120


def _closed(corners_px: np.ndarray) -> np.ndarray:
    return np.vstack([corners_px, corners_px[:1]])


def _outline(axes, corners_px, colour: str, label: str | None = None, **style) -> None:
    axes.plot(*_closed(np.asarray(corners_px)).T, color=colour, label=label, **style)


def _image_axes(axes, size_px: tuple[int, int]) -> None:
    axes.set_xlim(-0.5, size_px[0] - 0.5)
    axes.set_ylim(size_px[1] - 0.5, -0.5)
    axes.set_aspect('equal')
    axes.set_xticks([])
    axes.set_yticks([])


def _save(figure, path: Path) -> Path:
    figure.savefig(path, dpi=DPI)
    return path


def paths_figure(trial: TrialData, camera: Camera, path: Path) -> Path:
    """Draw figure 2: four poses as planned and as seen, with p_0 and the path."""
    indices = snapshot_indices(len(trial.plan.corners_px))
    shots = {shot.index: shot for shot in trial.snapshots}
    figure = Figure(figsize=(8.2, 3.1 * len(indices)), layout='constrained')
    grid = figure.subplots(len(indices), 2, squeeze=False)
    for row, index in zip(grid, indices):
        for axes in row:
            _image_axes(axes, (camera.width, camera.height))
        _planned(row[0], trial, index)
        _seen(row[1], trial, shots.get(index), index)
    grid[0][0].set_title('Planned')
    grid[0][1].set_title('Seen by the camera')
    grid[0][0].legend(loc='upper left', fontsize=8, framealpha=0.9)
    return _save(figure, path)


def _path_lines(axes, trial: TrialData) -> None:
    for corner in range(trial.plan.corners_px.shape[1]):
        axes.plot(*trial.plan.corners_px[:, corner].T, color=PATH, linewidth=1.0,
                  label='path of the corners' if corner == 0 else None)
    if trial.home_corners_px is not None:
        _outline(axes, trial.home_corners_px, HOME, 'virtual home $p_0$', linestyle='--',
                 linewidth=1.2)


def _planned(axes, trial: TrialData, index: int) -> None:
    axes.set_facecolor('#f4f5f7')
    _path_lines(axes, trial)
    _outline(axes, trial.plan.corners_px[index - 1], NOW, 'object', linewidth=2.0)
    axes.set_ylabel(f'$p_{{{index}}}$', rotation=0, labelpad=14, fontsize=12)


def _seen(axes, trial: TrialData, shot, index: int) -> None:
    if shot is None:
        axes.text(0.5, 0.5, f'pose {index} was not reached', transform=axes.transAxes,
                  ha='center', va='center')
        return
    image = shot.image if shot.image.ndim == 2 else shot.image[:, :, ::-1]
    axes.imshow(image, cmap='gray', vmin=0, vmax=255)
    _path_lines(axes, trial)
    outline = shot.contour_px if shot.contour_px is not None else shot.corners_px
    if outline is not None and len(outline):
        _outline(axes, outline, NOW, linewidth=1.6)


def joints_figure(trial: TrialData, path: Path) -> Path:
    """Draw figure 3: the joints against k, planned and as driven."""
    planned = np.degrees(trial.plan.joints_rad)
    driven = [(pose.index, np.degrees(pose.joints_rad)) for pose in trial.poses
              if len(pose.joints_rad)]
    count = planned.shape[1] if planned.size else len(trial.joint_names)
    figure = Figure(figsize=(9.6, 5.2), layout='constrained')
    grid = figure.subplots(2, (count + 1) // 2, sharex=True, squeeze=False)
    for joint, axes in zip(range(count), grid.ravel()):
        if planned.size:
            axes.plot(np.arange(1, len(planned) + 1), planned[:, joint], color=PLAN,
                      linewidth=2.5, label='planned')
        axes.plot([k for k, _ in driven], [joints[joint] for _, joints in driven], '.',
                  color=JOINT_COLOURS[joint % len(JOINT_COLOURS)], label='driven')
        axes.set_title(trial.joint_names[joint] if trial.joint_names else f'joint {joint + 1}',
                       fontsize=10)
        _at_least(axes, 10.0)
        axes.grid(color='#e3e5e8')
        axes.set_xlabel('pose k')
        axes.set_ylabel('deg')
    for axes in grid.ravel()[count:]:
        axes.set_visible(False)
    grid[0][0].legend(fontsize=8)
    return _save(figure, path)


def _at_least(axes, span: float) -> None:
    """Keep a joint that stands still from filling its plot with round-off."""
    low, high = axes.get_ylim()
    if high - low < span:
        axes.set_ylim((low + high - span) / 2.0, (low + high + span) / 2.0)


def errors_figure(trial: TrialData, path: Path) -> Path:
    """Draw the distance to the pose aimed at, against time."""
    figure = Figure(figsize=(9.6, 4.6), layout='constrained')
    top, bottom = figure.subplots(2, 1, sharex=True)
    rows = np.array(trial.errors, dtype=float).reshape(-1, 4)
    _error_line(top, rows[:, 0], 1e3 * rows[:, 2], 'position error [mm]')
    _error_line(bottom, rows[:, 0], np.degrees(rows[:, 3]), 'rotation error [deg]')
    bottom.set_xlabel('time since the start [s]')
    return _save(figure, path)


def _error_line(axes, time_s: Sequence[float], values, label: str) -> None:
    axes.plot(time_s, values, '.-', color=PATH, linewidth=0.8, markersize=4)
    axes.set_ylabel(label)
    axes.grid(color='#e3e5e8')
    axes.set_ylim(bottom=0.0)
