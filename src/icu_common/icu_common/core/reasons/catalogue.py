"""The English sentences of all messages, from the Fluent file ``messages/en.ftl``, which the operator page reads too.

Programs use this part of Fluent: values (``{ $name }``), the functions FIXED and SHORT, quoted text, and variants by a
number or a word, one to a line. Tests compare the results with Fluent's own Python runtime; why the programs do without
it is in docs/decisions/messages.md.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping
from importlib import resources

Part = Callable[[Mapping[str, object]], str]
_ENTRY = re.compile(r"^([a-zA-Z][\w-]*) = *(.*(?:\n(?:[ }].*)?)*)", re.MULTILINE)
_HOLE = re.compile(
    r"""\{\ *(?:
        \$(?P<value>\w+)
        |(?P<function>FIXED|SHORT)\(\$(?P<number>\w+)(?:,\ digits:\ (?P<digits>\d+))?(?P<sign>,\ sign:\ 1)?\)
        |"(?P<quoted>(?:[^"\\]|\\.)*)"
        |\$(?P<chosen>\w+)\ ->\n(?P<variants>(?:\ +\*?\[\w+\]\ .*\n)+)
    )\ *\}""",
    re.VERBOSE,
)
_VARIANT = re.compile(r"(\*?)\[(\w+)\] (.*)")


def key_of(code: str) -> str:
    """Return the key of a code's sentence: Fluent reserves the dot."""
    return code.replace(".", "-")


class Catalogue:
    """Sentences by their codes; each is parsed when it is first used.

    Parameters
    ----------
    text
        A Fluent file.
    """

    def __init__(self, text: str) -> None:
        self._sources = {key: source.rstrip() for key, source in _ENTRY.findall(text)}
        self._parsed: dict[str, list[Part]] = {}

    def __contains__(self, code: str) -> bool:
        return key_of(code) in self._sources

    def sentence(self, code: str, values: Mapping[str, object]) -> str:
        """Return the sentence of a code; without one, the code with its values, because a reason must not be lost.

        Examples
        --------
        >>> lines = Catalogue("drive-late = { FIXED($delay_s, digits: 1) } s late")
        >>> lines.sentence("drive.late", {"delay_s": 0.25}), lines.sentence("drive.early", {"delay_s": 0.25})
        ('0.2 s late', 'drive.early delay_s=0.25')
        """
        key = key_of(code)
        parts = self._parsed.get(key)
        if parts is None:
            if key not in self._sources:
                return " ".join([code, *(f"{name}={value}" for name, value in values.items())])
            parts = self._parsed[key] = list(_parts(self._sources[key]))
        return "".join(part(values) for part in parts)


@functools.cache
def english() -> Catalogue:
    """Return the English catalogue."""
    return Catalogue((resources.files("icu_common") / "messages" / "en.ftl").read_text(encoding="utf-8"))


def _parts(source: str) -> list[Part]:
    parts: list[Part] = []
    end = 0
    for hole in _HOLE.finditer(source):
        parts += [_constant(source[end : hole.start()]), _part(hole)]
        end = hole.end()
    return [*parts, _constant(source[end:])]


def _constant(text: str) -> Part:
    return lambda values: text


def _part(hole: re.Match[str]) -> Part:
    name = hole["value"] or hole["number"] or hole["chosen"]
    if hole["value"]:
        return lambda values: str(values.get(name, ""))
    if hole["function"]:
        layout = ("+" if hole["sign"] else "") + (f".{hole['digits']}f" if hole["digits"] else "g")
        return lambda values: _number(values.get(name, ""), layout)
    if hole["quoted"] is not None:
        return _constant(re.sub(r"\\(.)", r"\1", hole["quoted"]))
    variants = {key: _parts(text) for _, key, text in _VARIANT.findall(hole["variants"])}
    otherwise = next(key for star, key, _ in _VARIANT.findall(hole["variants"]) if star)

    def chosen(values: Mapping[str, object]) -> str:
        value = values.get(name, "")
        key = "one" if value == 1 and "one" in variants else str(value)
        return "".join(part(values) for part in variants.get(key, variants[otherwise]))

    return chosen


def _number(value: object, layout: str) -> str:
    return format(value, layout) if isinstance(value, (int, float)) else str(value)
