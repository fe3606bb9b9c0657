"""
Refine poses by reprojection: Levenberg-Marquardt on stacks of problems.

One stack holds both minima of one view, or of a thousand views; the same code
serves both (`stacks` lays them out in memory). Points run along the last axis, so
that every operation is on rows of numbers.

The six unknowns are a small translation of the object's origin and a small
rotation vector, both along the camera's axes, so the inverse of the normal matrix
is the pose's covariance in the order of ROS.
"""

from __future__ import annotations

from typing import NamedTuple

from homography_servo.geometry.pose_curvature import curvature
from homography_servo.geometry.stacks import crosses
from homography_servo.geometry.stacks import FEW
from homography_servo.geometry.stacks import images
from homography_servo.geometry.stacks import laid_out
from homography_servo.geometry.stacks import product
from homography_servo.geometry.stacks import solve_positive
from homography_servo.geometry.stacks import zeros
import numpy as np

_MAX_STEPS = 40
_RIDGE = 1e-12  # keeps the normal matrix invertible where the data leave it open
_COMPACT = 0.3  # share of settled poses that is worth sorting out
_PATIENCE = 4  # steps of Gauss-Newton before its curvature is completed
SAME_MINIMUM = 0.25  # squared distance, in units of the covariance, below which two minima are one


class Views(NamedTuple):
    """
    What is to be explained: one object, and its measured points in M views.

    `whitener` turns ray errors into errors of unit variance: (2, 1) where it is the
    same scale for all points, or (1 or M, 2, 2, N) with rows, columns, points. `mixer`
    (2N, 2N) or None acts after it, where the errors of different points are correlated;
    it is ordered u_0 .. u_N, v_0 .. v_N.
    """

    points_m: np.ndarray  # (3, N)
    rays: np.ndarray  # (M, 2, N); one view serves any number of poses
    whitener: np.ndarray
    mixer: np.ndarray | None

    def take(self, index: np.ndarray) -> Views:
        """Select or repeat views."""
        shared = self.whitener.ndim == 2 or len(self.whitener) == 1
        whitener = self.whitener if shared else self.whitener[index]
        return self._replace(rays=laid_out(self.rays[index]), whitener=whitener)


class Fit(NamedTuple):
    """Poses (B, ...) of the object in the camera, with what was learnt at them."""

    rotation: np.ndarray  # (B, 3, 3)
    translation_m: np.ndarray  # (B, 3)
    chi2: np.ndarray  # (B,)
    normal: np.ndarray  # (B, 6, 6) inverse of the covariance
    gradient: np.ndarray  # (B, 6)
    residual: np.ndarray  # (B, 2N) whitened

    def take(self, index: np.ndarray) -> Fit:
        """Select poses."""
        return Fit(*(laid_out(value[index]) for value in self))


def refine(views: Views, rotation: np.ndarray, translation_m: np.ndarray) -> Fit:
    """
    Minimise the whitened reprojection error from given starts.

    Parameters
    ----------
    views : Views
        One view, or as many as starts.
    rotation, translation_m : (B, 3, 3) and (B, 3) array
        Starts: the object in the camera.

    Returns
    -------
    Fit
        The minima; ``chi2`` is ``inf`` where a start had points behind the camera, and
        where it came to the minimum of the other one of the same view.

    """
    with np.errstate(all='ignore'):
        if len(rotation) <= FEW:
            return _descend(views, linearise(views, rotation, translation_m))
        views = views._replace(rays=laid_out(views.rays))
        return _descend_many(views, linearise(views, laid_out(rotation),
                                              laid_out(translation_m)))


def linearise(views: Views, rotation: np.ndarray, translation_m: np.ndarray) -> Fit:
    """Evaluate chi squared, its gradient and the Gauss-Newton matrix at poses."""
    rows = residuals(views, rotation, translation_m)
    products = product(rows, rows.swapaxes(-1, -2))
    return Fit(rotation, translation_m, products[:, 6, 6], products[:, :6, :6],
               products[:, :6, 6], rows[:, 6])


