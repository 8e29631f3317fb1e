"""The texts of the state topics: a state's name, which is a code, and a reason for people.

This is the only module that takes such a text apart. Programs decide by the name; the reason is only shown.
"""

from __future__ import annotations


def state_name(text: str) -> str:
    """Return the name of a published state.

    Examples
    --------
    >>> state_name("stopped: stop requested"), state_name("calibrating 3/12, 9 s left"), state_name("idle")
    ('stopped', 'calibrating', 'idle')
    """
    return split_state(text)[0]


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
    name, _, reason = text.partition(":")
    head, _, progress = name.strip().partition(" ")
    if head == "calibrating":
        return head, text.strip().removeprefix(head).strip()  # its reason may contain a colon
    return head, (reason.strip() or progress.strip())
