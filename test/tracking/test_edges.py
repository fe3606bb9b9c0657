"""Edges are measured where they are, as surely as the noise allows."""

import cv2
from face_views import BENT
from face_views import CAMERA
from face_views import FACE_M
from face_views import pose
from homography_servo.result import Rejected
from homography_servo.simulation.coverage import polygon_coverage
from homography_servo.simulation.coverage import Region
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking.edges import measure_edges
from homography_servo.tracking.focus import first_focus
from homography_servo.tracking.focus import refocus
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import fit_polygon
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.profile import edge_profile
from homography_servo.tracking.scan import read_scan
from homography_servo.tracking.scan import side_geometry
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.snake import let_go
import numpy as np
import pytest

IDEAL, LOOK = Plane(None), Look(0.8, 4)
SHAPE = np.array([[-53.0, -32.0], [53.0, -32.0], [53.0, 32.0], [-53.0, 32.0]])


def quad(rng, centre=(160.0, 120.0), bend=3.0):
    angle = rng.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return SHAPE @ turn.T + centre + rng.uniform(-bend, bend, (4, 2))


def blurred_share(corners, blur, fine=4):
    """Blur finely covered pixels, so that the kernel's few taps are no staircase."""
    wide = Region(0, 0, 320 * fine, 240 * fine)
    share = polygon_coverage(fine * (corners + 0.5) - 0.5, wide).astype(np.float32)
    reach = 2 * int(np.ceil(6.0 * blur * fine)) + 1
    soft = cv2.GaussianBlur(share, (reach, reach), blur * fine)
    return cv2.resize(soft, (320, 240), interpolation=cv2.INTER_AREA).astype(float)


