"""Judge what a tracker said about a sequence whose truth is known."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

from homography_servo.experiments.tracker_cases import Case
from homography_servo.experiments.tracker_peers import Peer
from homography_servo.simulation.scene import Frame
from homography_servo.tracking.tracker import COASTING
from homography_servo.tracking.tracker import LOST
import numpy as np

WRONG_PX = 5.0


class Answer(NamedTuple):
    """What a method said about one picture, and what that cost."""

    corners_px: np.ndarray | None  # (4, 2)
    state: str
    wall_s: float
    cpu_s: float


def ask(method: Peer, image: np.ndarray, time_s: float) -> Answer:
    """Show one picture to a method."""
    wall_s, cpu_s = time.perf_counter(), time.thread_time()
    corners_px = method.update(image, time_s)
    return Answer(corners_px, getattr(method, 'state', ''), time.perf_counter() - wall_s,
                  time.thread_time() - cpu_s)


def times_of(answers: list[Answer]) -> np.ndarray:
    """Give (N, 2) wall and CPU times [s]."""
    return np.array([(answer.wall_s, answer.cpu_s) for answer in answers])


def time_columns(times_s: np.ndarray) -> dict[str, float]:
    """Sum up (N, 2) times; CPU time does not grow when others use the machine."""
    columns = {}
    for name, times_ms in zip(('time', 'cpu'), 1e3 * times_s.T):
        columns[f'{name}_ms_median'] = float(np.median(times_ms))
        columns[f'{name}_ms_p99'] = float(np.percentile(times_ms, 99))
    return columns


def errors_of(case: Case, frames: list[Frame], answers: list[Answer]) -> np.ndarray:
    """Give errors (frames, 4, 2) [px], nan where nothing was said or nothing counts."""
    errors = np.full((len(frames), 4, 2), np.nan)
    for index, (frame, answer) in enumerate(zip(frames, answers)):
        if answer.corners_px is not None and frame.true_corners_px is not None:
            errors[index] = answer.corners_px - frame.true_corners_px
            if case.hidden(index):
                errors[index, list(case.hidden_corners)] = np.nan
    return errors


def score(method: str, case: Case, frames: list[Frame], answers: list[Answer],
          bound_px: float) -> dict[str, Any]:
    """Sum one sequence up in a row of the table."""
    errors = errors_of(case, frames, answers)
    distance = np.linalg.norm(errors, axis=2)
    row: dict[str, Any] = {'method': method, 'case': case.name}
    if np.isfinite(distance).any():
        rms_px = _rms(distance)
        bias_px = np.abs(np.nanmean(errors, axis=0)).max()
        row.update(corner_rms_px=rms_px, corner_max_px=float(np.nanmax(distance)),
                   corner_rms_over_bound=rms_px / bound_px, bias_px=float(bias_px))
    row.update(_counts(frames, answers, distance), **time_columns(times_of(answers)))
    if case.hidden_corners:
        row['hidden_rms_over_normal'] = _hidden_over_normal(case, distance)
    return row


def _rms(distance: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(distance ** 2)))


def _counts(frames: list[Frame], answers: list[Answer], distance: np.ndarray) -> dict[str, int]:
    there = np.array([frame.true_corners_px is not None for frame in frames])
    said = np.array([answer.corners_px is not None for answer in answers])
    off = (np.where(np.isnan(distance), 0.0, distance) > WRONG_PX).any(axis=1)
    return {'frames_lost': int((there & ~said).sum()),
            'wrong_locks': int(((~there & said) | off).sum()), 'frames': len(frames)}


def _hidden_over_normal(case: Case, distance: np.ndarray) -> float:
    """Compare the corners that stay in view while others are hidden with before and after."""
    hidden = np.array([case.hidden(index) for index in range(len(distance))])
    others = [corner for corner in range(4) if corner not in case.hidden_corners]
    during, normal = distance[hidden][:, others], distance[~hidden][:, others]
    if not (np.isfinite(during).any() and np.isfinite(normal).any()):
        return float('nan')
    return _rms(during) / _rms(normal)


def vanishing(frames: list[Frame], times_s: list[float],
              answers: list[Answer]) -> dict[str, float]:
    """Tell how soon after the box went it was given up, by frame times."""
    gone_s = next(t for t, frame in zip(times_s, frames) if frame.true_corners_px is None)
    after = [(t - gone_s, answer.state) for t, answer in zip(times_s, answers) if t >= gone_s]
    lost_s = next((since_s for since_s, state in after if state == LOST), float('nan'))
    return {'coasting_at_once': float(after[0][1] == COASTING), 'lost_after_ms': 1e3 * lost_s}
