"""What every test may ask for."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HAS_ROS = importlib.util.find_spec('rclpy') is not None
if not HAS_ROS:
    collect_ignore_glob = ['nodes/test_*.py', 'launch/test_config.py']


def pytest_report_header() -> str:
    """Say when the tests that need ROS are left out."""
    return '' if HAS_ROS else 'rclpy is not installed: tests of nodes and launch are left out'


@pytest.fixture
def shared_dir() -> Path:
    """Give the folder of shared test data, or skip where it is missing."""
    folder = ROOT.parent / 'shared'
    if not folder.is_dir():
        pytest.skip(f'needs the shared test data in {folder}')
    return folder
