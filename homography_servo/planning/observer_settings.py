"""How corners become poses: the only home of these defaults."""

from __future__ import annotations

from dataclasses import dataclass

from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import whole


@dataclass(frozen=True)
class ObserverSettings(Settings):
    """Noise of the corners, what else tells the mirror apart, and when looks are averaged."""

    measure_noise: bool = flag(
        True, 'use the noise measured while the object stands still, corner_sigma_px until then')
    arm_sigma_m: float = real(
        0.03, 0.001, 1.0, 'm', 'how far the arm model may be off, for choosing between the '
        'two minima')
    arm_sigma_rad: float = real(
        0.1, 0.001, 3.0, 'rad', 'how far the arm model may be turned, for the same choice')
    motion_m_s: float = real(
        0.3, 0.0, 10.0, 'm/s', 'speed that the object may have, for the choice by the last pose')
    motion_rad_s: float = real(
        2.0, 0.0, 50.0, 'rad/s', 'turning speed that the object may have, for the same choice')
    memory_s: float = real(1.0, 0.01, 60.0, 's', 'age at which the last pose tells nothing')
    fit_limit_px: float = real(
        3.0, 0.1, 100.0, 'px', 'corners that fit no pose of the object better than this are '
        'refused: wrong order, wrong size, or not the object')
    looks_max: int = whole(60, 1, 1000, '', 'looks that are averaged at most')
    looks_min: int = whole(8, 1, 1000, '', 'looks that teaching a goal needs')
    plan_looks_min: int = whole(3, 1, 1000, '', 'looks at rest that a plan needs')
    look_age_s: float = real(0.5, 0.05, 10.0, 's', 'age at which corners are no longer now')
    still_px: float = real(
        1.0, 0.05, 20.0, 'px', 'corners that stay this near to each other stand still')
