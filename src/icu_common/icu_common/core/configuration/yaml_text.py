"""A YAML loader whose errors name a line, and whose input is limited before it is parsed.

PyYAML raises errors without a line when it constructs values, takes seconds for a few kB of nested brackets, and reads
the numbers of YAML 1.1: ``5:20`` as 320, ``010`` as 8. Here both are texts, which no numeric field accepts.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import yaml

from icu_common.core.configuration.text_bounds import deepest_line
from icu_common.core.reasons.message import Message, quoted

UNREADABLE = (yaml.YAMLError, RecursionError)
"""Exceptions that :class:`Loader` can raise."""


class RepeatedKey(yaml.composer.ComposerError):
    """A key occurs twice in a mapping: only the last value would count, and the others would be lost."""

    def __init__(self, key: yaml.ScalarNode) -> None:
        super().__init__(None, None, Message("yaml.key_stands_twice", key=quoted(key.value)), key.start_mark)
        self.key = key


class Loader(yaml.SafeLoader):
    """Safe YAML loader; invalid values (a 13th month, a list as a key) and repeated keys are errors with a line.

    Attributes
    ----------
    max_bytes, max_depth, max_nodes
        Maximum size, number of levels, and number of values; an alias counts as the values that it repeats.
    """

    max_bytes, max_depth, max_nodes = 1_000_000, 24, 40_000

    def __init__(self, stream: str) -> None:
        if (size := len(stream.encode("utf-8", "surrogatepass"))) > self.max_bytes:
            raise yaml.YAMLError(Message("yaml.text_bytes_limit", size=size, max_bytes=self.max_bytes))
        if line := deepest_line(stream, self.max_depth):
            mark = yaml.Mark("", 0, line - 1, 0, None, 0)
            raise yaml.composer.ComposerError(
                None, None, Message("yaml.more_open_brackets", max_depth=self.max_depth), mark
            )
        super().__init__(stream)
        self._depth = self._nodes = 0
        self._repeated: dict[str, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event, before = self.peek_event(), self._nodes
        alias = isinstance(event, yaml.AliasEvent)
        self._nodes += self._repeated.get(event.anchor, 1) if alias else 1
        if self._depth >= self.max_depth:
            raise yaml.composer.ComposerError(
                None, None, Message("yaml.more_levels", max_depth=self.max_depth), event.start_mark
            )
        if self._nodes > self.max_nodes:
            raise yaml.composer.ComposerError(
                None, None, Message("yaml.more_values", max_nodes=self.max_nodes), event.start_mark
            )
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if not alias and getattr(event, "anchor", None) is not None:
            self._repeated[event.anchor] = self._nodes - before
        return node

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


def _is_number_of_1_1(tag: str) -> bool:
    return tag in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not _is_number_of_1_1(tag)]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"[-+]?(?:0|[1-9][0-9_]*|0x[0-9a-fA-F_]+)\Z"), list("-+0123456789")
)
Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(
        r"(?:[-+]?(?:(?:[0-9][0-9_]*)\.[0-9_]*(?:[eE][-+][0-9]+)?|\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?"
        r"|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN))\Z"
    ),
    list("-+0123456789."),
)


class ForeignLoader(Loader):
    """Loader for texts from other programs; its limits keep the parsing time below that allowed for a message."""

    max_bytes, max_depth, max_nodes = 64 * 1024, 12, 4_000


def mistake(error: Exception) -> str:
    """Return ``line: what is wrong`` for one of :data:`UNREADABLE`."""
    if isinstance(error, yaml.MarkedYAMLError):
        return f"{error.problem_mark.line + 1 if error.problem_mark else 1}: {error.problem}"
    return f"1: {str(error).partition(chr(10))[0]}"


def values_of_pairs(pairs: Iterable[str]) -> dict[str, Any]:
    """Return the values of KEY=VALUE texts, as they are given on a command line.

    Raises
    ------
    ValueError
        For a text without ``=``, and for a value that is not YAML.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals:
            raise ValueError(Message("yaml.expected_key_value", pair=quoted(pair)))
        try:
            values[name] = yaml.load(value, Loader)
        except UNREADABLE as error:
            raise ValueError(Message("yaml.value_cannot_read", pair=quoted(pair))) from error
        if isinstance(values[name], str) and re.fullmatch(r"[-+]?[\d.]+[eE][-+]?\d+", value):
            values[name] = float(value)  # YAML 1.1 reads 1e6 as a text
    return values
