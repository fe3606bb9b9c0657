"""Laws of rigid motions: group axioms, inverses, finite differences."""

from geometry_cases import seeds
from geometry_cases import vectors
from homography_servo.geometry import rigid
from hypothesis import given
from hypothesis import settings
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation


def random_transform(seed):
    rng = np.random.default_rng(seed)
    return rigid.exp_twist(np.concatenate([rng.normal(size=3), rng.uniform(-1.7, 1.7, 3)]))


def hat(twist):
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = rigid.skew(twist[3:]), twist[:3]
    return matrix


@given(seeds, seeds, seeds)
@settings(max_examples=50, deadline=None)
def test_group_axioms(a, b, c):
    a, b, c = map(random_transform, (a, b, c))
    assert (a @ b) @ c == pytest.approx(a @ (b @ c), abs=1e-12)
    assert a @ rigid.inverse(a) == pytest.approx(np.eye(4), abs=1e-12)
    assert rigid.inverse(a @ b) == pytest.approx(rigid.inverse(b) @ rigid.inverse(a), abs=1e-12)


@given(vectors, vectors)
@settings(max_examples=100, deadline=None)
def test_exponential_is_the_matrix_exponential(linear, angular):
    twist = np.concatenate([linear, angular])
    assert rigid.exp_twist(twist) == pytest.approx(expm(hat(twist)), abs=1e-12)


