"""Straight edges, sides, quadrilaterals and views that may be the face."""

from face_views import CAMERA
from face_views import FACE_M
from face_views import pose
from homography_servo.geometry.face import face_corners
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking.detection.beside import faces_beside
from homography_servo.tracking.detection.box_fit import held_by_box
from homography_servo.tracking.detection.box_fit import nearer
from homography_servo.tracking.detection.box_views import box_points
from homography_servo.tracking.detection.box_views import look_at
from homography_servo.tracking.detection.box_views import odds
from homography_servo.tracking.detection.outlook import look_across
from homography_servo.tracking.detection.outlook import Picture
from homography_servo.tracking.detection.outlook import rows_across
from homography_servo.tracking.detection.outlook import smoothed
from homography_servo.tracking.detection.segments import find_pieces
from homography_servo.tracking.detection.segments import Pieces
from homography_servo.tracking.detection.segments import shrunk
from homography_servo.tracking.detection.segments import straightened
from homography_servo.tracking.detection.side_quads import find_corners
from homography_servo.tracking.detection.side_quads import find_quads
from homography_servo.tracking.detection.side_quads import find_threes
from homography_servo.tracking.detection.side_quads import quads_of_three
from homography_servo.tracking.detection.sides import join_pieces
from homography_servo.tracking.detection.sides import matches
from homography_servo.tracking.detection.views import Views
from homography_servo.tracking.detection.views import views_of_face
from homography_servo.tracking.detection.views import with_mirrored
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.target import Target
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

PLANE = Plane(CAMERA)
TARGET = Target(FACE_M, 0.04, 0.15, 1.5, 0, 0.6)
TILTED = pose(0.05, -0.03, 0.8, 30.0, -20.0, 25.0)


def projected(camera_from_object, points_m):
    return CAMERA.project(points_m @ camera_from_object[:3, :3].T + camera_from_object[:3, 3])


def view(camera_from_object):
    """Make the view of the face in a pose."""
    corners = projected(camera_from_object, face_corners(*FACE_M))
    return Views(corners[None], camera_from_object[None, :3, :3],
                 camera_from_object[None, :3, 3], np.zeros(1))


def sides_of(corners, which=(0, 1, 2, 3), level=200.0):
    """Make pieces of the sides of a polygon, 5 % short at either end."""
    edge = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(edge, axis=1)
    pieces = Pieces(corners + 0.05 * edge, edge / length[:, None], 0.9 * length,
                    np.full(len(edge), level))
    return pieces.chosen(np.array(which))


def nearest(quads, corners):
    """Give the largest corner distance of the nearest quadrilateral in any turn."""
    return min(np.linalg.norm(np.roll(quad, turn, axis=0) - corners, axis=1).max()
               for quad in quads for turn in range(4))


@pytest.mark.parametrize('hand', [1, -1])
def test_straight_edges_have_their_inside_at_the_right_hand(hand):
    scene = Scene(CAMERA, FACE_M, 0.0, SceneSettings())
    frame = scene.render(TILTED, 0.0, 0)
    pieces = straightened(find_pieces(shrunk(frame.image_grey), hand), PLANE)
    assert len(pieces.length) == 4
    expected = sides_of(frame.true_corners_px)
    for number in range(4):
        own = int(np.argmax(hand * pieces.direction @ expected.direction[number]))
        normal = expected.direction[number] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        ends = pieces.start[own] + np.outer([0.0, pieces.length[own]], pieces.direction[own])
        assert np.abs((ends - frame.true_corners_px[number]) @ normal).max() < 0.7
        assert pieces.level[own] == pytest.approx(200.0 if hand > 0 else 75.0, abs=4.0)


def test_a_picture_without_edges_has_no_pieces():
    assert not len(find_pieces(np.full((60, 80), 50, np.uint8), 0).length)


def test_pieces_in_line_become_one_side():
    near = pose(z=0.4)
    whole = sides_of(projected(near, face_corners(*FACE_M)))
    first, last = (Pieces(whole.start + share * whole.length[:, None] * whole.direction,
                          whole.direction, 0.4 * whole.length, whole.level)
                   for share in (0.0, 0.6))
    sides = join_pieces(Pieces(*(np.concatenate(part) for part in zip(first, last))))
    assert len(sides.seen) == 4
    assert np.sort(sides.pieces.length) == pytest.approx(np.sort(whole.length))
    assert sides.seen == pytest.approx(0.8 * sides.pieces.length)
    other = last._replace(level=last.level - 50.0)
    assert len(join_pieces(Pieces(*(np.concatenate(part)
                                    for part in zip(first, other)))).seen) == 8


def test_matches_are_all_pairs_within_the_range():
    ordered = np.array([1.0, 2.0, 2.0, 5.0])
    one, two = matches(np.array([2.0, 0.0, 6.0]), np.array([5.0, 1.5, 7.0]), ordered)
    assert list(zip(one, two)) == [(0, 1), (0, 2), (0, 3), (1, 0)]


