"""A plan as messages: verdict, image path, predicted joints, markers."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from homography_servo.nodes.conversions import trajectory_msg
from homography_servo.nodes.kit import ERROR
from homography_servo.nodes.kit import Health
from homography_servo.nodes.kit import OK
from homography_servo.nodes.kit import status_msg
from homography_servo.nodes.kit import WARN
from homography_servo.planning.planner import Plan
from homography_servo.planning.verdict import Verdict
from homography_servo.robot.robot_file import Robot
import numpy as np
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory

AMBIGUOUS = 0.5
SHORTEST_STEP_S = 0.02


def verdict_msg(plan: Plan, header: Header, robot: Robot | None,
                home_depth_m: float = 1.0) -> DiagnosticArray:
    """Make one status for the whole path and then one for each pose."""
    statuses = [_whole(plan, header.frame_id, home_depth_m)]
    names = None if robot is None else robot.joint_names
    statuses += [_single(plan.verdict, k, names) for k in range(len(plan.verdict.reasons))]
    return DiagnosticArray(header=header, status=statuses)


def _whole(plan: Plan, frame_id: str, home_depth_m: float) -> DiagnosticStatus:
    verdict, values = plan.verdict, plan.verdict.values
    facts = {'feasible': plan.ok, 'poses': len(plan.poses), 'way': plan.family,
             'frame': frame_id, 'home_depth_m': float(home_depth_m),
             'smallest_border_px': float(values.field_px.min())}
    if not plan.ok:
        facts.update(first_bad_pose=verdict.first_bad + 1, failed_check=verdict.check)
    for number, attempt in enumerate(plan.attempts):
        facts[f'attempt_{number + 1}'] = f'{attempt.name}: {attempt.sentence}'
    return status_msg('path_planner', Health('path', OK if plan.ok else ERROR, plan.sentence,
                                             facts))


def _single(verdict: Verdict, k: int, joint_names: tuple[str, ...] | None) -> DiagnosticStatus:
    values = verdict.values
    facts = {'border_px': float(values.field_px[k]),
             'facing_deg': float(np.degrees(values.facing_rad[k])),
             'ambiguity': float(values.ambiguity[k])}
    if joint_names is not None:
        facts.update(
            reached=bool(values.reached[k]), nearest_limit=joint_names[values.joint_index[k]],
            joint_margin_rad=float(values.joint_margin_rad[k]),
            conditioning=float(values.conditioning[k]), led=bool(values.led[k]),
            joint_step_rad=float(values.joint_step_rad[k]))
    level, sentence = OK, 'ok'
    if verdict.reasons[k]:
        level, sentence = ERROR, verdict.reasons[k]
    elif values.led[k]:
        level = WARN
        sentence = 'near a singularity of the arm: the planned joints lead'
    elif values.ambiguity[k] > AMBIGUOUS:
        level = WARN
        sentence = f'its mirror looks nearly the same (ambiguity {facts["ambiguity"]:.2f})'
    return status_msg('path_planner', Health(f'pose {k + 1}', level, sentence, facts))


def predicted_trajectory_msg(plan: Plan, robot: Robot | None, header: Header) -> JointTrajectory:
    """Make the joints predicted along the path, at the speed of the slowest joint."""
    if robot is None or plan.joints_rad is None:
        return JointTrajectory(header=header)
    step_s = np.abs(np.diff(plan.joints_rad, axis=0)) / robot.velocity_rad_s
    step_s = np.maximum(step_s.max(axis=1, initial=0.0), SHORTEST_STEP_S)
    times_s = np.concatenate([[0.0], np.cumsum(step_s)])
    return trajectory_msg(robot.joint_names, plan.joints_rad, times_s, header)
