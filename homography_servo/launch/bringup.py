"""
Start the nodes of a configuration, in a process each, and keep them running.

Checks the whole YAML file first; then starts what it names, writes their output
with the node's name in front, restarts what dies, and ends everything in order on
Ctrl-C: SIGINT, after 5 s SIGTERM, after 5 s SIGKILL. The nodes are reachable from
this computer only, unless ROS_AUTOMATIC_DISCOVERY_RANGE says otherwise.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import signal
import sys
import tempfile
from typing import Sequence

from homography_servo.errors import ConfigError
from homography_servo.launch.config import Config
from homography_servo.launch.config import override
from homography_servo.launch.config import read_config
from homography_servo.launch.config import shown_config
from homography_servo.launch.registry import CHAIN
from homography_servo.launch.registry import programs_of
from homography_servo.launch.supervisor import Child
from homography_servo.launch.supervisor import Supervisor
from homography_servo.nodes.__main__ import die_with_launcher
from homography_servo.nodes.__main__ import PARENT
import yaml

EXIT_OK, EXIT_CONFIG = 0, 2
DISCOVERY = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(
        prog='bringup', description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='example:\n  bringup --config sim.yaml --set camera_sim.noise_grey:=5.0')
    about.add_argument('--config', default='sim.yaml', metavar='FILE',
                       help='a path or an installed name: sim.yaml, real.yaml, teabox.yaml')
    about.add_argument('--dashboard', action='store_true',
                       help='also start the dashboard, a page in the browser; it says where')
    about.add_argument('--one-process', action='store_true',
                       help='run tracker, planner and servo in one process, which is faster')
    about.add_argument('--only', nargs='+', metavar='NODE', help='start only these nodes')
    about.add_argument('--set', nargs='+', default=[], action='extend', dest='overrides',
                       metavar='NODE.PARAMETER:=VALUE', help='override single parameters')
    about.add_argument('--namespace', default='', metavar='NS', help='namespace of all nodes')
    about.add_argument('--log-level', default='info', metavar='LEVEL',
                       choices=['debug', 'info', 'warn', 'error', 'fatal'],
                       help='debug, info, warn, error or fatal')
    about.add_argument('--print-config', action='store_true',
                       help='print the effective parameters and where each came from, and end')
    return about


def checked_config(name: str, only: Sequence[str] | None, overrides: Sequence[str],
                   extra: Sequence[str] = ()) -> Config | list[ConfigError]:
    """Read a configuration with overrides and extra nodes, or list every mistake."""
    config, errors = read_config(name)
    if errors or config is None:
        return errors
    try:
        config = override(config.including(extra), overrides)
        return config.only([*only, *extra]) if only else config
    except ConfigError as error:
        return [error]


def environment() -> dict[str, str]:
    """Give the environment of the nodes."""
    values = dict(os.environ)
    values.setdefault(DISCOVERY, 'LOCALHOST')
    values['PYTHONUNBUFFERED'] = '1'
    values[PARENT] = str(os.getpid())
    return values


def children_of(config: Config, folder: Path, namespace: str, log_level: str,
                one_process: bool = False) -> list[Child]:
    """Describe the processes; the parameters of each go into a file in the folder."""
    children = []
    for name, nodes in programs_of(config.nodes, one_process).items():
        command = [sys.executable, '-m', 'homography_servo.nodes', name, '--ros-args',
                   '--log-level', log_level]
        if namespace:
            command += ['-r', f'__ns:=/{namespace.strip("/")}']
        # An empty section would be refused; an empty list means not set, as in the file.
        given = {node: {key: value for key, value in config.values(node).items() if value != []}
                 for node in nodes}
        sections = {'/**' if len(nodes) == 1 else f'/**/{node}': {'ros__parameters': values}
                    for node, values in given.items() if values}
        if sections:
            file = folder / f'{name}.yaml'
            file.write_text(yaml.safe_dump(sections))
            command += ['--params-file', str(file)]
        children.append(Child(name, command, environment()))
    return children


def main(args: Sequence[str] | None = None) -> int:
    """Run the launcher."""
    options = parser().parse_args(args)
    die_with_launcher()
    config = checked_config(options.config, options.only, options.overrides,
                            ['dashboard'] if options.dashboard else [])
    if isinstance(config, list):
        for error in config:
            print(error, file=sys.stderr)
        return EXIT_CONFIG
    missing = [name for name in CHAIN if name not in config.nodes]
    if options.one_process and missing:
        print(ConfigError(config.file, 0, '--one-process', f'needs {", ".join(missing)}'),
              file=sys.stderr)
        return EXIT_CONFIG
    if options.print_config:
        print(shown_config(config))
        return EXIT_OK
    with tempfile.TemporaryDirectory(prefix='homography_servo_') as folder:
        supervisor = Supervisor(children_of(config, Path(folder), options.namespace,
                                            options.log_level, options.one_process))
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, supervisor.interrupt)
        return supervisor.run()


if __name__ == '__main__':
    sys.exit(main())
