"""
Run the servo trial of the paper as the lab did it, and write a report.

Power on, drive to the goal joints, teach the goal from what the camera sees, drive
to the start joints, plan, and servo along the path; all through topics and
services. The report (index.html, figures, trial.json) goes into a folder.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any, Sequence

from homography_servo.experiments.bag import BagError
from homography_servo.experiments.report import print_summary
from homography_servo.experiments.report import write_report
from homography_servo.experiments.trial_bag import begin_bag
from homography_servo.experiments.trial_bag import recorder_of
from homography_servo.experiments.trial_bag import trial_from_bag
from homography_servo.nodes.__main__ import PARENT
from homography_servo.nodes.run import EXIT_CONFIG
from homography_servo.nodes.run import SignalWatch
from homography_servo.nodes.trial_client import TrialClient
from homography_servo.nodes.trial_client import TrialError
from homography_servo.nodes.trial_log import ENDED
from homography_servo.nodes.trial_log import STARTED
from homography_servo.nodes.trial_log import TAUGHT
from homography_servo.nodes.trial_log import TrialLog
import numpy as np

START_DEG = (-50.0, 40.0, 10.0, -10.0, 0.0, -20.0)
GOAL_DEG = (-5.0, 40.0, 10.0, -10.0, 0.0, -20.0)
STUCK_S = 30.0
REST_S = 2.5
EXIT_OK, EXIT_FAILED = 0, 1


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(
        prog='servo_trial', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog='examples:\n  servo_trial --bringup sim.yaml --output report --record\n'
               '  servo_trial --from-bag report/bag --output report_again')
    about.add_argument('--bringup', metavar='CONFIG',
                       help='start the nodes of this configuration and end them afterwards')
    about.add_argument('--one-process', action='store_true',
                       help='with --bringup: tracker, planner and servo in one process')
    about.add_argument('--set', nargs='+', default=[], action='extend', dest='overrides',
                       metavar='NODE.PARAMETER:=VALUE', help='handed on to bringup')
    about.add_argument('--output', default='report', metavar='FOLDER', type=Path)
    about.add_argument('--poses', type=int, metavar='N', help='number of poses of the path')
    about.add_argument('--start-deg', nargs='+', type=float, default=START_DEG, metavar='DEG',
                       help='joints at the start (default: the trial of the paper)')
    about.add_argument('--goal-deg', nargs='+', type=float, default=GOAL_DEG, metavar='DEG',
                       help='joints at which the goal is taught')
    about.add_argument('--timeout', type=float, default=300.0, metavar='S',
                       help='give up after this time')
    about.add_argument('--record', nargs='?', const='', metavar='FOLDER',
                       help='record all topics of the trial, pictures too, as an MCAP bag '
                       '(default: the folder bag, bag_2, ... in the output folder)')
    about.add_argument('--keep-free', type=float, default=500.0, metavar='MB',
                       help='stop recording when the disk has less room than this '
                       '(default: 500); the trial goes on')
    about.add_argument('--from-bag', type=Path, metavar='FOLDER',
                       help='write the report of a recording; nothing is started or moved')
    return about


class Bringup:
    """The launcher as a child process whose output goes to a file."""

    def __init__(self, config: str, overrides: Sequence[str], log: Path,
                 one_process: bool = False) -> None:
        log.parent.mkdir(parents=True, exist_ok=True)
        self.log = log
        command = [sys.executable, '-m', 'homography_servo.launch.bringup', '--config', config]
        command += ['--one-process'] if one_process else []
        with log.open('wb') as out:
            self.process = subprocess.Popen(
                [*command, *(['--set', *overrides] if overrides else [])],
                stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
                env={**os.environ, PARENT: str(os.getpid())}, start_new_session=True)

    def trouble(self) -> str | None:
        """Say why the launcher has ended, or None while it runs."""
        code = self.process.poll()
        if code is None:
            return None
        lines = self.log.read_text(errors='replace').strip().splitlines()[-3:]
        return f'bringup ended with code {code}: {" | ".join(lines)} (all of it: {self.log})'

    def end(self) -> None:
        """End the launcher and with it the nodes."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(20.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


