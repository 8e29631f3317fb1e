"""ROS parameters from a configuration dataclass: one declaration for type, range, description and YAML key."""

from __future__ import annotations

import typing
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from icu_common.core.configuration.config import Config, ConfigError, ConfigItem, from_mapping, settings_of, to_mapping

C = TypeVar("C", bound=Config)


class LiveParameters(Generic[C]):
    """The parameters of a node as one immutable configuration that is replaced as a whole.

    If the configuration rejects a change, the old one stays in force, and the requester receives the reason.

    Parameters
    ----------
    node
        The node that gets the parameters.
    config_class
        A frozen dataclass derived from :class:`icu_common.core.configuration.config.Config`.
    on_change
        Called with the new configuration after every accepted change.
    check
        Called with a changed configuration before it is accepted; a ConfigError rejects it.
    unrest
        Returns why the machine is not at rest, empty at rest: safety settings change only at rest. Required for a
        configuration with such settings.

    Raises
    ------
    TypeError
        If the configuration has safety settings and there is no ``unrest``.
    ConfigError
        If a parameter file has an unknown key or a value that the configuration rejects.
    """

    def __init__(
        self,
        node: Node,
        config_class: type[C],
        on_change: Callable[[C], None] | None = None,
        check: Callable[[C], None] | None = None,
        unrest: Callable[[], str] | None = None,
    ) -> None:
        self._config_class = config_class
        self._on_change, self._check, self._unrest = on_change, check, unrest
        self._guards = {i.name for i in settings_of(config_class) if i.setting.guards and not i.setting.read_only}
        if self._guards and unrest is None:
            raise TypeError(f"{config_class.__name__} has safety settings: unrest is required")
        items = {item.name: item for item in settings_of(config_class)}
        _refuse_unknown(node, items)
        values: dict[str, Any] = {}
        for name, item in items.items():
            parameter = node.declare_parameter(name, _ros_value(item.default), _descriptor(item))
            values[name] = parameter.value
        self._config = from_mapping(config_class, values)
        self._pending = self._config
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._after_set)

    @property
    def config(self) -> C:
        """The configuration in force."""
        return self._config

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        values = to_mapping(self._config)
        mine = {p.name: p.value for p in parameters if p.name in values}
        try:
            self._check_guards({name for name, value in mine.items() if value != values[name]})
            pending = from_mapping(self._config_class, {**values, **mine})
            if self._check is not None and pending != self._config:
                self._check(pending)
        except (ConfigError, TypeError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._pending = pending
        return SetParametersResult(successful=True)

    def _check_guards(self, changed: set[str]) -> None:
        guards = sorted(changed & self._guards)
        if guards and self._unrest is not None and (reason := self._unrest()):
            raise ConfigError(f"{', '.join(guards)} can change only while the machine is at rest: {reason}")

    def _after_set(self, parameters: list[Parameter]) -> None:
        if self._pending != self._config:
            self._config = self._pending
            if self._on_change is not None:
                self._on_change(self._config)


def _refuse_unknown(node: Node, items: dict[str, ConfigItem]) -> None:
    # Overrides come from parameter file and command line; without this check a misspelt key would be silently ignored.
    given = set(node._parameter_overrides)
    allowed = set(items) | {"use_sim_time", "start_type_description_service"}
    unknown = sorted(name for name in given - allowed if not name.startswith("qos_overrides."))
    if unknown:
        raise ConfigError(f"{node.get_name()} has no parameter {', '.join(unknown)}; it has {', '.join(sorted(items))}")


def _ros_value(default: Any) -> Any:
    return list(default) if isinstance(default, tuple) else default


def _descriptor(item: ConfigItem) -> ParameterDescriptor:
    info = item.setting
    unit = f" [{info.unit}]" if info.unit else ""
    descriptor = ParameterDescriptor(description=info.description + unit, read_only=info.read_only)
    if info.choices:
        descriptor.additional_constraints = "one of " + ", ".join(info.choices)
    kind = typing.get_args(item.kind)[0] if typing.get_origin(item.kind) is tuple else item.kind
    low, high = info.minimum, info.maximum
    if (low is None and high is None) or kind not in (int, float):
        return descriptor
    if kind is float:
        bounds = FloatingPointRange(
            from_value=float(low) if low is not None else -1.7e308,
            to_value=float(high) if high is not None else 1.7e308,
        )
        descriptor.floating_point_range = [bounds]
    else:
        descriptor.integer_range = [
            IntegerRange(
                from_value=int(low) if low is not None else -(2**63),
                to_value=int(high) if high is not None else 2**63 - 1,
            )
        ]
    return descriptor
