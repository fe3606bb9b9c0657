"""
The tracker and its peers on rendered sequences with exact truth.

``corner_rms_px`` is the RMS distance of a corner from its true place; ``over_bound``
divides it by the Cramer-Rao bound of the same pictures. A frame is lost when no
corners come out, a wrong lock when corners come out that are more than 5 px off.
While a corner is hidden only the others count in the error. ``time`` is by the clock,
``cpu`` is what the method itself used; pictures are rendered beforehand.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
from homography_servo.experiments.tracker_cases import CAMERA
from homography_servo.experiments.tracker_cases import Case
from homography_servo.experiments.tracker_cases import CASES
from homography_servo.experiments.tracker_cases import FACE_M
from homography_servo.experiments.tracker_cases import random_view
from homography_servo.experiments.tracker_cases import RATE_HZ
from homography_servo.experiments.tracker_peers import OURS
from homography_servo.experiments.tracker_peers import PEERS
from homography_servo.experiments.tracker_score import Answer
from homography_servo.experiments.tracker_score import ask
from homography_servo.experiments.tracker_score import score
from homography_servo.experiments.tracker_score import time_columns
from homography_servo.experiments.tracker_score import times_of
from homography_servo.experiments.tracker_score import vanishing
from homography_servo.result import Rejected
from homography_servo.simulation.bound import corner_bound
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.simulation.surfaces import NoiseStore
from homography_servo.tracking.tracker import Track
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

FOUND_PX = 3.0
BOUND_EVERY = 5
FRAMES, FRAMES_QUICK = 240, 90
VIEWS, VIEWS_QUICK = 1000, 60
LONG_RUN, LONG_RUN_QUICK = 10000, 1000
SLOW = {'skimage active_contour': ('plain noise 5', 'box')}  # the quick run leaves out the rest


def case_bound_px(case: Case, frames: int, seed: int) -> float:
    """Give the RMS over frames and corners of the bound of a corner's distance."""
    scene, squares = case.make_scene(seed), []
    for index in range(0, frames, BOUND_EVERY):
        time_s = index / RATE_HZ
        if case.hidden(index):
            continue
        bound = corner_bound(scene, case.motion.pose(time_s), time_s)
        if not isinstance(bound, Rejected):
            squares.append(np.trace(bound) / 4.0)
    return float(np.sqrt(np.mean(squares)))


def run_case(case: Case, frames: int, seed: int, quick: bool
             ) -> tuple[list[dict[str, Any]], np.ndarray]:
    """
    Run all methods over the same pictures, one method after the other.

    Returns
    -------
    rows : list of dict
        One for each method.
    times_s : (n, 2) array
        What our tracker took for each picture with the face in it: wall and CPU time.

    """
    shown = list(case.frames(frames, seed))
    times_s, pictures = [item[1] for item in shown], [item[3] for item in shown]
    bound_px, rows, ours_s = case_bound_px(case, frames, seed), [], np.zeros((0, 2))
    for name, peer in PEERS.items():
        if quick and case.name not in SLOW.get(name, (case.name,)):
            continue
        method = peer(pictures[0].true_corners_px, pictures[0].image_grey, case.camera, FACE_M,
                      case.height_m)
        answers = [ask(method, frame.image_grey, time_s)
                   for frame, time_s in zip(pictures, times_s)]
        rows.append(score(name, case, pictures, answers, bound_px))
        if name == OURS:
            there = [frame.true_corners_px is not None for frame in pictures]
            ours_s = times_of(answers)[there]
            if case.scene.vanish_start_s >= 0.0:
                rows[-1].update(vanishing(pictures, times_s, answers))
    return rows, ours_s


def run_long(count: int, seed: int) -> dict[str, Any]:
    """Show the same short sequence forth and back for long: nothing may grow."""
    case = next(case for case in CASES if case.name == 'plain noise 5')
    frames = [frame for *_, frame in case.frames(120, seed)]
    tour = [*frames, *frames[-2:0:-1]]
    method = PEERS[OURS](frames[0].true_corners_px, frames[0].image_grey, CAMERA, FACE_M, 0.0)
    times_s, early_kib = np.ones((count, 2)), 0.0  # written once: it must not grow either
    for index in range(count):
        if index == count // 10:
            early_kib = _resident_kib()
        frame = tour[index % len(tour)]
        times_s[index] = ask(method, frame.image_grey, index / RATE_HZ)[2:]
    early, late = (time_columns(part)['cpu_ms_median']
                   for part in (times_s[:count // 10], times_s[-(count // 10):]))
    return {'method': OURS, 'case': 'long run', 'frames': count, **time_columns(times_s),
            'memory_growth_kib': _resident_kib() - early_kib, 'late_over_early_time': late / early}


def _resident_kib() -> float:
    """Give the memory in use; 0 where the system does not tell it this way."""
    statm = Path('/proc/self/statm')
    if not statm.exists():
        return 0.0
    return int(statm.read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE') / 1024.0


def run_finder(views: int, seed: int) -> dict[str, Any]:
    """Look for the face in random cluttered pictures without being told where."""
    rng, found, wrong, answers = np.random.default_rng([seed, 5]), 0, 0, []
    noise = NoiseStore(CAMERA.width, CAMERA.height, np.random.default_rng([seed, 6]))
    for view in range(views):
        scene = Scene(CAMERA, FACE_M, 0.04, SceneSettings(clutter=1.0, noise_grey=3.0),
                      seed + view, noise)
        frame = scene.render(random_view(rng), 0.0, view)
        answer, track = _find(frame.image_grey)
        answers.append(answer)
        if track.corners_px is not None:
            good = _same_face(track.corners_px, frame.true_corners_px)
            found, wrong = found + good, wrong + (not good)
    times_s = times_of(answers)
    return {'method': OURS, 'case': 'finder, random views with clutter', 'frames': views,
            'found_share': found / views, 'wrong_locks': wrong, **time_columns(times_s),
            'cpu_ms_max': 1e3 * float(times_s[:, 1].max())}


def _find(image: np.ndarray) -> tuple[Answer, Track]:
    """Find the face in one picture; what was found must stand a second look."""
    tracker = Tracker(FACE_M, TrackerSettings(confirming_frames=1), CAMERA, 0.04)
    tracks: list[Track] = []

    class Finder:
        def update(self, image: np.ndarray, time_s: float) -> np.ndarray | None:
            tracks.append(tracker.update(image, time_s))
            return tracks[-1].corners_px

    answer = ask(Finder(), image, 0.0)
    if answer.corners_px is None:
        tracks.append(tracker.update(image, 1.0 / RATE_HZ))
    return answer, tracks[-1]


def _same_face(corners_px: np.ndarray, truth_px: np.ndarray) -> bool:
    """Compare, half a turn allowed: a blank rectangle looks the same then."""
    return any(np.linalg.norm(np.roll(corners_px, turn, axis=0) - truth_px, axis=1).max()
               < FOUND_PX for turn in (0, 2))


def run(quick: bool, seed: int) -> list[dict[str, Any]]:
    """Run every case, the long run and the finder."""
    cv2.setNumThreads(1)
    frames, views = (FRAMES_QUICK, VIEWS_QUICK) if quick else (FRAMES, VIEWS)
    results = [run_case(case, frames, seed, quick) for case in CASES]
    times_s = np.vstack([times_s for _, times_s in results])
    together = {'method': OURS, 'case': 'every frame with the face in it', 'frames': len(times_s),
                **time_columns(times_s)}
    return [*(row for rows, _ in results for row in rows), together,
            run_long(LONG_RUN_QUICK if quick else LONG_RUN, seed),
            run_finder(views, seed)]