class ProgressLine:
    """Shows ``pose k of N, error, time left``, over itself on a terminal."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._began_s = time.monotonic()
        self._shown = (0, 0)
        self._over = sys.stdout.isatty()

    def show(self, poses: list) -> None:
        """Show the last pose when there is news of it."""
        if not poses or (poses[-1].index, poses[-1].iterations) == self._shown:
            return
        record = poses[-1]
        fresh_pose = record.index != self._shown[0]
        self._shown = (record.index, record.iterations)
        if self._over or fresh_pose:
            print(self._line(record), end='\r' if self._over else '\n', flush=True)

    def _line(self, record) -> str:
        spent_s = time.monotonic() - self._began_s
        left_s = spent_s / record.index * (self._count - record.index)
        return (f'pose {record.index:2d} of {self._count}   '
                f'error {1e3 * record.position_error_m:5.2f} mm '
                f'{np.degrees(record.rotation_error_rad):5.2f} deg   '
                f'{record.iterations:2d} looks   about {left_s:3.0f} s left')


def prepare(client: TrialClient, options: argparse.Namespace) -> str:
    """Bring the arm to the start with a goal taught and a path planned."""
    print('waiting for the arm and the camera ...', flush=True)
    client.wait(lambda: client.state('robix_bridge') in ('IDLE', 'MOVING'), 30.0,
                f'the bridge is not ready: {client.state("robix_bridge") or "not running"}')
    client.switch('robix_bridge/power', True)
    if options.poses:
        client.set_parameter('path_planner', 'poses', options.poses)
    print('driving to the goal joints and teaching the goal ...', flush=True)
    client.drive(np.radians(options.goal_deg))
    wait_for_sight(client)
    print(client.trigger_patiently('path_planner/teach_goal'), flush=True)
    client.event(TAUGHT)
    print('driving to the start joints and planning ...', flush=True)
    client.drive(np.radians(options.start_deg))
    wait_for_sight(client)
    return client.trigger_patiently('path_planner/plan')


def wait_for_sight(client: TrialClient) -> None:
    """Wait until the tracker follows the face at rest."""
    client.fresh('image', 15.0, 'no image: is the camera running?')
    client.wait(lambda: client.state('snake_tracker') == 'TRACKING', 20.0,
                f'the tracker does not see the face: {client.state("snake_tracker")}')
    client.fresh('object/corners', 5.0, 'the tracker sends no corners')
    # A side of the box that has come into view is told from the face the better the longer
    # it has been seen; teaching and planning average the looks of the last two seconds.
    rested_s = time.monotonic() + REST_S
    client.wait(lambda: time.monotonic() > rested_s, 2.0 * REST_S, 'the clock stands still')


def servo(client: TrialClient, sentence: str, timeout_s: float) -> str:
    """Follow the path; gives how it ended as ``converged: ...`` or ``failed: ...``."""
    client.wait(lambda: len(client.log.plan.home_from_object), 5.0, 'no path came')
    client.event(f'{STARTED}: {sentence}')
    print(client.trigger_patiently('visual_servo/start'), flush=True)
    progress = ProgressLine(len(client.log.plan.home_from_object))
    until_s, news_s, seen = time.monotonic() + timeout_s, time.monotonic(), 0
    while True:
        client.spin_once()
        progress.show(client.log.data.poses)
        state = client.state('visual_servo')
        if len(client.log.data.errors) + len(client.log.data.states) != seen:
            seen = len(client.log.data.errors) + len(client.log.data.states)
            news_s = time.monotonic()
        if _states_since_start(client)[-1:] == ['DONE']:
            return 'converged: the object is at the goal'
        if state.startswith('FAILED') and _states_since_start(client):
            return f'failed: {state}'
        if 'IDLE' in _states_since_start(client)[1:]:
            return 'failed: visual_servo was restarted or stopped in mid-path'
        if time.monotonic() > until_s:
            return f'failed: not at the goal after {timeout_s:.0f} s, last state {state}'
        if time.monotonic() - news_s > STUCK_S:
            return f'failed: nothing new from visual_servo for {STUCK_S:.0f} s, ' \
                   f'last state {state}'


def _states_since_start(client: TrialClient) -> list[str]:
    return [state.partition(':')[0] for _, state in client.log.data.states]


def experiment(client: TrialClient, options: argparse.Namespace) -> None:
    """Run the whole trial; whatever happens, the log holds how it ended."""
    try:
        ending = servo(client, prepare(client, options), options.timeout)
        if ending.startswith('converged'):
            # A stream of commands that has ended is a HOLD, even of an arm at rest.
            client.wait(lambda: client.state('robix_bridge').startswith(('IDLE', 'HOLD')), 5.0,
                        'the arm still moves')
            client.fresh('object/corners', 5.0, 'the tracker sends no corners')
    except TrialError as error:
        ending = f'failed: {error}'
    client.settle()
    client.event(f'{ENDED}: {ending}')


def main(args: Sequence[str] | None = None) -> int:
    """Run the trial and the report."""
    options = parser().parse_args(args)
    if options.poses is not None and options.poses < 2:
        parser().error(f'--poses must be at least 2, got {options.poses}')
    try:
        if options.from_bag:
            return report(trial_from_bag(options.from_bag), options)
        bag = None if options.record is None else begin_bag(
            options.record, options.output, options.keep_free)
    except BagError as error:
        print(error, file=sys.stderr, flush=True)
        return EXIT_CONFIG
    return run(options, bag)


def run(options: argparse.Namespace, bag: Any) -> int:
    """Run the trial, recorded or not, and the report."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    watch = SignalWatch()
    bringup = None
    if options.bringup:
        bringup = Bringup(options.bringup, options.overrides, options.output / 'bringup.log',
                          options.one_process)

    def trouble() -> str | None:
        if watch.stopped.is_set():
            return 'interrupted'
        return bringup.trouble() if bringup else None

    client = TrialClient(trouble)
    recorder = recorder_of(bag) if bag else None
    try:
        experiment(client, options)
    finally:
        if recorder:
            print(recorder.close(), flush=True)
        client.close()
        if bringup:
            bringup.end()
    code = report(client.log, options)
    if code and bringup and bringup.process.returncode in (2, 3):
        return bringup.process.returncode
    return code


def report(log: TrialLog, options: argparse.Namespace) -> int:
    """Write and print the report; gives the exit code."""
    write_report(log.data, options.output, log.camera())
    print_summary(log.data, options.output)
    return EXIT_OK if log.data.converged else EXIT_FAILED


if __name__ == '__main__':
    sys.exit(main())
