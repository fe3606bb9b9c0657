"""A real box in front of a real camera: weak edges, print, a video file's noise."""

import csv

import cv2
from homography_servo.geometry.camera import Camera
from homography_servo.tracking.overlay import draw_track
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker import TRACKING
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np
import pytest

CAMERA = Camera(839.2147, 839.4456, 325.6678, 243.6973, 640, 480)
FACE_M = (0.068, 0.080)
FIRST_PX = (352.0, 204.0, 490.0, 188.0, 457.0, 349.0, 330.0, 378.0)
ORDER = [0, 3, 2, 1]  # the reference goes round the other way
RATE_HZ = 25.0


def reference(folder):
    with (folder / 'reference.csv').open() as file:
        rows = [[float(row[f'{axis}{corner}']) for corner in range(4) for axis in 'uv']
                for row in csv.DictReader(file)]
    return np.array(rows).reshape(-1, 4, 2)[:, ORDER]


def frames(folder):
    video = cv2.VideoCapture(str(folder / 'teabox.mp4'))
    more, frame = video.read()
    while more:
        yield frame
        more, frame = video.read()


@pytest.fixture
def teabox(shared_dir):
    folder = shared_dir / 'data' / 'teabox'
    if not (folder / 'teabox.mp4').is_file():
        pytest.skip(f'needs {folder}')
    return folder


@pytest.mark.parametrize('camera', [CAMERA, None], ids=['calibrated', 'uncalibrated'])
def test_every_frame_is_tracked_close_to_the_reference(teabox, tmp_path, camera, capsys):
    tracker = Tracker(FACE_M, TrackerSettings(initial_corners_px=FIRST_PX), camera)
    expected, distances = reference(teabox), []
    for index, frame in enumerate(frames(teabox)):
        track = tracker.update(np.ascontiguousarray(frame[:, :, 0]), 1.0 + index / RATE_HZ)
        assert track.state == TRACKING, f'frame {index}: {track.reason}'
        distances.append(np.linalg.norm(track.corners_px - expected[index], axis=1))
    assert len(distances) == 39
    picture = tmp_path / 'overlay.png'
    assert cv2.imwrite(str(picture), draw_track(frame, track))
    with capsys.disabled():
        print(f'\nteabox: corner distances, mean {np.mean(distances):.2f} px, largest '
              f'{np.max(distances):.2f} px; {picture}')
    assert np.max(distances) < 4.0


def test_a_video_that_begins_again_is_found_again_where_it_began(teabox):
    tracker = Tracker(FACE_M, TrackerSettings(initial_corners_px=FIRST_PX), CAMERA)
    expected, pictures = reference(teabox), list(frames(teabox))
    good = 0
    for index in range(2 * len(pictures)):
        frame = pictures[index % len(pictures)]
        track = tracker.update(np.ascontiguousarray(frame[:, :, 0]), 1.0 + index / RATE_HZ)
        if track.corners_px is not None:
            wanted = expected[index % len(pictures)]
            assert np.linalg.norm(track.corners_px - wanted, axis=1).max() < 4.0
            good += index >= len(pictures)
    assert good >= 30
