"""A body in free flight: commanded motion tells the mirror poses of a plane apart."""

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.path import interpolate
from homography_servo.geometry.pose import estimate_pose
from homography_servo.geometry.rigid import displaced
from homography_servo.planning.control import displacement
from homography_servo.planning.free_flight import FreeServo
from homography_servo.planning.free_flight import MirrorFilters
from homography_servo.planning.look_filter import Look
import numpy as np
import pytest
from servo_setup import ROBOT

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
POINTS, DEPTH, NOISE_PX = ROBOT.object_points_m, ROBOT.home_depth_m, 0.2
START = displaced(np.eye(4), np.array([0.05, -0.03, 0.05, 0.15, -0.35, 0.3]))
GOAL = displaced(np.eye(4), np.array([-0.02, 0.02, -0.05, -0.3, 0.1, -0.2]))


def corners(pose, rng):
    """Measure corners [px] of the object at a pose (4, 4)."""
    corners_px = CAMERA.project(POINTS @ pose[:3, :3].T + pose[:3, 3] + (0.0, 0.0, DEPTH))
    return corners_px + NOISE_PX * rng.normal(size=corners_px.shape)


def look_at(pose, rng):
    """Measure rays and their covariance."""
    return Look(CAMERA.rays(corners(pose, rng)).ravel(),
                (NOISE_PX / CAMERA.fx) ** 2 * np.eye(2 * len(POINTS)))


def begun(pose, rng):
    """Start filters from both minima at a pose (4, 4), the wrong one in front."""
    first = estimate_pose(POINTS, corners(pose, rng), CAMERA, DEPTH, NOISE_PX ** 2)
    filters, minima = MirrorFilters(POINTS, DEPTH), list(first.candidates)[::-1]
    assert len(minima) == 2
    filters.begin(np.array([m.home_from_object for m in minima]),
                  np.array([m.covariance for m in minima]), np.eye(4))
    return filters


def fly(servo, steps, rng, pushed=None):
    """Let a body that starts at START carry out what the servo says; give where it ends."""
    setpoint, push = np.eye(4), np.eye(4)
    for step in range(steps):
        push = push if step != 5 or pushed is None else pushed
        setpoint = servo.step(look_at(push @ START @ setpoint, rng), setpoint)
    return push @ START @ setpoint


def to_goal(pose, count=12):
    return interpolate(pose, GOAL, count, DEPTH)


@pytest.mark.parametrize('seed', range(3))
def test_the_goal_is_reached_whichever_minimum_came_first(seed):
    rng = np.random.default_rng(seed)
    filters = begun(START, rng)
    servo = FreeServo(filters, to_goal(filters.leader.pose(np.eye(4))), to_goal)
    end = fly(servo, 30, rng)
    assert servo.at_goal
    away = displacement(end, GOAL)
    assert np.linalg.norm(away[:3]) < 5e-3 and np.linalg.norm(away[3:]) < np.radians(2.0)


def test_a_push_off_the_path_makes_a_new_one():
    rng, asked = np.random.default_rng(4), []

    def replan(pose):
        asked.append(pose)
        return to_goal(pose)

    filters = begun(START, rng)
    servo = FreeServo(filters, to_goal(filters.leader.pose(np.eye(4))), replan)
    pushed = displaced(np.eye(4), np.array([0.12, 0.0, 0.0, 0.0, 0.0, 0.0]))
    end = fly(servo, 60, rng, pushed)
    assert asked and np.linalg.norm(displacement(end, GOAL)[:3]) < 5e-3
