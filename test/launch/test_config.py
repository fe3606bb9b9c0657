"""Every mistake in a configuration is found before anything starts, with its line."""

from pathlib import Path

from homography_servo.errors import ConfigError
from homography_servo.launch.bringup import main
from homography_servo.launch.config import defaults_of_node
from homography_servo.launch.config import override
from homography_servo.launch.config import read_config
from homography_servo.launch.config import rules_of_node
from homography_servo.launch.config import shown_config
from homography_servo.launch.registry import CHAIN
from homography_servo.launch.registry import NODES
from homography_servo.launch.registry import programs_of
from homography_servo.launch.registry import settings_types
from homography_servo.settings import rules_of
import pytest
import yaml

CONFIGS = Path(__file__).parents[2] / 'config'


def planner(line: str) -> str:
    """Make a file with one parameter of the planner in line 3."""
    return f'path_planner:\n  ros__parameters:\n    {line}\n'


@pytest.mark.parametrize('text, line, key, said', [
    (planner('poses: 31.0'), 3, 'path_planner.poses', 'must be a whole number'),
    (planner('poses: 010'), 3, 'path_planner.poses', 'must be a whole number'),
    (planner('poses: "31"'), 3, 'path_planner.poses', 'without quotes'),
    (planner('poses: -1'), 3, 'path_planner.poses', r'must be in [0, 2000], got -1'),
    (planner('poses: [31]'), 3, 'path_planner.poses', 'single value'),
    (planner('field_margin_px: 10'), 3, 'path_planner.field_margin_px', 'decimal point'),
    (planner('field_margin_px: .inf'), 3, 'path_planner.field_margin_px', 'decimal point'),
    (planner('field_margin_px: -1.0'), 3, 'path_planner.field_margin_px', 'must be in'),
    (planner('repair: no'), 3, 'path_planner.repair', 'true or false'),
    (planner('robot_file: no'), 3, 'path_planner.robot_file', 'put it in quotes'),
    (planner('robot_file: 7'), 3, 'path_planner.robot_file', 'put it in quotes'),
    (planner('pose: 31'), 3, 'path_planner.pose', 'did you mean poses?'),
    (planner('poses: 31\n    poses: 30'), 4, 'path_planner.poses', 'given twice'),
    (planner('robot_file: none.yaml'), 3, 'path_planner.robot_file', 'no file none.yaml'),
    ('planner:\n  ros__parameters:\n    a: 1\n', 1, 'planner', 'unknown node'),
    ('path_planner:\n  parameters:\n    a: 1\n', 2, 'path_planner.parameters', 'ros__parameters'),
    (planner('poses: 3') + '/**:\n  ros__parameters:\n    poses: 4\n', 4, '/**', 'come first'),
    ('path_planner: 3\n', 1, 'path_planner', 'keys and values'),
    ('[1, 2]\n', 1, '', 'keys and values'),
    ('a: [1\n', 2, '', 'not valid YAML'),
    ('', 0, '', 'empty'),
])
def test_mistakes_are_named_with_line_and_key(tmp_path, text, line, key, said):
    file = tmp_path / 'c.yaml'
    file.write_text(text)
    _, errors = read_config(file)
    error = errors[0]
    assert (error.line, error.key) == (line, key) and said in error.reason
    assert str(error).startswith(f'{file}:{line}: ')


def test_all_mistakes_are_found_at_once(tmp_path):
    file = tmp_path / 'c.yaml'
    file.write_text(planner('poses: x\n    nonsense: 1\n    repair: 1') + 'who:\n  a: 1\n')
    _, errors = read_config(file)
    assert [error.line for error in errors] == [3, 4, 5, 6]


def test_a_broken_robot_file_is_found_through_the_configuration(tmp_path):
    robot = tmp_path / 'robot.yaml'
    robot.write_text((CONFIGS / 'robots' / 'robix_rcs6.yaml').read_text().replace('name:', 'nme:'))
    file = tmp_path / 'c.yaml'
    file.write_text(planner(f'robot_file: {robot}'))
    _, errors = read_config(file)
    assert errors and errors[0].file == str(robot) and errors[0].line > 0


def test_a_tracker_that_believes_in_another_box_is_refused(tmp_path):
    file = tmp_path / 'c.yaml'
    file.write_text(planner('poses: 31') +
                    'snake_tracker:\n  ros__parameters:\n    face_size_m: [0.1, 0.07]\n')
    _, errors = read_config(file)
    assert errors[0].line == 6 and 'the robot file says' in errors[0].reason


