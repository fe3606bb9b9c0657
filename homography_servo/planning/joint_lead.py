"""
Planned joints that lead where a pose alone does not tell the way.

At a singularity two postures meet that hold the object alike; from the pose alone the
arm would turn back there. A path that was planned in joint space brings its joints
along: near the singularity the arm follows their changes, without correction, and the
looks take over again behind it.
"""

from __future__ import annotations

import numpy as np

ARRIVED_RAD = 2.5e-3
LARGEST_OFFSET_RAD = 0.35


class JointLead:
    """
    The joints of a plan, and where they have to be trusted.

    Parameters
    ----------
    joints_rad : (N, n) array
        Planned along the path.
    led : (N,) bool array
        Poses at or right behind a singularity.

    """

    def __init__(self, joints_rad: np.ndarray = np.zeros((0, 0)),
                 led: np.ndarray = np.zeros(0, dtype=bool)) -> None:
        if len(joints_rad) != len(led):
            raise ValueError(f'joints and flags must be as many, got {len(joints_rad)} and '
                             f'{len(led)}')
        self._joints_rad, self._led = np.asarray(joints_rad, float), np.asarray(led, bool)
        self._offset_rad = np.zeros(self._joints_rad.shape[1:])

    @property
    def needed(self) -> bool:
        """Tell whether the path passes a singularity at all."""
        return bool(self._led.any())

    def leads(self, index: int) -> bool:
        """Tell whether the first move to a pose follows the planned joints."""
        return self.needed and bool(self._led[max(index - 1, 0):index + 1].any())

    def passes(self, index: int) -> bool:
        """Tell whether a pose is only passed, without a look at how well it was met."""
        return self.needed and bool(self._led[index]) and index < len(self._led) - 1

    def note(self, index: int, joints_rad: np.ndarray) -> bool:
        """Keep how the real joints differ from the plan; false if it is another posture."""
        if not self.needed:
            return True
        self._offset_rad = joints_rad - self._joints_rad[index]
        return bool(np.abs(self._offset_rad).max() <= LARGEST_OFFSET_RAD)

    def target(self, index: int) -> np.ndarray:
        """Give the joints to go to."""
        return self._joints_rad[index] + self._offset_rad

    def planned(self, index: int) -> np.ndarray | None:
        """Give the planned joints (n,) of a pose, None where only poses are known."""
        return self._joints_rad[index] if len(self._joints_rad) else None

    def arrived(self, index: int, joints_rad: np.ndarray) -> bool:
        """Tell whether the joints are where the plan leads."""
        return bool(np.abs(joints_rad - self.target(index)).max() < ARRIVED_RAD)
