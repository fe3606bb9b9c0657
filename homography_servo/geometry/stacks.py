"""
Small matrices in stacks (B, i, j): a few of them, or thousands, each the fast way.

For a few, what costs is the number of calls: numpy's own routines. For many, what
costs is memory: they are laid out with the stack along the fastest axis, although
it stays the first index, so that every elementwise operation is one long loop.
"""

from __future__ import annotations

from homography_servo.geometry.rigid import skew
import numpy as np
from scipy.linalg import lapack

FEW = 4  # up to here nothing is laid out
_SINGLY = 32  # up to here one call of LAPACK per matrix is faster than long loops


def laid_out(array: np.ndarray) -> np.ndarray:
    """Give an array (B, ...) the memory layout that suits its length."""
    if len(array) <= FEW:
        return array
    return _stack_first(np.ascontiguousarray(array.transpose(*range(1, array.ndim), 0)))


def zeros(*shape: int) -> np.ndarray:
    """Make an array (B, ...) of zeros in the layout that suits its length."""
    if shape[0] <= FEW:
        return np.zeros(shape)
    return _stack_first(np.zeros((*shape[1:], shape[0])))


def _stack_first(array: np.ndarray) -> np.ndarray:
    return array.transpose(-1, *range(array.ndim - 1))


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply matrices (B, i, k) and (B, k, j)."""
    return a @ b if len(a) <= FEW else np.einsum('bik,bkj->bij', a, b)


def images(matrices: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Multiply matrices (B, i, k) and one matrix (k, j)."""
    return matrices @ columns if len(matrices) <= FEW else np.einsum(
        'bik,kj->bij', matrices, columns)


def crosses(vectors: np.ndarray) -> np.ndarray:
    """Give the cross product matrices (B, 3, 3) of vectors (B, 3)."""
    if len(vectors) <= FEW:
        return skew(vectors)
    x, y, z = (vectors[:, axis] for axis in range(3))
    matrices = zeros(len(vectors), 3, 3)
    matrices[:, 2, 1], matrices[:, 0, 2], matrices[:, 1, 0] = x, y, z
    matrices[:, 1, 2], matrices[:, 2, 0], matrices[:, 0, 1] = -x, -y, -z
    return matrices


def solve_positive(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """
    Solve systems with positive definite matrices.

    Parameters
    ----------
    matrices : (B, n, n) array
        Symmetric and positive definite.
    right : (B, n) array
        Right hand sides.

    Returns
    -------
    (B, n) array
        Solutions; ``nan`` where a matrix is not positive definite.

    """
    if len(matrices) <= _SINGLY:
        return np.array([_solved(m, r) for m, r in zip(matrices, right)])
    return _substitute(_cholesky(matrices), laid_out(right)[..., None])[..., 0]


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    _, solution, indefinite = lapack.dposv(matrix, right)
    return np.full(len(right), np.nan) if indefinite else solution


def inverse_positive(matrices: np.ndarray) -> np.ndarray:
    """Invert positive definite matrices (B, n, n); not finite where they are not."""
    size = matrices.shape[-1]
    right = zeros(len(matrices), size, size) + np.eye(size)
    return _substitute(_cholesky(matrices), right)


def _cholesky(matrices: np.ndarray) -> np.ndarray:
    lower = zeros(*matrices.shape)
    for j in range(matrices.shape[-1]):
        known = np.einsum('bik,bk->bi', lower[:, j:, :j], lower[:, j, :j])
        column = matrices[:, j:, j] - known
        lower[:, j:, j] = column / np.sqrt(column[:, :1])
    return lower


def _substitute(lower: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve lower lower' x = right (B, n, m), forwards, then backwards."""
    x = right.copy(order='K')
    size = lower.shape[-1]
    for j in range(size):
        x[:, j] -= np.einsum('bk,bkm->bm', lower[:, j, :j], x[:, :j])
        x[:, j] /= lower[:, j, j, None]
    for j in reversed(range(size)):
        x[:, j] -= np.einsum('bk,bkm->bm', lower[:, j + 1:, j], x[:, j + 1:])
        x[:, j] /= lower[:, j, j, None]
    return x
