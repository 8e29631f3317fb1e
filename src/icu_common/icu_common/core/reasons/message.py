"""A message for people: a code with its values, which programs decide by, and the English text made of them.

A message is its own English text, so that logs, terminals and messages of ROS take it as it is. The operator page gets
code and values, and makes the sentence in its language.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from numbers import Integral, Real
from typing import Any

from icu_common.core.reasons.catalogue import english

Value = str | int | float
"""A value of a message; a text may be another message."""
MESSAGE = "message"
"""Key of a status value that has the code and the values of its text as JSON."""
MAX_DEPTH = 8
MAX_PACKED = 16_000
"""Maximum depth and characters of a packed message; one beyond them is only shown as its text."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")
_CODE = re.compile(r"[a-z][a-z0-9_]{0,39}\.[a-z0-9_.]{1,79}")


class Message(str):
    """A text that knows its code and its values.

    Parameters
    ----------
    code
        Stable name, ``area.cause``; its sentence has the key ``area-cause`` in each language's file.
    values
        Values of the sentence: numbers, names, or other messages.

    Examples
    --------
    >>> late = Message("test.late", delay_s=0.5)
    >>> late.code, dict(late.values), str(Message("test.because", reason=late))
    ('test.late', {'delay_s': 0.5}, 'test.because reason=test.late delay_s=0.5')
    """

    code: str
    values: Mapping[str, Value]

    def __new__(cls, code: str, /, **values: object) -> Message:
        plain = {name: _plain(value) for name, value in values.items()}
        self = super().__new__(cls, english().sentence(code, plain))
        self.code, self.values = code, plain
        return self

    def __str__(self) -> str:
        """Return the message itself, so that ``str(error)`` keeps the code of an error's message."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _made, (self.code, dict(self.values))


def _made(code: str, values: Mapping[str, Value]) -> Message:
    return Message(code, **values)


def _plain(value: object) -> Value:
    match value:
        case Message():
            return value
        case bool():
            return str(value)
        case Integral():
            return int(value)
        case Real():
            return float(value)
        case _:
            return str(value)


def joined(texts: Iterable[str], code: str = "text.and_also") -> str:
    """Return texts as one message: ``first; second``, or as the sentence of ``code`` joins ``first`` and ``second``.

    Empty texts are left out; without any the result is empty.
    """
    result = ""
    for text in filter(None, texts):
        result = Message(code, first=result, second=text) if result else text
    return result


def parts(text: str) -> Iterator[Message]:
    """Yield a message and the messages among its values; nothing for another text."""
    if isinstance(text, Message):
        yield text
        for value in text.values.values():
            if isinstance(value, str):
                yield from parts(value)


def quoted(text: object) -> str:
    """Return a text in quotation marks: a name with its special characters escaped, or a message as it is."""
    return Message("text.quoted", text=text) if isinstance(text, Message) else repr(text)


def tree(text: str) -> str | dict[str, Any]:
    """Return a message as an object for JSON: its code and values; another text unchanged."""
    if not isinstance(text, Message):
        return text
    return {**_branch(text), "text": str.__str__(text)}


def _branch(message: Message) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, value in message.values.items():
        match value:
            case Message():
                values[name] = _branch(value)
            case str():
                values[name] = value
            case _:
                values[name] = _finite(value)
    return {"code": message.code, "values": values}


def _finite(value: float) -> Value:
    return value if abs(value) < float("inf") else str(value)  # JSON has neither nan nor inf


def encoded(value: Any) -> Any:
    """Return JSON values in which each message is an object of its code, values and text."""
    match value:
        case Message():
            return tree(value)
        case dict():
            return {key: encoded(part) for key, part in value.items()}
        case list() | tuple():
            return [encoded(part) for part in value]
        case _:
            return value


def decoded(value: Any) -> Any:
    """Return the values of :func:`encoded`, with its messages."""
    match value:
        case {"code": str(), "values": dict(), "text": str(text), **more} if not more:
            try:
                return _of_tree(value, 0)
            except ValueError:
                return text
        case dict():
            return {key: decoded(part) for key, part in value.items()}
        case list():
            return [decoded(part) for part in value]
        case _:
            return value


def _of_tree(found: Any, depth: int) -> Message:
    code, values = (found.get("code"), found.get("values")) if isinstance(found, dict) else (None, None)
    if depth > MAX_DEPTH or not isinstance(code, str) or not isinstance(values, dict) or not _CODE.fullmatch(code):
        raise ValueError("no message")
    made: dict[str, Value] = {}
    for name, value in values.items():
        if isinstance(value, bool) or not (isinstance(value, (str, int, float, dict)) and _NAME.fullmatch(name)):
            raise ValueError("no value of a message")
        made[name] = _of_tree(value, depth + 1) if isinstance(value, dict) else value
    message = Message(code, **made)
    if code not in english():  # of another version: its own English is better than the code
        message = str.__new__(Message, str(found.get("text", message)))
        message.code, message.values = code, made
    return message