def picture(corners, rng, noise=5.0, blur=0.8, inside=200.0, outside=75.0):
    soft = blurred_share(corners, blur)
    grey = outside + (inside - outside) * soft + noise * rng.standard_normal(soft.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def test_profile_is_a_step_with_its_slope():
    profile = edge_profile(0.8)
    at = np.linspace(-6.0, 6.0, 4001)
    place = profile.places(np.array((at, np.zeros_like(at)), np.float32), 1)
    share, slope = profile.share(place)[0], profile.slope(place)[0]
    assert (share[0], share[2000], share[-1]) == pytest.approx((0.0, 0.5, 1.0), abs=0.01)
    assert (np.diff(share) >= 0.0).all()
    assert slope.sum() * (at[1] - at[0]) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize('seed', range(4))
def test_every_pixel_near_a_side_is_read_once(seed):
    corners = quad(np.random.default_rng(seed))
    image = np.arange(240 * 320, dtype=np.int64).reshape(240, 320)
    scan = read_scan((image % 251).astype(np.uint8), corners, IDEAL, 4)
    total = scan.grey.shape[1]
    count = np.arange(9)[:, None]
    start, step = scan.place[:, :, None, :total]
    u, v = start + count * step
    assert scan.grey == pytest.approx((320 * v + u) % 251)
    for side in range(4):
        own = scan.layout.side[:total] == side
        places = set(zip(u[:, own].ravel(), v[:, own].ravel()))
        assert len(places) == 9 * own.sum()


def test_distances_are_zero_on_the_sides_and_positive_inside():
    geometry = side_geometry(SHAPE)
    to_centre = -geometry.level
    assert (to_centre > 0.0).all()
    on_side = (geometry.normal.T * SHAPE).sum(axis=1)
    assert on_side == pytest.approx(geometry.level)


@pytest.mark.parametrize('shift', [(-0.6, 0.3), (0.0, 0.2), (0.0, 0.0), (0.9, -0.2)])
def test_a_shifted_expectation_is_measured_as_that_shift(shift):
    rng = np.random.default_rng(5)
    corners = quad(rng, bend=0.0)
    image, moved = picture(corners, rng, noise=0.5), corners + shift
    edges = measure_edges(read_scan(image, moved, IDEAL, 4), moved, edge_profile(0.8))
    inner = (edges.along > 0.15) & (edges.along < 0.85)
    expected = -(shift @ edges.normal)
    tolerance = 0.03 + 0.15 * np.abs(expected[inner])
    assert (np.abs(edges.inward - expected)[inner] < tolerance).all()
    assert edges.contrast[inner] == pytest.approx(125.0, abs=12.0)


def test_stated_variance_is_the_real_one():
    rng, misses, sigmas = np.random.default_rng(8), [], []
    for _ in range(25):
        corners = quad(rng)
        scan = read_scan(picture(corners, rng), corners, IDEAL, 4)
        edges = measure_edges(scan, corners, edge_profile(0.8))
        inner = (edges.along > 0.15) & (edges.along < 0.85)
        misses.append(edges.inward[inner])
        sigmas.append(np.sqrt(edges.variance[inner]))
    ratio = np.concatenate(misses) / np.concatenate(sigmas)
    assert ratio.std() == pytest.approx(1.0, abs=0.15)
    assert ratio.mean() == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize('noise', [2.0, 5.0, 10.0])
def test_corners_come_close_to_the_cramer_rao_bound(noise):
    rng, errors, bounds = np.random.default_rng(11), [], []
    for number in range(40):
        corners = quad(rng)
        fit = fit_snake(picture(corners, rng, noise), corners + rng.normal(0.0, 0.3, (4, 2)),
                        Look(0.8, 4))
        errors.append(fit.corners - corners)
        if number < 4:
            bounds.append(bound_px2(corners, noise))
    rms = np.sqrt(np.mean(np.square(errors)))
    assert rms < 1.3 * np.sqrt(np.mean(bounds))
    assert np.abs(np.mean(errors, axis=0)).max() < 5.0 * rms / np.sqrt(len(errors))


def test_the_first_step_is_as_long_as_it_must_be():
    rng, gains = np.random.default_rng(3), []
    for _ in range(60):
        corners, away = quad(rng), rng.choice([-0.3, 0.3], 2)
        fit = fit_snake(picture(corners, rng), corners + away, Look(0.8, 4, iterations=1))
        gains.append((fit.corners - corners - away).mean(axis=0) / -away)
    assert np.mean(gains) == pytest.approx(1.0, abs=0.015)


def test_segments_that_noise_cannot_explain_hardly_count():
    rng = np.random.default_rng(15)
    corners = quad(rng, bend=0.0)
    edges = measure_edges(read_scan(picture(corners, rng), corners, IDEAL, 4), corners,
                          edge_profile(0.8))
    odd = (edges.side == 0) & (edges.along < 0.4)
    shifted = edges._replace(inward=edges.inward + 0.2 * odd)
    foreign = shifted._replace(residual=edges.residual * np.where(odd, 6.0, 1.0),
                               variance=edges.variance * np.where(odd, 6.0, 1.0))
    every = np.ones(len(odd), bool)
    wrong, guarded, without = (
        fit_polygon(each, corners, usable, None, Look(0.8, 4)).corners
        for each, usable in ((shifted, every), (foreign, every), (edges, ~odd)))
    assert np.abs(wrong - without).max() > 0.1
    assert np.abs(guarded - without).max() < 0.03


def bound_px2(corners, noise, step=0.05, blur=0.8):
    """Give the mean variance of a corner coordinate that no unbiased method can beat."""
    def clean(places):
        return 125.0 * blurred_share(places, blur)
    rows = []
    for number in range(8):
        shift = np.zeros(8)
        shift[number] = step
        shift = shift.reshape(4, 2)
        rows.append((clean(corners + shift) - clean(corners - shift)).ravel() / (2.0 * step))
    rows = np.array(rows)
    return np.trace(np.linalg.inv(rows @ rows.T / (noise ** 2 + 1.0 / 12.0))) / 8.0


def test_stated_covariance_of_corners_is_the_real_one():
    rng, pulls = np.random.default_rng(12), []
    for _ in range(40):
        corners = quad(rng)
        fit = fit_snake(picture(corners, rng), corners, Look(0.8, 4))
        pulls.append(((fit.corners - corners).ravel() / np.sqrt(np.diag(fit.covariance))))
    assert 0.7 < np.std(pulls) < 1.15


def test_a_dark_face_and_low_contrast_work_alike():
    rng = np.random.default_rng(2)
    corners = quad(rng)
    dark = picture(corners, rng, 2.0, inside=60.0, outside=90.0)
    fit = fit_snake(dark, corners + 0.5, Look(0.8, 4))
    assert np.abs(fit.corners - corners).max() < 0.3
    assert fit.quality.contrast == pytest.approx(-30.0, abs=3.0)
    assert isinstance(fit_snake(dark, corners, Look(0.8, 4), polarity=1), Rejected)


def test_a_hidden_side_does_not_drag_the_others():
    rng = np.random.default_rng(4)
    corners = quad(rng, bend=0.0)
    image = picture(corners, rng, 3.0)
    middle = 0.5 * (corners[0] + corners[1])
    cv2.circle(image, tuple(int(v) for v in middle), 18, 120, -1)
    fit = fit_snake(image, corners + 0.4, Look(0.8, 4))
    assert np.abs(fit.corners - corners).max() < 0.15
    assert fit.quality.side_share[0] < 0.9 < fit.quality.side_share[2]


@pytest.mark.parametrize('polarity, returns', [(0, True), (1, True), (-1, False)])
def test_corners_that_are_let_go_return_to_their_edges(polarity, returns):
    rng = np.random.default_rng(8)
    corners = quad(rng)
    away = corners + rng.uniform(-0.5, 0.5, (4, 2))
    held = fit_snake(picture(corners, rng, 2.0), away, LOOK, prior=Prior(away, 1e6 * np.eye(8)))
    assert np.abs(held.corners - corners).max() > 0.3
    free = let_go(held, LOOK, polarity)
    assert (np.abs(free.corners - corners).max() < 0.1) == returns


def test_nothing_to_see_is_refused_with_a_reason():
    flat = np.full((240, 320), 90, np.uint8)
    assert 'segments show an edge' in fit_snake(flat, SHAPE + 120.0, Look(0.8, 4)).reason
    assert 'inside the image' in fit_snake(flat, SHAPE - 900.0, Look(0.8, 4)).reason


def test_pixels_that_lie_off_the_edge_tell_nothing_and_do_no_harm():
    rng = np.random.default_rng(1)
    corners = quad(rng)
    scan = read_scan(picture(corners, rng), corners, IDEAL, 4)
    wider = corners + 0.3
    wider[1:3] += 0.4 * (corners[1] - corners[0])
    with np.errstate(all='raise', under='ignore'):
        edges = measure_edges(scan, wider, edge_profile(0.8))
    off = edges.side == 1
    assert np.isfinite(edges.inward).all()
    assert edges.variance[off].min() > 1.0 > edges.variance[~off].max()


@pytest.mark.parametrize('blur', [0.7, 1.0, 2.0])
def test_blur_is_learnt(blur):
    rng = np.random.default_rng(6)
    corners = quad(rng)
    image = picture(corners, rng, 3.0, blur)
    scan = read_scan(image, corners, IDEAL, 8)
    found = first_focus(scan, corners)
    everywhere = np.ones(len(scan.layout.lines), bool)
    for _ in range(12):
        found = refocus(scan, corners, everywhere, found)
    assert found == pytest.approx(blur, rel=0.15, abs=0.05)


def test_a_bent_lens_costs_nothing():
    scene = Scene(BENT, FACE_M, 0.0, SceneSettings(noise_grey=2.0))
    plane, errors = Plane(BENT), []
    for number, place in enumerate(((0.15, 0.1), (-0.18, 0.08), (0.1, -0.12))):
        frame = scene.render(pose(*place, 0.75, 10.0, 12.0, 20.0 * number), 0.0, number)
        truth = plane.from_image(frame.true_corners_px)
        fit = fit_snake(frame.image_grey, truth + 0.3, Look(0.6, 4), plane)
        errors.append(plane.to_image(fit.corners) - frame.true_corners_px)
    assert np.abs(errors).max() < 0.06
    shown = plane.to_image(plane.from_image(frame.true_corners_px))
    assert shown == pytest.approx(frame.true_corners_px, abs=1e-6)


def test_a_bent_lens_carries_the_covariance():
    plane, rng = Plane(BENT), np.random.default_rng(0)
    corners = np.array([[60.0, 60.0], [150.0, 70.0], [140.0, 130.0], [50.0, 120.0]])
    root = rng.normal(size=(8, 8)) * 0.01
    covariance = root @ root.T
    samples = corners.ravel() + rng.multivariate_normal(np.zeros(8), covariance, 4000)
    shown = plane.to_image(samples.reshape(-1, 4, 2)).reshape(-1, 8)
    bent, expected = plane.to_image_with_covariance(corners, covariance)
    assert bent == pytest.approx(plane.to_image(corners), abs=1e-9)
    assert np.cov(shown.T) == pytest.approx(expected, abs=0.1 * np.abs(expected).max())
    straight = Plane(CAMERA).to_image_with_covariance(corners, covariance)
    assert straight[0] is corners
    assert straight[1] is covariance
