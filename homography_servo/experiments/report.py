"""The report of a trial: numbers, figures and one page that shows them."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Sequence

from homography_servo.experiments.trial_data import save_json
from homography_servo.experiments.trial_data import TrialData
from homography_servo.geometry.camera import Camera
import numpy as np

TRUE_ERRORS = (
    ('sideways', 'lateral_m', 1e3, 'mm'), ('in depth', 'depth_m', 1e3, 'mm'),
    ('about the optical axis', 'gamma_rad', 180.0 / np.pi, 'deg'),
    ('in tilt', 'tilt_rad', 180.0 / np.pi, 'deg'))
# Keys of the verdict's diagnostics: heading, factor, digits after the point (-1: as it is).
VERDICT_COLUMNS = {
    'border_px': ('border [px]', 1.0, 0), 'facing_deg': ('facing [deg]', 1.0, 1),
    'ambiguity': ('ambiguity', 1.0, 2), 'reached': ('reached', 1.0, -1),
    'nearest_limit': ('nearest limit', 1.0, -1),
    'joint_margin_rad': ('margin to it [deg]', 180.0 / np.pi, 1),
    'conditioning': ('smallest singular value', 1.0, 3), 'led': ('joints lead', 1.0, -1),
    'joint_step_rad': ('largest joint step [deg]', 180.0 / np.pi, 1)}
STYLE = """
:root { color-scheme: light; --ink: #1d2430; --soft: #5c6675; --line: #e0e4ea; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); margin: 0 auto;
       max-width: 1080px; padding: 24px 16px 64px; }
