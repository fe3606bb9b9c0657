"""
Make the moving picture of the README from a recorded servo trial.

Shows what the camera saw on the way along the path, with the measured contour, the
path, and the pose that the servo goes to. Needs Pillow, which matplotlib brings.

Example: . tools/enter.sh && servo_trial --bringup sim.yaml --record --output report &&
python tools/animation.py report/bag
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
from typing import Any

import cv2
from homography_servo.experiments.bag import ANCHOR
from homography_servo.experiments.bag import BagError
from homography_servo.experiments.bag import read_bag
from homography_servo.nodes.trial_log import STARTED
import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
SIZE_PX, SPAN_MS, LAST_MS = (480, 360), 80, 1500
PATH, GOAL, TARGET, SEEN, INK = \
    (111, 195, 255), (120, 230, 130), (255, 205, 90), (255, 92, 112), (235, 238, 242)
TOPICS = ('image', 'object/contour', 'path/image', 'visual_servo/progress', ANCHOR)
SHIFT = 4  # of fixed-point pixels


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(description=__doc__,
                                    formatter_class=argparse.RawDescriptionHelpFormatter)
    about.add_argument('bag', type=Path, metavar='FOLDER', help='recording of servo_trial')
    about.add_argument('--output', default=ROOT / 'docs' / 'images' / 'trial.webp', type=Path,
                       metavar='FILE', help='.webp or .gif')
    about.add_argument('--pictures', default=60, type=int, metavar='N')
    return about


def outline(picture: np.ndarray, points_px: np.ndarray, colour: tuple, closed: bool = True,
            width: int = 1) -> None:
    """Draw a line through points (N, 2) with subpixel accuracy."""
    points = np.round(np.asarray(points_px) * 2**SHIFT).astype(np.int32)
    cv2.polylines(picture, [points], closed, colour, width, cv2.LINE_AA, SHIFT)


def drawn(seen: dict[str, Any]) -> np.ndarray:
    """Draw one picture, RGB, from the latest message of each topic."""
    msg, path_px = seen['image'], seen['path/image']
    grey = np.asarray(msg.data).reshape(msg.height, msg.step)[:, :msg.width]
    picture = np.repeat(cv2.GaussianBlur(grey, (0, 0), 1.0)[:, :, None], 3, axis=2)
    for corner in range(path_px.shape[1]):
        outline(picture, path_px[:, corner], PATH, closed=False)
    outline(picture, path_px[-1], GOAL, width=2)
    index = min(seen.get('index', 1), len(path_px))
    outline(picture, path_px[index - 1], TARGET, width=2)
    if 'object/contour' in seen:
        outline(picture, [(point.x, point.y) for point in
                          seen['object/contour'].polygon.points], SEEN, width=2)
    picture = cv2.resize(picture, SIZE_PX, interpolation=cv2.INTER_AREA)
    for row, (text, colour) in enumerate((
            (f'to pose {index} of {len(path_px)}', INK), ('goal', GOAL), ('next pose', TARGET),
            ('measured', SEEN))):
        cv2.putText(picture, text, (10, 20 + 17 * row), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour,
                    1, cv2.LINE_AA)
    return picture


def pictures(bag: Path) -> list[np.ndarray]:
    """Draw every picture between the start of the servo and its end."""
    seen: dict[str, Any] = {}
    found, begun = [], False
    for topic, msg, _ in read_bag(bag, TOPICS):
        if topic == ANCHOR:
            begun = msg.data.startswith(STARTED)
        elif topic == 'path/image':
            seen[topic] = np.reshape(msg.data, [dim.size for dim in msg.layout.dim])
        elif topic == 'visual_servo/progress':
            values = {item.key: item.value for item in msg.values}
            reached = values.get('reached', '').lower() == 'true'  # then the next one is the aim
            seen['index'] = int(values['pose']) + reached
        else:
            seen[topic] = msg
        if begun and topic == 'image' and 'path/image' in seen:
            found.append(drawn(seen))
    return found


def main() -> int:
    """Make the file."""
    options = parser().parse_args()
    try:
        found = pictures(options.bag)
    except BagError as error:
        print(error, file=sys.stderr)
        return 2
    if not found:
        print(f'{options.bag} shows no servo on its way', file=sys.stderr)
        return 1
    chosen = np.linspace(0, len(found) - 1, min(options.pictures, len(found))).astype(int)
    frames = [Image.fromarray(found[index]) for index in chosen]
    frames[0].save(options.output, save_all=True, append_images=frames[1:], loop=0, quality=55,
                   method=6, duration=[SPAN_MS] * (len(frames) - 1) + [LAST_MS])
    print(f'wrote {options.output}: {len(frames)} pictures, '
          f'{options.output.stat().st_size // 1000} kB')
    return 0


if __name__ == '__main__':
    sys.exit(main())
