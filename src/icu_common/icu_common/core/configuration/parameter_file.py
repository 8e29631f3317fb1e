"""ROS parameter files for programs that are not nodes: the values of a node by dotted names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from icu_common.core.configuration.config import ConfigError
from icu_common.core.configuration.yaml_text import UNREADABLE, Loader, mistake


def values_for(node: str, path: Path) -> dict[str, Any]:
    """Return a node's values in a parameter file for this node alone or for several nodes.

    A part applies by the node's own name or a wildcard, in any namespace.

    Raises
    ------
    ConfigError
        If it cannot be read, or has no values for the node.
    OSError
    """
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), Loader)
    except UNREADABLE as error:
        raise ConfigError(f"{path}:{mistake(error)}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: {error}") from error
    try:
        names = [name for name in document if len(document) == 1 or name.rpartition("/")[2] in (node, "*", "**")]
        entries = [_flat(document[name]["ros__parameters"]) for name in names]
    except (AttributeError, KeyError, TypeError):
        entries = []
    if not entries:
        raise ConfigError(f"{path}; expected ros__parameters for {node}")
    return {name: value for entry in entries for name, value in entry.items()}


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, value in values.items():
        result.update(_flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value})
    return result
