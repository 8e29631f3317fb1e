"""The texts of the state topics: a state's name, which is a code, and a reason for people.

This is the only module that takes such a text apart. Programs decide by the name; the reason is only shown.
"""

from __future__ import annotations

from icu_common.core.reasons.message import Message


def state_name(text: str) -> str:
    """Return the name of a published state.

    Examples
    --------
    >>> state_name("stopped: stop requested"), state_name("calibrating 3/12, 9 s left"), state_name("idle")
    ('stopped', 'calibrating', 'idle')
    """
    return split_state(text)[0]


def because(state: str, reason: str) -> str:
    """Return the text of a state with its reason, or the state alone if there is none.

    Examples
    --------
    >>> because("stopped", "stop requested"), because("idle", "")
    ('stopped: stop requested', 'idle')
    """
    return Message("state.because", state=state, reason=reason) if reason else state


def as_message(text: str) -> str:
    """Return the text of a state as a message, for a sentence that contains it."""
    if isinstance(text, Message):
        return text
    name, reason = split_state(text)
    for message in (because(name, reason), Message("state.named", state=name)):
        if message == text:
            return message
    return text


def split_state(text: str) -> tuple[str, str]:
    """Return the name of a published state and the rest of its text: its reason, or its progress.

    Examples
    --------
    >>> split_state("stopped: stop requested")
    ('stopped', 'stop requested')
    >>> split_state("calibrating 3/12, 9 s left (waiting: still)")
    ('calibrating', '3/12, 9 s left (waiting: still)')
    >>> split_state("step 2/3: press:RUN_STOP")
    ('step', 'press:RUN_STOP')
    """
    if isinstance(text, Message) and isinstance(told := text.values.get("reason"), str):
        return state_name(str.__str__(text)), told
    name, _, reason = text.partition(":")
    head, _, progress = name.strip().partition(" ")
    if head == "calibrating":
        return head, text.strip().removeprefix(head).strip()  # its reason may contain a colon
    return head, (reason.strip() or progress.strip())
