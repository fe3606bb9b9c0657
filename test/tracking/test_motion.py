"""What is known of corners that no edge shows lessens from picture to picture, and no faster."""

from face_views import RATE_HZ
from face_views import SQUARE
from homography_servo.tracking.motion import LEAST_SURPRISE_PX
from homography_servo.tracking.motion import Motion
from homography_servo.tracking.motion import similarity_basis
from homography_servo.tracking.motion import Spread
from homography_servo.tracking.motion import SURPRISES
import numpy as np


def random_covariance(rng, size):
    """Give a covariance of numbers that depend on each other."""
    factor = rng.normal(size=(size, size))
    return factor @ factor.T / size + 0.1 * np.eye(size)


def test_spread_is_that_of_a_kalman_filter_of_corners_and_velocities():
    rng, size, period_s = np.random.default_rng(1), 8, 0.04
    joint = random_covariance(rng, 2 * size)
    change, noise = random_covariance(rng, size), random_covariance(rng, size)
    steps = np.eye(2 * size)
    steps[:size, size:] = period_s * np.eye(size)
    shift = np.vstack([np.eye(size), np.eye(size) / period_s])
    before = steps @ joint @ steps.T + shift @ change @ shift.T
    gain = before[:, :size] @ np.linalg.inv(before[:size, :size] + noise)
    after = before - gain @ before[:size]

    ahead = Spread(joint[:size, :size], joint[:size, size:], joint[size:, size:]).ahead(
        period_s, change)
    spread, follow = ahead.told(after[:size, :size])
    assert np.allclose(np.block([[ahead.corners, ahead.cross], [ahead.cross.T, ahead.velocity]]),
                       before)
    assert np.allclose(np.block([[spread.corners, spread.cross],
                                 [spread.cross.T, spread.velocity]]), after)
    assert np.allclose(follow @ gain[:size], gain[size:])


def seen(motion, count, sigma_px, start=0, drift_px=0.0):
    """Let a square that drifts be measured so many times."""
    for index in range(start, start + count):
        motion.predict(index / RATE_HZ)
        motion.measured(SQUARE + index * drift_px, np.diag(np.square(sigma_px)),
                        index / RATE_HZ)


def bend_sigma_px(prior):
    """Give the deviation of the last corner where the other three are known."""
    return float(np.sqrt(np.diag(np.linalg.inv(prior.information[6:, 6:]))).max())


def expected_again(motion, index):
    """Predict, and measure exactly that: the last corner as uncertain as it is by then."""
    prior = motion.predict(index / RATE_HZ)
    known = np.diag([1.0 / 0.02 ** 2] * 6 + [0.0] * 2)
    motion.measured(prior.corners, np.linalg.inv(prior.information + known), index / RATE_HZ)
    return prior


def test_a_corner_that_no_picture_tells_is_known_worse_and_worse():
    motion = Motion()
    motion.measured(SQUARE, 0.02 ** 2 * np.eye(8), 0.0)
    seen(motion, 60, np.full(8, 0.02), start=1, drift_px=1.0)
    sigmas = [bend_sigma_px(expected_again(motion, index)) for index in range(61, 81)]
    assert np.all(np.diff(sigmas[1:]) > 0.0)
    assert sigmas[-1] > 5.0 * sigmas[0]
    expected_again(motion, 81)
    assert np.allclose(motion.corners, SQUARE + 81.0, atol=0.05)
    seen(motion, 2, np.full(8, 0.02), start=82, drift_px=1.0)
    assert bend_sigma_px(motion.predict(84.0 / RATE_HZ)) < 2.0 * sigmas[0]


def test_doubtful_corners_move_as_a_kalman_filter_says(monkeypatch):
    free_px = 5.0  # a plain filter cannot cope with numbers that differ much more
    monkeypatch.setattr('homography_servo.tracking.motion.FREE_SIGMA_PX', free_px)
    rng, period_s = np.random.default_rng(2), 1.0 / RATE_HZ
    sigma_px = np.array([0.02] * 6 + [0.5] * 2)
    noise = np.diag(np.square(sigma_px))
    motion = Motion()
    motion.measured(SQUARE, 0.01 ** 2 * np.eye(8), 0.0)
    seen(motion, 60, np.full(8, 0.01), start=1, drift_px=1.0)
    steps, measures = np.eye(16), np.eye(8, 16)
    steps[:8, 8:] = period_s * np.eye(8)
    shift = np.vstack([np.eye(8), np.eye(8) / period_s])
    state = np.concatenate([motion.corners.ravel(), np.full(8, RATE_HZ)])
    joint = np.zeros((16, 16))
    for index in range(61, 91):
        state = steps @ state
        free = similarity_basis(state[:8].reshape(4, 2))
        usual_px = LEAST_SURPRISE_PX * (SURPRISES if index == 61 else 1.0)
        change = usual_px ** 2 * np.eye(8) + free_px ** 2 * free @ free.T
        joint = steps @ joint @ steps.T + shift @ change @ shift.T
        prior = motion.predict(index * period_s)
        assert np.allclose(prior.corners.ravel(), state[:8], atol=1e-3)
        assert np.allclose(np.linalg.inv(prior.information), joint[:8, :8], atol=1e-3)
        gain = joint @ measures.T @ np.linalg.inv(joint[:8, :8] + noise)
        truth = (SQUARE + index + 0.005 * (index - 61) ** 2).ravel()
        state = state + gain @ (truth + sigma_px * rng.normal(size=8) - state[:8])
        joint = joint - gain @ joint[:8]
        motion.measured(state[:8].reshape(4, 2), joint[:8, :8], index * period_s)
