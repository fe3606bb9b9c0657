"""The example on the page about the mathematics runs, and its names exist."""

import importlib
from pathlib import Path
import re

import pytest

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'mathematics.md'


@pytest.fixture(scope='module')
def page():
    if not PAGE.is_file():
        pytest.skip(f'needs {PAGE}')
    return PAGE.read_text(encoding='utf-8')


def test_the_example_runs(page, capsys):
    example = re.search(r'```python\n(.*?)```', page, re.DOTALL).group(1)
    names = {}
    exec(compile(example, str(PAGE), 'exec'), names)
    assert names['poses'].shape == (31, 4, 4)
    assert len(names['estimate'].candidates) == 2
    assert capsys.readouterr().out


def test_every_function_in_the_table_exists(page):
    table = re.findall(r'^\|.*?\|(.*?)\|', page, re.MULTILINE)
    named = re.findall(r'`(\w+)\.(\w+)`', ' '.join(table))
    assert len(named) > 8
    for module, name in named:
        if module == 'Camera':
            module, name = 'camera', 'Camera'
        found = importlib.import_module(f'homography_servo.geometry.{module}')
        assert hasattr(found, name), f'{module}.{name}'
