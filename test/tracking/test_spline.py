"""The spline is the paper's: closed, quadratic, through its corners."""

from homography_servo.tracking.spline import ClosedSpline
import numpy as np
import pytest
from scipy.interpolate import BSpline

SHAPES = [(4, 2), (3, 1), (5, 3), (4, 1)]


def random_control(spline, seed=3):
    return np.random.default_rng(seed).normal(size=(spline.control_count, 2))


def test_the_papers_box_has_twelve_control_points_on_eight_spans():
    spline = ClosedSpline(4, 2)
    assert (spline.control_count, spline.parameters[-1] < 8.0) == (12, True)


@pytest.mark.parametrize('corners, spans', SHAPES)
def test_basis_sums_to_one_and_is_never_negative(corners, spans):
    spline = ClosedSpline(corners, spans)
    assert spline.basis.sum(axis=1) == pytest.approx(1.0)
    assert spline.slope_basis.sum(axis=1) == pytest.approx(0.0, abs=1e-12)
    assert spline.basis.min() >= 0.0
    assert (np.count_nonzero(spline.basis, axis=1) <= 3).all()


@pytest.mark.parametrize('corners, spans', SHAPES)
def test_each_side_is_the_b_spline_with_doubled_corner_knots(corners, spans):
    spline = ClosedSpline(corners, spans)
    control = random_control(spline)
    knots = np.concatenate([[0.0, 0.0], np.arange(spans + 1), [spans, spans]])
    at = np.linspace(0.0, spans - 1e-9, 17)
    side = BSpline(knots, control[:spans + 2], 2)(at)
    assert spline.basis_at(at)[0] @ control == pytest.approx(side, abs=1e-12)


@pytest.mark.parametrize('corners, spans', SHAPES)
def test_curve_closes_and_passes_through_its_corners(corners, spans):
    spline = ClosedSpline(corners, spans, 8)
    control = random_control(spline)
    assert spline.curve(control)[::8 * spans] == pytest.approx(spline.corners(control))
    ends = spline.basis_at(np.array([0.0, corners * spans]))[0] @ control
    assert ends[0] == pytest.approx(ends[1])


def test_slopes_agree_with_finite_differences():
    spline, step = ClosedSpline(4, 2), 1e-6
    ahead, _ = spline.basis_at(spline.parameters + step)
    assert (ahead - spline.basis) / step == pytest.approx(spline.slope_basis, abs=1e-5)


@pytest.mark.parametrize('corners, spans', SHAPES)
def test_straight_sides_run_evenly_from_corner_to_corner(corners, spans):
    spline = ClosedSpline(corners, spans, 4)
    points = np.random.default_rng(1).normal(size=(corners, 2))
    side, share = np.divmod(spline.parameters / spans, 1.0)
    side = side.astype(int)
    straight = points[side] + share[:, None] * (points[(side + 1) % corners] - points[side])
    assert spline.curve(spline.control(points)) == pytest.approx(straight, abs=1e-12)


def test_normals_of_a_clockwise_square_point_inwards():
    spline = ClosedSpline(4, 2)
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    control = spline.control(square)
    inner = spline.curve(control) + spline.normals(control)
    inside_sides = spline.parameters % 2.0 > 0.0  # at a corner there is no normal
    assert np.abs(inner - 5.0)[inside_sides].max() < 5.0
    assert np.linalg.norm(spline.normals(control), axis=1) == pytest.approx(1.0)


def test_impossible_shapes_are_refused():
    with pytest.raises(ValueError, match='at least 3 corners'):
        ClosedSpline(2, 2)
