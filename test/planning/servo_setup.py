"""What the tests of the servo share: an arm, a path, noisy measurements."""

from homography_servo.experiments.servo_world import ServoWorld
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import exp_twist
from homography_servo.places import find_config
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.control import displacement
from homography_servo.planning.look_filter import rays_of
from homography_servo.planning.servo import Servo
from homography_servo.planning.servo_settings import ServoSettings
from homography_servo.robot.robot_file import load_robot
import numpy as np

ROBOT = load_robot(find_config('robix_rcs6.yaml'))
START_RAD = np.radians([-50.0, 40.0, 10.0, -10.0, 0.0, -20.0])
GOAL_RAD = np.radians([-5.0, 40.0, 10.0, -10.0, 0.0, -20.0])
FOCAL_PX = 800.0


def twist_of_size(rng, length_m, angle_rad):
    linear, angular = rng.normal(size=(2, 3))
    return np.concatenate([length_m * linear / np.linalg.norm(linear),
                           angle_rad * angular / np.linalg.norm(angular)])


def wrong_arm(seed):
    """Stand 10 mm and 3 deg elsewhere, hold 5 mm and 2 deg off, joint zeros 2 deg off."""
    rng = np.random.default_rng(seed)
    return ArmModel(ROBOT, exp_twist(twist_of_size(rng, 0.01, np.radians(3.0))),
                    np.radians(2.0) * rng.choice([-1.0, 1.0], 6),
                    exp_twist(twist_of_size(rng, 0.005, np.radians(2.0))))


def straight_path(truth, count=31, start_rad=START_RAD, goal_rad=GOAL_RAD):
    start, goal = truth.pose(start_rad), truth.pose(goal_rad)
    way = displacement(start, goal)
    return np.array([displaced(start, share * way) for share in np.linspace(0.0, 1.0, count)])


def camera(seed, noise_px=0.1):
    """Measure poses as four corners with this noise would give them."""
    rng = np.random.default_rng(seed)

    def measure(home_from_object):
        _, jacobian = rays_of(home_from_object, ROBOT.object_points_m, ROBOT.home_depth_m)
        covariance = np.linalg.inv(jacobian.T @ jacobian) * (noise_px / FOCAL_PX) ** 2
        error = np.linalg.cholesky(covariance) @ rng.normal(size=6)
        return displaced(home_from_object, error), covariance
    return measure


def world(seed=0, truth=None, count=31, noise_px=0.1, settings=None, **kwargs):
    truth = truth or ArmModel(ROBOT)
    servo = Servo(ROBOT, settings or ServoSettings())
    servo.set_focal(FOCAL_PX)
    servo.set_path(straight_path(truth, count), True, 'good')
    return ServoWorld(servo, truth, START_RAD, camera(seed, noise_px), **kwargs)
