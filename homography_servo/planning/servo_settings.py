"""What the servo aims at and what it keeps to: the only home of these defaults."""

from __future__ import annotations

from dataclasses import dataclass
import math

from homography_servo.planning.arm_model import Prior
from homography_servo.planning.control import Errors
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole


@dataclass(frozen=True)
class ServoSettings(Settings):
    """
    Settings of the servo.

    The tolerances hold for the last pose; on the way they are `via_scale` times as
    wide. Depth and tilt are the weak ones of a plane.
    """

    mode: str = text('look_then_move', 'stop at every pose and look, or go on while looking',
                     choices=('look_then_move', 'continuous'))
    lateral_tolerance_mm: float = real(0.4, 0.01, 100.0, 'mm', 'across the line of sight')
    depth_tolerance_mm: float = real(1.2, 0.01, 200.0, 'mm', 'along the line of sight')
    gamma_tolerance_deg: float = real(0.3, 0.01, 45.0, 'deg', 'about the optical axis')
    tilt_tolerance_deg: float = real(1.0, 0.01, 45.0, 'deg', 'about the other two axes')
    via_scale: float = real(1.5, 1.0, 100.0, '', 'tolerance on the way over that at the end')
    sure_share: float = real(
        0.4, 0.05, 1.0, '', 'looks are averaged until one standard deviation is below this '
        'share of the tolerance')
    final_looks: int = whole(6, 1, 1000, '', 'looks that the last pose needs at least')
    looks_max: int = whole(60, 1, 10000, '', 'looks at one pose before giving up on the noise')
    iterations_max: int = whole(12, 1, 1000, '', 'moves towards one pose before giving up')
    growth_max: int = whole(3, 1, 100, '', 'moves in a row that may make the error larger')
    image_timeout_s: float = real(0.2, 0.02, 10.0, 's', 'longest time without a measured pose')
    joint_timeout_s: float = real(0.25, 0.02, 10.0, 's', 'longest time without joint_states')
    settle_s: float = real(
        0.03, 0.0, 5.0, 's', 'how long the arm must have stood before a look counts')
    sync_sigma_s: float = real(
        0.015, 0.0, 1.0, 's', 'how well stamps of images and joints agree while moving')
    found_looks: int = whole(5, 1, 100, '', 'measured poses in a row that end a loss of vision')
    servo_margin_rad: float = real(0.01, 0.0, 0.5, 'rad', 'distance kept from joint limits')
    move_max_rad: float = real(0.35, 0.001, 3.0, 'rad', 'largest motion of a joint in one move')
    corner_speed_px_s: float = real(
        400.0, 1.0, 10000.0, 'px/s', 'speed of a corner that the tracker can follow')
    corner_move_px: float = real(
        60.0, 1.0, 2000.0, 'px', 'largest motion of a corner in one move')
    speed_share: float = real(1.0, 0.01, 1.0, '', 'share of the speed and acceleration limits')
    start_distance_m: float = real(0.03, 0.001, 1.0, 'm', 'how far from the path it may start')
    start_angle_deg: float = real(15.0, 0.1, 90.0, 'deg', 'how far from the path it may start')
    # The filter of the looks is made with these, once.
    drift: float = real(0.01, 0.0, 1.0, '', 'share of the motion by which the model may err',
                        read_only=True)
    placement_sigma_m: float = real(0.03, 0.0, 1.0, 'm', 'how well home_from_base is known',
                                    read_only=True)
    placement_sigma_deg: float = real(5.0, 0.0, 90.0, 'deg', 'how well home_from_base is known',
                                      read_only=True)
    joint_sigma_deg: float = real(1.0, 0.0, 45.0, 'deg', 'how well the joint zeros are known',
                                  read_only=True)
    grip_sigma_m: float = real(0.01, 0.0, 1.0, 'm', 'how well tool_from_object is known',
                               read_only=True)
    grip_sigma_deg: float = real(2.5, 0.0, 90.0, 'deg', 'how well tool_from_object is known',
                                 read_only=True)

    @property
    def tolerance(self) -> Errors:
        """Give the tolerances of the last pose in SI units."""
        return Errors(self.lateral_tolerance_mm / 1000.0, self.depth_tolerance_mm / 1000.0,
                      math.radians(self.gamma_tolerance_deg),
                      math.radians(self.tilt_tolerance_deg))

    @property
    def prior(self) -> Prior:
        """Give how wrong the arm's model may be."""
        return Prior(self.placement_sigma_m, math.radians(self.placement_sigma_deg),
                     math.radians(self.joint_sigma_deg), self.grip_sigma_m,
                     math.radians(self.grip_sigma_deg))
