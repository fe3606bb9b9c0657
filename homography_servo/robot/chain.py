"""Link frames of an arm and the motion of what it holds, for one posture or many at once."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

from homography_servo.robot.robot_model import Joint
from homography_servo.robot.robot_model import Robot
import numpy as np

_YZX = np.array([1, 2, 0])
_ZXY = np.array([2, 0, 1])


class _Links(NamedTuple):
    """A link is cos(t) * along + sin(t) * across + still, t = theta0 + joint."""

    theta0_rad: np.ndarray  # (n,)
    along: np.ndarray  # (n, 4, 4)
    across: np.ndarray
    still: np.ndarray


@lru_cache(maxsize=64)
def _links(robot: Robot) -> _Links:
    fixed = np.array([after_turn(joint) for joint in robot.joints])
    along, across, still = (np.zeros_like(fixed) for _ in range(3))
    along[:, :2] = fixed[:, :2]
    across[:, 0], across[:, 1] = -fixed[:, 1], fixed[:, 0]
    still[:, 2:] = fixed[:, 2:]
    return _Links(np.array([joint.theta0_rad for joint in robot.joints]), along, across, still)


def after_turn(joint: Joint) -> np.ndarray:
    """Build Tz(d) Tx(a) Rx(alpha): what follows the turn of a joint."""
    cos, sin = np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
    return np.array([[1.0, 0.0, 0.0, joint.a_m],
                     [0.0, cos, -sin, 0.0],
                     [0.0, sin, cos, joint.d_m],
                     [0.0, 0.0, 0.0, 1.0]])


def checked_joints(robot: Robot, joints_rad) -> np.ndarray:
    """Give joints as a float array (..., n); another shape is a mistake of the caller."""
    joints = np.asarray(joints_rad, dtype=float)
    if joints.ndim == 0 or joints.shape[-1] != robot.count:
        raise ValueError(f'joints_rad must have shape (..., {robot.count}), got {joints.shape}')
    return joints


def link_frames(robot: Robot, joints_rad: np.ndarray, first: np.ndarray) -> np.ndarray:
    """
    Chain the links.

    Parameters
    ----------
    robot : Robot
        The arm.
    joints_rad : (..., n) array
        Joint angles.
    first : (4, 4) array
        Frame of the base in the frame wanted.

    Returns
    -------
    (..., n + 1, 4, 4) array
        The frame before joint 1, after joint 1, ... after joint n.

    """
    links = _links(robot)
    angle = links.theta0_rad + joints_rad
    cos, sin = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    turns = cos * links.along + sin * links.across + links.still
    frames = np.empty((*angle.shape[:-1], robot.count + 1, 4, 4))
    frames[..., 0, :, :] = first
    for index in range(robot.count):
        np.matmul(frames[..., index, :, :], turns[..., index, :, :],
                  out=frames[..., index + 1, :, :])
    return frames


def object_frames(robot: Robot, joints_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chain the links from home; gives the frames and home_from_object (..., 4, 4)."""
    frames = link_frames(robot, joints_rad, robot.home_from_base)
    return frames, frames[..., -1, :, :] @ robot.tool_from_object


def jacobian_of(frames: np.ndarray, tip: np.ndarray) -> np.ndarray:
    """
    Stack the motion of a point on the last link for each joint.

    Parameters
    ----------
    frames : (..., n + 1, 4, 4) array
        From `link_frames`.
    tip : (..., 4, 4) array
        Frame whose origin is the point.

    Returns
    -------
    (..., 6, n) array
        Linear velocity of the origin first, then angular velocity, in the axes of the first
        frame; column i is z_i x (p - o_i), z_i (Siciliano et al., Robotics, 2009, eq. 3.30).

    """
    axes = frames[..., :-1, :3, 2]
    arms = tip[..., None, :3, 3] - frames[..., :-1, :3, 3]
    columns = np.empty((*axes.shape[:-1], 6))
    # numpy's cross costs more than all the rest of a Jacobian for a single posture.
    columns[..., :3] = axes[..., _YZX] * arms[..., _ZXY] - axes[..., _ZXY] * arms[..., _YZX]
    columns[..., 3:] = axes
    return np.swapaxes(columns, -1, -2)