@pytest.mark.parametrize('node, refused', [('robix_bridge', True), ('camera_sim', False)])
def test_nodes_that_work_with_different_arms_are_refused(tmp_path, node, refused):
    other, file = tmp_path / 'other.yaml', tmp_path / 'c.yaml'
    other.write_text((CONFIGS / 'robots' / 'robix_rcs6.yaml').read_text())
    file.write_text(planner('poses: 31')
                    + f'{node}:\n  ros__parameters:\n    robot_file: {other}\n')
    _, errors = read_config(file)
    assert [error.line for error in errors] == ([6] if refused else [])
    assert not refused or 'path_planner works with robix_rcs6.yaml' in errors[0].reason


@pytest.mark.parametrize('name', sorted(path.name for path in CONFIGS.glob('*.yaml')))
def test_our_own_files_are_right(name):
    config, errors = read_config(CONFIGS / name)
    assert not errors
    for node in config.nodes:
        for key, value in config.values(node).items():
            held = tuple(value) if isinstance(value, list) else value
            assert rules_of_node(node)[key].problem(held) is None


@pytest.mark.parametrize('name', NODES)
def test_parameter_names_are_unique_within_a_node(name):
    names = [key for kind in settings_types(name) for key in rules_of(kind)]
    assert len(names) == len(set(names))


def test_common_section_reaches_only_those_who_know_the_key(tmp_path):
    file = tmp_path / 'c.yaml'
    file.write_text('/**:\n  ros__parameters:\n    poses: 7\n    use_sim_time: false\n' +
                    planner('repair: true') + 'visual_servo:\n  ros__parameters:\n'
                    '    mode: continuous\n')
    config, errors = read_config(file)
    assert not errors
    assert config.values('path_planner')['poses'] == 7
    assert 'poses' not in config.values('visual_servo')


def test_overrides_win_and_are_checked():
    config, _ = read_config('sim.yaml')
    changed = override(config, ['path_planner.poses:=5', 'camera_sim.noise_grey:=0.5'])
    assert changed.values('path_planner')['poses'] == 5
    assert config.values('path_planner')['poses'] == 31
    for word, said in (('poses:=5', 'NODE.PARAMETER'), ('path_planner.pose:=5', 'did you mean'),
                       ('path_planner.poses:=5.5', 'whole number'), ('who.a:=1', 'NODE.')):
        with pytest.raises(ConfigError, match=said):
            override(config, [word])


def test_effective_values_say_where_they_came_from():
    config, _ = read_config('sim.yaml')
    lines = shown_config(override(config, ['path_planner.seed:=9'])).splitlines()
    assert any(line.startswith('  poses: 31  #') and 'sim.yaml:' in line for line in lines)
    assert '  seed: 9  # --set' in lines
    assert sum(line.startswith('  ') for line in lines) == sum(
        len(defaults_of_node(name)) for name in config.nodes)


def test_bringup_ends_with_2_before_anything_starts(tmp_path, capsys):
    file = tmp_path / 'c.yaml'
    file.write_text(planner('poses: x'))
    assert main(['--config', str(file)]) == 2
    assert f'{file}:3: path_planner.poses: must be' in capsys.readouterr().err
    assert main(['--config', 'missing.yaml']) == 2
    assert 'looked in' in capsys.readouterr().err
    assert main(['--only', 'who', '--config', 'sim.yaml']) == 2
    assert main(['--print-config', '--config', 'sim.yaml']) == 0
    assert yaml.safe_load(capsys.readouterr().out)['path_planner']['poses'] == 31


def test_one_process_takes_the_chain_in_any_order_and_says_what_is_missing(capsys):
    others = ('camera_sim', 'robix_bridge')
    mixed = ['camera_sim', *reversed(CHAIN), 'robix_bridge']
    assert programs_of(mixed, True) == {'servo_chain': CHAIN, **{n: (n,) for n in others}}
    assert programs_of(mixed, False) == {name: (name,) for name in mixed}
    assert main(['--config', 'sim.yaml', '--one-process', '--only', *CHAIN[1:]]) == 2
    assert '--one-process: needs snake_tracker' in capsys.readouterr().err
