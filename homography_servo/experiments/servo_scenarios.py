"""Displacements from public examples: free-flying squares between two poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Iterator, NamedTuple

from homography_servo.experiments.servo_classic import run_free
from homography_servo.experiments.servo_free import FreeWorld
from homography_servo.experiments.servo_free import run_free_pair
from homography_servo.experiments.servo_laws import LAWS
from homography_servo.experiments.servo_outcome import Outcome
from homography_servo.experiments.servo_outcome import row
from homography_servo.geometry.camera import Camera
from homography_servo.geometry.face import face_corners
from homography_servo.geometry.rigid import transform
import numpy as np
from scipy.spatial.transform import Rotation
import yaml

LOOKS = 80
NEAR_SHARE, NEAR_RAD = 0.01, np.radians(3.0)  # of the goal's depth


class Scenario(NamedTuple):
    """A square, a camera, a start and a goal; home lies at the goal's depth."""

    name: str
    camera: Camera
    points_m: np.ndarray
    home_depth_m: float
    start: np.ndarray  # (4, 4) home_from_object
    goal: np.ndarray


def load_scenarios(path: Path) -> list[Scenario]:
    """Read scenarios from YAML; none where the file is missing."""
    if not path.is_file():
        return []
    return [_scenario(item) for item in yaml.safe_load(path.read_text())['scenarios']]


def _scenario(item: dict[str, Any]) -> Scenario:
    view = item['camera']
    camera = Camera(*(float(view[key]) for key in ('fx', 'fy', 'cx', 'cy')),
                    int(view['width']), int(view['height']))
    depth_m = float(item['goal']['t_m'][2])
    start, goal = (_pose(item[end], depth_m) for end in ('start', 'goal'))
    return Scenario(str(item['id']), camera, face_corners(item['side_m'], item['side_m']),
                    depth_m, start, goal)


def _pose(item: dict[str, list[float]], home_depth_m: float) -> np.ndarray:
    place = np.array(item['t_m'], dtype=float) - (0.0, 0.0, home_depth_m)
    return transform(Rotation.from_rotvec(item['rotvec_rad']).as_matrix(), place)


def run_scenario(scenario: Scenario, noise_px: float, seed: int) -> Outcome:
    """Plan and servo a scenario."""
    world = FreeWorld(scenario.camera, scenario.points_m, scenario.home_depth_m,
                      scenario.start, noise_px, seed)
    return _near(run_free_pair(world, scenario.goal, LOOKS), scenario)


def _near(outcome: Outcome, scenario: Scenario) -> Outcome:
    near = outcome.error_m < NEAR_SHARE * scenario.home_depth_m and outcome.error_rad < NEAR_RAD
    return outcome._replace(converged=bool(near and not outcome.left_image))


def scenario_rows(scenarios: list[Scenario], seed: int, noise_px: float
                  ) -> Iterator[dict[str, Any]]:
    """Run ours and all classical laws on every scenario, then all of them summed up."""
    sums: dict[str, list[Outcome]] = {}
    for scenario in scenarios:
        outcomes = {'homography_servo': run_scenario(scenario, noise_px, seed)}
        for name, law in LAWS.items():
            found, _ = run_free(law, scenario.camera, scenario.points_m, scenario.home_depth_m,
                                scenario.start[None], scenario.goal[None], noise_px, seed)
            outcomes[name] = _near(found[0], scenario)
        for name, outcome in outcomes.items():
            sums.setdefault(name, []).append(outcome)
            yield row(name, f'scenario {scenario.name}', [outcome], robot=False)
    for name, found in sums.items():
        yield row(name, 'scenarios', found, robot=False)
