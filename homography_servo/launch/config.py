"""
Read a configuration: ROS parameters of all nodes in one YAML file, checked first.

ROS ignores an unknown node or key in silence, drops a whole file for one wrong
type, and reads ``010`` as 8. Here every mistake of a file is found before any
process starts, with its line. The nodes that a configuration starts are the nodes
that it names.
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import replace
from pathlib import Path
import re
from typing import Any, Callable, Iterable, NamedTuple

from homography_servo.errors import ConfigError
from homography_servo.geometry.camera import load_camera
from homography_servo.launch.registry import NODES
from homography_servo.launch.registry import settings_types
from homography_servo.places import find_config
from homography_servo.result import Rejected
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.yaml_lines import read_values
from homography_servo.settings import defaults_of
from homography_servo.settings import Rule
from homography_servo.settings import rules_of
import yaml

EVERY_NODE = '/**'
PARAMETERS = 'ros__parameters'
_WHOLE = re.compile(r'[-+]?(0|[1-9][0-9_]*)')
_REAL = re.compile(r'[-+]?([0-9]+\.[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+')


class Given(NamedTuple):
    """A parameter that was given, and where."""

    value: Any
    file: str
    line: int


@dataclass(frozen=True)
class Config:
    """The nodes to start, each with the parameters that were given for it."""

    file: str
    nodes: dict[str, dict[str, Given]]

    def only(self, names: Iterable[str]) -> Config:
        """Keep some of the nodes."""
        wanted = list(names)
        missing = [name for name in wanted if name not in self.nodes]
        if missing:
            raise ConfigError(self.file, 0, missing[0], 'this configuration has no such node; '
                              f'it has {", ".join(self.nodes)}')
        return replace(self, nodes={name: self.nodes[name] for name in wanted})

    def including(self, names: Iterable[str]) -> Config:
        """Add nodes that the file does not name, with their defaults."""
        return replace(self, nodes={**self.nodes, **{name: self.nodes.get(name, {})
                                                     for name in names}})

    def values(self, name: str) -> dict[str, Any]:
        """Give the parameters of a node that differ from its defaults or were given."""
        return {key: list(item.value) if isinstance(item.value, tuple) else item.value
                for key, item in self.nodes[name].items()}


def rules_of_node(name: str) -> dict[str, Rule]:
    """Give the rules of all parameters of a node."""
    return {key: rule for kind in settings_types(name) for key, rule in rules_of(kind).items()}


def defaults_of_node(name: str) -> dict[str, Any]:
    """Give the defaults of all parameters of a node."""
    return {key: value for kind in settings_types(name)
            for key, value in defaults_of(kind).items()}


def _scalar(kind: str, node: yaml.Node) -> Any:
    """Read one scalar as the kind of its rule says, or Rejected."""
    if not isinstance(node, yaml.ScalarNode):
        return Rejected('must be a single value')
    word, quoted = node.value, node.style is not None
    if kind == 'text':
        plain = quoted or node.tag == 'tag:yaml.org,2002:str'
        return word if plain else Rejected(f'must be text (put it in quotes), got {word}')
    if quoted:
        return Rejected(f'must be without quotes, got {word!r}')
    if kind == 'flag':
        return {'true': True, 'false': False}.get(
            word, Rejected(f'must be true or false, got {word}'))
    if kind == 'whole':
        return int(word) if _WHOLE.fullmatch(word) else Rejected(
            f'must be a whole number, got {word}')
    return float(word) if _REAL.fullmatch(word) else Rejected(
        f'must be a number with a decimal point (such as 1.0), got {word}')


def _value(rule: Rule, node: yaml.Node) -> Any:
    if rule.kind not in ('reals', 'texts'):
        return _scalar(rule.kind, node)
    if not isinstance(node, yaml.SequenceNode):
        return Rejected('must be a list')
    items = [_scalar(rule.kind[:-1], item) for item in node.value]
    bad = [item for item in items if isinstance(item, Rejected)]
    return bad[0] if bad else tuple(items)


class _Reader:
    """Walks one file and collects every error instead of stopping at the first."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.errors: list[ConfigError] = []

    def error(self, node: yaml.Node, key: str, reason: str) -> None:
        self.errors.append(ConfigError(self.path, node.start_mark.line + 1, key, reason))

    def pairs(self, node: yaml.Node, key: str) -> list[tuple[str, yaml.Node, yaml.Node]]:
        """List the pairs of a mapping; repeated keys are errors."""
        if not isinstance(node, yaml.MappingNode):
            self.error(node, key, 'must hold keys and values')
            return []
        seen: dict[str, tuple[str, yaml.Node, yaml.Node]] = {}
        for key_node, value_node in node.value:
            if key_node.value in seen:
                self.error(key_node, f'{key}.{key_node.value}'.strip('.'), 'given twice')
            else:
                seen[key_node.value] = (key_node.value, key_node, value_node)
        return list(seen.values())

    def read(self) -> dict[str, dict[str, Given]]:
        common: dict[str, Given] = {}
        nodes: dict[str, dict[str, Given]] = {}
        for name, key_node, value_node in self.pairs(read_values(self.path).node, ''):
            if name == EVERY_NODE and nodes:
                self.error(key_node, name, 'must come first: ROS would let it override the nodes')
            elif name == EVERY_NODE:
                common = self.node(name, value_node)
            elif name not in NODES:
                self.error(key_node, name, f'unknown node, expected one of {", ".join(NODES)}')
            else:
                nodes[name] = self.node(name, value_node)
        if not nodes and not self.errors:
            self.errors.append(ConfigError(self.path, 1, '', 'names no node to start'))
        return {name: {**self.shared(name, common), **given} for name, given in nodes.items()}

    def shared(self, name: str, common: dict[str, Given]) -> dict[str, Given]:
        """Pick from the ``/**`` section what a node knows."""
        return {key: item for key, item in common.items() if key in rules_of_node(name)}

    def node(self, name: str, node: yaml.Node) -> dict[str, Given]:
        given: dict[str, Given] = {}
        for section, key_node, value_node in self.pairs(node, name):
            if section != PARAMETERS:
                self.error(key_node, f'{name}.{section}', f'expected {PARAMETERS}')
                continue
            for key, parameter_node, item in self.pairs(value_node, name):
                self.parameter(given, name, key, parameter_node, item)
        return given

    def parameter(self, given: dict[str, Given], name: str, key: str, key_node: yaml.Node,
                  node: yaml.Node) -> None:
        known = _known_rules(name)
        if key not in known:
            return self.error(key_node, f'{name}.{key}', _unknown(name, key, known))
        value = _value(known[key], node)
        problem = value.reason if isinstance(value, Rejected) else known[key].problem(value)
        if problem:
            return self.error(node, f'{name}.{key}', problem)
        given[key] = Given(value, str(self.path), key_node.start_mark.line + 1)
        return None


