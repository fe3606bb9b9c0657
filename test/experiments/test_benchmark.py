"""The benchmark command lays out and writes what a suite measures."""

import json
import math

from homography_servo.experiments import benchmark
from homography_servo.experiments.benchmarks import pose
import numpy as np
import pytest


@pytest.fixture
def rows(monkeypatch):
    """Replace a suite by known rows."""
    asked = []

    def run(quick, seed):
        asked.append((quick, seed))
        return [{'method': 'homography_servo', 'case': 'a', 'time_us_median': np.float64(1.5)},
                {'method': 'peer', 'case': 'a', 'share': math.nan, 'count': np.int64(3)}]
    monkeypatch.setattr(pose, 'run', run)
    return asked


def test_a_suite_is_printed_and_written(rows, tmp_path, capsys):
    assert benchmark.main(['pose', '--quick', '--seed', '7', '--output', str(tmp_path)]) == 0
    written = json.loads((tmp_path / 'pose.json').read_text())
    assert rows == [(True, 7)]
    assert written['suite'] == 'pose' and written['machine']['cores'] >= 1
    assert written['rows'][0]['time_us_median'] == 1.5
    assert written['rows'][1] == {'method': 'peer', 'case': 'a', 'share': None, 'count': 3}
    assert 'homography_servo' in capsys.readouterr().out
    assert written['complete'] and 'homography_servo' in (tmp_path / 'pose.txt').read_text()


def test_a_suite_that_breaks_off_leaves_what_it_has_measured(monkeypatch, tmp_path):
    def run(quick, seed):
        yield {'method': 'homography_servo', 'case': 'a', 'share': 0.5}
        raise KeyboardInterrupt
    monkeypatch.setattr(pose, 'run', run)
    with pytest.raises(KeyboardInterrupt):
        benchmark.main(['pose', '--output', str(tmp_path)])
    written = json.loads((tmp_path / 'pose.json').read_text())
    assert [row['share'] for row in written['rows']] == [0.5] and not written['complete']


def test_an_unknown_suite_is_refused(capsys):
    with pytest.raises(SystemExit) as ending:
        benchmark.main(['speed'])
    assert ending.value.code == 2 and 'invalid choice' in capsys.readouterr().err
