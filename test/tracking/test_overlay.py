"""What is drawn for people is where it should be."""

from homography_servo.tracking.overlay import draw_path
import numpy as np

SQUARE = np.array([[20.0, 20.0], [60.0, 20.0], [60.0, 50.0], [20.0, 50.0]])


def test_the_path_its_goal_and_the_target_are_drawn():
    path_px = np.array([SQUARE, SQUARE + [20.0, 0.0], SQUARE + [40.0, 10.0]])
    path_px[1, 2, 0] = np.nan
    image = draw_path(np.zeros((100, 140, 3), np.uint8), path_px, 0)
    goal, target = image[60, 90].astype(int), image[50, 40].astype(int)
    assert goal.any() and target.any() and np.abs(goal - target).max() > 50
    assert not image[55, 70].any()  # inside the goal nothing is drawn
    again = draw_path(np.zeros((100, 140, 3), np.uint8), path_px, 1)  # has no place
    assert not again[50, 40].any() and again[60, 90].any()


def test_without_a_path_nothing_is_drawn():
    blank = np.zeros((10, 10, 3), np.uint8)
    nowhere = np.full((3, 4, 2), np.nan)
    for path_px, target in ((None, None), (None, 3), (nowhere, 1), (np.zeros((0, 4, 2)), 0)):
        assert not draw_path(blank.copy(), path_px, target).any()
