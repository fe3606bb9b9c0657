"""
Draw figure 1 of the paper: two displacements, their paths in space and in the image.

Both paths are computed independently. The one in space starts from the two poses and
is projected; the one in the image starts from the corners of the three views, in
pixels, and knows homographies only. The numbers say how far apart they are.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
import json
from pathlib import Path
import sys
from typing import Any
from typing import Sequence

from homography_servo.geometry.camera import Camera
from homography_servo.geometry.decomposition import decompose
from homography_servo.geometry.decomposition import DisplacementParameters
from homography_servo.geometry.decomposition import rotation_from_angles
from homography_servo.geometry.face import face_corners
from homography_servo.geometry.homography import estimate_homography
from homography_servo.geometry.path import interpolate
from homography_servo.geometry.path import interpolate_image
from homography_servo.geometry.rigid import transform
from homography_servo.geometry.rigid import transform_points
from homography_servo.result import Rejected
import numpy as np

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
HOME_DEPTH_M = 1.0  # cZh = 1000 mm, as in the paper
FACE_M = face_corners(0.12, 0.08)
AGREEMENT_PX = 1e-9
START, PATH, GOAL, HOME = '#d1495b', '#2a78c2', '#2e933c', '#8a8f98'


@dataclass(frozen=True)
class Displacement:
    """Two displacements from the virtual home position: angles [deg], translation [m]."""

    title: str
    start_deg: tuple[float, float, float]
    start_m: tuple[float, float, float]
    goal_deg: tuple[float, float, float]
    goal_m: tuple[float, float, float]


# The paper prints the rotations; the translations are chosen so that all stays in view.
DISPLACEMENTS = (
    Displacement('180 deg about hZ, translation in hX and hZ',
                 (0.0, 0.0, 0.0), (-0.16, 0.0, 0.0), (0.0, 0.0, 180.0), (0.14, 0.0, -0.25)),
    Displacement('60 deg about hZ, translation in hX and hY, tilted out of the home plane',
                 (30.0, -20.0, 0.0), (-0.18, -0.08, 0.0), (30.0, -20.0, 60.0), (0.16, 0.10, 0.0)),
)


def main(args: Sequence[str] | None = None) -> int:
    """Compute, compare, draw and write; the exit code is 1 if the paths disagree."""
    options = parser().parse_args(args)
    results = [compute(each, options.count) for each in DISPLACEMENTS]
    options.output.mkdir(parents=True, exist_ok=True)
    numbers = {'home_depth_m': HOME_DEPTH_M, 'count': options.count,
               'largest_distance_px': max(each['largest_distance_px'] for each in results),
               'displacements': [_numbers(each) for each in results]}
    written = options.output / 'path_figures.json'
    written.write_text(json.dumps(numbers, indent=2) + '\n', encoding='utf-8')
    drawn = draw(results, options.output / 'path_figures.png')
    for each in results:
        print(f'{each["title"]}: {each["largest_distance_px"]:.2g} px apart at most')
    print(f'wrote {drawn} and {written}')
    if not numbers['largest_distance_px'] <= AGREEMENT_PX:
        print(f'the paths in space and in the image differ by more than {AGREEMENT_PX:g} px',
              file=sys.stderr)
        return 1
    return 0


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(
        prog='path_figures', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='example:\n  path_figures --count 13 --output report')
    about.add_argument('--output', type=Path, default=Path('report'), metavar='FOLDER',
                       help='where path_figures.png and path_figures.json go (report)')
    about.add_argument('--count', type=_count, default=13, metavar='N',
                       help='poses on each path, both ends included (13)')
    return about


def compute(displacement: Displacement, count: int) -> dict[str, Any]:
    """Compute both paths of one displacement, and how far apart they are."""
    start = _pose(displacement.start_deg, displacement.start_m)
    goal = _pose(displacement.goal_deg, displacement.goal_m)
    poses = interpolate(start, goal, count, HOME_DEPTH_M)
    _stop_if_rejected(poses)
    projected_px = project(poses)
    image_px = path_in_image(project(np.eye(4)), project(start), project(goal), count)
    distance_px = np.linalg.norm(projected_px - image_px, axis=-1)
    return {'title': displacement.title, 'poses': poses, 'projected_px': projected_px,
            'image_px': image_px, 'largest_distance_px': float(distance_px.max()),
            'distance_px_if_depth_were_linear': _linear_depth_distance(poses, image_px),
            'all_in_view': bool(CAMERA.contains(image_px).all())}


def path_in_image(home_px: np.ndarray, start_px: np.ndarray, goal_px: np.ndarray,
                  count: int) -> np.ndarray:
    """Interpolate (N, 4, 2) px between two views of the corners, by the paper's section 3."""
    ends = [_decomposed(home_px, view_px) for view_px in (start_px, goal_px)]
    return CAMERA.project_rays(interpolate_image(*ends, count, FACE_M, HOME_DEPTH_M))


