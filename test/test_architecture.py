"""Dependencies point one way, and only the adapters know ROS."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / 'homography_servo'
ROS = {'rclpy', 'launch', 'launch_ros', 'cv_bridge', 'tf2_ros', 'ament_index_python'}
ADAPTERS = ('nodes', 'launch')
GROUND = {'errors', 'result', 'settings', 'places'}
MAY_IMPORT = {
    'geometry': {'geometry'},
    'tracking': {'geometry', 'tracking'},
    'robot': {'geometry', 'robot'},
    'planning': {'geometry', 'robot', 'planning'},
    'simulation': {'geometry', 'robot', 'simulation'},
}
CLOCKS = {'time', 'random', 'datetime'}
# The wire needs a clock and threads: the port, the process that emulates the device.
WITH_CLOCK = {f'robot/{name}.py' for name in (
    'arm', 'arm_thread', 'emulator', 'emulator_main', 'faults', 'link', 'port', 'transport')}
MODULES = sorted(ROOT.rglob('*.py'))
CORE = [path for path in MODULES if path.relative_to(ROOT).parts[0] in MAY_IMPORT]


def imported(path: Path) -> set[str]:
    """List the full names of everything a module imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f'{path}: relative import'
            names.add(node.module)
    return names


def name_of(path: Path) -> str:
    """Name a module in test reports."""
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize('path', MODULES, ids=name_of)
def test_only_adapters_know_ros(path):
    tops = {name.split('.')[0] for name in imported(path)}
    ros = {n for n in tops if n in ROS or n.endswith(('_msgs', '_interfaces', '_srvs'))}
    assert path.relative_to(ROOT).parts[0] in ADAPTERS or not ros


@pytest.mark.parametrize('path', CORE, ids=name_of)
def test_arrows_point_one_way(path):
    part = path.relative_to(ROOT).parts[0]
    own = {name.split('.')[1] for name in imported(path) if name.startswith('homography_servo.')}
    assert own <= GROUND | MAY_IMPORT[part]


@pytest.mark.parametrize('path', CORE, ids=name_of)
def test_core_has_no_clock_and_prints_nothing(path):
    if name_of(path) in WITH_CLOCK:
        pytest.skip('talks to a port, which needs a clock')
    assert not CLOCKS & {name.split('.')[0] for name in imported(path)}
    calls = [node.func.id for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    assert 'print' not in calls


@pytest.mark.parametrize('path', CORE, ids=name_of)
def test_core_has_no_global_state(path):
    tree = ast.walk(ast.parse(path.read_text()))
    assert not [node for node in tree if isinstance(node, ast.Global)]


@pytest.mark.parametrize('path', sorted((ROOT / 'nodes').glob('*.py')), ids=name_of)
def test_no_node_overwrites_what_rclpy_keeps_for_itself(path):
    node = pytest.importorskip('rclpy.node')
    own = ast.parse(Path(node.__file__).read_text())
    kept = {n.attr for n in ast.walk(own) if isinstance(n, ast.Attribute)
            and isinstance(n.ctx, ast.Store) and n.attr.startswith('_')}
    tree = ast.walk(ast.parse(path.read_text()))
    classes = [n for n in tree if isinstance(n, ast.ClassDef)
               and {'Node', 'LifecycleNode'} & {getattr(b, 'id', '') for b in n.bases}]
    used = {n.attr for c in classes for n in ast.walk(c) if isinstance(n, ast.Attribute)
            and isinstance(n.ctx, ast.Store)} | {
                n.name for c in classes for n in c.body if isinstance(n, ast.FunctionDef)}
    assert '_parameters' in kept and not used & kept
