"""A first placement of arm and grip from poses alone, with no belief needed."""

from __future__ import annotations

from homography_servo.geometry.rigid import transform
from homography_servo.result import Rejected
import numpy as np

_ENOUGH = 3


def placement_from_poses(base_from_tool: np.ndarray, home_from_object: np.ndarray
                         ) -> tuple[np.ndarray, np.ndarray] | Rejected:
    """
    Solve home_from_base @ base_from_tool @ tool_from_object = home_from_object.

    Rotations first, as the null vector of a linear system, then translations by least
    squares. Good as a start: the noise of the poses is not weighed.

    Parameters
    ----------
    base_from_tool, home_from_object : (K, 4, 4) array
        What the joints and the camera say.

    Returns
    -------
    home_from_base, tool_from_object : (4, 4) arrays, or Rejected

    References
    ----------
    Shah, Solving the Robot-World/Hand-Eye Calibration Problem Using the Kronecker Product,
    2013, doi:10.1115/1.4024473.

    """
    count = len(base_from_tool)
    if count < _ENOUGH:
        return Rejected(f'{count} poses are too few for a start, {_ENOUGH} are needed')
    tool, seen = base_from_tool[:, :3, :3], home_from_object[:, :3, :3]
    # Rx^T seen = tool Ry, row by row of the matrices as vectors.
    rows = [np.hstack([np.kron(np.eye(3), s.T), -np.kron(t, np.eye(3))])
            for s, t in zip(seen, tool)]
    _, sizes, right = np.linalg.svd(np.concatenate(rows))
    if sizes[-2] < 1e-3 * sizes[0]:
        return Rejected('the poses turn about one axis only')
    base_from_home = right[-1][:9].reshape(3, 3)
    sign = 1.0 if np.linalg.det(base_from_home) > 0.0 else -1.0
    turn_base = _rotation(sign * base_from_home).T
    turn_object = _rotation(sign * right[-1][9:].reshape(3, 3))
    return _with_translations(base_from_tool, home_from_object, turn_base, turn_object)


def _rotation(matrix: np.ndarray) -> np.ndarray:
    """Take the rotation next to a matrix."""
    left, _, right = np.linalg.svd(matrix)
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def _with_translations(base_from_tool: np.ndarray, home_from_object: np.ndarray,
                       turn_base: np.ndarray, turn_object: np.ndarray
                       ) -> tuple[np.ndarray, np.ndarray]:
    turned = turn_base @ base_from_tool[:, :3, :3]
    left = np.concatenate([np.tile(np.eye(3), (len(turned), 1, 1)), turned], axis=2)
    right = home_from_object[:, :3, 3] - base_from_tool[:, :3, 3] @ turn_base.T
    solved = np.linalg.lstsq(left.reshape(-1, 6), right.ravel(), rcond=None)[0]
    return transform(turn_base, solved[:3]), transform(turn_object, solved[3:])
