"""Quaternions of messages agree with scipy's, at every angle."""

import math

from homography_servo.geometry.quaternion import quaternion_of
from homography_servo.geometry.quaternion import rotation_of
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

HALF_TURNS = [math.pi * np.array(axis) / np.linalg.norm(axis)
              for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -2, 3), (-1, 0, 1))]
NEAR = [(1.0 - 1e-9) * vector for vector in HALF_TURNS]
SMALL = [np.zeros(3), np.array([1e-9, 0.0, 0.0]), np.array([0.0, -1e-4, 1e-4])]


@pytest.mark.parametrize('vector', [
    *HALF_TURNS, *NEAR, *SMALL, *np.random.default_rng(5).uniform(-1.8, 1.8, (40, 3))])
def test_there_and_back_and_as_scipy_does_it(vector):
    rotation = Rotation.from_rotvec(vector).as_matrix()
    quaternion = np.array(quaternion_of(rotation))
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15) and quaternion[3] >= 0.0
    assert np.abs(Rotation.from_quat(quaternion).as_matrix() - rotation).max() < 1e-15 * 8
    assert np.abs(rotation_of(*quaternion) - rotation).max() < 1e-15 * 8


def test_the_length_of_a_quaternion_does_not_matter():
    quaternion = np.array([0.1, -0.7, 0.3, 0.2])
    assert np.abs(rotation_of(*(3.0 * quaternion))
                  - Rotation.from_quat(quaternion).as_matrix()).max() < 1e-15


@pytest.mark.parametrize('wrong', [(0, 0, 0, 0), (math.nan, 0, 0, 1), (math.inf, 0, 0, 1)])
def test_a_quaternion_without_direction_is_refused(wrong):
    with pytest.raises(ValueError, match='finite length above 0'):
        rotation_of(*wrong)
