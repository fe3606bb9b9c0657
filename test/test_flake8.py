"""The code keeps to the style of ROS."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.linter
def test_flake8():
    ament_flake8 = pytest.importorskip('ament_flake8.main')
    count, errors = ament_flake8.main_with_errors(
        argv=[str(ROOT / folder) for folder in ('homography_servo', 'test', 'setup.py')])
    assert count == 0, '\n'.join(errors)
