"""Configuration files are found by path and by name."""

from homography_servo.errors import ConfigError
from homography_servo.places import find_config
from homography_servo.places import load_named
import pytest


def test_bare_names_are_found_wherever_one_stands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_config('sim.yaml').is_file()
    assert find_config('robix_rcs6.yaml').parent.name == 'robots'


def test_a_file_beside_another_wins(tmp_path):
    (tmp_path / 'sim.yaml').write_text('mine')
    assert find_config('sim.yaml', beside=tmp_path / 'other.yaml').read_text() == 'mine'


def test_a_missing_file_says_where_it_was_looked_for(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match=str(tmp_path)):
        find_config('no_such_file.yaml')
    with pytest.raises(FileNotFoundError, match='no file /nowhere/a.yaml; looked in /nowhere'):
        find_config('/nowhere/a.yaml')


def test_installed_files_are_found_by_the_ament_prefix(tmp_path, monkeypatch):
    folder = tmp_path / 'share' / 'homography_servo' / 'config'
    folder.mkdir(parents=True)
    (folder / 'only_here.yaml').write_text('x')
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    assert find_config('only_here.yaml') == folder / 'only_here.yaml'


def test_a_file_that_a_parameter_names_is_loaded_or_the_parameter_blamed():
    assert load_named(lambda path: path.name, 'sim.yaml', 'a_node', 'a_file') == 'sim.yaml'
    with pytest.raises(ConfigError, match='^a_node:0: a_file: no file nowhere.yaml; looked in'):
        load_named(str, 'nowhere.yaml', 'a_node', 'a_file')