def _known_rules(name: str) -> dict[str, Rule]:
    if name != EVERY_NODE:
        return {'use_sim_time': Rule('flag', 'use the clock of a simulation'),
                **rules_of_node(name)}
    return {key: rule for node in NODES for key, rule in _known_rules(node).items()}


def _unknown(name: str, key: str, known: dict[str, Rule]) -> str:
    import difflib  # only needed to help after a mistake
    close = difflib.get_close_matches(key, known, 1)
    hint = f'; did you mean {close[0]}?' if close else ''
    return f'unknown parameter{hint} ({name} --help lists them)'


def read_config(name: str | Path) -> tuple[Config | None, list[ConfigError]]:
    """
    Read and check a configuration.

    Parameters
    ----------
    name : str or path
        A path, or the bare name of an installed file such as ``sim.yaml``.

    Returns
    -------
    config, errors
        Every mistake of the file and of the files it names; the configuration is
        None where the file cannot be read at all.

    """
    try:
        path = find_config(name)
        reader = _Reader(path)
        config = Config(str(path), reader.read())
    except FileNotFoundError as error:
        return None, [ConfigError(name, 0, '', str(error))]
    except ConfigError as error:
        return None, [error]
    return config, [*reader.errors, *(_problems_of_files(config) if not reader.errors else ())]


