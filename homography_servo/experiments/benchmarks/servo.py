"""
Plan and servo, without images, next to classical visual-servo laws.

(a) *scenario*: displacements from public examples, the object flies freely, corner
noise 0.1 px (only where the scenarios' file is there). The convergence tolerance of
(a) is 1 % of the depth and 3 deg, since objects are up to 6 m away.
(b) *random pairs*: poses of the default robot that are reachable and visible, drawn
uniformly in joint space; exact models, corner noise 0.1 px. Converged means DONE (for
the laws: at rest) with the true pose within 5 mm and 3 deg of the goal. A law that
leaves the image, breaks a joint limit or jumps (0.5 rad in one iteration) has failed.
A veto is put to an independent search in joint space (`servo_search`).
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

from pathlib import Path
from typing import Any

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
from homography_servo.experiments.servo_pairs import wrong_world
from homography_servo.experiments.servo_runs import run_pair
from homography_servo.experiments.servo_scenarios import load_scenarios
from homography_servo.experiments.servo_scenarios import scenario_rows
from homography_servo.experiments.servo_search import way_exists
from homography_servo.geometry.face import face_corners
from homography_servo.geometry.rigid import pose_difference
from homography_servo.places import find_config
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.robot_file import Robot
import numpy as np

OURS = 'homography_servo'
NOISE_PX = 0.1
NOISES_PX = (0.1, 0.3, 1.0)
PAIRS, QUICK_PAIRS = 1000, 4
FREE_PAIRS, QUICK_FREE_PAIRS = 300, 2
LOOKS, LAST_LOOKS = 200, 100
SETTLED_M, SETTLED_RAD = 0.02, np.radians(5.0)
SCENARIOS = 'shared/scenarios.yaml'  # beside the folder it runs in, or beside the sources


def run(quick: bool, seed: int) -> list[dict[str, Any]]:
    """Measure everything; rows as described in the module."""
    folders = (Path.cwd().parent, Path(__file__).resolve().parents[4])
    found = [folder / SCENARIOS for folder in folders if (folder / SCENARIOS).is_file()]
    scenarios = load_scenarios(found[0]) if found else []
    rows = scenario_rows(scenarios[:2] if quick else scenarios, seed, NOISE_PX)
    robot = load_robot(find_config('robix_rcs6.yaml'))
    rows += _robot_rows(robot, QUICK_PAIRS if quick else PAIRS, seed)
    return rows + _noisy_rows(QUICK_FREE_PAIRS if quick else FREE_PAIRS, seed)


def _robot_rows(robot: Robot, count: int, seed: int) -> list[dict[str, Any]]:
    pairs, rows, known = random_pairs(robot, count, seed), [], {}

    def confirm(pair) -> bool:
        if pair.seed not in known:
            known[pair.seed] = not way_exists(robot, pair.start_rad, pair.goal_rad, pair.seed)
        return known[pair.seed]

    for case, worlds in (
            ('random pairs', [exact_world(robot) for _ in pairs]),
            ('wrong models', [wrong_world(robot, pair) for pair in pairs])):
        ours = [run_pair(world, pair, NOISE_PX, confirm) for world, pair in zip(worlds, pairs)]
        for outcome in ours:
            if outcome.why and not outcome.confirmed:
                print(f'{case}: {outcome.why}', flush=True)
        rows.append(row(OURS, case, ours, robot=True))
        rows += [row(name, case, run_on_robot(law, robot, worlds, pairs, NOISE_PX, seed), True)
                 for name, law in LAWS.items()]
    return rows


def _noisy_rows(count: int, seed: int) -> list[dict[str, Any]]:
    points_m, depth_m, rows = face_corners(0.10, 0.06), 1.0, []
    poses = free_poses(points_m, 2 * count, seed)
    starts, goals = poses[:count], poses[count:]
    for noise_px in NOISES_PX:
        case, ways, ours = f'noisy {noise_px} px', [], []
        for index, (start, goal) in enumerate(zip(starts, goals)):
            world = FreeWorld(CAMERA, points_m, depth_m, start, noise_px, seed + index)
            ours.append(run_free_pair(world, goal, LOOKS))
            ways.append(world.trace[-LAST_LOOKS:])
        rows.append(_settled(OURS, case, ours, ways, goals))
        for name, law in LAWS.items():
            outcomes, trace = run_free(law, CAMERA, points_m, depth_m, starts, goals, noise_px,
                                       seed, LOOKS)
            ways = list(np.swapaxes(trace[-LAST_LOOKS:], 0, 1))
            rows.append(_settled(name, case, outcomes, ways, goals))
    return rows


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
