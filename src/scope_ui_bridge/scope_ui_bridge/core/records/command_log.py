"""Command log: each command, who gave it, and its result."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

from icu_common.core.goals.results import EFFECT, EFFECT_MISSING, EffectMissing, GoalResult
from scope_ui_bridge.core.effects import Broadcast, Effect, Now, Record

_OPEN = ("sent", "accepted")
# A recorder starts as a program, and at its end writes up to 256 MB of images; it always answers. Teaching searches a
# new face for print. None of these moves anything, nor does a stop.
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
    bound_mm: float | None = None
    """Distance from the target within which the tip was with 95 % probability."""
    duration_s: float | None = None
    effect: str = ""
    touch: str = ""
    """Value of :class:`icu_common.core.goals.results.Felt`, empty if the command touches nothing."""
    sent_s: float = 0.0

    def message(self) -> dict[str, Any]:
        """Return the message for the page."""
        about = ("entry", "wall_ms", "who", "action", "target", "status", "reason")
        return {name: getattr(self, name) for name in (*about, "error_mm", "bound_mm", "duration_s", "effect", "touch")}


def record(who: str, command: str, target: str, now: Now) -> dict[str, Any]:
    """Return the fields common to all lines of the audit file."""
    return {"wall_s": round(now.wall_s, 3), "who": who, "command": command, "target": target}


def shown(entry: LogEntry) -> Broadcast:
    """Return the message that shows an entry on all pages."""
    return Broadcast(message={"type": "log", "entry": entry.message()})


class CommandLog:
    """The newest entries, and those without a final result."""

    def __init__(self) -> None:
        self.count = 0
        self._entries: deque[LogEntry] = deque(maxlen=200)
        self._pending: dict[str, LogEntry] = {}
        self._last_active_s = -math.inf

    def messages(self) -> list[dict[str, Any]]:
        """Return the messages of all entries for the page, oldest first."""
        return [entry.message() for entry in self._entries]

    @property
    def waiting(self) -> bool:
        """Whether a command of the machine has no final result; a recording, a lesson or a stop does not count."""
        return any(entry.action not in _PATIENCE_S for entry in self._pending.values())

    def at_work(self, action: str) -> bool:
        """Return whether a command of this kind has no final result."""
        return bool(self.open_entries(action))

    def open_entries(self, action: str) -> list[int]:
        """Return the numbers of the commands of this kind without a final result."""
        return [entry.entry for entry in self._pending.values() if entry.action == action]

    @property
    def motion_waiting(self) -> bool:
        """Whether a goal (not a service) has no final result."""
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
        """Change an entry and return the new one."""
        changed = replace(entry, **changes)
        for index, old in enumerate(self._entries):
            if old.entry == entry.entry:
                self._entries[index] = changed
        self._pending.pop(entry.goal_id, None)
        if changed.status in _OPEN:
            self._pending[changed.goal_id] = changed
        return changed

    def open_entry(self, number: int) -> LogEntry | None:
        """Return the entry of this number if it has no final result."""
        return next((entry for entry in self._pending.values() if entry.entry == number), None)

    def goal(self, goal_id: str) -> LogEntry | None:
        """Return the entry of this goal if it has no final result."""
        return self._pending.get(goal_id)

    def given_up(self, *, goal_id: str = "", number: int = 0) -> LogEntry | None:
        """Return the entry of this goal or number that was given up without an answer: a result may still arrive."""
        unanswered = (entry for entry in self._entries if entry.status == "no_answer")
        return next((entry for entry in unanswered if goal_id == entry.goal_id or number == entry.entry), None)

    def expire(self, active: bool, timeout_s: float, now: Now) -> list[Effect]:
        """Give up commands without an answer for ``timeout_s``; ``active`` is whether the machine is moving."""
        if active:
            self._last_active_s = now.graph_s
        effects: list[Effect] = []
        for entry in list(self._pending.values()):
            # An accepted goal may take long, but not while the machine is at rest: its result was lost then.
            since_s = max(entry.sent_s, self._last_active_s if entry.status == "accepted" else -math.inf)
            if now.graph_s - since_s > max(timeout_s, _PATIENCE_S.get(entry.action, 0.0)):
                changed = self.update(entry, status="no_answer")
                effects += [shown(changed), result_record(changed, now)]
        return effects

    def ended(self, entry: LogEntry, result: GoalResult, now: Now) -> list[Effect]:
        """Set the result of an entry; return the effects that show and record it."""
        details = dict(result.details)
        # An error of a move from the board's own readings is no measurement: they are where the board assumes to be.
        measured = math.isfinite(result.error_m) and details.get("measured_by") != "readings"
        looked_for = details.get(EFFECT_MISSING) != EffectMissing.NOT_LOOKED_FOR
        changed = self.update(
            entry,
            status=result.outcome.value,
            reason=result.reason,
            error_mm=round(result.error_m * 1e3, 3) if measured else None,
            bound_mm=_millimetres(details.get("error_95_m", "")) if measured else None,
            duration_s=round(result.duration_s, 2) if math.isfinite(result.duration_s) else None,
            effect=details.get(EFFECT, "") if looked_for else "",
            touch="" if result.touch is None else result.touch.value,
        )
        return [shown(changed), result_record(changed, now)]


def _millimetres(text: str) -> float | None:
    """Return a length in metres as mm, None for anything else."""
    try:
        value = 1e3 * float(text)
    except ValueError:
        return None
    return round(value, 3) if math.isfinite(value) else None


def result_record(entry: LogEntry, now: Now) -> Record:
    """Return the line of the audit file with the result of an entry."""
    measured = {"error_mm": entry.error_mm, "bound_mm": entry.bound_mm}
    outcome = {"result": entry.status, "reason": entry.reason, **measured, "effect": entry.effect}
    outcome["touch"] = entry.touch
    return Record(record=record(entry.who, entry.action, entry.target, now) | outcome | {"goal_id": entry.goal_id})
