"""Messages as facts for the page: plain lists, dicts, numbers and text."""

from __future__ import annotations

import math
from typing import Any, Iterable

import cv2
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from homography_servo.nodes.conversions import bgr_from_image
from homography_servo.nodes.conversions import image_path_from_msg
from homography_servo.nodes.conversions import LONGEST_PATH
from homography_servo.nodes.progress import progress_from_msg
from homography_servo.result import Rejected
import numpy as np
from sensor_msgs.msg import Image
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

LEVELS = {DiagnosticStatus.OK: 'ok', DiagnosticStatus.WARN: 'warn',
          DiagnosticStatus.ERROR: 'error', DiagnosticStatus.STALE: 'stale'}
_WORST = ('ok', 'stale', 'warn', 'error')
MOST_JOINTS = 16


def status_fact(status: DiagnosticStatus) -> dict[str, Any]:
    """Give level, message and values of a status."""
    return {'name': status.name, 'level': LEVELS.get(status.level, 'error'),
            'message': status.message, 'values': {v.key: v.value for v in status.values}}


def node_facts(msg: DiagnosticArray) -> dict[str, dict[str, Any]]:
    """Give, for each node that a message speaks of, its worst level and its parts."""
    nodes: dict[str, list] = {}
    for status in msg.status:
        node, separator, part = status.name.partition(': ')
        if separator:
            nodes.setdefault(node, []).append({**status_fact(status), 'name': part})
    return {node: _node_fact(parts) for node, parts in nodes.items()}


def _node_fact(parts: list[dict]) -> dict[str, Any]:
    worst = max((part['level'] for part in parts), key=_WORST.index)
    first = next(part for part in parts if part['level'] == worst)
    return {'level': worst, 'message': first['message'], 'parts': parts}


def verdict_fact(msg: DiagnosticArray) -> dict[str, Any] | None:
    """Give the verdict of the whole path and of every pose; None without one."""
    if not msg.status:
        return None
    whole, *poses = (status_fact(status) for status in msg.status[:LONGEST_PATH + 1])
    return {**whole, 'poses': poses}


def path_fact(msg: Float64MultiArray) -> list | Rejected:
    """Give the corners (N, M, 2) of the path in the image; corners without a place are None."""
    corners_px = image_path_from_msg(msg)
    if isinstance(corners_px, Rejected):
        return corners_px
    return [[point if all(map(math.isfinite, point)) else None for point in pose]
            for pose in np.round(corners_px, 2).tolist()]


def joints_fact(msg: JointState) -> tuple[list[str], list[float]] | Rejected:
    """Give names and positions of the joints in degrees."""
    if len(msg.name) != len(msg.position):
        return Rejected(f'{len(msg.name)} names but {len(msg.position)} positions')
    degrees = [round(math.degrees(value), 3) for value in msg.position[:MOST_JOINTS]
               if math.isfinite(value)]
    if len(degrees) != len(msg.position[:MOST_JOINTS]):
        return Rejected('a joint position is not a finite number')
    return list(msg.name[:MOST_JOINTS]), degrees


def progress_fact(msg: DiagnosticStatus) -> dict[str, Any]:
    """Give how far the servo is; what is not a number is None."""
    now = progress_from_msg(msg)
    return {'pose': now.pose, 'of': now.of, 'reached': now.reached,
            'iterations': now.iterations,
            'position_error_mm': _rounded(1e3 * now.position_error_m),
            'rotation_error_deg': _rounded(math.degrees(now.rotation_error_rad))}


def _rounded(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


def jpeg_from_image(msg: Image, widest_px: int, quality: int) -> bytes | Rejected:
    """Make a JPEG of an image message, no wider than asked."""
    pixels = bgr_from_image(msg)
    if isinstance(pixels, Rejected):
        return pixels
    height, width = pixels.shape[:2]
    if width > widest_px:
        size = (widest_px, max(1, round(height * widest_px / width)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    good, data = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return data.tobytes() if good else Rejected('the image cannot be made a JPEG')


def sentence_of(answers: Iterable[tuple[str, bool, str]]) -> tuple[bool, str]:
    """Join the answers of several nodes (name, success, sentence) to one."""
    answers = list(answers)
    return (all(ok for _, ok, _ in answers),
            '; '.join(f'{name}: {sentence}' for name, _, sentence in answers))
