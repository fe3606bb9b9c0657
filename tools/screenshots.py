"""
Make the pictures of dashboard and report in docs/images from a real run of the simulation.

Starts the nodes with the dashboard, lets the servo trial run, and photographs the
dashboard half-way along the path, and a report, wide and narrow.

Example: . tools/enter.sh && python tools/screenshots.py
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import tempfile
import time
from typing import Callable

from browser import Browser
from browser import find_browser

ROOT = Path(__file__).resolve().parents[1]
PATIENCE_S = 120.0


def parser() -> argparse.ArgumentParser:
    """Describe the command line."""
    about = argparse.ArgumentParser(description=__doc__,
                                    formatter_class=argparse.RawDescriptionHelpFormatter)
    about.add_argument('--config', default='sim.yaml', metavar='FILE')
    about.add_argument('--output', default=ROOT / 'docs' / 'images', type=Path, metavar='FOLDER')
    about.add_argument('--report', default=ROOT / 'report', type=Path, metavar='FOLDER',
                       help='of the report to photograph (default report)')
    about.add_argument('--poses', default=15, type=int, metavar='N', help='of the path')
    about.add_argument('--domain', default=87, type=int, help='ROS domain to work in')
    return about


def module(name: str, *words: str, log: Path, domain: int) -> subprocess.Popen:
    """Start a module of the package; its output goes to a file."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1',
                   'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                   'PYTHONPATH': os.pathsep.join([str(ROOT), os.environ.get('PYTHONPATH', '')])}
    with log.open('wb') as out:
        return subprocess.Popen([sys.executable, '-m', f'homography_servo.{name}', *words],
                                stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
                                env=environment, start_new_session=True)


def end(process: subprocess.Popen) -> None:
    """End a process as Ctrl-C does."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()  # its nodes notice
            process.wait()


def wait(condition: Callable, sentence: str):
    """Wait for a condition and give its value."""
    until_s = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        if time.monotonic() > until_s:
            sys.exit(sentence)
        time.sleep(0.1)
    return value


def half_way(browser: Browser) -> bool:
    """Tell whether the servo is in the second half of the path."""
    found = re.search(r'pose (\d+) of (\d+)', browser.text('#target'))
    return bool(found) and 2 * int(found.group(1)) > int(found.group(2))


def photograph(browser: Browser, stem: Path, screens: float = 1.0) -> None:
    """Save the page wide and narrow, so many screens of it."""
    for width, height, mobile in ((1280, 900, False), (390, 844, True)):
        browser.resize(width, round(screens * height), mobile, scale=2.0 if mobile else 1.0)
        browser.run('new Promise((done) => setTimeout(done, 700))')  # until it is drawn anew
        file = stem.with_name(f'{stem.name}_{width}.png')
        browser.screenshot(file, whole=False)
        print(f'wrote {file}')


def main() -> int:
    """Run everything."""
    options = parser().parse_args()
    if find_browser() is None:
        print('no Chromium on this machine (Debian: apt install chromium)', file=sys.stderr)
        return 3
    if not (options.report / 'index.html').is_file():
        print(f'no report in {options.report}; run `make demo` first', file=sys.stderr)
        return 2
    options.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder, domain = Path(name), options.domain
        log = folder / 'bringup.log'
        nodes = module('launch.bringup', '--config', options.config, '--dashboard', '--set',
                       'dashboard.port:=0', log=log, domain=domain)
        trial, browser = None, Browser()
        try:
            url = wait(lambda: re.search(r'http://127\.0\.0\.1:\d+/', log.read_text()),
                       'the dashboard does not start').group()
            browser.open(url)
            trial = module('experiments.servo_trial', '--poses', str(options.poses), '--output',
                           str(folder / 'report'), log=folder / 'trial.log', domain=domain)
            wait(lambda: half_way(browser) or trial.poll() is not None, 'the servo does not move')
            if trial.poll() is not None:
                print((folder / 'trial.log').read_text(), file=sys.stderr)
                return 1
            photograph(browser, options.output / 'dashboard')
            browser.open((options.report / 'index.html').resolve().as_uri())
            photograph(browser, options.output / 'report', screens=1.6)
        finally:
            browser.close()
            for process in filter(None, (trial, nodes)):
                end(process)
    return 0


if __name__ == '__main__':
    sys.exit(main())
