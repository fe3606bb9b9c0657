"""The program `robix_emulator`: a secondary PC with a Robix arm that is not there."""

from __future__ import annotations

import argparse
import signal
import sys
from typing import Sequence

from homography_servo.errors import LinkError
from homography_servo.robot.device import Device
from homography_servo.robot.emulator import Emulator
from homography_servo.robot.emulator import PtyPort
from homography_servo.robot.emulator import RealPort
from homography_servo.robot.faults import FAULTS
from homography_servo.robot.faults import parse_fault

_EPILOG = """example:
  robix_emulator --link /tmp/robix --log heard.txt --fault drop=0.05 --fault unplug@20-23
  ros2 run homography_servo robix_bridge --ros-args -p port:=/tmp/robix

faults, each NAME[=VALUE][@START[-END]] in seconds from the start:
"""


def _fault(text: str):
    try:
        return parse_fault(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _parser() -> argparse.ArgumentParser:
    faults = '\n'.join(f'  {name:10} {about} (default {value:g})'
                       for name, (value, about) in FAULTS.items())
    parser = argparse.ArgumentParser(
        'robix_emulator', description='Answer like the secondary PC of a Robix arm (RBX/1), on a '
        'pty whose path is printed, or on a real port.', epilog=_EPILOG + faults,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--port', help='a device or URL to serve, instead of a pty')
    parser.add_argument('--link', help='symbolic link to keep pointing at the pty')
    parser.add_argument('--baud', type=int, default=0,
                        help='speed of the port; on a pty, the speed to imitate (default: none)')
    parser.add_argument('--servos', type=int, default=6, help='number of servos (default 6)')
    parser.add_argument('--tick', type=float, default=0.020,
                        help='interpolator tick in seconds (default 0.020)')
    parser.add_argument('--log', metavar='FILE',
                        help='write what is heard: steady time and raw bytes')
    parser.add_argument('--fault', action='append', type=_fault, default=[], metavar='FAULT',
                        help='misbehave, see below; may be repeated')
    parser.add_argument('--seed', type=int, default=0, help='of the faults (default 0)')
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Run until SIGINT or SIGTERM."""
    options = _parser().parse_args(args)
    if not (1 <= options.servos <= 32 and 0.001 <= options.tick <= 1.0):
        print('robix_emulator: --servos must be in [1, 32], --tick in [0.001, 1]',
              file=sys.stderr)
        return 2
    try:
        port: RealPort | PtyPort = RealPort(options.port, options.baud or 115200) \
            if options.port else PtyPort(options.link)
        emulator = Emulator(Device(options.servos, tick_s=options.tick), port, options.fault,
                            options.log, options.seed, 0 if options.port else options.baud)
    except (LinkError, OSError) as error:
        print(f'robix_emulator: {error}', file=sys.stderr)
        return 3
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: emulator.end())
    print(port.path, flush=True)
    emulator.run()
    return 0


if __name__ == '__main__':
    sys.exit(main())