@pytest.mark.parametrize('left_out', [0, 1, 2, 3])
def test_three_sides_and_the_proportions_give_the_fourth(left_out):
    corners = projected(TILTED, face_corners(*FACE_M))
    sides = join_pieces(sides_of(corners, [side for side in range(4) if side != left_out]))
    found = find_corners(sides)
    quads = quads_of_three(sides, found, find_threes(sides, found), FACE_M, PLANE)
    assert nearest(quads, corners) < 0.01


def test_four_sides_give_their_quadrilateral_clockwise():
    corners = projected(TILTED, face_corners(*FACE_M))
    quads = find_quads(join_pieces(sides_of(corners)), FACE_M, PLANE)
    assert nearest(quads, corners) < 0.001
    edge = np.roll(quads, -1, axis=1) - quads
    after = np.roll(edge, -1, axis=1)
    assert (edge[..., 0] * after[..., 1] - edge[..., 1] * after[..., 0] > 0.0).all()
    assert find_quads(join_pieces(sides_of(corners[::-1])), FACE_M, PLANE).shape == (0, 4, 2)


@pytest.mark.parametrize('turn', [0, 1])
def test_views_are_the_poses_that_were_projected(turn):
    quad = np.roll(projected(TILTED, face_corners(*FACE_M)), turn, axis=0)
    views = views_of_face(quad[None], FACE_M, PLANE)
    best = int(np.argmin(views.miss_px))
    assert views.miss_px[best] < 1e-3
    half_turn = np.trace(views.rotation[best].T @ TILTED[:3, :3]) < 0.0
    rotation = views.rotation[best] @ np.diag([-1.0, -1.0, 1.0] if half_turn else [1.0] * 3)
    assert rotation == pytest.approx(TILTED[:3, :3], abs=1e-4)
    assert views.translation[best] == pytest.approx(TILTED[:3, 3], abs=1e-5)


def test_a_mirrored_view_far_away_looks_the_same():
    far = view(pose(0.5, 0.2, 8.0, 40.0, 10.0, 30.0))
    both = with_mirrored(far)
    again = projected(np.block([[both.rotation[1], both.translation[1][:, None]],
                                [np.zeros((1, 3)), 1.0]]), face_corners(*FACE_M))
    assert np.abs(again - far.corners[0]).max() < 0.1
    assert np.linalg.det(both.rotation[1]) == pytest.approx(1.0)
    assert both.facing[1] == pytest.approx(both.facing[0])
    assert np.abs(both.rotation[1] - both.rotation[0]).max() > 0.5


@pytest.mark.parametrize('away_px', [-2.5, 0.0, 1.5])
def test_changes_of_level_are_measured_across_the_sides(away_px):
    image = np.full((200, 300), 60, np.uint8)
    image[50:150, 80:220] = 180
    corners = np.array([[79.5, 49.5], [219.5, 49.5], [219.5, 149.5], [79.5, 149.5]])
    grown = corners + away_px * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    seen = look_across(Picture(image, image, 9.0),
                       rows_across(grown[None], np.linspace(0.1, 0.9, 5)), PLANE, 8.0, -8.0, 17)
    assert seen.shown.all() and seen.even.all()
    assert np.abs(seen.inward_px - away_px).max() <= 0.5
    assert seen.level == pytest.approx(180.0)


def test_the_box_tells_the_true_tilt_from_the_mirrored_one():
    scene = Scene(CAMERA, FACE_M, 0.04, SceneSettings())
    picture = smoothed(scene.render(TILTED, 0.0, 0).image_grey)
    points_m = box_points(FACE_M, 0.04)
    true, mirrored = odds(look_at(picture, with_mirrored(view(TILTED)), points_m, PLANE), 4.0)
    assert true > mirrored + 2.0
    flat = look_at(picture, view(TILTED), points_m[:4], PLANE)
    assert flat.back is None and odds(flat, 4.0)[0] > 1.5


def test_a_face_that_was_looked_at_needs_no_second_look():
    scene = Scene(CAMERA, FACE_M, 0.04, SceneSettings())
    picture = smoothed(scene.render(TILTED, 0.0, 0).image_grey)
    points_m, views = box_points(FACE_M, 0.04), with_mirrored(view(TILTED))
    whole = look_at(picture, views, points_m, PLANE)
    face = look_at(picture, views, points_m[:4], PLANE).face
    parts = look_at(picture, views, points_m, PLANE, face)
    for one, other in zip(whole[:3], parts[:3]):
        assert all(np.array_equal(a, b) for a, b in zip(one, other))


def test_a_side_of_the_box_that_is_missing_speaks_against_the_face():
    plate = Scene(CAMERA, FACE_M, 0.0, SceneSettings()).render(pose(tilt_x=30.0), 0.0, 0)
    picture, points_m = smoothed(plate.image_grey), box_points(FACE_M, 0.04)
    seen = look_at(picture, view(pose(tilt_x=30.0)), points_m, PLANE)
    assert seen.sure.sum() == pytest.approx(1.0)
    assert odds(seen, 4.0)[0] < -2.0