def residuals(views: Views, rotation: np.ndarray, translation_m: np.ndarray) -> np.ndarray:
    """
    Give the whitened errors of reprojection and their derivatives.

    Parameters
    ----------
    views : Views
        One view, or B.
    rotation, translation_m : (B, 3, 3) and (B, 3) array
        The object in the camera.

    Returns
    -------
    (B, 7, 2N) array
        Rows 0 to 5: derivatives by translation and rotation vector along the camera's
        axes, the interaction matrix of visual servoing. Row 6: the errors, not finite
        where a point is not before the camera.

    """
    camera_m = images(rotation, views.points_m) + translation_m[:, :, None]
    inverse = 1.0 / np.maximum(camera_m[:, 2:], 0.0)
    image = camera_m[:, :2] * inverse
    square = image * image + 1.0
    rows = zeros(len(camera_m), 7, 2, camera_m.shape[2])
    rows[:, 0, 0] = rows[:, 1, 1] = inverse[:, 0]
    np.multiply(image, -inverse, out=rows[:, 2])
    u, v = image[:, 0], image[:, 1]
    np.multiply(u, v, out=rows[:, 4, 1])
    np.negative(rows[:, 4, 1], out=rows[:, 3, 0])
    np.negative(square[:, 1], out=rows[:, 3, 1])
    rows[:, 4, 0] = square[:, 0]
    np.negative(v, out=rows[:, 5, 0])
    rows[:, 5, 1] = u
    np.subtract(image, views.rays, out=rows[:, 6])
    rows = _whitened(views, rows).reshape(len(camera_m), 7, -1)
    # So far it turns about the camera; let it turn about the object's origin.
    rows[:, 3:6] -= product(crosses(translation_m), rows[:, :3])
    return rows


def _whitened(views: Views, rows: np.ndarray) -> np.ndarray:
    if views.whitener.ndim == 2:
        rows = rows * views.whitener
    else:
        by_u, by_v = views.whitener[:, None, :, 0], views.whitener[:, None, :, 1]
        rows = by_u * rows[:, :, :1] + by_v * rows[:, :, 1:]
    if views.mixer is None:
        return rows
    return rows.reshape(len(rows), 7, -1) @ views.mixer.T


def _descend(views: Views, state: Fit) -> Fit:
    """Descend with a few poses together until all have settled."""
    damping: np.ndarray | None = None
    before: np.ndarray | float = 0.0
    for count in range(_MAX_STEPS):
        step, gain = (_step if count < _PATIENCE else _newton_step)(views, state, damping)
        settled = _settled(gain, before, state.chi2)
        if settled.all():
            return _arrived(state, step, gain)
        if len(settled) == 2 and len(views.rays) == 1 and settled.any():
            done, late = (0, 1) if settled[0] else (1, 0)
            if same_minimum(state, done, late):
                gain[late] = -np.inf
                return _arrived(state, step, gain)
        trial = linearise(views, *moved(state.rotation, state.translation_m, step))
        state, damping = _accept(state, trial, damping, settled)
        before = gain
    return state


def same_minimum(fit: Fit, i: int, j: int) -> bool:
    """Tell whether two poses are one minimum: nearer than the uncertainty of the first."""
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = turn = (fit.rotation[i] @ fit.rotation[j].T).tolist()
    difference = np.array([*(fit.translation_m[i] - fit.translation_m[j]).tolist(),
                           0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)])
    return bool(turn[0][0] + turn[1][1] + turn[2][2] > 1.0
                and difference @ fit.normal[i] @ difference < SAME_MINIMUM)


