"""
Refine poses by reprojection: Levenberg-Marquardt on stacks of problems.

One stack holds both minima of one view, or of a thousand views; the same code
serves both. Points run along the last axis, so that every operation is on rows
of numbers: with four points the cost is in the calls, not in the arithmetic.

The six unknowns are a small translation of the object's origin and a small
rotation vector, both along the camera's axes, so the inverse of the normal matrix
is the pose's covariance in the order of ROS.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

_MAX_STEPS = 60
_RIDGE = 1e-12  # keeps the normal matrix invertible where the data leave it open
_FEW = 4  # up to here single LAPACK calls beat numpy's stacked solver


class Views(NamedTuple):
    """
    What is to be explained: one object, and its measured points in M views.

    `whitener` turns ray errors into errors of unit variance: (1 or M, 2, 2, N) with
    rows, columns, points. `mixer` (2N, 2N) or None acts after it, where the errors of
    different points are correlated; it is ordered u_0 .. u_N, v_0 .. v_N.
    """

    points_m: np.ndarray  # (3, N)
    rays: np.ndarray  # (M, 2, N)
    whitener: np.ndarray
    mixer: np.ndarray | None

    def take(self, index: np.ndarray) -> Views:
        """Select or repeat views."""
        whitener = self.whitener if len(self.whitener) == 1 else self.whitener[index]
        return self._replace(rays=self.rays[index], whitener=whitener)


class Fit(NamedTuple):
    """Poses (B, ...) of the object in the camera, with what was learnt at them."""

    rotation: np.ndarray  # (B, 3, 3)
    translation_m: np.ndarray  # (B, 3)
    chi2: np.ndarray  # (B,)
    normal: np.ndarray  # (B, 6, 6) inverse of the covariance
    gradient: np.ndarray  # (B, 6)

    def take(self, index: np.ndarray) -> Fit:
        """Select poses."""
        return Fit(*(value[index] for value in self))


def refine(views: Views, rotation: np.ndarray, translation_m: np.ndarray) -> Fit:
    """
    Minimise the whitened reprojection error from given starts.

    Parameters
    ----------
    views : Views
        As many views as starts.
    rotation, translation_m : (B, 3, 3) and (B, 3) array
        Starts: the object in the camera.

    Returns
    -------
    Fit
        The minima; ``chi2`` is ``inf`` where a start had points behind the camera.

    """
    with np.errstate(all='ignore'):
        state = linearise(views, rotation, translation_m)
        if len(state.chi2) <= _FEW:
            return _descend(views, state)
        return _descend_many(views, state)


def linearise(views: Views, rotation: np.ndarray, translation_m: np.ndarray) -> Fit:
    """Evaluate chi squared, its gradient and the Gauss-Newton matrix at poses."""
    jacobian, residual = residuals(views, rotation, translation_m)
    gradient = (jacobian @ residual[..., None])[..., 0]
    chi2 = (residual * residual).sum(axis=-1)
    return Fit(rotation, translation_m, chi2, jacobian @ jacobian.swapaxes(-1, -2), gradient)


def residuals(views: Views, rotation: np.ndarray, translation_m: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """
    Give the whitened errors of reprojection and their derivatives.

    Parameters
    ----------
    views : Views
        B views.
    rotation, translation_m : (B, 3, 3) and (B, 3) array
        The object in the camera.

    Returns
    -------
    jacobian : (B, 6, 2N) array
        Derivatives by translation and rotation vector along the camera's axes.
    residual : (B, 2N) array
        ``inf`` where a point is not before the camera.

    """
    turned = rotation @ views.points_m
    camera_m = turned + translation_m[..., None]
    depth = camera_m[:, 2:]
    inverse = 1.0 / np.where(depth > 0.0, depth, 0.0)
    image = camera_m[:, :2] * inverse
    error = image - views.rays
    by_u, by_v = views.whitener[:, :, 0], views.whitener[:, :, 1]
    jacobian = np.empty((len(turned), 6, 2, turned.shape[-1]))
    # The image moves by (dX - u dZ, dY - v dZ) / Z; a rotation w moves the point by w x turned.
    x, y, z = (jacobian[:, axis] for axis in range(3))
    np.multiply(by_u, inverse, out=x)
    np.multiply(by_v, inverse, out=y)
    np.subtract(-x * image[:, :1], y * image[:, 1:], out=z)
    a, b, c = (turned[:, axis:axis + 1] for axis in range(3))
    np.subtract(b * z, c * y, out=jacobian[:, 3])
    np.subtract(c * x, a * z, out=jacobian[:, 4])
    np.subtract(a * y, b * x, out=jacobian[:, 5])
    residual = (by_u * error[:, :1] + by_v * error[:, 1:]).reshape(len(turned), -1)
    jacobian = jacobian.reshape(len(turned), 6, -1)
    if views.mixer is None:
        return jacobian, residual
    return jacobian @ views.mixer.T, residual @ views.mixer.T


def _descend(views: Views, state: Fit) -> Fit:
    damping = np.zeros(len(state.chi2))
    for _ in range(_MAX_STEPS):
        step, gain = _step(state, damping)
        trial_pose = moved(state.rotation, state.translation_m, step)
        settled = _settled(gain, state.chi2)
        if settled.all():
            return state._replace(rotation=trial_pose[0], translation_m=trial_pose[1])
        trial = linearise(views, *trial_pose)
        state, damping = _accept(state, trial, damping, settled)
    return state


def _descend_many(views: Views, state: Fit) -> Fit:
    """Do as `_descend`, and go on only with the poses that have not settled."""
    result = Fit(*(value.copy() for value in state))
    open_index, damping = np.arange(len(state.chi2)), np.zeros(len(state.chi2))
    for _ in range(_MAX_STEPS):
        step, gain = _step(state, damping)
        rotation, translation_m = moved(state.rotation, state.translation_m, step)
        settled = _settled(gain, state.chi2)
        _store(result, open_index[settled], state._replace(
            rotation=rotation, translation_m=translation_m).take(settled))
        if settled.all():
            return result
        left = ~settled
        open_index, views, damping = open_index[left], views.take(left), damping[left]
        trial = linearise(views, rotation[left], translation_m[left])
        state, damping = _accept(state.take(left), trial, damping, settled[left])
    _store(result, open_index, state)
    return result


def _store(result: Fit, index: np.ndarray, part: Fit) -> None:
    for whole, values in zip(result, part):
        whole[index] = values


def _settled(gain: np.ndarray, chi2: np.ndarray) -> np.ndarray:
    """Tell where a step would change chi squared by nothing that matters."""
    return ~(gain > 1e-9 + 1e-7 * chi2) | ~np.isfinite(chi2)


def _step(state: Fit, damping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solve the damped normal equations; also give the decrease they predict."""
    normal = state.normal.copy()
    diagonal = np.einsum('bii->bi', normal)
    diagonal *= 1.0 + _RIDGE + damping[:, None]
    if len(normal) <= _FEW:
        step = np.array([lapack.dposv(m, g)[1] for m, g in zip(normal, state.gradient)])
    else:
        step = np.linalg.solve(normal, state.gradient[..., None])[..., 0]
    return -step, (step * state.gradient).sum(axis=-1)


