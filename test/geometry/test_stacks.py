"""Stacks of small matrices: the same numbers in every size and layout."""

from homography_servo.geometry import stacks
import numpy as np
import pytest

SIZES = (1, 3, 20, 300)


def positive(count, seed=1):
    factors = np.random.default_rng(seed).normal(size=(count, 6, 8))
    return factors @ factors.swapaxes(1, 2)


@pytest.mark.parametrize('count', SIZES)
def test_products_agree_with_numpy(count):
    rng = np.random.default_rng(2)
    a, b, c = rng.normal(size=(count, 3, 5)), rng.normal(size=(count, 5, 4)), np.ones((5, 2))
    laid = stacks.laid_out(a)
    assert np.array_equal(laid, a)
    assert stacks.product(laid, stacks.laid_out(b)) == pytest.approx(a @ b)
    assert stacks.images(laid, c) == pytest.approx(a @ c)
    vectors, other = rng.normal(size=(2, count, 3))
    turned = (stacks.crosses(vectors) @ other[..., None])[..., 0]
    assert turned == pytest.approx(np.cross(vectors, other))
    assert stacks.zeros(count, 2, 3).shape == (count, 2, 3)


@pytest.mark.parametrize('count', SIZES)
def test_positive_systems_are_solved_and_inverted(count):
    matrices, right = positive(count), np.random.default_rng(3).normal(size=(count, 6))
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    for given in (matrices, stacks.laid_out(matrices)):
        assert stacks.solve_positive(given, right) == pytest.approx(expected, rel=1e-6)
        assert stacks.inverse_positive(given) == pytest.approx(np.linalg.inv(matrices), rel=1e-6)


@pytest.mark.parametrize('count', SIZES)
def test_what_is_not_positive_definite_gives_nan_and_spoils_nothing_else(count):
    matrices, right = positive(count), np.ones((count, 6))
    matrices[0] = np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    with np.errstate(all='ignore'):
        found = stacks.solve_positive(matrices, right)
    assert np.isnan(found[0]).any()
    assert found[1:] == pytest.approx(np.linalg.solve(matrices[1:], right[1:, :, None])[..., 0],
                                      rel=1e-6)
