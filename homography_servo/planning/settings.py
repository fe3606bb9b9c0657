"""What a path must keep to, and how paths are made: the only home of these defaults."""

from __future__ import annotations

from dataclasses import dataclass

from homography_servo.settings import flag
from homography_servo.settings import real
from homography_servo.settings import Settings
from homography_servo.settings import whole


@dataclass(frozen=True)
class FeasibilitySettings(Settings):
    """
    The limits of the verdict.

    A start that is already beyond one of them (a joint that stands in its margin, a
    corner near the border) may be left, never be made worse.
    """

    field_margin_px: float = real(
        10.0, 0.0, 500.0, 'px', 'distance that every point keeps from the border of the image')
    facing_limit_deg: float = real(
        75.0, 5.0, 89.0, 'deg', 'largest angle between the face normal and the line of sight')
    joint_margin_rad: float = real(
        0.05, 0.0, 1.0, 'rad', 'distance that every joint keeps from its limits')
    joint_step_rad: float = real(
        0.5, 0.01, 3.0, 'rad', 'largest motion of one joint from pose to pose; more is a jump')
    conditioning_min: float = real(
        0.02, 0.0, 1.0, '', 'smallest singular value of the object Jacobian, lengths in units '
        'of conditioning_length_m; below it small errors move the arm a lot')
    lead_below: float = real(
        0.12, 0.0, 1.0, '', 'singular value below which the planned joints lead the servo past '
        'a pose, without correction by looks')
    conditioning_length_m: float = real(
        0.1, 0.001, 10.0, 'm', 'length that counts like one radian in the conditioning')
    ambiguity_max: float = real(
        1.0, 0.0, 1.0, '', 'largest predicted mirror ambiguity; 1 reports it without a veto, '
        'since the joints or the previous pose decide')
    reach_tolerance_m: float = real(
        1e-6, 1e-9, 0.01, 'm', 'a pose is reached when the arm comes this near')
    reach_tolerance_rad: float = real(
        1e-5, 1e-9, 0.1, 'rad', 'a pose is reached when the arm turns this near')
    disagreement_max_m: float = real(
        0.1, 0.001, 10.0, 'm', 'largest distance between the pose seen at the start and the '
        'pose by the joints; more means a wrong model or a wrong object')
    disagreement_max_rad: float = real(
        0.5, 0.01, 3.15, 'rad', 'largest angle between the pose seen at the start and the '
        'pose by the joints')
    corner_sigma_px: float = real(
        0.1, 0.001, 10.0, 'px', 'standard deviation of a measured corner coordinate')
    home_depth_m: float = real(
        1.0, 0.01, 100.0, 'm', 'depth of the virtual home pose when there is no robot file')


@dataclass(frozen=True)
class PlannerSettings(FeasibilitySettings):
    """How a path is made, and how hard repairs are tried."""

    poses: int = whole(
        31, 0, 2000, '', 'number of poses of a path, both ends counted; 0 chooses it from '
        'the largest steps')
    step_max_m: float = real(0.05, 0.0001, 1.0, 'm', 'largest step when poses is 0')
    step_max_rad: float = real(0.15, 0.001, 1.0, 'rad', 'largest turn when poses is 0')
    step_max_px: float = real(
        20.0, 0.1, 500.0, 'px', 'largest motion of a corner between poses when poses is 0')
    repair: bool = flag(True, 'try to repair a path that is vetoed')
    pass_singularities: bool = flag(
        True, 'as a last resort pass through a singularity of the arm, led by the planned joints')
    via_tries: int = whole(24, 0, 1000, '', 'via-poses that are tried')
    search_nodes: int = whole(
        1500, 0, 100000, '', 'joint configurations that the search in joint space may try')
    seed: int = whole(0, 0, 2**31 - 1, '', 'seed of the repairs; the same input and seed '
                      'give the same plan')
