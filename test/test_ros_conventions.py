"""What the tools of ROS look for is where they look: package, launch file, names, types."""

import ast
import importlib
import inspect
from pathlib import Path
import re
import runpy
import sys
import types

import pytest

ROOT = Path(__file__).resolve().parents[1]
NAME = 'homography_servo'
# What rosdep calls the Python packages that are imported.
ROSDEP = {'cv2': 'python3-opencv', 'matplotlib': 'python3-matplotlib', 'numpy': 'python3-numpy',
          'scipy': 'python3-scipy', 'serial': 'python3-serial', 'tornado': 'python3-tornado',
          'yaml': 'python3-yaml'}
OPTIONAL = {'rosbags', 'skimage'}


@pytest.fixture(scope='module')
def setup_words():
    """Give what setup.py tells setuptools, without building anything."""
    import setuptools
    told = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(setuptools, 'setup', lambda **words: told.update(words))
        runpy.run_path(str(ROOT / 'setup.py'))
    return told


@pytest.fixture(scope='module')
def manifest():
    """Give package.xml as colcon, rosdep and bloom read it."""
    catkin_pkg = pytest.importorskip('catkin_pkg.package', reason='catkin_pkg is not installed')
    return catkin_pkg.parse_package(ROOT / 'package.xml')


def installed(words) -> set[str]:
    return {f'{folder}/{Path(file).name}' for folder, files in words['data_files']
            for file in files}


def programs(words) -> dict[str, str]:
    return dict(line.split(' = ') for line in words['entry_points']['console_scripts'])


# --- ros2 pkg, ros2 run, colcon, rosdep, bloom -----------------------------------------------

def test_everything_that_tools_look_for_is_installed(setup_words):
    share, files = f'share/{NAME}', installed(setup_words)
    assert {f'share/ament_index/resource_index/packages/{NAME}', f'{share}/package.xml',
            f'{share}/launch/servo.launch.py'} <= files
    config = {str(path.relative_to(ROOT)) for path in (ROOT / 'config').rglob('*')
              if path.is_file()}
    assert config and {f'{share}/{file}' for file in config} <= files


def test_programs_are_installed_where_ros2_run_looks_and_can_be_called(setup_words):
    from configparser import ConfigParser
    setup_cfg = ConfigParser()
    setup_cfg.read(ROOT / 'setup.cfg')
    assert setup_cfg['install']['install_scripts'] == f'$base/lib/{NAME}'
    for program, target in programs(setup_words).items():
        module, _, function = target.partition(':')
        source = ROOT.joinpath(*module.split('.')).with_suffix('.py')
        defined = [node.name for node in ast.parse(source.read_text()).body
                   if isinstance(node, ast.FunctionDef)]
        assert function in defined, program


def test_an_installed_package_has_its_programs_and_files(setup_words):
    index = pytest.importorskip('ament_index_python', reason='ament_index_python is not installed')
    try:
        prefix = Path(index.get_package_prefix(NAME))
    except (index.PackageNotFoundError, OSError):  # the latter outside of any environment
        pytest.skip(f'{NAME} is not installed here (colcon build, then source install/setup.bash)')
    missing = [file for file in installed(setup_words) if not (prefix / file).is_file()]
    assert not missing
    for program in programs(setup_words):
        file = prefix / 'lib' / NAME / program
        assert file.stat().st_mode & 0o111, program


def test_the_manifest_is_complete_enough_to_release(manifest, setup_words):
    warnings: list[str] = []
    manifest.validate(warnings=warnings)
    assert not warnings
    assert manifest.package_format == 3 and manifest.get_build_type() == 'ament_python'
    assert manifest.name == setup_words['name'] == NAME
    assert manifest.version == setup_words['version']
    assert manifest.licenses == [setup_words['license']]
    assert (ROOT / manifest.licenses[0].file).is_file()


def test_the_manifest_names_everything_that_is_imported(manifest):
    names = set()
    for path in (ROOT / NAME).rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module.partition('.')[0])
    foreign = names - set(sys.stdlib_module_names) - OPTIONAL - {NAME}
    declared = {item.name for item in manifest.exec_depends}
    assert {ROSDEP.get(name, name) for name in foreign} <= declared


