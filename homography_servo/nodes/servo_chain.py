"""Tracker, planner and servo in one process: less time from an image to a command."""

from __future__ import annotations

import sys
from typing import Sequence

from homography_servo.launch.registry import CHAIN
from homography_servo.launch.registry import node_type
from homography_servo.nodes.run import run_nodes

HELP = f"""{__doc__}

The nodes {', '.join(CHAIN)} with all their topics, services and
parameters, as if each ran for itself; but when one ends, all end.
The --help of each lists its parameters. Give them with the name of their node:
--ros-args -p {CHAIN[-1]}:speed_share:=0.2, or --params-file FILE.

example:
  ros2 run homography_servo servo_chain --ros-args --params-file chain.yaml"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the nodes of the chain."""
    return run_nodes([node_type(name) for name in CHAIN], args, HELP)


if __name__ == '__main__':
    sys.exit(main())
