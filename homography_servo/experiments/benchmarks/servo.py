"""
Plan and servo, without images, next to classical visual-servo laws.

(a) *scenario*: displacements from public examples, the object flies freely, corner
noise 0.1 px (only where the scenarios' file is there). The convergence tolerance of
(a) is 1 % of the depth and 3 deg, since objects are up to 6 m away.
(b) *random pairs*: poses of the default robot that are reachable and visible, drawn
uniformly in joint space; exact models, corner noise 0.1 px. Converged means DONE (for
the laws: at rest) with the true pose within 5 mm and 3 deg of the goal. A law that
leaves the image, breaks a joint limit or jumps (0.5 rad in one iteration) has failed.
A veto is put to an independent search of the joint space (`veto_check`), in the world as
it truly is.
(c) *wrong models*: the same pairs in worlds where the robot stands 10 mm and 3 deg
elsewhere, the object is held 5 mm and 2 deg off, every joint zero is 2 deg off and the
focal length is 2 % off. Goals are taught with the arm standing there.
(d) *noisy*: free-flying pairs of a 0.10 x 0.06 m face, f = 800 px, corner noise 0.1,
0.3 and 1.0 px. Settled means that over the last 100 of 200 looks the true pose is
within 20 mm and 5 deg of the goal, root mean square. Displacements are carried out
exactly for every method.

Classical laws (`servo_laws`): image-based with the current, desired and mean
interaction matrix, position-based in the camera frame, 2 1/2-D; gain 0.15 per
iteration, 250 iterations; pose by reprojection, minimum nearest to the last one.
"""

from __future__ import annotations

from functools import lru_cache
from functools import partial
from pathlib import Path
import time
from typing import Any, Iterator, Sequence, TypeVar

import cv2
from homography_servo.experiments.servo_classic import run_free
from homography_servo.experiments.servo_classic import run_on_robot
from homography_servo.experiments.servo_free import FreeWorld
from homography_servo.experiments.servo_free import run_free_pair
from homography_servo.experiments.servo_laws import LAWS
from homography_servo.experiments.servo_outcome import Outcome
from homography_servo.experiments.servo_outcome import row
from homography_servo.experiments.servo_pairs import CAMERA
from homography_servo.experiments.servo_pairs import exact_world
from homography_servo.experiments.servo_pairs import free_poses
from homography_servo.experiments.servo_pairs import random_pairs
from homography_servo.experiments.servo_pairs import RobotPair
from homography_servo.experiments.servo_pairs import World
from homography_servo.experiments.servo_pairs import wrong_world
from homography_servo.experiments.servo_runs import Confirm
from homography_servo.experiments.servo_runs import run_pair
from homography_servo.experiments.servo_scenarios import load_scenarios
from homography_servo.experiments.servo_scenarios import scenario_rows
from homography_servo.experiments.veto_check import NODES
from homography_servo.experiments.veto_check import Roadmap
from homography_servo.geometry.face import face_corners
from homography_servo.geometry.rigid import pose_difference
from homography_servo.places import find_config
from homography_servo.planning.settings import PlannerSettings
from homography_servo.robot.robot_file import load_robot
import numpy as np

OURS = 'homography_servo'
NOISE_PX = 0.1
NOISES_PX = (0.1, 0.3, 1.0)
PAIRS, QUICK_PAIRS = 1000, 4
QUICK_NODES = 3000
FREE_PAIRS, QUICK_FREE_PAIRS = 300, 2
LOOKS, LAST_LOOKS = 200, 100
SETTLED_M, SETTLED_RAD = 0.02, np.radians(5.0)
SCENARIOS = 'shared/scenarios.yaml'  # beside the folder it runs in, or beside the sources


def run(quick: bool, seed: int) -> Iterator[dict[str, Any]]:
    """Measure everything; yields rows as described in the module."""
    cv2.setNumThreads(1)
    folders = (Path.cwd().parent, Path(__file__).resolve().parents[4])
    found = [folder / SCENARIOS for folder in folders if (folder / SCENARIOS).is_file()]
    scenarios = load_scenarios(found[0]) if found else []
    yield from scenario_rows(scenarios[:2] if quick else scenarios, seed, NOISE_PX)
    robot = load_robot(find_config('robix_rcs6.yaml'))
    pairs = random_pairs(robot, QUICK_PAIRS if quick else PAIRS, seed)
    confirm = partial(_confirmed, nodes=QUICK_NODES if quick else NODES, seed=seed)
    exact = exact_world(robot)
    yield from _robot_rows('random pairs', [exact] * len(pairs), pairs, seed, confirm)
    wrong = [wrong_world(robot, pair) for pair in pairs]
    yield from _robot_rows('wrong models', wrong, pairs, seed, confirm)
    yield from _noisy_rows(QUICK_FREE_PAIRS if quick else FREE_PAIRS, seed)


