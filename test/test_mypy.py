"""The core keeps what its type annotations promise."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.linter
def test_mypy(monkeypatch):
    api = pytest.importorskip('mypy.api', reason='mypy is not installed (pip install mypy)')
    monkeypatch.chdir(ROOT)  # what is checked is named in setup.cfg relative to it
    report, trouble, code = api.run(['--config-file', 'setup.cfg', '--no-error-summary'])
    assert code == 0, report + trouble
