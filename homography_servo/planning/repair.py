"""
Repairs of a vetoed path, in the order in which they are tried.

Each method yields proposals; the planner checks them in full and takes the first that
can be executed. A method that has nothing to propose says why.
"""

from __future__ import annotations

from typing import Callable, Iterator

from homography_servo.geometry.path import FAMILIES
from homography_servo.geometry.rigid import displaced
from homography_servo.geometry.rigid import pose_difference
from homography_servo.planning.feasibility import goal_fault
from homography_servo.planning.joint_search import search
from homography_servo.planning.joint_search import shortened
from homography_servo.planning.joint_search import spread
from homography_servo.planning.joint_space import JointSpace
from homography_servo.planning.joint_space import SPARES
from homography_servo.planning.task import Proposal
from homography_servo.planning.task import shared_out
from homography_servo.planning.task import Task
from homography_servo.result import required
from homography_servo.robot.kinematics import inverse
from homography_servo.robot.kinematics import object_pose
import numpy as np

TURNS = ('positive', 'negative')
CALM_FAMILY = 'straight'  # between via-poses: the image of the centre goes straight
_SAMPLES = 400


def hopeless(task: Task) -> str:
    """Say why no path whatever can help, empty if one might."""
    fault = goal_fault(task.goal, task.camera, task.object_points_m, task.home_depth_m,
                       task.settings, task.goal_known)
    if fault:
        return f'at the goal {fault}'
    if task.robot is None:
        return ''
    if len(task.goal_branches) == 0:
        return 'no joints inside the limits put the object at the goal'
    return _all_faults(task, JointSpace(task, through=True))


def divided(task: Task) -> str:
    """Say why no path can help that keeps off singularities, empty if one might."""
    return _all_faults(task, JointSpace(task))


def _all_faults(task: Task, space: JointSpace) -> str:
    faults = [space.fault(joints_rad) for joints_rad in task.goal_branches]
    if not all(faults):
        return ''
    ways = len(faults)
    return (f'the arm can hold the object at the goal in {ways} way{"s" * (ways > 1)}, but '
            + ' and '.join(dict.fromkeys(faults)))


def other_turn(task: Task) -> Iterator[Proposal]:
    """Turn gamma the long way round."""
    taken = _path(task)
    for turn in TURNS:
        poses = _path(task, turn=turn)
        if not same_way(poses, taken):
            yield Proposal('the other turn of gamma', poses)


def _path(task: Task, family: str = 'paper', turn: str = 'shorter') -> np.ndarray:
    """Interpolate between ends that the planner has found to be joined by a path."""
    return required(task.path(family, turn), 'path')


def same_way(poses: np.ndarray, others: np.ndarray) -> bool:
    """Tell whether two paths are the same."""
    return bool(np.abs(poses - others).max() < 1e-9)


def other_branch(task: Task) -> Iterator[Proposal]:
    """Go over to other joints for the start pose first, then along the path."""
    name = 'another branch of the inverse kinematics'
    if task.robot is None:
        return
    start = task.start_joints_rad
    found = inverse(task.robot, object_pose(task.robot, start), start, task.settings.seed)
    branches = [b for b in found if np.abs(b - start).max() > 1e-3]
    space = JointSpace(task)
    usable = [b for b in branches if space.open(start, b)]
    if not usable:
        yield Proposal(name, None, reason=(
            f'{len(branches)} other branches at the start, none can be gone over to without '
            'a singularity, a limit or leaving the view'))
    path = _path(task)
    for branch in usable:
        ways = [np.abs(branch - start).max(), 1.0]
        first, _ = shared_out(task.count - 1, ways)
        switch = spread(np.array([start, branch]), first + 1)
        poses = np.concatenate([task.poses_of(switch), path[1:]])
        yield Proposal(name, poses)


def other_families(task: Task) -> Iterator[Proposal]:
    """Take other interpolations, with both turns where they differ."""
    for family in FAMILIES:
        if family == 'paper':
            continue
        taken: list[np.ndarray] = []
        for turn in ('shorter', *TURNS):
            poses = _path(task, family, turn)
            if any(same_way(poses, other) for other in taken):
                continue
            taken.append(poses)
            yield Proposal(f'the family {family} ({turn} turn)', poses)