def test_where_no_side_of_the_box_is_in_view_nothing_is_told():
    front = Scene(CAMERA, FACE_M, 0.04, SceneSettings()).render(pose(turn=20.0), 0.0, 0)
    picture, points_m = smoothed(front.image_grey), box_points(FACE_M, 0.04)
    of_box, of_face = (odds(look_at(picture, view(pose(turn=20.0)), points, PLANE), 4.0)[0]
                       for points in (points_m, points_m[:4]))
    assert of_box == of_face > 1.5


@pytest.mark.parametrize('tilt', [(40.0, 3.0), (-40.0, 3.0), (3.0, 40.0), (3.0, -40.0)])
def test_the_face_follows_from_a_side_of_its_box(tilt):
    camera_from_object = pose(0.03, 0.02, 0.8, *tilt, 25.0)
    points_m = box_points(FACE_M, 0.04)
    corners = projected(camera_from_object, points_m)
    sides = [np.array([corners[(k + 1) % 4], corners[k], corners[k + 4],
                       corners[(k + 1) % 4 + 4]]) for k in range(4)]
    in_view = max(sides, key=signed_area)
    for turn in range(4):
        faces = faces_beside(np.roll(in_view, turn, axis=0), TARGET, PLANE)
        assert nearest(faces.corners, corners[:4]) < 0.1
    plate = TARGET._replace(box_height_m=0.0)
    assert not len(faces_beside(in_view, plate, PLANE).corners)


def signed_area(quad):
    """Measure a quadrilateral that runs clockwise on the screen; else it is negative."""
    one, two = quad[2] - quad[0], quad[3] - quad[1]
    return one[0] * two[1] - one[1] * two[0]


def test_rough_views_move_to_the_edges():
    scene = Scene(CAMERA, FACE_M, 0.04, SceneSettings())
    picture = smoothed(scene.render(TILTED, 0.0, 0).image_grey)
    rough, points_m = TILTED.copy(), box_points(FACE_M, 0.04)
    rough[:3, 3] += 0.003, -0.002, 0.01
    rough[:3, :3] = Rotation.from_euler('xyz', [2.0, -2.0, 1.0],
                                        degrees=True).as_matrix() @ rough[:3, :3]
    views, truth = view(rough), projected(TILTED, face_corners(*FACE_M))
    assert np.abs(views.corners[0] - truth).max() > 3.0
    for _ in range(3):
        views = nearer(views, look_at(picture, views, points_m, PLANE), points_m, PLANE)
    assert np.abs(views.corners[0] - truth).max() < 1.0


def test_the_edges_of_the_box_tell_how_long_the_face_is():
    image = Scene(CAMERA, FACE_M, 0.04, SceneSettings()).render(TILTED, 0.0, 0).image_grey
    points_m = box_points(FACE_M, 0.04)
    truth = projected(TILTED, face_corners(*FACE_M))
    longer = 0.03 * (truth[1] - truth[0] + truth[2] - truth[3])  # as if a side had no edge
    away = np.array([0.0 * longer, longer, longer, 0.0 * longer])
    told = held_by_box(smoothed(image), truth + away, points_m, PLANE)
    along = away.ravel() / np.linalg.norm(away)
    weight = told.information @ along
    assert np.linalg.norm(away) > 4.0
    assert abs(weight @ (told.corners - truth).ravel()) < 0.5 * (weight @ along)  # 0.5 px
    assert weight @ along > 1.0  # per px^2
    assert held_by_box(smoothed(image), truth, points_m[:4], PLANE) is None
    assert held_by_box(smoothed(image), np.zeros((4, 2)), points_m, PLANE) is None


def test_nothing_in_nothing_out():
    views = views_of_face(np.zeros((0, 4, 2)), FACE_M, PLANE)
    points_m, picture = box_points(FACE_M, 0.04), smoothed(np.zeros((480, 640), np.uint8))
    seen = look_at(picture, views, points_m, PLANE)
    assert len(nearer(views, seen, points_m, PLANE).miss_px) == 0 == len(odds(seen, 4.0))


def test_more_lines_are_read_than_a_picture_of_opencv_has_rows():
    image = np.tile(np.arange(640, dtype=np.uint8), (480, 1))
    corners = np.array([[100.0, 100.0], [180.0, 100.0], [180.0, 150.0], [100.0, 150.0]])
    rows = np.linspace(0.1, 0.9, 5)
    one, many = (look_across(Picture(image, image, 9.0),
                             rows_across(np.tile(corners, (count, 1, 1)), rows), PLANE,
                             8.0, -8.0, 17) for count in (1, 2000))
    for few, each in zip(one[1:], many[1:]):  # the first is the share that all have
        assert len(each) == 2000 and np.array_equal(np.tile(few, (2000, *[1] * (few.ndim - 1))),
                                                    each)
