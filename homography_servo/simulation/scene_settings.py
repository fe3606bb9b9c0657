"""What the rendered world looks like: every setting with unit and range."""

from __future__ import annotations

from dataclasses import dataclass

from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import reals
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole

GREY = 'grey levels'


@dataclass(frozen=True)
class SceneSettings(Settings):
    """Appearance of box and background, light, lens blur, noise, things in the way."""

    face_level: float = real(200.0, 0.0, 255.0, GREY, 'brightness of the tracked face')
    side_levels: tuple[float, ...] = reals(
        (120.0, 95.0, 65.0, 105.0), GREY,
        'brightness of the sides of the box at the top, right, bottom, left of the face',
        length=4, low=0.0, high=255.0)
    back_level: float = real(60.0, 0.0, 255.0, GREY, 'brightness of the back of the box')
    background_level: float = real(75.0, 0.0, 255.0, GREY, 'mean brightness behind the box')
    texture_grey: float = real(0.0, 0.0, 40.0, GREY, 'standard deviation of slow background '
                               'variation')
    clutter: float = real(0.0, 0.0, 1.0, '', 'amount of things lying around: 0 none, 1 full')
    print_contrast: float = real(0.0, 0.0, 200.0, GREY, 'how much darker the print on the face '
                                 'is; 0 is a blank face')
    shadow: float = real(0.0, 0.0, 1.0, '', 'share of light the cast shadow takes away')
    shadow_gap_m: float = real(0.02, 0.0, 1.0, 'm', 'distance of the surface that carries the '
                               'shadow behind the farthest point of the box')
    shadow_slope_x: float = real(0.5, -3.0, 3.0, '', 'sideways travel of the light per depth, '
                                 'image right')
    shadow_slope_y: float = real(0.3, -3.0, 3.0, '', 'sideways travel of the light per depth, '
                                 'image down')
    shadow_softness_px: float = real(1.5, 0.0, 20.0, 'px', 'standard deviation of the penumbra')
    gradient: float = real(0.0, 0.0, 1.0, '', 'relative change of the light over the image width')
    gradient_direction_rad: float = real(0.5, -3.2, 3.2, 'rad', 'direction in which the light '
                                         'grows, from image right towards image down')
    flicker: float = real(0.0, 0.0, 0.5, '', 'relative amplitude of flickering light')
    flicker_hz: float = real(7.0, 0.0, 500.0, 'Hz', 'frequency of the flicker')
    blur_px: float = real(0.6, 0.0, 6.0, 'px', 'standard deviation of the lens blur')
    noise_grey: float = real(3.0, 0.0, 50.0, GREY, 'standard deviation of the pixel noise')
    box_visible: bool = flag(True, 'whether the box is in the scene at all')
    vanish_start_s: float = real(-1.0, -1.0, 1e6, 's', 'when the box is taken away; -1 is never')
    vanish_duration_s: float = real(1.0, 0.0, 1e6, 's', 'how long the box stays away')
    occluder: str = text('none', 'what passes in front of the box',
                         choices=('none', 'corner', 'side', 'sweep'))
    occluder_index: int = whole(0, 0, 3, '', 'which corner or side the occluder hides')
    occluder_level: float = real(110.0, 0.0, 255.0, GREY, 'brightness of the occluder')
    occluder_size: float = real(0.3, 0.01, 3.0, '', 'radius or half width of the occluder '
                                'over the shorter side of the face')
    occluder_start_s: float = real(1.0, 0.0, 1e6, 's', 'when the occluder comes')
    occluder_duration_s: float = real(1.0, 0.0, 1e6, 's', 'how long the occluder stays')
    occluder_period_s: float = real(0.0, 0.0, 1e6, 's', 'time between occlusions; 0 is once')
