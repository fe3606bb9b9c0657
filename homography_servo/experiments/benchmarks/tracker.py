"""
The tracker and its peers on rendered sequences with exact truth.

``corner_rms_px`` is the RMS distance of a corner from its true place; ``over_bound``
divides it by the Cramer-Rao bound of the same pictures. A frame is lost when no
corners come out, a wrong lock when corners come out that are more than 5 px off.
While a corner is hidden only the others count in the error.
"""

from __future__ import annotations

import time
from typing import Any

import cv2
from homography_servo.experiments.tracker_cases import CAMERA
from homography_servo.experiments.tracker_cases import Case
from homography_servo.experiments.tracker_cases import CASES
from homography_servo.experiments.tracker_cases import FACE_M
from homography_servo.experiments.tracker_cases import random_view
from homography_servo.experiments.tracker_peers import OURS
from homography_servo.experiments.tracker_peers import PEERS
from homography_servo.result import Rejected
from homography_servo.simulation.bound import corner_bound
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking.tracker import COASTING
from homography_servo.tracking.tracker import LOST
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

WRONG_PX = 5.0
FOUND_PX = 3.0
BOUND_EVERY = 10
FRAMES, FRAMES_QUICK = 240, 90
VIEWS, VIEWS_QUICK = 1000, 60
SLOW = {'skimage active_contour': ('plain noise 5', 'box')}  # tens of ms per frame: few cases


class Score:
    """What one method did in one sequence."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self.errors: list[np.ndarray] = []  # (4, 2), nan where a corner does not count
        self.times_s: list[float] = []
        self.lost = 0
        self.wrong = 0
        self.states: list[tuple[float, bool, str]] = []

    def add(self, index: int, time_s: float, truth: np.ndarray | None,
            corners_px: np.ndarray | None, spent_s: float, state: str) -> None:
        """Judge one frame."""
        self.times_s.append(spent_s)
        self.states.append((time_s, truth is not None, state))
        if corners_px is None:
            self.lost += truth is not None
            return
        if truth is None:
            self.wrong += 1
            return
        error = corners_px - truth
        if self._case.hidden(index):
            error[list(self._case.hidden_corners)] = np.nan
        self.wrong += bool(np.nanmax(np.linalg.norm(error, axis=1)) > WRONG_PX)
        self.errors.append(error)

    def row(self, method: str, bound_px: float) -> dict[str, Any]:
        """Sum up."""
        row: dict[str, Any] = {'method': method, 'case': self._case.name}
        if self.errors:
            errors = np.array(self.errors)
            distance = np.linalg.norm(errors, axis=2)
            rms_px = float(np.sqrt(np.nanmean(distance ** 2)))
            row.update(corner_rms_px=rms_px, corner_max_px=float(np.nanmax(distance)),
                       corner_rms_over_bound=rms_px / bound_px,
                       bias_px=float(np.abs(np.nanmean(errors, axis=0)).max()))
        times_ms = 1e3 * np.array(self.times_s)
        row.update(frames_lost=self.lost, wrong_locks=self.wrong, frames=len(times_ms),
                   time_ms_median=float(np.median(times_ms)),
                   time_ms_p99=float(np.percentile(times_ms, 99)))
        return row

    def vanishing(self) -> dict[str, float]:
        """Tell how long after the box went it was given up, by frame times."""
        gone_s = next(time_s for time_s, there, _ in self.states if not there)
        after = [(time_s - gone_s, state) for time_s, _, state in self.states
                 if time_s >= gone_s]
        lost_s = next((since_s for since_s, state in after if state == LOST), np.nan)
        return {'coasting_at_once': float(after[0][1] == COASTING), 'lost_after_ms': 1e3 * lost_s}


def case_bound_px(case: Case, frames: int, seed: int) -> float:
    """Give the RMS over frames and corners of the bound of a corner's distance."""
    scene, squares = case.make_scene(seed), []
    for index in range(0, frames, BOUND_EVERY):
        time_s = index / 30.0
        if case.hidden(index):
            continue
        bound = corner_bound(scene, case.motion.pose(time_s), time_s)
        if not isinstance(bound, Rejected):
            squares.append(np.trace(bound) / 4.0)
    return float(np.sqrt(np.mean(squares)))


def run_case(case: Case, frames: int, seed: int) -> list[dict[str, Any]]:
    """Run all methods over the same pictures."""
    methods: dict[str, Any] = {}
    scores = {name: Score(case) for name in PEERS if case.name in SLOW.get(name, (case.name,))}
    for index, time_s, _, frame in case.frames(frames, seed):
        if not methods:
            methods = {name: PEERS[name](frame.true_corners_px, frame.image_grey, case.camera,
                                         FACE_M, case.height_m) for name in scores}
        for name, method in methods.items():
            began_s = time.perf_counter()
            corners_px = method.update(frame.image_grey, time_s)
            spent_s = time.perf_counter() - began_s
            scores[name].add(index, time_s, frame.true_corners_px, corners_px, spent_s,
                             getattr(method, 'state', ''))
    bound_px = case_bound_px(case, frames, seed)
    rows = [score.row(name, bound_px) for name, score in scores.items()]
    if case.name == 'vanish':
        rows[0].update(scores[OURS].vanishing())
    return rows


def run_finder(views: int, seed: int) -> dict[str, Any]:
    """Look for the face in random cluttered pictures without being told where."""
    rng, found, times_ms, wrong = np.random.default_rng([seed, 5]), 0, [], 0
    settings = TrackerSettings(confirming_frames=1)
    cluttered = SceneSettings(clutter=1.0, noise_grey=3.0)
    for view in range(views):
        scene = Scene(CAMERA, FACE_M, 0.04, cluttered, seed + view)
        frame = scene.render(random_view(rng), 0.0, view)
        tracker = Tracker(FACE_M, settings, CAMERA, 0.04)
        began_s = time.perf_counter()
        track = tracker.update(frame.image_grey, 0.0)
        times_ms.append(1e3 * (time.perf_counter() - began_s))
        if track.corners_px is None:
            track = tracker.update(frame.image_grey, 1.0 / 30.0)
        if track.corners_px is not None:
            good = _same_face(track.corners_px, frame.true_corners_px)
            found, wrong = found + good, wrong + (not good)
    return {'method': OURS, 'case': 'finder, random views with clutter', 'frames': views,
            'found_share': found / views, 'wrong_locks': wrong,
            'time_ms_median': float(np.median(times_ms)),
            'time_ms_p99': float(np.percentile(times_ms, 99)), 'time_ms_max': max(times_ms)}


def _same_face(corners_px: np.ndarray, truth_px: np.ndarray) -> bool:
    """Compare, half a turn allowed: a blank rectangle looks the same then."""
    return any(np.linalg.norm(np.roll(corners_px, turn, axis=0) - truth_px, axis=1).max()
               < FOUND_PX for turn in (0, 2))


def run(quick: bool, seed: int) -> list[dict[str, Any]]:
    """Run every case and the finder."""
    cv2.setNumThreads(1)
    frames, views = (FRAMES_QUICK, VIEWS_QUICK) if quick else (FRAMES, VIEWS)
    rows = [row for case in CASES for row in run_case(case, frames, seed)]
    return [*rows, run_finder(views, seed)]
