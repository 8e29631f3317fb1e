"""YAML whose mistakes all have a line: PyYAML lets errors of what builds its values through, without one."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import yaml

UNREADABLE = (yaml.YAMLError, RecursionError)
"""What reading with :class:`Loader` can raise."""


class RepeatedKey(yaml.composer.ComposerError):
    """A key stands twice in a mapping: the last one would count, and what the others say be missing."""

    def __init__(self, key: yaml.ScalarNode) -> None:
        super().__init__(None, None, f"key {key.value!r} stands twice", key.start_mark)
        self.key = key


class Loader(yaml.SafeLoader):
    """Safe YAML; what cannot be built (a 13th month, a list as a key) or stands twice is an error with its line."""

    def compose_mapping_node(self, anchor: dict[Any, yaml.Node]) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise RepeatedKey(key)
            seen.add(key.value)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, TypeError, AttributeError) as error:
            raise yaml.constructor.ConstructorError(None, None, str(error), node.start_mark) from error


def mistake(error: Exception) -> str:
    """Return ``line: what is wrong`` of one of :data:`UNREADABLE`."""
    if isinstance(error, yaml.MarkedYAMLError):
        return f"{error.problem_mark.line + 1 if error.problem_mark else 1}: {error.problem}"
    return f"1: {str(error).partition(chr(10))[0]}"


def values_of_pairs(pairs: Iterable[str]) -> dict[str, Any]:
    """Return the values of KEY=VALUE texts, as they are given on a command line.

    Raises
    ------
    ValueError
        For a text without ``=``, and for a value that is no YAML.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals:
            raise ValueError(f"{pair!r}: KEY=VALUE is needed")
        try:
            values[name] = yaml.load(value, Loader)
        except UNREADABLE as error:
            raise ValueError(f"{pair!r}: the value cannot be read") from error
        if isinstance(values[name], str) and re.fullmatch(r"[-+]?[\d.]+[eE][-+]?\d+", value):
            values[name] = float(value)  # YAML 1.1 takes 1e6 for a text
    return values
