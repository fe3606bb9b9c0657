"""A million random and hostile commands: what reaches the wire is always safe."""

import math
import os

from homography_servo.robot.trajectory import TrajectoryPoint
from link_setup import Judge
from link_setup import NAMES
from link_setup import Rig
from link_setup import ROBOT
import numpy as np
import pytest

DIRECT = int(os.environ.get('HOSTILE_DIRECT', 15_000))
OFFERED = 1_000_000 - min(2 * DIRECT, 1_000_000)
LOWER, UPPER = ROBOT.lower_rad + 0.05, ROBOT.upper_rad - 0.05
BAD_NUMBERS = [math.nan, math.inf, -math.inf, 1e9, -1e9, 1e300, 5e-324, -0.0]


def posture(rng):
    return rng.uniform(LOWER, UPPER)


def nudged(rng):
    """Leave the limits by as little as 1e-9 or as much as 1e9."""
    joints, index = posture(rng), rng.integers(6)
    joints[index] = UPPER[index] + 10.0 ** rng.integers(-9, 10)
    return joints


def poisoned(rng):
    joints = posture(rng)
    joints[rng.integers(6)] = rng.choice(BAD_NUMBERS)
    return joints


def points(rng):
    """Make a trajectory, wrong in one of many ways more often than not."""
    kind = rng.integers(12)
    times = np.cumsum(rng.uniform(0.01, 1.0, rng.integers(1, 4)))
    rows = [posture(rng) for _ in times]
    if kind == 0:
        times = times[::-1] - rng.uniform(0.0, 0.5)
    elif kind == 1:
        rows[-1] = nudged(rng)
    elif kind == 2:
        rows[0] = poisoned(rng)
    elif kind == 3:
        rows[0] = rows[0][:rng.integers(6)]
    elif kind == 4:
        times = times * rng.choice([1e-9, -1.0, math.nan, math.inf, 1e9])
    elif kind == 5:
        speeds = rng.normal(0.0, 10.0 ** rng.integers(-2, 9), (len(times), 6))
        return [TrajectoryPoint(t, r, v) for t, r, v in zip(times, rows, speeds)]
    elif kind == 6:
        return [TrajectoryPoint(t, r, (), (), (1.0,) * 6) for t, r in zip(times, rows)]
    elif kind == 7:
        return []
    elif kind == 8:
        rows = [rng.uniform(-0.02, 0.02, 6) for _ in times]
    return [TrajectoryPoint(t, r) for t, r in zip(times, rows)]


def names(rng):
    kind = rng.integers(10)
    if kind == 0:
        return NAMES[:5]
    if kind == 1:
        return (*NAMES[:5], 'joint1')
    if kind == 2:
        return (*NAMES[:5], 'elbow')
    return tuple(rng.permutation(NAMES)) if kind == 3 else NAMES


def mischief(rig, rng):
    """Do what other threads, operators and cables do."""
    kind = rng.integers(12)
    if kind == 0:
        rig.driver.stop_now('a person')
    elif kind in (1, 2, 3):
        rig.driver.reset(0.0)
    elif kind == 4:
        rig.driver.pause(bool(rng.integers(2)), rig.now_s)
    elif kind == 5:
        rig.driver.power(bool(rng.integers(4)))
    elif kind == 6:
        rig.driver.home(rig.now_s)
    elif kind == 7:
        rig.driver.hold('a reason', rig.now_s, rng.uniform(0.0, 0.2))
    elif kind == 8 and rng.integers(10) == 0:
        rig.break_at = {rig.operations + int(rng.integers(1, 20))}
    else:
        rig.driver.reset(0.0)
        rig.driver.pause(False, rig.now_s)
        rig.driver.power(True)


@pytest.mark.parametrize('seed, count, burst, offered', [
    (1, DIRECT, 8, False), (2, DIRECT, 3, False), (3, OFFERED, 100, True)])
def test_nothing_unsafe_reaches_the_wire(seed, count, burst, offered):
    rng = np.random.default_rng(seed)
    rig, judge, done = Rig(), Judge(), 0
    pool = [(names(rng), points(rng)) for _ in range(4000)]
    picks = rng.integers(len(pool), size=count)
    rig.run(0.2)
    while done < count:
        for pick in picks[done:done + burst]:
            who, what = pool[pick]
            if offered:
                rig.driver.offer(lambda now_s, w=who, p=what: rig.driver.command(w, p, now_s))
            else:
                rig.driver.command(who, what, rig.now_s)
        done += burst
        rig.step_s = float(rng.choice([0.001, 0.004, 0.01, 0.03]))
        rig.turn()
        if rng.random() < 0.03:
            mischief(rig, rng)
        if len(rig.log) > 2000:
            judge.watch(rig.log)
            rig.log.clear()
    judge.watch(rig.log)
    assert judge.violations == []
    assert judge.targets > count / 1000  # it did move
    counts = rig.driver.all_counts
    taken = counts['commands_accepted'] + counts['commands_rejected'] + \
        counts['commands_replaced']
    assert count - 1 <= taken <= count + burst  # every command is accounted for
    assert counts['targets_refused'] == 0
