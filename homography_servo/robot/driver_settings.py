"""How the bridge drives an arm."""

from __future__ import annotations

from dataclasses import dataclass

from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import whole


@dataclass(frozen=True)
class DriverSettings(Settings):
    """How the bridge drives the arm."""

    baud: int = whole(115200, 1200, 4000000, 'baud', 'speed of the serial line',
                      read_only=True)
    tick_s: float = real(0.020, 0.001, 1.0, 's', 'interpolator tick of the device: its speeds '
                         'are in units per tick', read_only=True)
    joint_margin_rad: float = real(0.05, 0.0, 0.5, 'rad', 'distance to keep from the ends of '
                                   'every joint', read_only=True)
    command_timeout_s: float = real(0.25, 0.02, 10.0, 's', 'while commands come as a stream, a '
                                    'command older than this ends in HOLD')
    watchdog_s: float = real(0.5, 0.1, 10.0, 's', 'the device stops by itself when it hears '
                             'nothing for so long', read_only=True)
    home_speed_rad_s: float = real(0.3, 0.02, 2.0, 'rad/s', 'largest joint speed of ~/home')
    rival_hold_s: float = real(1.0, 0.1, 60.0, 's', 'how long two publishers who command at the '
                               'same time are locked out after the last sign of both')