def override(config: Config, words: Iterable[str]) -> Config:
    """
    Apply ``NODE.PARAMETER:=VALUE`` words on top of a configuration.

    Raises
    ------
    ConfigError
        When a word names what does not exist or holds a bad value.

    """
    nodes = {name: dict(given) for name, given in config.nodes.items()}
    for word in words:
        target, separator, text = word.partition(':=')
        node, dot, key = target.partition('.')
        if not (separator and dot) or node not in nodes:
            raise ConfigError('--set', 0, word, 'expected NODE.PARAMETER:=VALUE with a node of '
                              f'the configuration ({", ".join(nodes)})')
        nodes[node][key] = Given(_overriding(node, key, text), '--set', 0)
    return replace(config, nodes=nodes)


def _overriding(node: str, key: str, text: str) -> Any:
    known = _known_rules(node)
    if key not in known:
        raise ConfigError('--set', 0, f'{node}.{key}', _unknown(node, key, known))
    parsed = yaml.compose(text, Loader=yaml.SafeLoader) or yaml.ScalarNode(
        'tag:yaml.org,2002:str', text)
    value = _value(known[key], parsed)
    problem = value.reason if isinstance(value, Rejected) else known[key].problem(value)
    if problem:
        raise ConfigError('--set', 0, f'{node}.{key}', problem)
    return value


_LOADERS: dict[str, Callable[[Path], Any]] = {'robot_file': load_robot, 'camera_file': load_camera}


def _problems_of_files(config: Config) -> list[ConfigError]:
    """Check the robot and camera files, and what the tracker believes about the face."""
    problems, robots = [], {}
    for name in config.nodes:
        values = {**defaults_of_node(name), **config.values(name)}
        for key in set(_LOADERS) & set(values):
            loaded = _loaded(config, name, key, values[key])
            if isinstance(loaded, ConfigError):
                problems.append(loaded)
            elif key == 'robot_file' and loaded is not None:
                robots[name] = loaded
    return problems or [*_different_robots(config, list(robots)), *_disagreements(config, robots)]


def _loaded(config: Config, name: str, key: str, file: str) -> Any:
    if not file:
        return None
    given = config.nodes[name].get(key, Given(file, config.file, 0))
    try:
        return _LOADERS[key](find_config(file))
    except FileNotFoundError as error:
        return ConfigError(given.file, given.line, f'{name}.{key}', str(error))
    except ConfigError as error:
        return error


def _different_robots(config: Config, names: list[str]) -> list[ConfigError]:
    """Compare the robot files; what is simulated may well be another arm than is believed."""
    def given(name: str) -> Given:
        default = defaults_of_node(name)['robot_file']
        return config.nodes[name].get('robot_file', Given(default, config.file, 0))

    first, *others = [name for name in names if name != 'camera_sim'] or ['']
    return [ConfigError(given(name).file, given(name).line, f'{name}.robot_file',
                        f'is {given(name).value}, but {first} works with {given(first).value}')
            for name in others
            if find_config(given(name).value) != find_config(given(first).value)]


def _disagreements(config: Config, robots: dict[str, Any]) -> list[ConfigError]:
    """Compare the face that the tracker follows with the one in the robot file."""
    if 'snake_tracker' not in config.nodes or not robots:
        return []
    robot = next(iter(robots.values()))
    believed = {**defaults_of_node('snake_tracker'), **config.values('snake_tracker')}
    problems = []
    for key, wanted in (('face_size_m', list(robot.face_size_m)),
                        ('box_height_m', robot.box_height_m)):
        value = believed.get(key, wanted)
        value = list(value) if isinstance(value, tuple) else value
        if value != wanted:
            given = config.nodes['snake_tracker'].get(key, Given(value, config.file, 0))
            problems.append(ConfigError(given.file, given.line, f'snake_tracker.{key}',
                                        f'is {value}, but the robot file says {wanted}'))
    return problems


def _origin(given: Given) -> str:
    return f'{given.file}:{given.line}' if given.line else given.file


def shown_config(config: Config) -> str:
    """List the effective value of every parameter, and where it came from."""
    lines = []
    for name, given in config.nodes.items():
        lines.append(f'{name}:')
        for key, default in defaults_of_node(name).items():
            item = given.get(key)
            value = default if item is None else item.value
            source = 'default' if item is None else _origin(item)
            shown = list(value) if isinstance(value, tuple) else value
            lines.append(f'  {key}: {shown!r}  # {source}')
    return '\n'.join(lines)
