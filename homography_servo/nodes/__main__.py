"""
Run one node: ``python -m homography_servo.nodes NODE [--ros-args ...]``.

``servo_chain`` stands for tracker, planner and servo together.

This is how the launcher starts nodes. A child asks the kernel for a signal when
its launcher dies, so that not even a killed launcher leaves a node behind.
"""

import ctypes
import importlib
import os
import signal
import sys

from homography_servo.launch.registry import CHAIN_PROGRAM
from homography_servo.launch.registry import node_module
from homography_servo.launch.registry import NODES

PARENT = 'HOMOGRAPHY_SERVO_LAUNCHER'
_PR_SET_PDEATHSIG = 1


def die_with_launcher() -> None:
    """Get SIGTERM when the launcher named in the environment ends."""
    parent = os.environ.pop(PARENT, '')
    if not parent:
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # it ended before the kernel was asked
        sys.exit(1)


def main() -> int:
    """Run the node named by the first word."""
    if len(sys.argv) < 2 or sys.argv[1] not in (*NODES, CHAIN_PROGRAM):
        print(f'expected one of {", ".join((*NODES, CHAIN_PROGRAM))}', file=sys.stderr)
        return 2
    die_with_launcher()
    module = importlib.import_module(node_module(sys.argv[1]))
    return module.main(sys.argv[2:])


if __name__ == '__main__':
    sys.exit(main())
