"""The command log: what was asked of the machine, by whom, and what became of it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

from icu_common.core.results import GoalResult
from scope_ui_bridge.core.effects import Broadcast, Effect, Now, Record

_OPEN = ("sent", "accepted")
# A recorder starts as a program, and writes up to 256 MB of pictures at its end; it answers in any case. Teaching
# searches a new face for print. Neither moves anything, nor does a stop.
_PATIENCE_S = {"record": 60.0, "end_record": 60.0, "teach": 30.0, "stop": 0.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class LogEntry:
    """One line of the command log; ``status``: sent, accepted, reached, aborted, rejected, done, failed, no_answer."""

    entry: int
    goal_id: str
    wall_ms: int
    who: str
    action: str
    target: str
    status: str
    reason: str = ""
    error_mm: float | None = None
    duration_s: float | None = None
    effect: str = ""
    sent_s: float = 0.0

    def message(self) -> dict[str, Any]:
        """Return what the page gets."""
        fields = ("entry", "wall_ms", "who", "action", "target", "status", "reason", "error_mm", "duration_s", "effect")
        return {name: getattr(self, name) for name in fields}


def record(who: str, command: str, target: str, now: Now) -> dict[str, Any]:
    """Return the fields that every line of the audit file has."""
    return {"wall_s": round(now.wall_s, 3), "who": who, "command": command, "target": target}


def shown(entry: LogEntry) -> Broadcast:
    """Return the message that shows an entry on all pages."""
    return Broadcast(message={"type": "log", "entry": entry.message()})


class CommandLog:
    """The newest entries, and those of them that wait for their end."""

    def __init__(self) -> None:
        self.count = 0
        self._entries: deque[LogEntry] = deque(maxlen=200)
        self._pending: dict[str, LogEntry] = {}
        self._last_active_s = -math.inf

    def messages(self) -> list[dict[str, Any]]:
        """Return all entries as the page gets them, oldest first."""
        return [entry.message() for entry in self._entries]

    @property
    def waiting(self) -> bool:
        """Whether any command of the machine has no end yet; a recording, a lesson or a stop holds nobody up."""
        return any(entry.action not in _PATIENCE_S for entry in self._pending.values())

    def at_work(self, action: str) -> bool:
        """Tell whether a command of this kind has no end yet."""
        return bool(self.open_entries(action))

    def open_entries(self, action: str) -> list[int]:
        """Return the numbers of the commands of this kind that have no end yet."""
        return [entry.entry for entry in self._pending.values() if entry.action == action]

    @property
    def motion_waiting(self) -> bool:
        """Whether a goal (not a service) has no end yet."""
        return any(not entry.goal_id.startswith("service-") for entry in self._pending.values())

    def add(self, who: str, action: str, target: str, now: Now, *, status: str, goal_id: str = "") -> LogEntry:
        """Append an entry."""
        self.count += 1
        entry = LogEntry(
            entry=self.count,
            goal_id=goal_id,
            wall_ms=round(now.wall_s * 1e3),
            who=who,
            action=action,
            target=target,
            status=status,
            sent_s=now.graph_s,
        )
        self._entries.append(entry)
        if status in _OPEN:
            self._pending[goal_id] = entry
        return entry

    def update(self, entry: LogEntry, **changes: Any) -> LogEntry:
        """Change an entry, and return it as it is now."""
        changed = replace(entry, **changes)
        for index, old in enumerate(self._entries):
            if old.entry == entry.entry:
                self._entries[index] = changed
        self._pending.pop(entry.goal_id, None)
        if changed.status in _OPEN:
            self._pending[changed.goal_id] = changed
        return changed

    def open_entry(self, number: int) -> LogEntry | None:
        """Return the entry of this number while it waits for its end."""
        return next((entry for entry in self._pending.values() if entry.entry == number), None)

    def goal(self, goal_id: str) -> LogEntry | None:
        """Return the entry that waits for the end of this goal."""
        return self._pending.get(goal_id)

    def given_up(self, *, goal_id: str = "", number: int = 0) -> LogEntry | None:
        """Return the entry of this goal or number that was given up as unanswered: its end may still come."""
        unanswered = (entry for entry in self._entries if entry.status == "no_answer")
        return next((entry for entry in unanswered if goal_id == entry.goal_id or number == entry.entry), None)

    def expire(self, active: bool, timeout_s: float, now: Now) -> list[Effect]:
        """Give up what has had no answer for ``timeout_s``; ``active`` says whether the machine is at work."""
        if active:
            self._last_active_s = now.graph_s
        effects: list[Effect] = []
        for entry in list(self._pending.values()):
            # An accepted goal may take its time, but not while the controller rests: then its end was lost.
            since_s = max(entry.sent_s, self._last_active_s if entry.status == "accepted" else -math.inf)
            if now.graph_s - since_s > max(timeout_s, _PATIENCE_S.get(entry.action, 0.0)):
                changed = self.update(entry, status="no_answer")
                effects += [shown(changed), result_record(changed, now)]
        return effects

    def ended(self, entry: LogEntry, result: GoalResult, now: Now) -> list[Effect]:
        """Note a result, and return what shows and records it."""
        details = dict(result.details)
        # A move's error by the board's own readings is no measurement: they say where it believes to be.
        measured = math.isfinite(result.error_m) and details.get("measured_by") != "readings"
        effect = details.get("effect", "")
        changed = self.update(
            entry,
            status=result.outcome.value,
            reason=result.reason,
            error_mm=round(result.error_m * 1e3, 3) if measured else None,
            duration_s=round(result.duration_s, 2) if math.isfinite(result.duration_s) else None,
            effect="" if effect == "not looked for" else effect,
        )
        return [shown(changed), result_record(changed, now)]


def result_record(entry: LogEntry, now: Now) -> Record:
    """Return the line of the audit file that tells how an entry ended."""
    outcome = {"result": entry.status, "reason": entry.reason, "error_mm": entry.error_mm, "effect": entry.effect}
    return Record(record=record(entry.who, entry.action, entry.target, now) | outcome | {"goal_id": entry.goal_id})
