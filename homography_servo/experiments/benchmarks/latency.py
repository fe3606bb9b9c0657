"""
The whole chain as processes: from the stamp of an image to bytes on the wire.

Everything of sim.yaml runs in continuous mode at 30, 60 and 120 images a second while
the arm follows a path, once with every node in a process of its own, once with tracker,
planner and servo in one. ``image_hop`` is a bare hop between two processes in the same
run: the age of the camera_info that goes out right after the image.
"""

from __future__ import annotations

import argparse
import ast
import os
from pathlib import Path
import tempfile
import time
from typing import Any, Sequence

from homography_servo.experiments.servo_trial import Bringup
from homography_servo.experiments.servo_trial import GOAL_DEG
from homography_servo.experiments.servo_trial import prepare
from homography_servo.experiments.servo_trial import servo
from homography_servo.experiments.servo_trial import START_DEG
from homography_servo.nodes.latency_probe import LatencyProbe
from homography_servo.nodes.trial_client import TrialClient
import numpy as np

RATES_HZ = (30.0, 60.0, 120.0)
POSE_AFTER_S = 0.003  # less than the period of the images
# By the client; the probe hears what is timed, once.
NOT_HEARD = ('image', 'camera_info', 'object/corners', 'object/contour', 'object/true_pose')
TICKS_PER_S = os.sysconf('SC_CLK_TCK')


def targets_on_wire(log: Path) -> list[float]:
    """Read from a session log when targets were written (steady clock, s)."""
    sent_s = []
    for line in log.read_text(errors='replace').splitlines():
        words = line.split(' ', 2)
        if len(words) == 3 and words[1] == '>' and any(
                word in ast.literal_eval(words[2]) for word in (b'!goto', b'move')):
            sent_s.append(float(words[0]))
    return sent_s


def node_pids(launcher: int) -> dict[str, int]:
    """Find the node processes of a launcher."""
    found = {}
    for entry in Path('/proc').glob('[0-9]*'):
        try:
            parent = int((entry / 'stat').read_text().rpartition(')')[2].split()[1])
            words = (entry / 'cmdline').read_text().split('\0')
        except OSError:
            continue
        if parent == launcher and 'homography_servo.nodes' in words:
            found[words[words.index('homography_servo.nodes') + 1]] = int(entry.name)
    return found


def cpu_s(pid: int) -> float:
    """Give the processor time that a process has used."""
    words = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(words[11]) + int(words[12])) / TICKS_PER_S


def memory_mb(pid: int) -> float:
    """Give the resident memory of a process."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


def _quantiles(name: str, ages_s: Sequence[float]) -> dict[str, Any]:
    if not ages_s:
        return {f'{name}_ms_p50': None, f'{name}_ms_p99': None}
    p50, p99 = np.percentile(ages_s, (50, 99)) * 1e3
    return {f'{name}_ms_p50': float(p50), f'{name}_ms_p99': float(p99)}


def measure(rate_hz: float, poses: int, folder: Path, one_process: bool) -> dict[str, Any]:
    """Run one trial in continuous mode and time it."""
    name = f'{rate_hz:.0f}_{"one" if one_process else "each"}'
    wire_log = folder / f'wire_{name}.log'
    words = [f'camera_sim.rate_hz:={rate_hz:.1f}', 'visual_servo.mode:=continuous',
             f'robix_bridge.session_log:={wire_log}']
    options = argparse.Namespace(start_deg=START_DEG, goal_deg=GOAL_DEG, poses=poses)
    os.environ['ROS_DOMAIN_ID'] = str(1 + (os.getpid() + int(rate_hz) + one_process) % 100)
    bringup = Bringup('sim.yaml', words, folder / f'bringup_{name}.log', one_process)
    client = TrialClient(bringup.trouble)
    probe = LatencyProbe(client.node, POSE_AFTER_S if one_process else 0.0)
    try:
        sentence = prepare(client, options)
        client.stop_hearing(*NOT_HEARD)
        pids = node_pids(bringup.process.pid)
        before = {name: cpu_s(pid) for name, pid in pids.items()}
        probe.begin()
        began_s = time.monotonic()
        ending = servo(client, sentence, 120.0)
        spent_s = time.monotonic() - began_s
        probe.end()
        usage = {f'{name}_cpu_share': (cpu_s(pid) - before[name]) / spent_s
                 for name, pid in pids.items()}
        memory = {f'{name}_memory_mb': memory_mb(pid) for name, pid in pids.items()}
    finally:
        client.close()
        bringup.end()
    return {'method': 'one process' if one_process else 'a process each',
            'case': f'{rate_hz:.0f} Hz',
            'converged_share': float(ending.startswith('converged')),
            **_quantiles('image_hop', probe.ages_s['image_hop']),
            **_quantiles('stamp_to_corners', probe.ages_s['corners']),
            **_quantiles('stamp_to_pose', probe.ages_s['pose']),
            **_quantiles('stamp_to_command', probe.command_ages_s()),
            **_quantiles('stamp_to_wire', probe.wire_ages_s(targets_on_wire(wire_log))),
            'images': len(probe.ages_s['image_hop']), 'corners': len(probe.ages_s['corners']),
            'commands': len(probe.commands_s), **usage, **memory}


def run(quick: bool, seed: int) -> list[dict[str, Any]]:
    """Measure every rate; ``quick`` leaves out 60 Hz and follows a shorter path."""
    rates_hz = (30.0, 120.0) if quick else RATES_HZ
    with tempfile.TemporaryDirectory(prefix='homography_servo_') as folder:
        return [measure(rate_hz, 7 if quick else 31, Path(folder), one_process)
                for rate_hz in rates_hz for one_process in (False, True)]
