"""The files in config/params as the nodes read them: dotted names and their values."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import yaml

CONFIG = Path(__file__).resolve().parents[2] / "config"


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in values.items():
        result |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return result


def file_values(path: Path) -> dict[str, dict[str, Any]]:
    """Return the values for each node, or pattern of nodes, that the file names."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {node: _flat(entry["ros__parameters"]) for node, entry in document.items()}


@functools.cache
def _of_every_node(name: str) -> dict[str, Any]:
    return file_values(CONFIG / "params" / f"{name}.yaml")["/**"]


def parameters(name: str, part: str = "") -> dict[str, Any]:
    """Return the values in the file of a node; with ``part`` those below it, without its name."""
    values = _of_every_node(name)
    start = f"{part}." if part else ""
    return {key.removeprefix(start): value for key, value in values.items() if key.startswith(start)}
