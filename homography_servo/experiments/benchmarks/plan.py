"""
Planning: how often, how fast, and whether vetoes are true.

Random pairs are reachable, visible poses of the default robot, seen exactly. Each is
planned with repairs, with repairs that keep off singularities, by the paper's path
alone, and by the straight way in joint space alone. Every executable plan is looked at
again between its poses, with the joints on the straight way that the arm takes from
pose to pose; every veto is put to an exhaustive search (`veto_check`). Wall time is what
a user waits; processor time is the same on a machine that does nothing else.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
import time
from typing import Any, Callable, Iterator, NamedTuple

import cv2
from homography_servo.experiments.servo_pairs import CAMERA
from homography_servo.experiments.servo_pairs import random_pairs
from homography_servo.experiments.servo_pairs import RobotPair
from homography_servo.experiments.veto_check import Roadmap
from homography_servo.geometry.path import interpolate
from homography_servo.places import find_config
from homography_servo.planning.feasibility import check_path
from homography_servo.planning.feasibility import look
from homography_servo.planning.joint_search import spread
from homography_servo.planning.planner import FIRST
from homography_servo.planning.planner import Plan
from homography_servo.planning.planner import plan
from homography_servo.planning.settings import PlannerSettings
from homography_servo.result import Rejected
from homography_servo.robot.kinematics import inverse
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.robot_file import Robot
import numpy as np

OURS = 'homography_servo'
SETTINGS = PlannerSettings()
TRIAL_DEG = ((-50.0, 40.0, 10.0, -10.0, 0.0, -20.0), (-5.0, 40.0, 10.0, -10.0, 0.0, -20.0))
BETWEEN = 5  # looks between two poses of a plan
JUMP_RAD = 0.5


def run(quick: bool, seed: int) -> Iterator[dict[str, Any]]:
    """Measure; yields rows as every suite has them."""
    cv2.setNumThreads(1)
    robot = load_robot(find_config('robix_rcs6.yaml'))
    pairs = random_pairs(robot, 40 if quick else 1000, seed)
    yield from _verdict_rows(robot, 5 if quick else 50)
    for settings in (SETTINGS, replace(SETTINGS, pass_singularities=False)):
        roadmap = Roadmap(robot, CAMERA, settings, 3000 if quick else 12000, seed)
        yield from _pair_rows(robot, pairs, roadmap, settings)
    yield from _others(robot, pairs)


class Times(NamedTuple):
    """What one call took."""

    wall_ms: float
    processor_ms: float


def _timed(work: Callable[[], Any]) -> tuple[Any, Times]:
    began_s, used_s = time.perf_counter(), time.process_time()
    result = work()
    return result, Times(1e3 * (time.perf_counter() - began_s),
                         1e3 * (time.process_time() - used_s))


def _times(times: list[Times]) -> dict[str, float]:
    if not times:
        return {}
    columns = {}
    for name, values in zip(('time_ms', 'processor_ms'), zip(*times)):
        for label, value in zip(('median', 'p95', 'p99'), np.percentile(values, (50, 95, 99))):
            columns[f'{name}_{label}'] = float(value)
    return columns


def _verdict_rows(robot: Robot, rounds: int) -> list[dict[str, Any]]:
    start_rad, goal_rad = np.radians(TRIAL_DEG)
    ends = object_pose(robot, start_rad), object_pose(robot, goal_rad)
    rows = []
    for count in (31, 1000):
        poses = interpolate(*ends, count, robot.home_depth_m)
        judged = [_timed(lambda: check_path(poses, CAMERA, robot.object_points_m, robot,
                                            start_rad, SETTINGS)) for _ in range(rounds)]
        rows.append({'method': OURS, 'case': f'verdict of the trial, N = {count}',
                     'planned_share': float(judged[-1][0].ok),
                     **_times([ms for _, ms in judged])})
    planned = [_timed(lambda: plan(*ends, CAMERA, robot, start_rad)) for _ in range(rounds)]
    rows.append({'method': OURS, 'case': 'plan of the trial, N = 31, no repair',
                 'planned_share': float(planned[-1][0].family == FIRST and planned[-1][0].ok),
                 **_times([ms for _, ms in planned])})
    return rows


def _pair_rows(robot: Robot, pairs: list[RobotPair], roadmap: Roadmap,
               settings: PlannerSettings) -> list[dict[str, Any]]:
    found = [_timed(lambda: _planned(robot, pair, settings)) for pair in pairs]
    first = [(p, ms) for p, ms in found if p.ok and p.family == FIRST]
    repaired = [(p, ms) for p, ms in found if p.ok and p.family != FIRST]
    vetoed = [(pair, p, ms) for pair, (p, ms) in zip(pairs, found) if not p.ok]
    confirmed = [roadmap.confirms(pair.start_rad, object_pose(robot, pair.goal_rad))
                 for pair, _, _ in vetoed]
    kind = '' if settings.pass_singularities else ', singularities kept off'
    whole = {'method': OURS, 'case': f'{len(pairs)} random pairs{kind}', 'pairs': len(pairs),
             'planned_share': (len(first) + len(repaired)) / len(pairs),
             'vetoed_share': len(vetoed) / len(pairs),
             'vetoes_confirmed': sum(confirmed),
             'vetoes_not_confirmed': len(vetoed) - sum(confirmed),
             **_broken(robot, [p for p, _ in first + repaired]), **_times([ms for _, ms in found])}
    rows = [whole]
    for case, part in (('without a repair', first), ('with a repair', repaired),
                       ('vetoed', [(p, ms) for _, p, ms in vetoed])):
        rows.append({'method': OURS, 'case': f'of these, {case}', 'pairs': len(part),
                     'planned_share': len(part) / len(pairs), **_times([ms for _, ms in part])})
    ways = Counter(_kind(p.family) for p, _ in repaired)
    rows += [{'method': OURS, 'case': f'repaired by {way}', 'pairs': number,
              'planned_share': number / len(pairs)} for way, number in ways.most_common()]
    return rows


def _planned(robot: Robot, pair: RobotPair, settings: PlannerSettings) -> Plan | Rejected:
    return plan(object_pose(robot, pair.start_rad), object_pose(robot, pair.goal_rad), CAMERA,
                robot, pair.start_rad, settings)


def _kind(family: str) -> str:
    return 'a via-pose' if family.startswith('via-pose') else family.split(' (')[0]


def _others(robot: Robot, pairs: list[RobotPair]) -> list[dict[str, Any]]:
    """Give the shares of the paper's path alone and of straight ways in joint space."""
    alone = replace(SETTINGS, repair=False)
    paper = [_timed(lambda: _planned(robot, pair, alone)) for pair in pairs]
    joint = [_timed(lambda: _straight(robot, pair)) for pair in pairs]
    case = f'{len(pairs)} random pairs'
    return [
        {'method': "the paper's path alone", 'case': case, 'pairs': len(pairs),
         'planned_share': float(np.mean([p.ok for p, _ in paper])),
         **_times([ms for _, ms in paper])},
        {'method': 'straight in joint space alone', 'case': case, 'pairs': len(pairs),
         'planned_share': float(np.mean([ok for ok, _ in joint])),
         **_times([ms for _, ms in joint])}]


