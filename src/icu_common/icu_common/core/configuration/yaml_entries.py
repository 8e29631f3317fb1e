"""Typed entries of a YAML document with the line of each mapping; every error names file, line and key."""

from __future__ import annotations

from typing import Any

import yaml

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.configuration.yaml_text import Loader
from icu_common.core.reasons.message import Message, quoted

MAX_TEXT = 100
"""Maximum number of characters of a text."""


class LineLoader(Loader):
    """Safe YAML that remembers on which line each mapping starts."""


def _mapping_with_line(loader: LineLoader, node: yaml.MappingNode) -> dict[str, Any]:
    build = loader.construct_object
    mapping: dict[str, Any] = {build(key, deep=True): build(value, deep=True) for key, value in node.value}
    mapping["__line__"] = node.start_mark.line + 1
    return mapping


LineLoader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping_with_line)


class YamlEntries:
    """Reads values from the mappings of a document that :class:`LineLoader` has loaded.

    Parameters
    ----------
    file_name
        Name of the file in errors.
    wrong
        Type of the errors, made of ``file:line: what is wrong``.
    """

    def __init__(self, file_name: str, wrong: type[ValueError] = ValueError) -> None:
        self.file_name, self._wrong = file_name, wrong

    def error(self, entry: dict[str, Any], what: str) -> ValueError:
        """Return the error of an entry, with file and line."""
        return self._wrong(f"{self.file_name}:{entry.get('__line__', 1)}: {plain(what)}")

    def known(self, entry: dict[str, Any], names: set[str]) -> None:
        """Reject a mapping with an unknown key."""
        unknown = set(entry) - names - {"__line__"}
        if unknown:
            raise self.error(
                entry,
                Message(
                    "yaml.unknown_key_known", map=", ".join(sorted(map(str, unknown))), names=", ".join(sorted(names))
                ),
            )

    def entries(self, document: dict[str, Any], key: str) -> list[dict[str, Any]]:
        """Return a list of mappings, empty if the key is missing."""
        value = document.get(key, [])
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise self.error(document, Message("yaml.must_list_mappings", key=key))
        return value

    def text(self, entry: dict[str, Any], key: str, default: str | None = None) -> str:
        """Return a short printable text; without a default it must not be empty."""
        value = entry.get(key, default)
        if not isinstance(value, str) or (default is None and not value):
            raise self.error(entry, Message("yaml.text_needed_quote", key=key, value=quoted(value)))
        if len(value) > MAX_TEXT or not value.isprintable():
            found = Message("yaml.characters", key=key, value=quoted(value[:20]), value_2=len(value))
            raise self.error(entry, Message("yaml.expected_up_printable_characters", found=found, max_text=MAX_TEXT))
        return value

    def choice(self, entry: dict[str, Any], key: str, choices: tuple[str, ...], default: str | None = None) -> str:
        """Return one of several texts."""
        value = self.text(entry, key, default)
        if value not in choices:
            raise self.error(entry, Message("yaml.none", key=key, value=quoted(value), choices=", ".join(choices)))
        return value

    def colour(self, entry: dict[str, Any], key: str, default: str) -> str:
        """Return a colour such as ``#ff8800``; empty only if that is the default."""
        value = self.text(entry, key, default)
        if (value or default) and not (
            len(value) == 7 and value[0] == "#" and all(c in "0123456789abcdefABCDEF" for c in value[1:])
        ):
            raise self.error(entry, Message("yaml.colour_such_ff_8800_needed", key=key, value=quoted(value)))
        return value

    def numbers(self, entry: dict[str, Any], key: str, count: int, *, positive: bool = False) -> tuple[float, ...]:
        """Return a list of ``count`` numbers up to 10000."""
        value = entry.get(key)
        good = isinstance(value, list) and len(value) == count
        if not good or not all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in value or ()):
            raise self.error(entry, Message("yaml.numbers_needed", key=key, value=plain(repr(value), 60), count=count))
        assert isinstance(value, list)
        if any(v != v or abs(v) > 1e4 for v in value) or (positive and min(value) <= 0):
            raise self.error(
                entry,
                Message(
                    "yaml.numbers_up_10000_needed",
                    key=key,
                    value=plain(repr(value), 60),
                    value_2="positive " if positive else "",
                ),
            )
        return tuple(float(v) for v in value)

    def one_number(
        self, entry: dict[str, Any], key: str, default: float | None = None, *, positive: bool = False
    ) -> float:
        """Return one number."""
        return self.numbers({**entry, key: [entry.get(key, default)]}, key, 1, positive=positive)[0]
