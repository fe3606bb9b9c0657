"""The nodes of this package by name, and the settings that each declares."""

from __future__ import annotations

import importlib
import inspect
from typing import Iterable

NODES = ('camera_sim', 'video_camera', 'snake_tracker', 'path_planner', 'visual_servo',
         'robix_bridge', 'dashboard')
# These may share a process, which is the program of this name.
CHAIN = ('snake_tracker', 'path_planner', 'visual_servo')
CHAIN_PROGRAM = 'servo_chain'


def node_module(name: str) -> str:
    """Name the module that holds a node, or the chain of nodes, and its ``main``."""
    if name not in (*NODES, CHAIN_PROGRAM):
        raise ValueError(f'node must be one of {", ".join(NODES)}, got {name!r}')
    return f'homography_servo.nodes.{name}'


def node_type(name: str) -> type:
    """Give the class of a node; importing it needs ROS."""
    module = importlib.import_module(node_module(name))
    found = [kind for _, kind in inspect.getmembers(module, inspect.isclass)
             if getattr(kind, 'NAME', '') == name and kind.__module__ == module.__name__]
    return found[0]


def programs_of(nodes: Iterable[str], one_process: bool) -> dict[str, tuple[str, ...]]:
    """Give the programs that run some nodes, each with its nodes, in their order."""
    programs: dict[str, tuple[str, ...]] = {}
    for name in nodes:
        if one_process and name in CHAIN:
            programs[CHAIN_PROGRAM] = CHAIN
        else:
            programs[name] = (name,)
    return programs


def settings_types(name: str) -> tuple:
    """Give the settings classes that a node declares as parameters."""
    return tuple(node_type(name).SETTINGS)
