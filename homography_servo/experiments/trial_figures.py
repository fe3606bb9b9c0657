"""
Figures 2 and 3 of the paper, and the error against time, from the data of a trial.

Each is drawn wide, for a page or a README, or narrow, for a telephone.
"""

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
SEEN_PATH, SEEN_HOME, SEEN_NOW = '#6fc3ff', '#d9b3ff', '#ff5c70'  # on a dark picture
DPI = {False: 120, True: 200}
NARROW_IN = 4.0


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


def _save(figure, path: Path, narrow: bool) -> Path:
    figure.savefig(path, dpi=DPI[narrow])
    return path


def paths_figure(trial: TrialData, camera: Camera, path: Path, narrow: bool = False) -> Path:
    """Draw figure 2: four poses as planned and as seen, with p_0 and the path."""
    indices = snapshot_indices(len(trial.plan.corners_px))
    shots = {shot.index: shot for shot in trial.snapshots}
    shape = camera.height / camera.width
    width_in = NARROW_IN if narrow else 10.0
    cells = (len(indices), 2) if narrow else (2, len(indices))
    height_in = cells[0] * shape * width_in / cells[1] + (0.9 if narrow else 0.6)
    figure = Figure(figsize=(width_in, height_in), layout='constrained')
    grid = figure.subplots(*cells, squeeze=False)
    if narrow:
        grid = grid.T
    for column, index in enumerate(indices):
        for axes in grid[:, column]:
            _image_axes(axes, (camera.width, camera.height))
        _planned(grid[0, column], trial, index)
        _seen(grid[1, column], trial, shots.get(index), index)
        grid[0, column].set_title(f'pose {index} of {len(trial.plan.corners_px)}', fontsize=9)
    for axes, text in zip(grid[:, 0], ('planned', 'seen by the camera')):
        if narrow:
            axes.set_title(text if text != 'planned' else f'pose {indices[0]}, planned',
                           fontsize=9)
        else:
            axes.set_ylabel(text, fontsize=10)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=len(labels),
                  fontsize=8 if narrow else 9, frameon=False, handlelength=1.4,
                  columnspacing=1.2)
    return _save(figure, path, narrow)


def _path_lines(axes, trial: TrialData, path_colour: str, home_colour: str) -> None:
    for corner in range(trial.plan.corners_px.shape[1]):
        axes.plot(*trial.plan.corners_px[:, corner].T, color=path_colour, linewidth=1.0,
                  label='path of the corners' if corner == 0 else None)
    if trial.home_corners_px is not None:
        _outline(axes, trial.home_corners_px, home_colour, 'virtual home', linestyle='--',
                 linewidth=1.2)


def _planned(axes, trial: TrialData, index: int) -> None:
    axes.set_facecolor('#f4f5f7')
    _path_lines(axes, trial, PATH, HOME)
    _outline(axes, trial.plan.corners_px[index - 1], NOW, 'object', linewidth=2.0)


def _seen(axes, trial: TrialData, shot, index: int) -> None:
    if shot is None:
        axes.text(0.5, 0.5, f'pose {index} was not reached', transform=axes.transAxes,
                  ha='center', va='center')
        return
    image = shot.image if shot.image.ndim == 2 else shot.image[:, :, ::-1]
    axes.imshow(image, cmap='gray', vmin=0, vmax=255)
    _path_lines(axes, trial, SEEN_PATH, SEEN_HOME)
    outline = shot.contour_px if shot.contour_px is not None else shot.corners_px
    if outline is not None and len(outline):
        _outline(axes, outline, SEEN_NOW, linewidth=1.6)


def joints_figure(trial: TrialData, path: Path, narrow: bool = False) -> Path:
    """Draw figure 3: the joints against k, planned and as driven."""
    planned = np.degrees(trial.plan.joints_rad)
    driven = [(pose.index, np.degrees(pose.joints_rad)) for pose in trial.poses
              if len(pose.joints_rad)]
    count = planned.shape[1] if planned.size else len(trial.joint_names)
    rows, columns = ((count + 1) // 2, 2) if narrow else (2, (count + 1) // 2)
    size_in = (NARROW_IN, 1.7 * rows) if narrow else (9.6, 5.2)
    figure = Figure(figsize=size_in, layout='constrained')
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for joint, axes in zip(range(count), grid.ravel()):
        if planned.size:
            axes.plot(np.arange(1, len(planned) + 1), planned[:, joint], color=PLAN,
                      linewidth=2.5, label='planned')
        axes.plot([k for k, _ in driven], [joints[joint] for _, joints in driven], '.',
                  color=JOINT_COLOURS[joint % len(JOINT_COLOURS)], label='driven')
        name = trial.joint_names[joint] if trial.joint_names else f'joint {joint + 1}'
        axes.set_title(f'{name} [deg]', fontsize=9)
        axes.tick_params(labelsize=8)
        _at_least(axes, 10.0)
        axes.grid(color='#e3e5e8')
    for axes in grid.ravel()[count:]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel('pose k', fontsize=9)
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=len(labels), fontsize=9,
                  frameon=False)
    return _save(figure, path, narrow)


def _at_least(axes, span: float) -> None:
    """Keep a joint that stands still from filling its plot with round-off."""
    low, high = axes.get_ylim()
    if high - low < span:
        axes.set_ylim((low + high - span) / 2.0, (low + high + span) / 2.0)


def errors_figure(trial: TrialData, path: Path, narrow: bool = False) -> Path:
    """Draw the distance to the pose aimed at, against time."""
    figure = Figure(figsize=(NARROW_IN, 3.8) if narrow else (9.6, 4.6), layout='constrained')
    top, bottom = figure.subplots(2, 1, sharex=True)
    rows = np.array(trial.errors, dtype=float).reshape(-1, 4)
    _error_line(top, rows[:, 0], 1e3 * rows[:, 2], 'position error [mm]')
    _error_line(bottom, rows[:, 0], np.degrees(rows[:, 3]), 'rotation error [deg]')
    bottom.set_xlabel('time since the start [s]', fontsize=9)
    return _save(figure, path, narrow)


def _error_line(axes, time_s: Sequence[float], values, label: str) -> None:
    axes.plot(time_s, values, '.-', color=PATH, linewidth=0.8, markersize=4)
    axes.set_ylabel(label, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.grid(color='#e3e5e8')
    axes.set_ylim(bottom=0.0)
