"""Pixels are covered by exactly the area that a polygon has in them."""

from homography_servo.simulation.coverage import bounding_region
from homography_servo.simulation.coverage import polygon_coverage
from homography_servo.simulation.coverage import Region
import numpy as np
import pytest


def polygon_area(points: np.ndarray) -> float:
    """Compute the area of a simple polygon by the shoelace formula."""
    following = np.roll(points, -1, axis=0)
    return 0.5 * abs(np.sum(points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]))


def test_coverage_of_random_polygons_adds_up_to_their_area():
    rng = np.random.default_rng(3)
    for _ in range(100):
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 9)))
        if np.diff(angles, append=angles[0] + 2.0 * np.pi).max() > 3.0:
            continue
        polygon = rng.uniform(20, 30, 2) + rng.uniform(3, 18) * np.column_stack(
            [np.cos(angles), np.sin(angles)])
        share = polygon_coverage(polygon, Region(0, 0, 60, 60))
        assert share.sum() == pytest.approx(polygon_area(polygon), abs=1e-9)
        assert share.min() >= 0.0 and share.max() <= 1.0


def test_coverage_of_a_rectangle_is_what_paper_and_pencil_say():
    share = polygon_coverage(np.array([[0.75, 1.0], [2.5, 1.0], [2.5, 1.75], [0.75, 1.75]]),
                             Region(0, 0, 4, 3))
    # Pixels reach half a pixel around their centres: columns 1 and 2, rows 1 and 2.
    assert share[1] == pytest.approx([0.0, 0.75 * 0.5, 1.0 * 0.5, 0.0])
    assert share[2] == pytest.approx([0.0, 0.75 * 0.25, 1.0 * 0.25, 0.0])
    assert share[0] == pytest.approx(0.0)


@pytest.mark.parametrize('sense', [1, -1])
@pytest.mark.parametrize('region', [Region(5, 7, 20, 20), Region(20, 0, 30, 40)])
def test_coverage_does_not_depend_on_sense_or_window(sense, region):
    polygon = np.array([[3.2, 4.1], [40.7, 9.3], [31.0, 35.5], [-6.0, 20.0]])[::sense]
    whole = polygon_coverage(polygon, Region(0, 0, 60, 60))
    assert polygon_coverage(polygon, region) == pytest.approx(whole[region.slices], abs=1e-12)


def area_in_pixel(polygon: np.ndarray, u: int, v: int) -> float:
    """Clip a polygon with the four sides of a pixel, one after the other."""
    for axis, limit, sign in ((0, u - 0.5, 1), (0, u + 0.5, -1), (1, v - 0.5, 1),
                              (1, v + 0.5, -1)):
        inside, kept = sign * (polygon[:, axis] - limit), []
        for i in range(len(polygon)):
            j = (i + 1) % len(polygon)
            if inside[i] >= 0.0:
                kept.append(polygon[i])
            if inside[i] * inside[j] < 0.0:
                share = inside[i] / (inside[i] - inside[j])
                kept.append(polygon[i] + share * (polygon[j] - polygon[i]))
        if len(kept) < 3:
            return 0.0
        polygon = np.array(kept)
    return polygon_area(polygon)


def test_every_pixel_agrees_with_clipping_the_polygon():
    rng = np.random.default_rng(11)
    for _ in range(6):
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 5))
        polygon = rng.uniform(6, 10, 2) + 9.0 * np.column_stack([np.cos(angles), np.sin(angles)])
        share = polygon_coverage(polygon, Region(0, 0, 16, 14))
        expected = [[area_in_pixel(polygon, u, v) for u in range(16)] for v in range(14)]
        assert share == pytest.approx(np.array(expected), abs=1e-12)


@pytest.mark.parametrize('shift', [0.0, 0.5, 1e-12, 0.25])
def test_edges_on_the_grid_and_upright_edges_are_no_trouble(shift):
    square = np.array([[1.0, 2.0], [5.0, 2.0], [5.0, 6.0], [1.0, 6.0]]) + shift
    share = polygon_coverage(square, Region(0, 0, 8, 8))
    assert share.sum() == pytest.approx(16.0) and np.isfinite(share).all()
    assert share[4, 3] == 1.0 and share[0, 0] == 0.0


def test_neighbours_share_an_edge_without_gap_or_overlap():
    first = np.array([[2.3, 3.1], [14.7, 1.9], [9.1, 11.4]])
    second = np.array([[14.7, 1.9], [17.2, 13.3], [9.1, 11.4]])
    both = np.array([[2.3, 3.1], [14.7, 1.9], [17.2, 13.3], [9.1, 11.4]])
    region = Region(0, 0, 20, 20)
    together = polygon_coverage(first, region) + polygon_coverage(second, region)
    assert together == pytest.approx(polygon_coverage(both, region), abs=1e-12)


def test_a_polygon_around_or_beside_the_region_covers_all_or_nothing():
    region = Region(10, 10, 5, 5)
    large = np.array([[-100.0, -90.0], [200.0, -95.0], [210.0, 190.0], [-80.0, 180.0]])
    assert polygon_coverage(large, region) == pytest.approx(1.0, abs=1e-12)
    for beside in ((-50.0, 0.0), (50.0, 0.0), (0.0, -50.0), (0.0, 50.0)):
        square = np.array([[8.0, 8.0], [17.0, 8.0], [17.0, 17.0], [8.0, 17.0]]) + beside
        assert polygon_coverage(square, region) == pytest.approx(0.0, abs=1e-12)


def test_bounding_regions_stay_inside_the_image():
    points = np.array([[-30.0, 5.0], [12.0, 700.0]])
    region = bounding_region(points, 640, 480, 3)
    assert region == Region(0, 2, 16, 478)
    assert bounding_region(points + 5000.0, 640, 480, 3).empty
