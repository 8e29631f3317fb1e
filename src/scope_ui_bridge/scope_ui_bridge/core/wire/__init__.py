"""Messages between page and bridge.

Enters: the text of a page, which may be anything. Leaves: one of the typed ``requests``, or a ``refusal`` with a code
for the page's sentence. ``decoding`` reads a text by its ``fields``; ``strict_json`` reads and writes JSON.
"""

from scope_ui_bridge.core.wire.decoding import MAX_BYTES, MAX_STOP, decode, seq_of
from scope_ui_bridge.core.wire.fields import MAX_TEXT
from scope_ui_bridge.core.wire.refusal import Refusal
from scope_ui_bridge.core.wire.requests import (
    CAMERAS,
    LEASE_STEPS,
    SERVICES,
    Act,
    Alive,
    Blind,
    Call,
    Hidden,
    Hold,
    Jog,
    Lease,
    MoveTo,
    PageMessage,
    PointedControl,
    RunSequence,
    Select,
    StopAll,
    Teach,
)
from scope_ui_bridge.core.wire.strict_json import decode_object, encode

__all__ = [
    "CAMERAS",
    "LEASE_STEPS",
    "MAX_BYTES",
    "MAX_STOP",
    "MAX_TEXT",
    "SERVICES",
    "Act",
    "Alive",
    "Blind",
    "Call",
    "Hidden",
    "Hold",
    "Jog",
    "Lease",
    "MoveTo",
    "PageMessage",
    "PointedControl",
    "Refusal",
    "RunSequence",
    "Select",
    "StopAll",
    "Teach",
    "decode",
    "decode_object",
    "encode",
    "seq_of",
]
