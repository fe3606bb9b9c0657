"""Robots for tests: the default one, and arms of other builds."""

import dataclasses
import math

from homography_servo.places import find_config
from homography_servo.robot.robot_file import Joint
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.robot_file import Robot
import numpy as np

DEFAULT = find_config('robix_rcs6.yaml')


def default_robot() -> Robot:
    return load_robot(DEFAULT)


def joint(name='joint1', channel=1, **changes) -> Joint:
    values = {'name': name, 'theta0_rad': 0.0, 'd_m': 0.1, 'a_m': 0.2, 'alpha_rad': 0.0,
              'lower_rad': -1.4, 'upper_rad': 1.4, 'velocity_rad_s': 1.5,
              'acceleration_rad_s2': 6.0, 'channel': channel, 'units_per_rad': 1000.0,
              'sign': 1, 'zero_units': 0.0}
    return Joint(**{**values, **changes})


def arm(rows, **changes) -> Robot:
    """Build an arm from rows (theta0, d, a, alpha)."""
    joints = [joint(f'joint{i + 1}', i + 1, theta0_rad=row[0], d_m=row[1], a_m=row[2],
                    alpha_rad=row[3]) for i, row in enumerate(rows)]
    values = {'name': 'arm', 'joints': joints, 'home_depth_m': 1.0, 'home_from_base': np.eye(4),
              'tool_from_object': np.eye(4), 'face_size_m': (0.1, 0.06)}
    return Robot(**{**values, **changes})


def elbow_arm() -> Robot:
    """Turn, shoulder, elbow and a wrist of three, with no two axes where a Robix has them."""
    right = 0.5 * math.pi
    return arm([(0, 0.3, 0.05, right), (0, 0, 0.3, 0), (0, 0.02, 0.06, right),
                (0, 0.28, 0, -right), (0, 0, 0, right), (0, 0.08, 0, 0)])


def random_joints(robot: Robot, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.lower_rad, robot.upper_rad, (count, robot.count))


def changed_joint(robot: Robot, index: int, **changes) -> Robot:
    joints = list(robot.joints)
    joints[index] = dataclasses.replace(joints[index], **changes)
    return dataclasses.replace(robot, joints=tuple(joints))