def _accept(state: Fit, trial: Fit, damping: np.ndarray, settled: np.ndarray
            ) -> tuple[Fit, np.ndarray]:
    """Keep what became better; damp the rest more."""
    better = (trial.chi2 <= state.chi2) | settled
    if better.all():
        return trial, damping * 0.1
    kept = Fit(*(np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
                 for new, old in zip(trial, state)))
    return kept, np.where(better, damping * 0.1, np.maximum(damping * 10.0, 1e-3))


def moved(rotation: np.ndarray, translation_m: np.ndarray, step: np.ndarray
          ) -> tuple[np.ndarray, np.ndarray]:
    """
    Apply small motions (B, 6) to poses.

    The rotation is that of the quaternion (1, w / 2), which agrees with the
    exponential map to second order and stays a rotation for steps of any size.
    """
    half = 0.5 * step[:, 3:]
    cross = (half @ _CROSS).reshape(-1, 3, 3)
    gain = 2.0 / (1.0 + (half * half).sum(axis=-1))
    turn = _EYE + gain[:, None, None] * (cross + cross @ cross)
    return turn @ rotation, translation_m + step[:, :3]


_EYE = np.eye(3)
_CROSS = np.zeros((3, 9))  # v @ _CROSS is the cross product matrix of v, by rows
_CROSS[0, 7], _CROSS[0, 5], _CROSS[1, 2], _CROSS[1, 6], _CROSS[2, 3], _CROSS[2, 1] = (
    1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
