"""The control law: exact away from singularities, bounded near them, all joints together."""

from homography_servo.geometry.rigid import displaced
from homography_servo.planning.arm_model import ArmModel
from homography_servo.planning.control import corner_travel
from homography_servo.planning.control import damped_step
from homography_servo.planning.control import displacement
from homography_servo.planning.control import Errors
from homography_servo.planning.control import errors_of
from homography_servo.planning.control import joints_for
from homography_servo.planning.control import limit_step
from homography_servo.planning.control import move_time
from homography_servo.planning.control import next_pose
from homography_servo.planning.control import sigmas_of
import numpy as np
import pytest
from servo_setup import GOAL_RAD
from servo_setup import ROBOT
from servo_setup import START_RAD
from servo_setup import straight_path
from servo_setup import wrong_arm


def test_errors_are_sorted_by_degree_of_freedom():
    errors = errors_of(np.array([3.0, -4.0, -2.0, 0.3, 0.4, -0.1]))
    assert errors == pytest.approx((5.0, 2.0, 0.1, 0.5))
    assert errors.over(Errors(10.0, 1.0, 1.0, 1.0)) == pytest.approx(2.0)


@pytest.mark.parametrize('place, expected', [(0.0, 0), (0.7, 0), (9.8, 10), (20.0, 20)])
def test_a_path_is_begun_at_its_first_pose_unless_another_is_nearer(place, expected):
    path = straight_path(ArmModel(ROBOT), 21)
    way = displacement(path[0], path[-1])
    assert next_pose(path, displaced(path[0], place / 20.0 * way)) == expected


def test_sigmas_take_the_worst_direction():
    covariance = np.diag([1.0, 4.0, 9.0, 16.0, 25.0, 36.0])
    assert sigmas_of(covariance) == pytest.approx((2.0, 3.0, 6.0, 5.0))


@pytest.mark.parametrize('seed', range(5))
def test_step_is_exact_for_small_displacements_away_from_singularities(seed):
    rng = np.random.default_rng(seed)
    model = wrong_arm(seed)
    jacobian = model.posture(START_RAD)[1]
    twist = rng.normal(size=6)
    assert jacobian @ damped_step(jacobian, twist) == pytest.approx(twist, abs=1e-9)


def test_step_stays_bounded_where_the_jacobian_is_singular():
    jacobian = ArmModel(ROBOT).posture(START_RAD)[1].copy()
    jacobian[:, 5] = jacobian[:, 4]
    step = damped_step(jacobian, np.full(6, 0.01))
    assert np.isfinite(step).all() and np.abs(step).max() < 1.0


@pytest.mark.parametrize('seed', range(5))
def test_joints_for_a_reachable_pose_bring_the_object_there(seed):
    model = wrong_arm(seed)
    goal = model.pose(GOAL_RAD)
    found = joints_for(model, START_RAD, goal)
    assert displacement(model.pose(found), goal) == pytest.approx(0.0, abs=1e-7)


def test_shortened_step_keeps_its_direction_and_names_the_joint():
    target = START_RAD + np.radians([10.0, 50.0, -5.0, 0.0, 3.0, 0.0])
    step = limit_step(ROBOT, START_RAD, target, 0.02, 10.0)
    assert step.limited_by == 'joint2'
    assert step.joints_rad[1] == pytest.approx(ROBOT.upper_rad[1] - 0.02)
    assert step.joints_rad - START_RAD == pytest.approx(step.share * (target - START_RAD))
    free = limit_step(ROBOT, START_RAD, START_RAD + 0.01, 0.02, 10.0)
    assert free.share == 1.0 and free.limited_by == ''


def test_long_step_is_cut_to_the_largest_move():
    step = limit_step(ROBOT, START_RAD, GOAL_RAD, 0.02, 0.1)
    assert np.abs(step.joints_rad - START_RAD).max() == pytest.approx(0.1)
    assert step.limited_by == 'step'


@pytest.mark.parametrize('side', (-1.0, 1.0))
def test_joint_inside_its_margin_may_leave_it_but_not_go_deeper(side):
    inside = START_RAD.copy()
    inside[1] = ROBOT.upper_rad[1] - 0.001
    step = limit_step(ROBOT, inside, inside + [0.0, side * 0.1, 0.0, 0.0, 0.0, 0.0], 0.02, 1.0)
    assert step.share == (0.0 if side > 0 else 1.0)


@pytest.mark.parametrize('size_rad', (1e-4, 0.02, 0.5))
def test_cubic_move_of_that_time_keeps_speed_and_acceleration(size_rad):
    step = size_rad * np.array([1.0, -0.5, 0.2, 0.0, -1.0, 0.7])
    span = move_time(ROBOT, step)
    u = np.linspace(0.0, 1.0, 201)[:, None]
    speed, acceleration = step * 6.0 * u * (1 - u) / span, step * (6 - 12 * u) / span ** 2
    over = max((np.abs(speed) / ROBOT.velocity_rad_s).max(),
               (np.abs(acceleration) / ROBOT.acceleration_rad_s2).max())
    assert over == pytest.approx(1.0, abs=1e-3)


def test_corner_travel_is_zero_at_rest_and_grows_with_the_step():
    model = ArmModel(ROBOT)
    travel = [corner_travel(model, START_RAD, START_RAD + share * (GOAL_RAD - START_RAD),
                            ROBOT.object_points_m, 1.0) for share in (0.0, 0.1, 0.2)]
    assert travel[0] == 0.0 and 0.0 < travel[1] < travel[2]
