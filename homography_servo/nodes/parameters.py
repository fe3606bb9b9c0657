"""Settings classes as ROS parameters: declared, checked, and changed as a whole."""

from __future__ import annotations

from dataclasses import fields
from dataclasses import replace
from typing import Any, Callable, TypeVar

from homography_servo.errors import ConfigError
from homography_servo.settings import Rule
from homography_servo.settings import Settings
from rcl_interfaces.msg import FloatingPointRange
from rcl_interfaces.msg import IntegerRange
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

_LIST_TYPES = {'reals': Parameter.Type.DOUBLE_ARRAY, 'texts': Parameter.Type.STRING_ARRAY}
_ALWAYS_KNOWN = ('use_sim_time', 'start_type_description_service')
SettingsT = TypeVar('SettingsT', bound=Settings)


def _descriptor(rule: Rule) -> ParameterDescriptor:
    text = ParameterDescriptor(description=rule.description, read_only=rule.read_only)
    if rule.choices:
        text.additional_constraints = f'one of {", ".join(rule.choices)}'
    if rule.kind == 'real':
        text.floating_point_range = [
            FloatingPointRange(from_value=float(rule.low), to_value=float(rule.high))]
    if rule.kind == 'whole':
        text.integer_range = [
            IntegerRange(from_value=int(rule.low), to_value=int(rule.high), step=1)]
    return text


def _to_ros(rule: Rule, value: Any) -> Any:
    if rule.kind not in _LIST_TYPES:
        return value
    return list(value) or _LIST_TYPES[rule.kind]  # rclpy takes [] for bytes: declare unset


def _from_ros(rule: Rule, value: Any) -> Any:
    return tuple(value or ()) if rule.kind in _LIST_TYPES else value


class Parameters:
    """
    The parameters of a node, held as frozen settings.

    ``parameters[SnakeSettings]`` is the instance in force. A change that breaks a
    rule is refused with a sentence; one that is accepted replaces the instances and
    then calls what was given to `on_change`.
    """

    def __init__(self, node: Node, *settings_types: type[Settings]) -> None:
        self._rules = {item.name: (kind, item.metadata['rule'])
                       for kind in settings_types for item in fields(kind)}
        self._hooks: list[Callable[[], None]] = []
        self._refuse_unknown(node)
        self._current = {kind: self._declare(node, kind) for kind in settings_types}
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def __getitem__(self, kind: type[SettingsT]) -> SettingsT:
        return self._current[kind]

    def on_change(self, hook: Callable[[], None]) -> None:
        """Call a function after every accepted change."""
        self._hooks.append(hook)

    def _refuse_unknown(self, node: Node) -> None:
        given = getattr(node, '_parameter_overrides', {})
        for name in given:
            if name not in self._rules and name not in _ALWAYS_KNOWN \
                    and not name.startswith('qos_overrides.'):
                raise ConfigError(node.get_name(), 0, name, 'no such parameter; --help lists them')

    def _declare(self, node: Node, kind: type[Settings]) -> Settings:
        values = {}
        for item in fields(kind):
            rule = item.metadata['rule']
            parameter = node.declare_parameter(
                item.name, _to_ros(rule, item.default), _descriptor(rule))
            values[item.name] = _from_ros(rule, parameter.value)
        try:
            return kind(**values)
        except ValueError as error:
            raise ConfigError(node.get_name(), 0, '', str(error)) from error

    def _changed(self, parameters) -> dict[type[Settings], Settings]:
        news: dict[type[Settings], dict[str, Any]] = {}
        for parameter in parameters:
            if parameter.name in self._rules:
                kind, rule = self._rules[parameter.name]
                value = _from_ros(rule, parameter.value)
                news.setdefault(kind, {})[parameter.name] = value
        return {kind: replace(self._current[kind], **values) for kind, values in news.items()}

    def _check(self, parameters) -> SetParametersResult:
        try:
            self._changed(parameters)
        except (ValueError, TypeError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters) -> None:
        changed = self._changed(parameters)
        self._current.update(changed)
        for hook in self._hooks if changed else ():
            hook()