def test_release_tools_can_tag_the_changelog(manifest):
    tag = pytest.importorskip('catkin_pkg.cli.tag_changelog')
    pytest.importorskip('docutils', reason='docutils is not installed')
    from catkin_pkg.changelog import get_changelog_from_path
    from catkin_pkg.changelog import populate_changelog_from_rst
    file = ROOT / 'CHANGELOG.rst'
    changelog, text = get_changelog_from_path(str(file), NAME), file.read_text()
    waiting = tag.get_forthcoming_label(text)
    if waiting:
        text = tag.rename_section(text, waiting, f'{manifest.version} (2026-01-01)')
        populate_changelog_from_rst(changelog, text)
    found = {version: content for version, _, content in changelog.foreach_version()}
    assert len(list(found[manifest.version][0])) > 3


# --- ros2 topic, ros2 bag: the interfaces as docs/reference.md lists them --------------------

def interfaces():
    """List node, direction, name, type and quality of everything in the reference."""
    node, rows = '', []
    for line in (ROOT / 'docs' / 'reference.md').read_text().splitlines():
        node = line[3:] if line.startswith('## ') else node
        row = re.fullmatch(r'\| (in|out|service) \| `(.+)` \| (\S+) \| (.*) \|', line)
        if row:
            rows.append((node, *row.groups()))
    return rows


def test_names_are_relative_and_well_formed():
    rows = interfaces()
    assert len(rows) > 40
    for node, _, name, _, _ in rows:
        assert re.fullmatch(r'(~/)?[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*', name), (node, name)


def test_types_can_be_resolved_and_sent():
    pytest.importorskip('rclpy', reason='rclpy is not installed')
    from rclpy.type_support import check_for_type_support
    for node, way, name, kind, _ in interfaces():
        package, _, word = kind.partition('/')
        module = importlib.import_module(f'{package}.{"srv" if way == "service" else "msg"}')
        check_for_type_support(getattr(module, word))


def profile(quality):
    """Make the profile that the reference describes."""
    from rclpy.qos import DurabilityPolicy
    from rclpy.qos import QoSProfile
    from rclpy.qos import ReliabilityPolicy
    kind, _, depth = quality.partition(', depth ')
    return QoSProfile(
        depth=int(depth),
        reliability=ReliabilityPolicy.BEST_EFFORT if kind == 'best effort'
        else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kind == 'latched'
        else DurabilityPolicy.VOLATILE)


def test_publishers_and_listeners_of_a_topic_fit_together():
    qos = pytest.importorskip('rclpy.qos', reason='rclpy is not installed')
    ends = {'in': {}, 'out': {}}
    for node, way, name, kind, quality in interfaces():
        if way != 'service':
            topic = name.replace('~', node)
            ends[way].setdefault(topic, []).append((node, kind, quality))
    met = 0
    for topic, listeners in ends['in'].items():
        for talker, sent, offered in ends['out'].get(topic, []):
            for listener, heard, asked in listeners:
                assert sent == heard, (topic, talker, listener)
                fit, why = qos.qos_check_compatible(profile(offered), profile(asked))
                assert fit != qos.QoSCompatibility.ERROR, (topic, talker, listener, why)
                met += 1
    assert met > 15
    # The rest comes from people and other programs.
    alone = {topic for topic in ends['in'] if topic not in ends['out']}
    assert alone == {'goal/corners', 'goal/pose', 'joint_commands'}


# --- ros2 launch ------------------------------------------------------------------------------

class Recorded:
    """Stands for an action or substitution of the launch system; keeps what it was given."""

    def __init__(self, *args, **words):
        self.args, self.words = args, words

    def perform(self, context):
        return context[self.args[0]]


# The arguments that launch_ros.actions.Node takes in Jazzy, its own and those of its bases.
NODE_WORDS = {'executable', 'package', 'name', 'namespace', 'exec_name', 'parameters',
              'remappings', 'ros_arguments', 'arguments', 'condition', 'prefix', 'output',
              'output_format', 'emulate_tty', 'log_cmd', 'cached_output', 'sigterm_timeout',
              'sigkill_timeout', 'on_exit', 'respawn', 'respawn_delay', 'respawn_max_retries',
              'additional_env', 'env', 'cwd', 'shell'}