Item = TypeVar('Item')


def _told(case: str, items: Sequence[Item]) -> Iterator[Item]:
    """Go through items and print, ten times in all, how far that is."""
    began_s = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        if 10 * done // len(items) > 10 * (done - 1) // len(items):
            print(f'{case}: {done} of {len(items)}, {time.monotonic() - began_s:.0f} s',
                  flush=True)


@lru_cache(maxsize=1)
def _roadmap(world: World, nodes: int, seed: int) -> Roadmap:
    return Roadmap(world.arm.corrected, world.camera, PlannerSettings(), nodes, seed)


def _confirmed(world: World, pair: RobotPair, nodes: int, seed: int) -> bool:
    """Search for a way as the world truly is."""
    return _roadmap(world, nodes, seed).confirms(pair.start_rad, world.arm.pose(pair.goal_rad))


def _robot_rows(case: str, worlds: Sequence[World], pairs: Sequence[RobotPair], seed: int,
                confirm: Confirm) -> Iterator[dict[str, Any]]:
    ours = []
    for world, pair in _told(case, list(zip(worlds, pairs))):
        outcome = run_pair(world, pair, NOISE_PX, confirm)
        ours.append(outcome)
        if outcome.why and not outcome.confirmed:
            print(f'{case}, pair {len(ours)}: {outcome.why}', flush=True)
    yield row(OURS, case, ours, robot=True)
    robot = worlds[0].arm.robot
    for name, law in LAWS.items():
        yield row(name, case, run_on_robot(law, robot, worlds, pairs, NOISE_PX, seed), True)


def _noisy_rows(count: int, seed: int) -> Iterator[dict[str, Any]]:
    points_m, depth_m = face_corners(0.10, 0.06), 1.0
    poses = free_poses(points_m, 2 * count, seed)
    starts, goals = poses[:count], poses[count:]
    for noise_px in NOISES_PX:
        case, ways, ours = f'noisy {noise_px} px', [], []
        for index, (start, goal) in enumerate(_told(case, list(zip(starts, goals)))):
            world = FreeWorld(CAMERA, points_m, depth_m, start, noise_px, seed + index)
            ours.append(run_free_pair(world, goal, LOOKS))
            ways.append(world.trace[-LAST_LOOKS:])
        yield _settled(OURS, case, ours, ways, goals)
        for name, law in LAWS.items():
            outcomes, trace = run_free(law, CAMERA, points_m, depth_m, starts, goals, noise_px,
                                       seed, LOOKS)
            ways = list(np.swapaxes(trace[-LAST_LOOKS:], 0, 1))
            yield _settled(name, case, outcomes, ways, goals)


def _settled(method: str, case: str, outcomes: list[Outcome], ways: list, goals: np.ndarray
             ) -> dict[str, Any]:
    """Count the runs whose last looks stay near the goal."""
    rms = []
    for way, goal in zip(ways, goals):
        errors = pose_difference(np.array(way), np.broadcast_to(goal, np.shape(way)))
        rms.append([np.sqrt(np.square(errors[:, part]).sum(axis=1).mean())
                    for part in (slice(0, 3), slice(3, 6))])
    rms = np.array(rms)
    left = np.array([outcome.left_image for outcome in outcomes])
    settled = (rms[:, 0] < SETTLED_M) & (rms[:, 1] < SETTLED_RAD) & ~left
    result = row(method, case, outcomes, robot=False)
    for name in ('vetoed_confirmed', 'vetoed_not_confirmed', 'failed'):
        result.pop(name, None)
    result.update(settled_share=float(settled.mean()),
                  settled_rms_mm_median=float(1e3 * np.median(rms[:, 0])),
                  settled_rms_deg_median=float(np.degrees(np.median(rms[:, 1]))))
    return result