def _straight(robot: Robot, pair: RobotPair) -> bool:
    """Tell whether a straight way in joint space to any branch of the goal is feasible."""
    for goal_rad in inverse(robot, object_pose(robot, pair.goal_rad), pair.start_rad):
        joints = spread(np.array([pair.start_rad, goal_rad]), SETTINGS.poses)
        if check_path(object_pose(robot, joints), CAMERA, robot.object_points_m, robot,
                      pair.start_rad, SETTINGS).ok:
            return True
    return False


def _broken(robot: Robot, plans: list[Plan]) -> dict[str, float]:
    """Look between the poses of plans: hard limits, border of the image, jumps."""
    outside, beyond, jumps = 0, 0, 0
    for found in plans:
        joints = _dense(found.joints_rad)
        seen = look(object_pose(robot, joints), CAMERA, robot.object_points_m,
                    robot.home_depth_m)
        outside += bool(seen.border_px.min() < 0.0)
        beyond += bool(((joints < robot.lower_rad) | (joints > robot.upper_rad)).any())
        jumps += bool(np.abs(np.diff(found.joints_rad, axis=0)).max() > JUMP_RAD)
    number = max(len(plans), 1)
    return {'left_image_share': outside / number, 'limit_broken_share': beyond / number,
            'jump_share': jumps / number}


def _dense(joints_rad: np.ndarray) -> np.ndarray:
    at = np.arange(len(joints_rad), dtype=float)
    fine = np.linspace(0.0, at[-1], (len(at) - 1) * BETWEEN + 1)
    return np.column_stack([np.interp(fine, at, column) for column in joints_rad.T])