@pytest.fixture
def launch_file(monkeypatch):
    """Run the launch file with stand-ins for the launch system; give its names."""
    members = {
        'launch': ['LaunchDescription'],
        'launch.actions': ['DeclareLaunchArgument', 'OpaqueFunction', 'SetEnvironmentVariable'],
        'launch.substitutions': ['EnvironmentVariable', 'LaunchConfiguration'],
        'launch_ros': [], 'launch_ros.actions': ['Node']}
    for module, names in members.items():
        made = types.ModuleType(module)
        for name in names:
            setattr(made, name, type(name, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, module, made)
    return runpy.run_path(str(ROOT / NAME / 'launch' / 'servo.launch.py'))


def launched(launch_file, **values):
    """Give the nodes that the launch file starts with these arguments."""
    description = launch_file['generate_launch_description']()
    actions = description.args[0]
    context = {action.args[0]: action.words['default_value'] for action in actions
               if type(action).__name__ == 'DeclareLaunchArgument'}
    assert set(values) <= set(context)
    start = next(action for action in actions if type(action).__name__ == 'OpaqueFunction')
    return start.words['function']({**context, **values})


def test_the_launch_file_declares_its_arguments_with_a_description(launch_file):
    actions = launch_file['generate_launch_description']().args[0]
    declared = {action.args[0]: action.words for action in actions
                if type(action).__name__ == 'DeclareLaunchArgument'}
    assert set(declared) == {'config', 'namespace', 'dashboard', 'use_sim_time', 'log_level'}
    assert all(words['description'] for words in declared.values())


@pytest.mark.parametrize('config', ['sim.yaml', 'real.yaml'])
def test_the_launch_file_starts_what_bringup_starts(config, launch_file, setup_words, tmp_path):
    pytest.importorskip('rclpy', reason='rclpy is not installed')
    yaml = pytest.importorskip('yaml')
    from homography_servo.launch.bringup import children_of
    from homography_servo.launch.config import read_config
    found, errors = read_config(config)
    assert not errors
    children = {child.name: child.command for child in children_of(found, tmp_path, '', 'info')}
    nodes = {node.words['name']: node.words for node in launched(launch_file, config=config)}
    assert set(nodes) == set(children) and set(nodes) <= set(programs(setup_words))
    for name, words in nodes.items():
        assert set(words) <= NODE_WORDS
        assert (words['package'], words['executable']) == (NAME, name)
        parameters, = words['parameters']
        assert parameters.pop('use_sim_time') is False
        file = tmp_path / f'{name}.yaml'
        given = yaml.safe_load(file.read_text())['/**']['ros__parameters'] \
            if file.exists() else {}
        assert parameters == given, name


def test_launch_arguments_reach_the_nodes(launch_file):
    pytest.importorskip('rclpy', reason='rclpy is not installed')
    nodes = launched(launch_file, namespace='cell', use_sim_time='true', dashboard='true',
                     log_level='debug')
    assert 'dashboard' in [node.words['name'] for node in nodes]
    for node in nodes:
        assert node.words['namespace'] == 'cell'
        assert node.words['parameters'][0]['use_sim_time'] is True
        assert node.words['arguments'] == ['--ros-args', '--log-level', 'debug']


def test_a_bad_configuration_ends_the_launch_with_its_line(launch_file, tmp_path):
    pytest.importorskip('rclpy', reason='rclpy is not installed')
    file = tmp_path / 'bad.yaml'
    file.write_text('camera_sim:\n  ros__parameters:\n    rate_hz: -1.0\n')
    with pytest.raises(RuntimeError, match=rf'{re.escape(str(file))}:3: .*rate_hz'):
        launched(launch_file, config=str(file))


def test_node_words_are_those_of_the_launch_system_where_it_is_installed():
    actions = pytest.importorskip('launch_ros.actions', reason='launch_ros is not installed')
    known = set()
    for kind in inspect.getmro(actions.Node):
        known |= set(inspect.signature(kind.__init__).parameters)
    used = {'package', 'executable', 'name', 'namespace', 'output', 'emulate_tty', 'respawn',
            'respawn_delay', 'respawn_max_retries', 'parameters', 'arguments'}
    assert used <= known