h1 { font-size: 1.6rem; margin: 0 0 .3rem; } h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
.verdict { border-left: 6px solid; padding: .7rem 1rem; border-radius: 4px; margin: 1rem 0; }
.good { border-color: #2e933c; background: #edf7ee; }
.bad { border-color: #d1495b; background: #fdeef0; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(130px, 1fr)); gap: 10px; }
.card { border: 1px solid var(--line); border-radius: 8px; padding: .6rem .8rem; }
.card b { display: block; font-size: 1.25rem; } .card span, figcaption { color: var(--soft);
          font-size: .87rem; }
figure { margin: 0; } img { max-width: 100%; height: auto; display: block; margin: 0 auto; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-size: .87rem;
          font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .25rem .5rem; border-bottom: 1px solid var(--line);
         white-space: nowrap; } th { white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0;
                                 background: #fff; }
.text { text-align: left; white-space: normal; min-width: 12rem; }
"""


def write_report(trial: TrialData, folder: Path, camera: Camera | None) -> Path:
    """
    Write trial.json, the figures and index.html.

    Parameters
    ----------
    trial : TrialData
        What happened; may be incomplete, then figures are left out.
    folder : path
        Made when it is missing; files of an earlier report are replaced.
    camera : Camera, optional
        For the size of the image.

    Returns
    -------
    path
        The page.

    """
    folder.mkdir(parents=True, exist_ok=True)
    save_json(trial, folder)
    page = folder / 'index.html'
    page.write_text(_page(trial, _figures(trial, folder, camera)))
    return page


def _figures(trial: TrialData, folder: Path, camera: Camera | None) -> list[tuple[str, str, str]]:
    """Draw what can be drawn; rows of file, title and caption."""
    for old in folder.glob('figure_*.png'):
        old.unlink()
    if trial.plan is None or not len(trial.plan.corners_px):
        return []
    from homography_servo.experiments import trial_figures as draw  # matplotlib is slow to load
    made = []
    if camera is not None:
        for name, narrow in _both('figure_2_paths'):
            draw.paths_figure(trial, camera, folder / name, narrow)
        made.append(('figure_2_paths', 'The object on its path',
                     'Four poses of the path: as planned, and what the camera saw when the pose '
                     'was reached, with the measured contour.'))
    if trial.poses:
        for name, narrow in _both('figure_3_joints'):
            draw.joints_figure(trial, folder / name, narrow)
        made.append(('figure_3_joints', 'Joint positions against k',
                     'Grey: planned. Dots: where the arm stood when pose k was reached. The path '
                     'is a chord in space, so other joints than the first move in between and '
                     'come back.'))
    if trial.errors:
        for name, narrow in _both('figure_4_errors'):
            draw.errors_figure(trial, folder / name, narrow)
        made.append(('figure_4_errors', 'Distance to the pose aimed at',
                     'At each look. It rises when the next pose becomes the aim.'))
    return made


def _both(stem: str) -> tuple[tuple[str, bool], tuple[str, bool]]:
    """Name the wide and the narrow drawing of a figure."""
    return (f'{stem}.png', False), (f'{stem}_narrow.png', True)


def _figure(stem: str, title: str, caption: str) -> str:
    (wide, _), (narrow, _) = _both(stem)
    return (f'<h2>{escape(title)}</h2><figure><picture>'
            f'<source media="(max-width: 600px)" srcset="{narrow}">'
            f'<img src="{wide}" alt="{escape(title)}"></picture>'
            f'<figcaption>{escape(caption)}</figcaption></figure>')


def _cards(rows: Sequence[tuple[str, str]]) -> str:
    return '<div class="cards">' + ''.join(
        f'<div class="card"><b>{escape(value)}</b><span>{escape(label)}</span></div>'
        for label, value in rows) + '</div>'


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = ()) -> str:
    cells = ''.join(f'<th{" class=text" if i in text else ""}>{escape(item)}</th>'
                    for i, item in enumerate(head))
    body = ''.join('<tr>' + ''.join(
        f'<td{" class=text" if i in text else ""}>{escape(str(item))}</td>'
        for i, item in enumerate(row)) + '</tr>' for row in rows)
    return f'<div class="scroll"><table><tr>{cells}</tr>{body}</table></div>'


def error_rows(trial: TrialData) -> list[tuple[str, str]]:
    """Give the true errors at the end as label and number with unit."""
    if trial.final_true_error is None:
        return []
    return [(f'true error {label}', f'{scale * trial.final_true_error[key]:.2f} {unit}')
            for label, key, scale, unit in TRUE_ERRORS]


def _overview(trial: TrialData) -> list[tuple[str, str]]:
    reached = sum(pose.reached for pose in trial.poses)
    planned = len(trial.plan.home_from_object) if trial.plan else 0
    return [('poses reached', f'{reached} of {planned}'), *error_rows(trial),
            ('duration', f'{trial.duration_s:.1f} s'),
            ('of it the arm moved', f'{trial.motion_s:.1f} s')]


def pose_rows(trial: TrialData) -> list[list[str]]:
    """Give one row per pose: k, looks, errors, joints in degrees."""
    return [[str(pose.index), str(pose.iterations), f'{1e3 * pose.position_error_m:.2f}',
             f'{np.degrees(pose.rotation_error_rad):.2f}',
             *(f'{angle:.1f}' for angle in np.degrees(pose.joints_rad))] for pose in trial.poses]


def _verdict_table(trial: TrialData) -> str:
    rows = trial.plan.verdict if trial.plan else []
    if not rows:
        return ''
    keys = list(dict.fromkeys(key for row in rows[1:] for key in row))
    keys = [key for key in keys if key not in ('name', 'message', 'level')]
    table = [[row['name'].rpartition(': ')[2],
              *(shown_value(key, row.get(key, '')) for key in keys), row['message']]
             for row in rows[1:]]
    return ('<h2>Verdict before the motion</h2>'
            f'<p>{escape(_sentence(rows[0]["message"]))}</p>'
            + _table(['pose', *(_heading(key) for key in keys), 'verdict'], table,
                     text=(len(keys) + 1,)))


def _sentence(text: str) -> str:
    return f'{text[:1].upper()}{text[1:].rstrip(".")}.'


def _heading(key: str) -> str:
    return VERDICT_COLUMNS[key][0] if key in VERDICT_COLUMNS else key.replace('_', ' ')


def shown_value(key: str, value: str) -> str:
    """Write a value of the verdict as a person reads it: few digits, degrees, yes or no."""
    if value in ('true', 'false'):
        return 'yes' if value == 'true' else 'no'
    _, scale, digits = VERDICT_COLUMNS.get(key, ('', 1.0, -1))
    try:
        return f'{scale * float(value):.{digits}f}' if digits >= 0 else value
    except ValueError:
        return value


def _page(trial: TrialData, figures: Sequence[tuple[str, str, str]]) -> str:
    kind = 'good' if trial.converged else 'bad'
    shown = ''.join(_figure(*figure) for figure in figures)
    joints = [f'{name} [deg]' for name in trial.joint_names]
    table = _table(['k', 'looks', 'position error [mm]', 'rotation error [deg]', *joints],
                   pose_rows(trial))
    return (f'<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f'<title>Servo trial</title><style>{STYLE}</style></head><body>'
            '<h1>Servo trial</h1><p>An object in the hand of an arm, moved to where a fixed '
            'camera should see it, along a path that was planned and checked first.</p>'
            f'<p class="verdict {kind}">{escape(summary(trial))}</p>'
            f'{_cards(_overview(trial))}{shown}<h2>Every pose</h2>{table}'
            f'{_verdict_table(trial)}</body></html>\n')


def summary(trial: TrialData) -> str:
    """Say in one sentence how the trial ended."""
    if not trial.converged:
        return f'The trial did not converge: {trial.verdict}.'
    errors = error_rows(trial)
    ending = ': ' + ', '.join(f'{value} {label.removeprefix("true error ")}'
                              for label, value in errors) if errors else ''
    return (f'The trial converged: all {len(trial.poses)} poses reached in '
            f'{trial.duration_s:.1f} s, the object ended at the goal{ending}.')


def print_summary(trial: TrialData, folder: Path) -> None:
    """Print the table and the sentence."""
    print()
    if trial.poses:
        print('pose  looks  position error  rotation error')
    for row in pose_rows(trial):
        print(f'{row[0]:>4}  {row[1]:>5}  {row[2]:>11} mm  {row[3]:>10} deg')
    print()
    for label, value in _overview(trial):
        print(f'{label:>36}: {value}')
    print(f'\nReport: {folder / "index.html"}')
    print(summary(trial), flush=True)
