"""The camera_info YAML file of the ROS camera calibration tool."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from homography_servo.errors import ConfigError
from homography_servo.geometry.camera_model import Camera
from homography_servo.geometry.camera_model import camera_from_calibration
from homography_servo.geometry.distortion import MODELS
import yaml


def load_camera(path: str | Path) -> Camera:
    """
    Read a camera_info file.

    Parameters
    ----------
    path : path
        The YAML file.

    Returns
    -------
    Camera
        The camera.

    Raises
    ------
    ConfigError
        With file, line and key of what is wrong.

    """
    reader = _Reader(Path(path))
    width, height = reader.whole('image_width'), reader.whole('image_height')
    k = reader.numbers('camera_matrix', 9)
    model = reader.text('distortion_model', 'plumb_bob')
    d = reader.numbers('distortion_coefficients', None)
    camera = camera_from_calibration(width, height, k, d, model)
    if isinstance(camera, Camera):
        return camera
    key = 'distortion_model' if 'distortion_model' in camera.reason or 'coeff' in camera.reason \
        else 'image_width' if 'size' in camera.reason else 'camera_matrix'
    raise reader.error(key, camera.reason)


def save_camera(path: str | Path, camera: Camera, name: str = 'camera') -> None:
    """Write a camera as camera_info YAML, readable by the ROS camera drivers."""
    k = [float(value) for value in camera.matrix.ravel()]
    d = list(camera.distortion) or [0.0] * MODELS[camera.distortion_model].lengths[-1]
    projection = [*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0]
    content = {
        'image_width': int(camera.width),
        'image_height': int(camera.height),
        'camera_name': name,
        'camera_matrix': {'rows': 3, 'cols': 3, 'data': k},
        'distortion_model': camera.distortion_model,
        'distortion_coefficients': {'rows': 1, 'cols': len(d), 'data': d},
        'rectification_matrix': {'rows': 3, 'cols': 3,
                                 'data': [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]},
        'projection_matrix': {'rows': 3, 'cols': 4, 'data': projection},
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    Path(path).write_text(text, encoding='utf-8')


class _Reader:
    """Looks up keys of one YAML file and knows the line of each."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lines: dict[str, int] = {}
        try:
            text = path.read_text(encoding='utf-8')
            root, node = yaml.safe_load(text), yaml.compose(text, Loader=yaml.SafeLoader)
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(path, 0, '', f'cannot be read: {error}') from None
        except yaml.YAMLError as error:
            mark = getattr(error, 'problem_mark', None)
            raise ConfigError(path, mark.line + 1 if mark else 0, '',
                              f'is not YAML: {getattr(error, "problem", error)}') from None
        if not isinstance(root, dict):
            raise ConfigError(path, 0, '', 'must hold keys and values of a camera_info file')
        self._root = root
        self._lines = {key.value: key.start_mark.line + 1 for key, _ in node.value}

    def error(self, key: str, reason: str) -> ConfigError:
        return ConfigError(self._path, self._lines.get(key, 0), key, reason)

    def text(self, key: str, default: str) -> str:
        value = self._root.get(key, default)
        if not isinstance(value, str):
            raise self.error(key, f'must be text, got {value!r}')
        return value

    def whole(self, key: str) -> int:
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f'must be a whole number, got {value!r}')
        return value

    def numbers(self, key: str, count: int | None) -> list[float]:
        value = self._value(key)
        data = value.get('data') if isinstance(value, dict) else value
        if not isinstance(data, list) or not all(_is_number(item) for item in data):
            raise self.error(key, f'must have data: a list of finite numbers, got {data!r}')
        if count is not None and len(data) != count:
            raise self.error(key, f'must have {count} numbers, got {len(data)}')
        return [float(item) for item in data]

    def _value(self, key: str) -> Any:
        if key not in self._root:
            raise self.error(key, 'is missing')
        return self._root[key]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) \
        and math.isfinite(value)
