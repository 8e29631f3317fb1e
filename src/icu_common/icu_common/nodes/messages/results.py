"""Results of goals and statuses as messages, and back."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.goals.results import Felt, GoalResult, Outcome
from icu_common.core.reasons.message import MAX_PACKED, MESSAGE, Message, decoded, tree
from icu_common.nodes.messages.heads import MAX_NAME, header

MAX_PAIRS = 100
"""Maximum number of values in a status."""
TEXT = ""
"""Key, among the messages of a status, of the status's own text."""


LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


def diagnostic_status(name: str, level: str, message: str, values: Iterable[tuple[str, Any]]) -> DiagnosticStatus:
    """Return a status; ``level`` is ok, warn or error.

    Codes and values of its message and of its values are one more value, :data:`MESSAGE`.
    """
    found = list(values)
    messages = {key: tree(text) for key, text in ((TEXT, message), *found) if isinstance(text, Message)}
    if messages:
        found.append((MESSAGE, json.dumps(messages, separators=(",", ":"))))
    pairs = [KeyValue(key=key, value=str(value)) for key, value in found]
    return DiagnosticStatus(name=name, level=LEVELS[level], message=message, hardware_id="icu_gantry", values=pairs)


def result_message(result: GoalResult, stamp: int) -> DiagnosticArray:
    """Pack the answer to a goal: one status named ``goal`` with the message ``outcome: reason``, the rest as pairs."""
    level = {Outcome.REJECTED: "warn", Outcome.ABORTED: "error"}.get(result.outcome, "ok")
    text = result.outcome.value + (f": {result.reason}" if result.reason else "")
    values = [
        ("goal_id", result.goal_id),
        ("goal", result.goal),
        ("outcome", result.outcome.value),
        ("reason", result.reason),
        ("error_m", repr(result.error_m)),
        ("duration_s", repr(result.duration_s)),
        *((("code", result.code),) if result.code else ()),
        *((("touch", result.touch.value),) if result.touch is not None else ()),
        *result.details,
    ]
    return DiagnosticArray(header=header(stamp, ""), status=[diagnostic_status("goal", level, text, values)])


def pairs_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the first :data:`MAX_PAIRS` values of a status by key, as texts that are safe to show.

    A value whose code and values the status has under :data:`MESSAGE` is a message.
    """
    values = {plain(pair.key, MAX_NAME): plain(pair.value) for pair in status.values[:MAX_PAIRS]}
    source = next((pair.value for pair in status.values[:MAX_PAIRS] if pair.key == MESSAGE), "")
    return {**values, **{key: text for key, text in _messages(source).items() if key in values}}


def message_of(status: DiagnosticStatus) -> str:
    """Return the text of a status, as a message if it reports the code and the values of it."""
    source = next((pair.value for pair in status.values[:MAX_PAIRS] if pair.key == MESSAGE), "")
    return _messages(source).get(TEXT, plain(status.message))


def _messages(source: str) -> dict[str, str]:
    if not source or len(source) > MAX_PACKED:
        return {}
    try:
        found = json.loads(source)
    except (ValueError, RecursionError):
        return {}
    made = {str(key): decoded(value) for key, value in found.items()} if isinstance(found, dict) else {}
    return {key: value for key, value in made.items() if isinstance(value, Message)}


def result_of_message(message: DiagnosticArray) -> GoalResult:
    """Unpack the answer to a goal.

    Raises
    ------
    ValueError
        If the message is not an answer to a goal.
    """
    if len(message.status) != 1 or message.status[0].name != "goal":
        raise ValueError("not the answer to a goal")
    values = pairs_of(message.status[0])
    known = (MESSAGE, "goal_id", "goal", "outcome", "reason", "error_m", "duration_s", "code", "touch")
    return GoalResult(
        goal_id=values.get("goal_id", ""),
        goal=values.get("goal", ""),
        outcome=Outcome(values.get("outcome", "")),
        reason=values.get("reason", ""),
        error_m=float(values.get("error_m", math.nan)),
        duration_s=float(values.get("duration_s", math.nan)),
        details=tuple((k, v) for k, v in values.items() if k not in known),
        code=values.get("code", ""),
        touch=Felt(values["touch"]) if "touch" in values else None,
    )
