"""The message of a service's answer: the English text, and on a second line its code and values as JSON."""

from __future__ import annotations

import json

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.reasons.message import MAX_PACKED, Message, decoded, tree


def answer_text(text: str) -> str:
    """Return the answer of a service; a text without a code is a single line."""
    return f"{text}\n{json.dumps(tree(text), separators=(',', ':'))}" if isinstance(text, Message) else text


def answer_of(received: str) -> str:
    """Return the text of a service's answer, as a message if it has a second line with the code and values.

    Examples
    --------
    >>> answer_of(answer_text(Message("state.named", state="idle"))).code
    'state.named'
    >>> answer_of("enabled")
    'enabled'
    """
    text, _, source = received.partition("\n")
    if not source or len(source) > MAX_PACKED:
        return plain(received)
    try:
        found = decoded(json.loads(source))
    except (ValueError, RecursionError):
        return plain(received)
    return found if isinstance(found, Message) else plain(text)
