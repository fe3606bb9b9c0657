"""Docstrings keep to the style of ROS."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.linter
def test_pep257():
    ament_pep257 = pytest.importorskip('ament_pep257.main')
    arguments = [str(ROOT / folder) for folder in ('homography_servo', 'test')]
    assert ament_pep257.main(argv=arguments) == 0
