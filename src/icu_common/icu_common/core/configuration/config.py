"""Frozen dataclasses as the one declaration of a setting: type, default, range, unit and description.

A class derived from :class:`Config` validates itself at construction; ``icu_common.nodes.parameters`` turns the same
class into ROS parameters, and the YAML keys in ``config/params`` equal its field names.
"""

from __future__ import annotations

import dataclasses
import sys
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

_KEY = "icu_setting"
GRAPH_TIME, WALL_TIME = "graph", "wall"


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Metadata of one field besides its type and default; :func:`setting` describes ``guards``."""

    description: str
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    choices: tuple[str, ...] = ()
    read_only: bool = False
    clock: str = ""
    guards: str = ""


def setting(
    default: Any,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    unit: str = "",
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    clock: str = "",
    guards: str = "",
) -> Any:
    """Declare one field of a :class:`Config`.

    Parameters
    ----------
    default
        bool, int, float, str, or a tuple of one of these.
    description
        One sentence for people; it becomes the ROS parameter's description.
    minimum, maximum
        Closed bounds; for a tuple they hold for each element.
    unit
        Unit, SI or another, as the description shows it.
    choices
        Allowed strings.
    read_only
        The ROS parameter cannot change while the node runs.
    clock
        For a duration: the clock that measures it. GRAPH_TIME, the default, slows down with the simulation; WALL_TIME
        is for limits that guard people or programs. See docs/decisions/simulated-time.md.
    guards
        For a safety setting: the danger of a weaker value. A safety parameter has a maximum near its purpose and
        changes only while the machine is at rest. See docs/decisions/sources.md.
    """
    info = Setting(
        description=description,
        minimum=minimum,
        maximum=maximum,
        unit=unit,
        choices=choices,
        read_only=read_only,
        clock=clock or (GRAPH_TIME if unit == "s" else ""),
        guards=guards,
    )
    return field(default=default, metadata={_KEY: info})


def nested(config_class: type[Any]) -> Any:
    """Declare a field that holds another :class:`Config`; its parameters get the prefix of field name and dot."""
    return field(default_factory=config_class)


class ConfigError(ValueError):
    """A setting has the wrong type or is outside its bounds; the message names the value and the bound."""


class Config:
    """Base of all configurations: ``@dataclass(frozen=True, slots=True, kw_only=True) class MyConfig(Config)``."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for item in settings_of(type(self), deep=False):
            check(item, getattr(self, item.name))


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfigItem:
    """One field of a configuration: dotted ``name``, python ``kind`` (bool, int, float, str or tuple of one)."""

    name: str
    kind: Any
    default: Any
    setting: Setting


def settings_of(config_class: type[Any], *, deep: bool = True, prefix: str = "") -> Iterator[ConfigItem]:
    """Iterate over the settings of a configuration class, nested ones (``deep``) with dotted names."""
    hints = typing.get_type_hints(config_class)
    for item in dataclasses.fields(config_class):
        kind = hints[item.name]
        if isinstance(kind, type) and issubclass(kind, Config):
            if deep:
                yield from settings_of(kind, prefix=f"{prefix}{item.name}.")
            continue
        info = item.metadata.get(_KEY)
        if info is None:
            raise TypeError(f"{config_class.__name__}.{item.name} is not declared by setting() or nested()")
        yield ConfigItem(name=prefix + item.name, kind=kind, default=item.default, setting=info)


def check(item: ConfigItem, value: Any) -> None:
    """Raise :class:`ConfigError` unless ``value`` has the item's type and is inside its bounds."""
    origin = typing.get_origin(item.kind)
    if origin is tuple:
        element = typing.get_args(item.kind)[0]
        if not isinstance(value, tuple):
            raise ConfigError(f"{item.name} = {value!r}; expected a tuple of {element.__name__}")
        for part in value:
            _check_scalar(item, element, part)
    else:
        _check_scalar(item, item.kind, value)


def _check_scalar(item: ConfigItem, kind: Any, value: Any) -> None:
    info = item.setting
    number = kind in (int, float)
    accepted: Any = (int, float) if kind is float else kind
    if not isinstance(value, accepted) or (number and isinstance(value, bool)):
        raise ConfigError(f"{item.name} = {value!r}; expected {kind.__name__}")
    if number:
        if kind is int and not -(2**63) <= value < 2**63:  # as a ROS parameter
            raise ConfigError(f"{item.name} = {value!r} does not fit into 64 bits")
        if not abs(value) <= sys.float_info.max:
            raise ConfigError(f"{item.name} = {value!r} is not finite")
        if info.minimum is not None and value < info.minimum:
            raise ConfigError(f"{item.name} = {value!r} is below its minimum {info.minimum:g} {info.unit}".rstrip())
        if info.maximum is not None and value > info.maximum:
            raise ConfigError(f"{item.name} = {value!r} is above its maximum {info.maximum:g} {info.unit}".rstrip())
    if info.choices and value not in info.choices:
        raise ConfigError(f"{item.name} = {value!r} is none of {', '.join(info.choices)}")


C = TypeVar("C")


def from_mapping(config_class: type[C], values: Mapping[str, Any]) -> C:
    """Build a configuration from dotted names, for example from YAML; lists become tuples, ints become floats.

    Raises
    ------
    ConfigError
        For unknown names (with the known ones), wrong types and values outside their bounds.
    """
    items = {item.name: item for item in settings_of(config_class)}
    unknown = sorted(set(values) - set(items))
    if unknown:
        raise ConfigError(f"{config_class.__name__} has no setting {', '.join(unknown)}; it has {', '.join(items)}")
    converted = {name: _convert(items[name], value) for name, value in values.items()}
    return _build(config_class, converted, "")


def _convert(item: ConfigItem, value: Any) -> Any:
    if typing.get_origin(item.kind) is tuple and isinstance(value, Iterable) and not isinstance(value, (str, tuple)):
        element = typing.get_args(item.kind)[0]
        return tuple(_as_float(v) if element is float else v for v in value)
    return _as_float(value) if item.kind is float else value


def _as_float(value: Any) -> Any:
    """Return an int as a float, if a float can hold it."""
    return float(value) if type(value) is int and abs(value) <= sys.float_info.max else value


def _build(config_class: type[C], values: Mapping[str, Any], prefix: str) -> C:
    hints = typing.get_type_hints(config_class)
    arguments: dict[str, Any] = {}
    for item in dataclasses.fields(config_class):  # type: ignore[arg-type]
        name, kind = prefix + item.name, hints[item.name]
        if isinstance(kind, type) and issubclass(kind, Config):
            arguments[item.name] = _build(kind, values, name + ".")
        elif name in values:
            arguments[item.name] = values[name]
    return config_class(**arguments)


def to_mapping(config: Any, prefix: str = "") -> dict[str, Any]:
    """Return the dotted names and values of a configuration."""
    result: dict[str, Any] = {}
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if isinstance(value, Config):
            result.update(to_mapping(value, f"{prefix}{item.name}."))
        else:
            result[prefix + item.name] = value
    return result
