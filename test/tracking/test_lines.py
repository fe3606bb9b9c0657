"""Scan lines cover the sides, and their arrangement rests while the polygon moves."""

from homography_servo.tracking.lines import CORNER_REACH_PX
from homography_servo.tracking.lines import lines_within
from homography_servo.tracking.lines import place_lines
import numpy as np
import pytest

HALF, PER_SEGMENT, ROUND_PX = 4, 6, 8


def quad(angle=0.2, centre=(160.0, 120.0)):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.array([[-53.0, -32.0], [53.0, -32.0], [53.0, 32.0], [-53.0, 32.0]]) @ turn.T \
        + centre


def lay(corners):
    return place_lines(corners, None, HALF, 1, PER_SEGMENT, None, ROUND_PX)


@pytest.mark.parametrize('angle', np.linspace(-3.0, 3.0, 9))
def test_lines_reach_from_corner_to_corner_and_hardly_beyond(angle):
    corners = quad(angle)
    lines = lay(corners)
    layout, total = lines.layout, lines.layout.total
    along = np.array([lines.along[layout.side[:total] == side] for side in range(4)],
                     dtype=object)
    for side, places in enumerate(along):
        step = np.abs(np.diff(places.astype(float))).max()
        reach = (CORNER_REACH_PX + 0.25 * ROUND_PX) * step
        assert -reach <= places.min() < 0.5 * ROUND_PX * step
        assert 1.0 - 0.5 * ROUND_PX * step < places.max() <= 1.0 + reach
        assert len(places) % ROUND_PX == 0


def test_each_line_crosses_its_side_in_its_middle():
    corners = quad()
    lines = lay(corners)
    layout, total = lines.layout, lines.layout.total
    start, step = lines.place[:, :, :total]
    middle = start + HALF * step
    side = layout.side[:total]
    edge = np.roll(corners, -1, axis=0) - corners
    on_side = corners[side] + lines.along[:, None] * edge[side]
    assert np.abs(middle.T - on_side).max() <= 0.5 + 1e-9


def test_lines_near_a_corner_are_repeated_for_the_side_across_it():
    layout = lay(quad()).layout
    across, own = layout.side[layout.total:], layout.side[:layout.near]
    assert set((across - own) % 4) == {1, 3}


def test_the_layout_rests_while_the_polygon_moves():
    layouts = [lay(quad(centre=(160.0 + shift, 120.0 - 0.3 * shift))).layout
               for shift in np.linspace(0.0, 9.0, 30)]
    assert sum(after is before for before, after in zip(layouts, layouts[1:])) >= 20


def test_segments_cut_every_side_into_neighbouring_lines():
    layout = lay(quad()).layout
    ends = np.append(layout.first_line[1:], layout.total)
    assert np.array_equal(ends - layout.first_line, layout.lines)
    for first, last, side in zip(layout.first_line, ends, layout.segment_side):
        assert (layout.side[first:last] == side).all()
    assert layout.lines.min() >= 4 and layout.lines.max() <= 8


@pytest.mark.parametrize('angle', np.linspace(-3.0, 3.0, 9))
def test_segments_are_as_short_at_the_corners_as_between(angle):
    # A longer one would mix more of what hides a side with the little that shows of it.
    layout = lay(quad(angle)).layout
    at_ends = layout.first_line < layout.near
    assert 8 <= np.count_nonzero(at_ends) < len(at_ends)
    for lines in (layout.lines[at_ends], layout.lines[~at_ends]):
        assert abs(lines - PER_SEGMENT).max() <= 1


def test_lines_that_would_leave_the_image_are_left_out():
    lines = lay(quad(centre=(30.0, 120.0)))
    kept = lines_within(lines, HALF, (240, 320), PER_SEGMENT)
    total = kept.layout.total
    assert 0 < total < lines.layout.total
    start = kept.place[0, :, :total]
    assert start.min() >= 0.0
    assert np.array_equal(np.unique(kept.layout.segment_side), np.unique(kept.layout.side))
    places = {tuple(place) for place in lines.place[0, :, :lines.layout.total].T}
    assert {tuple(place) for place in start.T} <= places
