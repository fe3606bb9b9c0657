"""Where the package's own files are, installed or in the source tree, with or without ROS."""

from __future__ import annotations

import os
from pathlib import Path
import sys
from typing import Callable, TypeVar

from homography_servo.errors import ConfigError

PACKAGE = 'homography_servo'
_FOLDERS = ('.', 'robots', 'cameras')
Loaded = TypeVar('Loaded')


def share_dirs() -> list[Path]:
    """List the folders that may hold ``config/``, the best first."""
    prefixes = [Path(p) for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    shares = [prefix / 'share' / PACKAGE for prefix in [*prefixes, Path(sys.prefix)]]
    installed = [parent / 'share' / PACKAGE for parent in Path(__file__).resolve().parents[:6]]
    return [Path(__file__).resolve().parents[1], *shares, *installed]


def find_config(name: str | Path, beside: str | Path | None = None) -> Path:
    """
    Find a configuration file by path or by bare name.

    Parameters
    ----------
    name : str or path
        A path, or a bare name such as ``sim.yaml`` or ``robix_rcs6.yaml``.
    beside : path, optional
        A file in whose folder to look first.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    FileNotFoundError
        With a sentence that says where it was looked for.

    """
    wanted = Path(name).expanduser()
    starts = [Path.cwd()] if beside is None else [Path(beside).resolve().parent, Path.cwd()]
    tries = [wanted] if wanted.is_absolute() else [start / wanted for start in starts]
    for share in share_dirs() if not wanted.is_absolute() else ():
        tries += [share / 'config' / folder / wanted for folder in _FOLDERS]
    for path in tries:
        if path.is_file():
            return path.resolve()
    shown = ', '.join(dict.fromkeys(str(path.parent.resolve()) for path in tries[:6]))
    raise FileNotFoundError(f'no file {name}; looked in {shown}')


def load_named(load: Callable[[Path], Loaded], name: str, owner: str, key: str) -> Loaded:
    """
    Load the file that a parameter names.

    Parameters
    ----------
    load : callable
        Makes something of a path.
    name : str
        A path or a bare name, see `find_config`.
    owner, key : str
        Whose parameter it is, and its name, for the error.

    Raises
    ------
    ConfigError
        When there is no such file, or `load` says that it cannot be used.

    """
    try:
        return load(find_config(name))
    except FileNotFoundError as error:
        raise ConfigError(owner, 0, key, str(error)) from error