def project(home_from_object: np.ndarray) -> np.ndarray:
    """Project the corners (..., 4, 2) px of poses: eq. 2."""
    points_m = transform_points(home_from_object, FACE_M)
    return CAMERA.project(points_m + (0.0, 0.0, HOME_DEPTH_M))


def _stop_if_rejected(result: Any) -> None:
    """Stop with the reason if a result was rejected."""
    if isinstance(result, Rejected):
        raise SystemExit(f'path_figures: {result.reason}')


def _decomposed(home_px: np.ndarray, view_px: np.ndarray) -> DisplacementParameters:
    homography = estimate_homography(CAMERA.rays(home_px), CAMERA.rays(view_px))
    _stop_if_rejected(homography)
    parameters = decompose(homography)
    _stop_if_rejected(parameters)
    return parameters


def _pose(angles_deg: tuple[float, float, float], origin_m: tuple[float, float, float]
          ) -> np.ndarray:
    return transform(rotation_from_angles(*np.radians(angles_deg)), np.array(origin_m))


def _linear_depth_distance(poses: np.ndarray, image_px: np.ndarray) -> float:
    """Show what interpolating Z instead of the divergence would cost."""
    wrong = poses.copy()
    wrong[:, 2, 3] = np.linspace(poses[0, 2, 3], poses[-1, 2, 3], len(poses))
    return float(np.linalg.norm(project(wrong) - image_px, axis=-1).max())


def _numbers(result: dict[str, Any]) -> dict[str, Any]:
    return {key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in result.items()}


def _count(text: str) -> int:
    count = int(text)
    if count < 2:
        raise argparse.ArgumentTypeError(f'must be at least 2, got {count}')
    return count


def draw(results: Sequence[dict[str, Any]], path: Path) -> Path:
    """Draw space on the left, the image on the right, a row for each displacement."""
    from matplotlib.figure import Figure  # only the figures need it

    figure = Figure(figsize=(10.5, 4.4 * len(results)), layout='constrained')
    for row, result in enumerate(results):
        space = figure.add_subplot(len(results), 2, 2 * row + 1, projection='3d')
        image = figure.add_subplot(len(results), 2, 2 * row + 2)
        _draw_space(space, result)
        _draw_image(image, result)
    figure.savefig(path, dpi=130)
    return path


def _draw_space(axes: Any, result: dict[str, Any]) -> None:
    axes.set_title(result['title'], fontsize=9)
    home_mm = 1e3 * FACE_M
    paths_mm = 1e3 * transform_points(result['poses'], FACE_M)
    axes.plot(*_closed(home_mm).T, color=HOME, linestyle='--', label='P_0')
    for corner in range(len(FACE_M)):
        axes.plot(*paths_mm[:, corner].T, color=PATH, linewidth=0.7)
    for outline, colour, width, label in _outlines(paths_mm, 'P'):
        axes.plot(*_closed(outline).T, color=colour, linewidth=width, label=label)
    axes.set_xlabel('hX [mm]')
    axes.set_ylabel('hY [mm]')
    axes.set_zlabel('hZ [mm]')
    axes.set_aspect('equal')
    axes.locator_params(axis='y', nbins=4)
    axes.locator_params(axis='z', nbins=3)
    axes.view_init(elev=-60.0, azim=-75.0)  # from the camera's side: hZ points away
    axes.legend(fontsize=8, loc='upper left')


def _draw_image(axes: Any, result: dict[str, Any]) -> None:
    axes.set_title(f'paths {result["largest_distance_px"]:.1g} px apart at most', fontsize=9)
    axes.plot(*_closed(project(np.eye(4))).T, color=HOME, linestyle='--', label='p_0')
    for outline, colour, width, label in _outlines(result['image_px'], 'p'):
        axes.plot(*_closed(outline).T, color=colour, linewidth=width, label=label)
    axes.plot(*result['projected_px'].reshape(-1, 2).T, 'x', color='black', markersize=3.0,
              label='projection of the path in space')
    axes.set_xlim(-0.5, CAMERA.width - 0.5)
    axes.set_ylim(CAMERA.height - 0.5, -0.5)
    axes.set_aspect('equal')
    axes.set_xlabel('u [px]')
    axes.set_ylabel('v [px]')
    axes.legend(fontsize=8, loc='best')


def _outlines(corners: np.ndarray, symbol: str
              ) -> list[tuple[np.ndarray, str, float, str | None]]:
    between = [(outline, PATH, 0.6, None) for outline in corners[1:-1]]
    return [*between, (corners[0], START, 1.8, f'{symbol}_1'),
            (corners[-1], GOAL, 1.8, f'{symbol}_N')]


def _closed(corners: np.ndarray) -> np.ndarray:
    return np.vstack([corners, corners[:1]])


if __name__ == '__main__':
    sys.exit(main())
