"""Changed parameters of the graph's nodes: a line for each in command log and audit file, limited during a flood."""

from __future__ import annotations

from collections import deque

from scope_ui_bridge.core.effects import Effect, Now, Record
from scope_ui_bridge.core.records.command_log import CommandLog, record, shown

MOST, WITHIN_S = 20, 10.0
"""Maximum number of changes shown within this time; the next one shown counts the omitted ones."""
ACTION = "parameter"


class ParameterChanges:
    """Writes the changes to a command log."""

    def __init__(self, log: CommandLog) -> None:
        self._log = log
        self._shown_s: deque[float] = deque(maxlen=MOST)
        self._omitted = 0

    def changed(self, node: str, name: str, value: str, now: Now) -> list[Effect]:
        """Record a change; ``value`` is the new value as text."""
        if len(self._shown_s) == MOST and now.mono_s - self._shown_s[0] < WITHIN_S:
            self._omitted += 1
            return []
        self._shown_s.append(now.mono_s)
        text = f"{name} = {value}"
        entry = self._log.add(node, ACTION, text, now, status="done")
        line = record(node, ACTION, text, now) | {"result": "done"}
        if self._omitted:
            line["omitted"], self._omitted = self._omitted, 0
        return [Record(record=line), shown(entry)]
