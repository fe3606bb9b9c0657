"""What every test may ask for."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HAS_ROS = importlib.util.find_spec('rclpy') is not None
HAS_ROSBAGS = importlib.util.find_spec('rosbags') is not None
collect_ignore_glob = [] if HAS_ROS else ['nodes/test_*.py', 'launch/test_config.py']
collect_ignore_glob += [] if HAS_ROSBAGS else ['experiments/test_bag.py', 'nodes/test_recorder.py']


def pytest_report_header() -> str:
    """Say when tests are left out because what they need is not installed."""
    missing = [] if HAS_ROS else ['rclpy is not installed: tests of nodes and launch are left out']
    missing += [] if HAS_ROSBAGS else ['rosbags is not installed: tests of bags are left out']
    return '; '.join(missing)


@pytest.fixture
def shared_dir() -> Path:
    """Give the folder of shared test data, or skip where it is missing."""
    folder = ROOT.parent / 'shared'
    if not folder.is_dir():
        pytest.skip(f'needs the shared test data in {folder}')
    return folder
