"""JSON without the extensions of Python's decoder.

Python's decoder accepts NaN, Infinity and 1e999; this one refuses them, as well as repeated keys and deep nesting.
"""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

from icu_common.core.configuration.text_bounds import deepest_line
from icu_common.core.reasons.message import Message, encoded
from scope_ui_bridge.core.wire.refusal import Refusal

MAX_DEPTH = 8
"""Maximum number of open brackets, including those in texts; the rows of a lesson need three."""


def decode_object(text: str | bytes) -> dict[str, Any]:
    """Parse a JSON object strictly: no NaN, no infinity, no repeated key, limited depth."""
    if deepest_line(text if isinstance(text, str) else text.decode("utf-8", "replace"), MAX_DEPTH):
        raise Refusal("malformed", what=Message("yaml.more_open_brackets", max_depth=MAX_DEPTH))
    try:
        value = json.loads(
            text, parse_constant=_no_constant, parse_float=_finite, parse_int=_integer, object_pairs_hook=_unique
        )
    except (ValueError, RecursionError) as error:  # JSONDecodeError and UnicodeDecodeError are ValueErrors
        raise Refusal("malformed", what=str(error)[:120] or type(error).__name__) from error
    if not isinstance(value, dict):
        raise Refusal("malformed", what=Message("json.object_needed_not", name=type(value).__name__))
    return value


def encode(message: dict[str, Any]) -> str:
    """Return JSON; messages become their codes and values, NaN and infinity null, because JSON has neither."""
    return json.dumps(_without_nan(encoded(message)), separators=(",", ":"), allow_nan=False)


def _without_nan(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _without_nan(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(part) for part in value]
    return value


def _no_constant(text: str) -> NoReturn:
    raise ValueError(Message("json.not_json", text=text))


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(Message("json.too_large", text=text))
    return value


def _integer(text: str) -> int:
    if len(text) > 20:
        raise ValueError(Message("json.integer_digits_too_large", text=len(text)))
    return int(text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError(Message("json.key_stands_twice"))
    return value