def _descend_many(views: Views, state: Fit) -> Fit:
    """Do as `_descend`, and go on only with the poses that have not settled."""
    result = Fit(*(value.copy(order='K') for value in state))
    index = np.arange(len(state.chi2))
    damping: np.ndarray | None = np.full(len(state.chi2), _RIDGE)
    before: np.ndarray | float = 0.0
    for count in range(_MAX_STEPS):
        step, gain = (_step if count < _PATIENCE else _newton_step)(views, state, damping)
        settled = _settled(gain, before, state.chi2)
        if settled.mean() > _COMPACT or settled.all():
            left = ~settled
            _store(result, index[settled],
                   _arrived(state.take(settled), step[settled], gain[settled]))
            if not left.any():
                return result
            index, views, gain = index[left], views.take(left), gain[left]
            damping = None if damping is None else damping[left]
            state, step, settled = state.take(left), laid_out(step[left]), settled[left]
        trial = linearise(views, *moved(state.rotation, state.translation_m, step))
        state, damping = _accept(state, trial, damping, settled)
        before = gain
    _store(result, index, state)
    return result


def _store(result: Fit, index: np.ndarray, part: Fit) -> None:
    for whole, values in zip(result, part):
        whole[index] = values


def _settled(gain: np.ndarray, before: np.ndarray | float, chi2: np.ndarray) -> np.ndarray:
    """
    Tell where the step after this one would change nothing that matters.

    ``gain`` is the decrease of chi squared that this step predicts, ``before`` that of
    the last one; they go on falling at this rate or faster. Also true where not finite.
    """
    return ~(gain * np.minimum(gain / before, 1.0) > 1e-10 + 1e-6 * chi2)


def _arrived(state: Fit, step: np.ndarray, gain: np.ndarray) -> Fit:
    """Take a last step without looking again."""
    rotation, translation_m = moved(state.rotation, state.translation_m, step)
    return state._replace(rotation=rotation, translation_m=translation_m,
                          chi2=np.maximum(state.chi2 - gain, 0.0))


def _step(views: Views, state: Fit, damping: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Solve the damped normal equations; also give the decrease they predict."""
    step = solve_positive(_damped(state.normal, damping), state.gradient)
    return -step, (step * state.gradient).sum(axis=1)


def _damped(normal: np.ndarray, damping: np.ndarray | None) -> np.ndarray:
    return normal if damping is None else normal + normal * (_DIAGONAL * damping[:, None, None])


def _newton_step(views: Views, state: Fit, damping: np.ndarray | None
                 ) -> tuple[np.ndarray, np.ndarray]:
    """
    Do as `_step` with the whole curvature, where that is positive definite.

    Elsewhere Newton's method would look for saddles; Gauss-Newton goes down from them.
    """
    extra = curvature(views, state.rotation, state.translation_m, state.residual)
    whole = state._replace(normal=_damped(state.normal, damping) + extra)
    step, gain = _step(views, whole, None)
    indefinite = ~(gain > 0.0)
    if indefinite.any():
        safe_step, safe_gain = _step(views, state, damping)
        step = np.where(indefinite[:, None], safe_step, step)
        gain = np.where(indefinite, safe_gain, gain)
    return step, gain


def _accept(state: Fit, trial: Fit, damping: np.ndarray | None, settled: np.ndarray
            ) -> tuple[Fit, np.ndarray | None]:
    """Keep what became better; damp the rest more."""
    better = (trial.chi2 <= state.chi2) | settled
    if better.all():
        return trial, damping if damping is None else damping * 0.1
    kept = Fit(*(np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
                 for new, old in zip(trial, state)))
    before = np.zeros(len(better)) if damping is None else damping
    return kept, np.where(better, before * 0.1, np.maximum(before * 10.0, 1e-3)) + _RIDGE


def moved(rotation: np.ndarray, translation_m: np.ndarray, step: np.ndarray
          ) -> tuple[np.ndarray, np.ndarray]:
    """
    Apply small motions (B, 6) to poses.

    The rotation is that of the quaternion (1, w / 2), which agrees with the
    exponential map to second order and stays a rotation for steps of any size.
    """
    half = 0.5 * step[:, 3:]
    cross = crosses(half)
    gain = 2.0 / (1.0 + (half * half).sum(axis=1))
    turn = _EYE + gain[:, None, None] * (cross + product(cross, cross))
    return product(turn, rotation), translation_m + step[:, :3]


_EYE = np.eye(3)
_DIAGONAL = np.eye(6)
