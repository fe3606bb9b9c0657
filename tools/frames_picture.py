"""
Draw the frames of the package around the simulated cell: docs/images/frames.png.

Camera, virtual home, object, base and flange are placed as the robot file says, the
arm half-way between start and goal of the trial.

Example: . tools/enter.sh && python tools/frames_picture.py
"""

from __future__ import annotations

import argparse
from pathlib import Path

from homography_servo.geometry.rigid import inverse
from homography_servo.geometry.rigid import transform
from homography_servo.places import find_config
from homography_servo.robot.chain import link_frames
from homography_servo.robot.kinematics import object_pose
from homography_servo.robot.robot_file import load_robot
from matplotlib.figure import Figure
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
JOINTS_RAD = np.radians([-40.0, 55.0, 10.0, -10.0, 0.0, -25.0])
AXES = (('x', '#d1495b'), ('y', '#2e933c'), ('z', '#2a78c2'))
LENGTH_M = 0.16
INK, SOFT = '#1d2430', '#8a8f98'


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(description=__doc__,
                                    formatter_class=argparse.RawDescriptionHelpFormatter)
    about.add_argument('--output', default=ROOT / 'docs' / 'images' / 'frames.png', type=Path,
                       metavar='FILE')
    return about


def draw_frame(axes, pose: np.ndarray, name: str, shift_m: tuple[float, float, float],
               length_m: float = LENGTH_M) -> None:
    """Draw the axes of a frame (4, 4) in the base, with its name beside it."""
    origin = pose[:3, 3]
    for column, (letter, colour) in enumerate(AXES):
        tip = origin + length_m * pose[:3, column]
        axes.plot(*np.array([origin, tip]).T, color=colour, linewidth=2.2, zorder=5)
        beyond = origin + (tip - origin) * (1.0 + 0.03 / length_m)
        axes.text(*beyond, letter, color=colour, fontsize=9, ha='center', va='center')
    axes.text(*(origin + shift_m), name, color=INK, fontsize=10, fontweight='bold', ha='center',
              va='center', zorder=10)


def draw_camera(axes, base_from_camera: np.ndarray, depth_m: float) -> None:
    """Draw the pyramid of what a 640 x 480 camera with f = 800 px sees, and its axis."""
    size = 0.30 * np.array([[-0.4, -0.3], [0.4, -0.3], [0.4, 0.3], [-0.4, 0.3]])
    corners = np.column_stack([size, np.full(4, 0.30)])
    corners = corners @ base_from_camera[:3, :3].T + base_from_camera[:3, 3]
    eye = base_from_camera[:3, 3]
    for corner in corners:
        axes.plot(*np.array([eye, corner]).T, color=SOFT, linewidth=1.0)
    axes.plot(*np.vstack([corners, corners[:1]]).T, color=SOFT, linewidth=1.0)
    end = eye + depth_m * base_from_camera[:3, 2]
    axes.plot(*np.array([eye, end]).T, color=SOFT, linewidth=1.0, linestyle=':')
    middle = 0.5 * (eye + end) + (0.03, 0.0, 0.08)
    axes.text(*middle, 'home_depth_m', color=SOFT, fontsize=9, ha='left')


def main() -> int:
    """Draw."""
    options = parser().parse_args()
    robot = load_robot(find_config('robix_rcs6.yaml'))
    base_from_home = inverse(robot.home_from_base)
    base_from_camera = base_from_home @ transform(
        np.eye(3), np.array([0.0, 0.0, -robot.home_depth_m]))
    frames = link_frames(robot, JOINTS_RAD, np.eye(4))
    base_from_object = base_from_home @ object_pose(robot, JOINTS_RAD)

    figure = Figure(figsize=(5.2, 7.0), layout='constrained')
    axes = figure.add_subplot(projection='3d', proj_type='persp')
    chain = np.array([np.zeros(3), *[frame[:3, 3] for frame in frames]])
    axes.plot(*chain.T, color='#4a5362', linewidth=5.0, solid_capstyle='round', alpha=0.85)
    axes.plot(*chain[:-1].T, 'o', color='#20262f', markersize=5.0)
    face = robot.object_points_m @ base_from_object[:3, :3].T + base_from_object[:3, 3]
    axes.plot(*np.vstack([face, face[:1]]).T, color='#edae49', linewidth=3.0, zorder=6)
    home = robot.object_points_m @ base_from_home[:3, :3].T + base_from_home[:3, 3]
    axes.plot(*np.vstack([home, home[:1]]).T, color='#7a5195', linewidth=1.5, linestyle='--')
    draw_camera(axes, base_from_camera, robot.home_depth_m)
    draw_frame(axes, base_from_camera, 'camera_optical', (-0.02, 0.0, 0.07))
    draw_frame(axes, base_from_home, 'home', (-0.12, 0.0, -0.04))
    draw_frame(axes, np.eye(4), 'base_link', (-0.03, -0.14, 0.0))
    draw_frame(axes, base_from_object, 'object', (0.13, 0.0, 0.03))
    draw_frame(axes, frames[-1], 'tool0', (0.07, 0.0, 0.12), 0.10)
    axes.view_init(elev=18.0, azim=-62.0)
    axes.set_box_aspect((0.8, 0.8, 1.2), zoom=1.25)
    axes.set_xlim(-0.15, 0.65)
    axes.set_ylim(-0.4, 0.4)
    axes.set_zlim(-0.15, 1.05)
    axes.set_axis_off()
    figure.savefig(options.output, dpi=120, bbox_inches='tight', pad_inches=0.1)
    print(f'wrote {options.output}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
