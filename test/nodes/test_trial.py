"""The whole loop in simulation, and what becomes of it when a part of it dies."""

import json
import math
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

import pytest

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 120.0
NODES = ('camera_sim', 'snake_tracker', 'path_planner', 'visual_servo', 'robix_bridge')
LIMITS = {'lateral_m': 1.5e-3, 'depth_m': 3e-3, 'gamma_rad': math.radians(1.0),
          'tilt_rad': math.radians(3.0)}


def numbers_without_clock(numbers: dict) -> dict:
    """Keep what does not depend on when a message was taken, which two readers see apart."""
    keys = ('verdict', 'converged', 'plan', 'planned_joints_rad', 'planned_corners_px', 'looks')
    poses = [(pose['index'], pose['iterations'], pose['reached'], pose['position_error_m'],
              pose['rotation_error_rad']) for pose in numbers['poses']]
    return {**{key: numbers[key] for key in keys}, 'poses': poses,
            'final': {k: round(v, 4) for k, v in numbers['final_true_error'].items()}}


class Trial:
    """A trial as a process in a ROS domain of its own."""

    def __init__(self, folder: Path, domain: int, *words: str) -> None:
        self.folder = folder
        self.lines: list[str] = []
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
                       'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                       'ROS_PYTHON_CHECK_FIELDS': '1'}
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'homography_servo.experiments.servo_trial', '--bringup',
             'sim.yaml', '--output', str(folder), *words], cwd=ROOT, env=environment,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            start_new_session=True)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    @property
    def output(self) -> str:
        """Give everything printed so far, and what the nodes said."""
        log = self.folder / 'bringup.log'
        return '\n'.join([*self.lines, log.read_text() if log.is_file() else ''])

    def wait_for(self, text: str) -> None:
        """Wait until a line holds a text."""
        until_s = time.monotonic() + PATIENCE_S
        while not any(text in line for line in self.lines):
            assert self.process.poll() is None and time.monotonic() < until_s, self.output
            time.sleep(0.02)

    def wait(self) -> int:
        """Wait for the end and give the exit code."""
        code = self.process.wait(PATIENCE_S)
        self._reader.join(5.0)
        return code

    def numbers(self) -> dict:
        """Read the numbers of the report."""
        return json.loads((self.folder / 'trial.json').read_text())

    def numbers_from_bag(self) -> dict:
        """Make the report once more from the recording alone, and read its numbers."""
        again = self.folder / 'again'
        subprocess.run([sys.executable, '-m', 'homography_servo.experiments.servo_trial',
                        '--from-bag', str(self.folder / 'bag'), '--output', str(again)],
                       cwd=ROOT, check=True, timeout=PATIENCE_S, stdout=subprocess.DEVNULL)
        return numbers_without_clock(json.loads((again / 'trial.json').read_text()))

    def node_pids(self, programs: tuple[str, ...] = NODES) -> dict[str, int]:
        """Find the nodes that this trial has started, by their parent's parent."""
        children = _children_of(self.process.pid)
        launched = [pid for child in children for pid in _children_of(child)]
        return {name: pid for pid in launched for name in programs
                if f'homography_servo.nodes\0{name}\0' in _command(pid)}


def _command(pid: int) -> str:
    try:
        return Path(f'/proc/{pid}/cmdline').read_text()
    except OSError:
        return ''


def _children_of(parent: int) -> list[int]:
    found = []
    for entry in Path('/proc').glob('[0-9]*/stat'):
        try:
            if int(entry.read_text().rpartition(')')[2].split()[1]) == parent:
                found.append(int(entry.parent.name))
        except OSError:
            pass
    return found


def alive(pid: int) -> bool:
    """Tell whether a process is there and not only waiting to be collected."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


@pytest.fixture
def start_trial(tmp_path, domain):
    """Give a function that starts a trial; nothing is left of it afterwards."""
    started = []

    def start(*words: str) -> Trial:
        started.append(Trial(tmp_path / 'report', domain, *words))
        return started[-1]

    yield start
    for trial in started:
        if trial.process.poll() is None:
            os.killpg(trial.process.pid, signal.SIGKILL)
            trial.process.wait()


def test_a_trial_in_continuous_mode_with_the_chain_in_one_process(start_trial):
    trial = start_trial('--poses', '7', '--one-process', '--set', 'visual_servo.mode:=continuous')
    trial.wait_for('on the way')
    running = trial.node_pids((*NODES, 'servo_chain'))
    assert set(running) == {'camera_sim', 'servo_chain', 'robix_bridge'}
    assert trial.wait() == 0, trial.output
    numbers = trial.numbers()
    assert numbers['converged'] and len(numbers['poses']) == 7
    for key, limit in LIMITS.items():
        assert numbers['final_true_error'][key] <= limit, numbers['final_true_error']


def test_a_short_trial_reaches_every_pose_and_the_goal(start_trial):
    trial = start_trial('--poses', '7', '--record')
    assert trial.wait() == 0, trial.output
    numbers = trial.numbers()
    assert trial.numbers_from_bag() == numbers_without_clock(numbers)
    assert numbers['converged'] and len(numbers['poses']) == 7
    assert all(pose['reached'] for pose in numbers['poses'])
    for key, limit in LIMITS.items():
        assert numbers['final_true_error'][key] < limit, key
    assert 'The trial converged' in trial.lines[-1]
    assert any('pose' in line and 'of 7' in line and 'left' in line for line in trial.lines)
    page = (trial.folder / 'index.html').read_text()
    assert all((trial.folder / name).stat().st_size > 1000
               for name in ('figure_2_paths.png', 'figure_3_joints.png'))
    assert 'The trial converged' in page
    assert 'Traceback' not in trial.output


@pytest.mark.parametrize('name', NODES)
def test_killing_a_node_ends_in_a_restart_that_works_or_a_sentence(name, start_trial):
    trial = start_trial('--poses', '11', '--timeout', '60')
    trial.wait_for('pose  3 of 11')
    pids = trial.node_pids()
    assert set(pids) == set(NODES)
    os.kill(pids[name], signal.SIGKILL)
    code = trial.wait()
    assert code in (0, 1)
    assert f'{name} was ended by SIGKILL; restarting' in trial.output
    last = trial.lines[-1]
    assert last.startswith('The trial converged' if code == 0 else 'The trial did not converge: ')
    assert not any(alive(pid) for pid in pids.values())


def test_two_interrupts_leave_nothing_running(start_trial):
    trial = start_trial()
    trial.wait_for('pose  2 of 31')
    pids = trial.node_pids()
    trial.process.send_signal(signal.SIGINT)
    trial.process.send_signal(signal.SIGINT)
    assert trial.wait() == 1
    assert 'interrupted' in trial.lines[-1]
    assert len(pids) == len(NODES) and not any(alive(pid) for pid in pids.values())


def test_a_missing_port_ends_with_3_and_what_to_do(start_trial):
    trial = start_trial('--set', 'robix_bridge.port:=/dev/no_such_port')
    assert trial.wait() == 3
    assert '/dev/no_such_port' in trial.output
