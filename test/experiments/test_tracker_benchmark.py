"""The tracker benchmark judges by the truth, and all methods see the same pictures."""

from dataclasses import replace

from homography_servo.experiments.benchmarks.tracker import case_bound_px
from homography_servo.experiments.benchmarks.tracker import run_case
from homography_servo.experiments.tracker_cases import CAMERA
from homography_servo.experiments.tracker_cases import CASES
from homography_servo.experiments.tracker_cases import FACE_M
from homography_servo.experiments.tracker_cases import Motion
from homography_servo.experiments.tracker_cases import random_view
from homography_servo.experiments.tracker_peers import OURS
from homography_servo.experiments.tracker_peers import PEERS
from homography_servo.experiments.tracker_score import Answer
from homography_servo.experiments.tracker_score import score
from homography_servo.experiments.tracker_score import vanishing
from homography_servo.simulation.scene import Frame
from homography_servo.simulation.scene import Scene
from homography_servo.tracking.tracker import COASTING
from homography_servo.tracking.tracker import LOST
from homography_servo.tracking.tracker import TRACKING
import numpy as np
import pytest

BY_NAME = {case.name: case for case in CASES}
COLUMNS = {'method', 'case', 'corner_rms_px', 'corner_max_px', 'corner_rms_over_bound', 'bias_px',
           'frames_lost', 'wrong_locks', 'time_ms_median', 'time_ms_p99'}


def judged(offsets, case=BY_NAME['plain noise 5'], there=None):
    """Score answers that are off by known amounts; None says nothing."""
    truth = np.array([[100.0, 100.0], [200.0, 100.0], [200.0, 160.0], [100.0, 160.0]])
    there = [True] * len(offsets) if there is None else there
    frames = [Frame(np.zeros((1, 1), np.uint8), truth if seen else None, None) for seen in there]
    answers = [Answer(None if off is None else truth + off, '', 0.001, 0.001) for off in offsets]
    return score('any', case, frames, answers, 0.5)


def test_a_constant_offset_is_error_and_bias_and_noise_is_no_bias():
    row = judged([(3.0, 4.0)] * 10)
    assert (row['corner_rms_px'], row['corner_max_px'], row['bias_px']) == (5.0, 5.0, 4.0)
    assert row['corner_rms_over_bound'] == 10.0
    noise = np.random.default_rng(1).standard_normal((4000, 4, 2))
    row = judged(list(noise))
    assert row['corner_rms_px'] == pytest.approx(np.sqrt(2.0), rel=0.02)
    assert row['bias_px'] < 0.06


def test_losses_and_wrong_locks_are_counted_apart():
    row = judged([None, (0.0, 0.0), (30.0, 0.0), None, (0.0, 0.0)],
                 there=[True, True, True, False, False])
    assert (row['frames_lost'], row['wrong_locks'], row['frames']) == (1, 2, 5)


def test_hidden_corners_do_not_count_and_the_others_are_compared():
    case = replace(BY_NAME['hidden corner'], hidden=lambda index: index >= 5, hidden_corners=(1,))
    off = np.full((4, 2), (0.3, 0.0))
    worse = 2.0 * off
    worse[1] = 99.0
    row = judged([off] * 5 + [worse] * 5, case)
    assert row['wrong_locks'] == 0 and row['corner_max_px'] == pytest.approx(0.6)
    assert row['hidden_rms_over_normal'] == pytest.approx(2.0)


def test_the_time_to_give_up_is_counted_from_the_first_empty_picture():
    frames = [Frame(None, truth, None) for truth in (1, 1, None, None, None)]
    answers = [Answer(None, state, 0.0, 0.0)
               for state in (TRACKING, TRACKING, COASTING, COASTING, LOST)]
    assert vanishing(frames, [0.0, 0.1, 0.2, 0.3, 0.4], answers) == {
        'coasting_at_once': 1.0, 'lost_after_ms': pytest.approx(200.0)}


def test_cases_cover_what_is_promised_and_stay_in_view():
    names = ' | '.join(BY_NAME)
    for word in ('plain noise 2', 'plain noise 5', 'plain noise 10', 'blur', '20 px', 'rotation',
                 'tilt', 'scale', 'hidden corner', 'hidden side', 'clutter',
                 'gradient and flicker', 'print', 'box', 'distorted', 'vanish'):
        assert word in names
    for case in CASES:
        scene = case.make_scene(1)
        corners = np.array([scene.corners(case.motion.pose(i / 30.0)) for i in range(240)])
        assert case.camera.contains(corners, 5.0).all(), case.name


@pytest.mark.parametrize('speed_px', [3.0, 20.0])
def test_motions_are_as_fast_as_they_say(speed_px):
    motion = Motion(speed_px=speed_px, slowness=0.4, tilt_deg=0.0, turn_deg=0.0, scale=0.0)
    centres = np.array([CAMERA.project(motion.pose(i / 30.0)[:3, 3]) for i in range(240)])
    fastest = np.linalg.norm(np.diff(centres, axis=0), axis=1).max()
    assert 0.85 * speed_px < fastest < 1.05 * speed_px


def test_in_the_box_case_every_side_appears_and_vanishes():
    case = BY_NAME['box']
    scene = Scene(case.camera, FACE_M, case.height_m)
    seen = [{outline.face for outline in scene.layers(case.motion.pose(i / 30.0)).faces}
            for i in range(240)]
    for side in (1, 2, 3, 4):
        shown = [side in faces for faces in seen]
        assert any(shown) and not all(shown)


def test_all_methods_are_judged_on_the_same_pictures():
    case = replace(BY_NAME['plain noise 5'], motion=Motion(speed_px=1.0))
    rows = {row['method']: row for row in run_case(case, 12, 3, True)[0]}
    assert set(rows) == set(PEERS) and all(COLUMNS <= set(row) for row in rows.values())
    assert all(row['frames'] == 12 for row in rows.values())
    for name in PEERS:
        assert rows[name]['corner_rms_px'] < 4.0, name
    first, again = (list(case.frames(3, 3))[2][3].image_grey for _ in range(2))
    assert np.array_equal(first, again)


def test_ours_is_near_the_bound_and_before_all_others():
    rows, times_s = run_case(BY_NAME['plain noise 5'], 30, 3, True)
    assert times_s.shape == (30, 2) and (times_s > 0.0).all()
    rows = {row['method']: row for row in rows}
    ours = rows.pop(OURS)
    assert 0.7 < ours['corner_rms_over_bound'] < 1.4 and ours['frames_lost'] == 0
    assert all(ours['corner_rms_px'] < row['corner_rms_px'] for row in rows.values())


def test_the_bound_of_a_case_grows_with_its_noise():
    bounds = [case_bound_px(BY_NAME[f'plain noise {noise}'], 10, 1) for noise in (2, 5, 10)]
    assert bounds[2] / bounds[1] == pytest.approx(2.0, rel=0.01)
    assert bounds[0] < bounds[1]


def test_random_views_show_the_whole_face():
    rng = np.random.default_rng(4)
    scene = Scene(CAMERA, FACE_M, 0.04)
    for _ in range(50):
        view = random_view(rng)
        assert CAMERA.contains(scene.corners(view), 10.0).all()
        assert 0 in {outline.face for outline in scene.layers(view).faces}
