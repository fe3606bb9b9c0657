"""
Refine poses by reprojection: Levenberg-Marquardt on stacks of problems.

One stack holds both minima of one view, or of a thousand views; the same code
serves both (`stacks` lays them out in memory). The inverse of the normal matrix is the
pose's covariance in the order of ROS.
"""

from __future__ import annotations

from homography_servo.geometry.pose_curvature import curvature
from homography_servo.geometry.pose_residuals import Fit
from homography_servo.geometry.pose_residuals import linearise
from homography_servo.geometry.pose_residuals import Views
from homography_servo.geometry.stacks import crosses
from homography_servo.geometry.stacks import FEW
from homography_servo.geometry.stacks import laid_out
from homography_servo.geometry.stacks import product
from homography_servo.geometry.stacks import solve_positive
import numpy as np

_MAX_STEPS = 40
_RIDGE = 1e-12  # keeps the normal matrix invertible where the data leave it open
_COMPACT = 0.3  # share of settled poses that is worth sorting out
_PATIENCE = 4  # steps of Gauss-Newton before its curvature is completed
SAME_MINIMUM = 0.25  # squared distance, in units of the covariance, below which two minima are one


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
        where of two starts of one view only one leads to a minimum of its own.

    """
    with np.errstate(all='ignore'):
        if len(rotation) <= FEW:
            return _descend(views, linearise(views, rotation, translation_m))
        views = views._replace(rays=laid_out(views.rays))
        return _descend_many(views, linearise(views, laid_out(rotation),
                                              laid_out(translation_m)))


def _descend(views: Views, state: Fit) -> Fit:
    """Descend with a few poses together until all have settled."""
    damping: np.ndarray | None = None
    before: np.ndarray | float = 0.0
    pair = len(state.chi2) == 2 and len(views.rays) == 1
    for count in range(_MAX_STEPS):
        step, gain, bent = _next_step(views, state, damping, count)
        settled = _settled(gain, before, state.chi2)
        if settled.all():
            return _arrived(state, step, gain)
        if pair and settled.any() and _is_idle_walk(state, int(settled[0]), bent):
            gain[~settled] = -np.inf
            return _arrived(state, step, gain)
        trial = linearise(views, *moved(state.rotation, state.translation_m, step))
        state, damping = _accept(state, trial, damping, settled)
        before = gain
    return state


def _is_idle_walk(state: Fit, late: int, bent: np.ndarray) -> bool:
    """
    Tell whether one pose of two leads nowhere, the other being at a minimum.

    It has come there too; or, where it explains the view worse, the error bends down: no
    minimum is near, and what is left is the way from where the mirror's would have been.
    """
    done = 1 - late
    return same_minimum(state, done, late) or bool(
        bent[late] and state.chi2[late] > state.chi2[done])


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
        step, gain, _ = _next_step(views, state, damping, count)
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


def _next_step(views: Views, state: Fit, damping: np.ndarray | None, count: int
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give the step, the decrease it predicts, and where the error is seen to bend down."""
    if count < _PATIENCE:
        return *_step(state, damping), np.zeros(len(state.chi2), bool)
    return _newton_step(views, state, damping)


def _step(state: Fit, damping: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Solve the damped normal equations; also give the decrease they predict."""
    step = solve_positive(_damped(state.normal, damping), state.gradient)
    return -step, (step * state.gradient).sum(axis=1)


def _damped(normal: np.ndarray, damping: np.ndarray | None) -> np.ndarray:
    return normal if damping is None else normal + normal * (_DIAGONAL * damping[:, None, None])


def _newton_step(views: Views, state: Fit, damping: np.ndarray | None
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Do as `_step` with the whole curvature, where that is positive definite.

    Elsewhere Newton's method would look for saddles; Gauss-Newton goes down from them.
    """
    extra = curvature(views, state.rotation, state.translation_m, state.residual)
    whole = state._replace(normal=_damped(state.normal, damping) + extra)
    step, gain = _step(whole, None)
    indefinite = ~(gain > 0.0)
    if indefinite.any():
        safe_step, safe_gain = _step(state, damping)
        step = np.where(indefinite[:, None], safe_step, step)
        gain = np.where(indefinite, safe_gain, gain)
    return step, gain, indefinite


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