def via_poses(task: Task) -> Iterator[Proposal]:
    """Go through a pose in between: the middle of the view first, then what the arm likes."""
    stops = _calm_stops(task)
    if task.robot is not None:
        stops += _arm_stops(task, task.settings.via_tries - len(stops))
    for number, stop in enumerate(stops[:task.settings.via_tries]):
        poses = task.through([task.start, stop, task.goal], CALM_FAMILY)
        yield Proposal(f'via-pose {number + 1}', poses)


def _calm_stops(task: Task) -> list[np.ndarray]:
    """Give poses on the optical axis, square to the camera, halfway in turn."""
    middle = required(task.between(task.start, task.goal, 3, CALM_FAMILY), 'path')[1]
    heading = np.arctan2(middle[1, 0], middle[0, 0])
    stops = []
    for turn in (0.0, np.pi / 2, -np.pi / 2):
        stop = np.eye(4)
        cos, sin = np.cos(heading + turn), np.sin(heading + turn)
        stop[:2, :2] = [[cos, -sin], [sin, cos]]
        stop[2, 3] = max(task.start[2, 3], task.goal[2, 3])
        stops.append(stop)
    return stops


def _arm_stops(task: Task, count: int) -> list[np.ndarray]:
    """Give poses at free joints that are a small detour, for any way to hold the goal."""
    space = JointSpace(task)
    rng = np.random.default_rng(task.settings.seed)
    samples = rng.uniform(space.lower_rad, space.upper_rad, (_SAMPLES, len(space.lower_rad)))
    samples = samples[space.free(samples)]
    calm = space.values(samples).conditioning >= task.settings.lead_below
    samples = samples[calm] if np.any(calm) else samples
    if not len(space.goals) or not len(samples):
        return []
    onward = np.linalg.norm(samples[:, None] - space.goals[None], axis=2).min(axis=1)
    detour = onward + np.linalg.norm(samples - task.start_joints_rad, axis=1)
    best = samples[np.argsort(detour, kind='stable')[:max(count, 0)]]
    return list(task.poses_of(best)) if len(best) else []


def joint_space(task: Task) -> Iterator[Proposal]:
    """Plan in joint space: straight to each way to hold the goal, then by search."""
    if task.robot is None:
        return
    yield from _straight(task, JointSpace(task))
    for spare in SPARES:
        yield _searched(task, JointSpace(task, spare))


def through_singularity(task: Task) -> Iterator[Proposal]:
    """Plan in joint space with no regard to singularities; the joints lead the way."""
    for spare in SPARES:
        space = JointSpace(task, spare, through=True)
        if spare == SPARES[0]:
            yield from _straight(task, space)
        yield _searched(task, space)


def _straight(task: Task, space: JointSpace) -> Iterator[Proposal]:
    for number, goal in enumerate(space.goals):
        yield _along(task, space, np.array([task.start_joints_rad, goal]),
                     f'a straight path in joint space{space.suffix} (branch {number + 1})')


def _searched(task: Task, space: JointSpace) -> Proposal:
    name = f'a searched path in joint space{space.suffix}'
    rng = np.random.default_rng(task.settings.seed)
    way = search(space, task.start_joints_rad, space.goals, task.settings.search_nodes, rng)
    if way is not None:
        return _along(task, space, shortened(space, way, rng), name)
    return Proposal(name, None, reason=(
        f'no way found with {task.settings.search_nodes} tries that stays in view and inside '
        f'the joint limits{"" if space.through else " and off singularities"}'))


def _along(task: Task, space: JointSpace, way: np.ndarray, name: str) -> Proposal:
    length = np.abs(np.diff(way, axis=0)).max(axis=1).sum()
    count = max(task.count, int(np.ceil(length / (0.8 * task.settings.joint_step_rad))) + 1)
    joints_rad = spread(way, count)
    poses = _bent(task.poses_of(joints_rad), task.start, task.goal)
    return Proposal(name, poses, joints_rad if space.through else None)


def _bent(poses: np.ndarray, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Spread along a path what the arm's model and the camera disagree by at its goal."""
    share = np.linspace(0.0, 1.0, len(poses))[:, None]
    bent = displaced(poses, share * pose_difference(goal, poses[-1]))
    bent[0], bent[-1] = start, goal
    return bent


REPAIRS: tuple[Callable[[Task], Iterator[Proposal]], ...] = (
    other_turn, other_branch, other_families, via_poses, joint_space)