@pytest.mark.parametrize('angle_rad', [0.0, 1e-12, 1e-8, 1e-4, 0.0999, 0.1001, 1.0, 3.0, 3.14159])
def test_log_undoes_exp_at_every_angle(angle_rad):
    rng = np.random.default_rng(1)
    axis = rng.normal(size=(50, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    twists = np.concatenate([rng.normal(size=(50, 3)), angle_rad * axis], axis=1)
    assert rigid.log_transform(rigid.exp_twist(twists)) == pytest.approx(twists, abs=1e-9)


def test_exp_undoes_log_at_half_a_turn():
    for axis in np.eye(3):
        turn = rigid.exp_twist(np.concatenate([[0.3, -0.2, 0.5], np.pi * axis]))
        assert rigid.exp_twist(rigid.log_transform(turn)) == pytest.approx(turn, abs=1e-12)


@given(seeds, vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_adjoint_carries_twists_between_frames(seed, linear, angular):
    a_from_b, twist_b = random_transform(seed), np.concatenate([linear, angular])
    moved_a = a_from_b @ rigid.exp_twist(twist_b) @ rigid.inverse(a_from_b)
    twist_a = rigid.adjoint(a_from_b) @ twist_b
    assert rigid.exp_twist(twist_a) == pytest.approx(moved_a, abs=1e-9)


@given(seeds, seeds)
@settings(max_examples=50, deadline=None)
def test_screw_and_difference_lead_from_start_to_goal(start, goal):
    start, goal = random_transform(start), random_transform(goal)
    screw = rigid.screw_between(start, goal)
    assert rigid.exp_twist(screw) @ start == pytest.approx(goal, abs=1e-9)
    difference = rigid.pose_difference(goal, start)
    assert rigid.displaced(start, difference) == pytest.approx(goal, abs=1e-12)
    assert difference[:3] == pytest.approx(goal[:3, 3] - start[:3, 3])
    # The angle is the same by every route.
    turn = goal[:3, :3] @ start[:3, :3].T
    assert np.linalg.norm(screw[3:]) == pytest.approx(rigid.rotation_angle(turn), abs=1e-9)


def test_points_of_the_screw_axis_only_advance():
    rng = np.random.default_rng(2)
    for twist in rng.normal(size=(20, 6)):
        screw = rigid.screw_axis(twist)
        point = screw.point_m + 0.7 * screw.direction
        moved = (rigid.exp_twist(twist) @ [*point, 1.0])[:3]
        assert moved == pytest.approx(point + screw.advance_m * screw.direction, abs=1e-12)
        assert screw.point_m @ screw.direction == pytest.approx(0.0, abs=1e-12)


def test_axis_of_a_translation_and_of_no_motion():
    screw = rigid.screw_axis([0.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    assert (*screw.direction, screw.advance_m, screw.angle_rad) == (0.0, 1.0, 0.0, 3.0, 0.0)
    assert np.isfinite(np.concatenate(rigid.screw_axis(np.zeros(6))[:2])).all()


def test_the_long_way_round_ends_at_the_same_place():
    motion = rigid.exp_twist([0.3, -0.1, 0.2, 0.4, 0.5, -1.0])
    vector = rigid.rotation_log(motion[:3, :3])
    longer = vector * (1.0 - 2.0 * np.pi / np.linalg.norm(vector))
    twist = rigid.twist_about(longer, motion[:3, 3])
    assert rigid.exp_twist(twist) == pytest.approx(motion, abs=1e-12)
    assert np.linalg.norm(twist[3:]) > np.pi


@pytest.mark.parametrize('angle_rad', [0.0, 1e-9, 1e-5, 1.0, np.pi - 1e-9, np.pi])
def test_rotation_angle_is_exact_at_both_ends(angle_rad):
    turn = rigid.exp_twist([0.0, 0.0, 0.0, *(angle_rad * np.array([0.6, 0.0, 0.8]))])
    assert rigid.rotation_angle(turn[:3, :3]) == pytest.approx(angle_rad, abs=1e-12)


@pytest.mark.parametrize('angle_rad', [0.0, 1e-13, 1e-7, 0.5, 2.0, 2.99, 3.01, 3.14, np.pi])
def test_rotation_vectors_agree_with_scipy(angle_rad):
    axes = np.random.default_rng(7).normal(size=(2, 20, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    flat = Rotation.from_rotvec(angle_rad * axes.reshape(-1, 3)).as_matrix()
    found = rigid.rotation_log(flat.reshape(2, 20, 3, 3))
    again = Rotation.from_rotvec(found.reshape(-1, 3)).as_matrix()
    assert again == pytest.approx(flat, abs=1e-12)
    assert np.linalg.norm(found, axis=-1) == pytest.approx(angle_rad, abs=1e-12)
    assert rigid.rotation_log(flat[3]) == pytest.approx(found[0, 3], abs=1e-12)


def test_stacks_agree_with_single_motions():
    twists = np.random.default_rng(3).normal(size=(4, 5, 6))
    stack = rigid.exp_twist(twists)
    assert stack.shape == (4, 5, 4, 4)
    assert stack[2, 3] == pytest.approx(rigid.exp_twist(twists[2, 3]))
    assert rigid.log_transform(stack)[1, 1] == pytest.approx(rigid.log_transform(stack[1, 1]))
    assert rigid.adjoint(stack)[3, 0] == pytest.approx(rigid.adjoint(stack[3, 0]))
    assert rigid.inverse(stack)[0, 4] == pytest.approx(np.linalg.inv(stack[0, 4]))
    points = np.arange(6.0).reshape(2, 3)
    assert rigid.transform_points(stack, points)[1, 2, 1] == pytest.approx(
        (stack[1, 2] @ [*points[1], 1.0])[:3])


@pytest.mark.parametrize('angle_rad', [
    0.0, 1e-200, 1e-12, 1e-6, 1e-3, 0.0999, 0.1001, 1.0, 3.0, np.pi - 1e-9, 4.0, 6.2])
def test_single_motions_and_stacks_are_computed_apart_and_agree(angle_rad):
    rng = np.random.default_rng(9)
    twists = rng.normal(size=(50, 6))
    twists[:, 3:] *= angle_rad / np.linalg.norm(twists[:, 3:], axis=1)[:, None]
    motions = rigid.exp_twist(twists)
    for twist, motion in zip(twists, motions):
        np.testing.assert_allclose(rigid.exp_twist(twist), motion, rtol=0.0, atol=5e-15)
        np.testing.assert_allclose(rigid.rotation_log(motion[:3, :3]),
                                   rigid.rotation_log(motion[None, :3, :3])[0],
                                   rtol=0.0, atol=5e-15)


def test_wrong_shapes_name_the_shape_expected():
    with pytest.raises(ValueError, match=r'\(\.\.\., 4, 4\), got \(3, 3\)'):
        rigid.inverse(np.eye(3))
    with pytest.raises(ValueError, match=r'\(\.\.\., 6\), got \(5,\)'):
        rigid.exp_twist(np.zeros(5))
    with pytest.raises(ValueError, match=r'\(\.\.\., 3, 3\)'):
        rigid.transform(np.eye(2), np.zeros(3))
    with pytest.raises(ValueError, match='finite'):
        rigid.exp_twist([0.0, 0.0, 0.0, 0.0, 0.0, np.inf])
    with pytest.raises(ValueError, match='finite'):
        rigid.log_transform(np.full((4, 4), np.nan))
