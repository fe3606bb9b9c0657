"""Settings of the tracker."""

from __future__ import annotations

from dataclasses import dataclass

from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import reals
from homography_servo.settings import Settings
from homography_servo.settings import text
from homography_servo.settings import whole

POLARITIES = {'any': 0, 'bright': 1, 'dark': -1}


@dataclass(frozen=True)
class TrackerSettings(Settings):
    """How the face is found, followed and trusted."""

    edge_blur_px: float = real(
        0.6, 0.0, 6.0, 'px', 'standard deviation of the lens blur to begin with; it is '
        'estimated from the edges while tracking')
    edge_half_px: int = whole(4, 3, 16, 'px', 'pixels read on either side of an edge')
    search_px: float = real(
        24.0, 2.0, 100.0, 'px', 'how far from its prediction the face is looked for')
    polarity: str = text(
        'any', 'whether the face is brighter or darker than what surrounds it',
        choices=tuple(POLARITIES))
    min_contrast: float = real(
        8.0, 1.0, 200.0, 'grey levels', 'median contrast of the edges below which nothing is '
        'trusted')
    min_inlier_share: float = real(
        0.55, 0.1, 1.0, '', 'share of the lines that must agree with the shape')
    max_corner_sigma_px: float = real(
        1.0, 0.01, 20.0, 'px', 'standard deviation of a corner above which the measurement '
        'is not trusted')
    max_jump_px: float = real(
        6.0, 1.0, 100.0, 'px', 'largest difference between a corner and its prediction '
        'after the common motion of all corners is taken out')
    max_shape_miss_px: float = real(
        1.5, 0.1, 100.0, 'px', 'largest RMS distance of the corners from the nearest view of '
        'the face that is trusted; needs a calibrated camera')
    coasting_frames: int = whole(
        3, 0, 30, 'frames', 'frames that are bridged by prediction before the face is lost')
    coasting_s: float = real(
        0.12, 0.0, 5.0, 's', 'time that is bridged by prediction before the face is lost')
    confirming_frames: int = whole(
        5, 1, 60, 'frames', 'good frames in a row before a face that was found is trusted')
    initial_corners_px: tuple[float, ...] = reals(
        (), 'px', 'where the corners are in the first image: u and v of top left, top right, '
        'bottom right, bottom left as seen at the home pose; empty: they are looked for',
        length=8)
    nearest_m: float = real(
        0.15, 0.01, 100.0, 'm', 'least distance of the face from the camera that is possible')
    farthest_m: float = real(
        1.5, 0.01, 100.0, 'm', 'largest distance of the face from the camera that is possible')
    find_face: bool = flag(
        True, 'whether to look for the face in the whole image when it is not known where it is')
