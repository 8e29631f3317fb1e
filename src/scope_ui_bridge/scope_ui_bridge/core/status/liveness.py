"""Nodes that report on /diagnostics, and which of them are late, hang or have ended; pure, no clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

LONGEST_TURN_S = 1.0
"""Maximum silence counted between two checks: a bridge that was delayed itself has not read the reports."""

_LARGEST_LIMIT_S = _REGULAR_S = 60.0


class Condition(str, Enum):
    """Condition of a node."""

    REPORTS = "reports"
    LATE = "late"
    """Silent, but its process exists."""
    HANGS = "hangs"
    """Bring-up has found its process blocked."""
    ENDED = "ended"
    """Its process is gone, or the node has left the graph."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sender:
    """A node by its full name, and its process as ``icu_common.adapters.processes.process_identity`` writes it.

    Empty: unknown.
    """

    node: str = ""
    process: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A node whose condition differs from the last check; ``silent_s`` since its last report."""

    name: str
    condition: Condition
    silent_s: float


@dataclass(slots=True, kw_only=True)
class _Reporter:
    limit_s: float
    sender: Sender
    silent_s: float = 0.0
    regular_s: float = 0.0
    """Seconds of timely reports since the node was last late."""
    condition: Condition = Condition.REPORTS


class LivenessMonitor:
    """Remembers every node that has reported once.

    Parameters
    ----------
    limit_s
        Seconds without a report from which on a node is late; nodes report every second. The limit of a node that
        has been late doubles, up to a minute, until the node has reported in time for a minute.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._reporters: dict[str, _Reporter] = {}
        self._checked_s: float | None = None

    def heard(self, name: str, sender: Sender) -> bool:
        """Process a report; return whether its node had been late, hung or ended."""
        reporter = self._reporters.setdefault(name, _Reporter(limit_s=self._limit_s, sender=sender))
        before, reporter.condition = reporter.condition, Condition.REPORTS
        reporter.sender, reporter.silent_s = sender, 0.0
        if before is not Condition.REPORTS:
            reporter.regular_s = 0.0
            # On a computer that stays busy, the same change would be reported every few seconds.
            reporter.limit_s = (
                min(2 * reporter.limit_s, _LARGEST_LIMIT_S) if before is Condition.LATE else self._limit_s
            )
        return before is not Condition.REPORTS

    def check(self, now_s: float, condition_of: Callable[[Sender], Condition]) -> list[Change]:
        """Return the changes since the last check, in alphabetical order.

        Parameters
        ----------
        now_s
            Seconds of a clock that may jump: at most ``LONGEST_TURN_S`` of each turn count.
        condition_of
            Called for silent nodes only; see :func:`judge`.
        """
        turn_s = 0.0 if self._checked_s is None else min(max(now_s - self._checked_s, 0.0), LONGEST_TURN_S)
        self._checked_s = now_s
        changes = []
        for name, reporter in sorted(self._reporters.items()):
            reporter.silent_s += turn_s
            if reporter.silent_s <= self._limit_s:
                reporter.regular_s += turn_s
            if reporter.regular_s > _REGULAR_S:
                reporter.limit_s = self._limit_s
            if reporter.silent_s <= reporter.limit_s:
                continue
            condition = condition_of(reporter.sender)
            if condition is not reporter.condition:
                reporter.condition = condition
                changes.append(Change(name=name, condition=condition, silent_s=reporter.silent_s))
        return changes


def judge(*, alive: bool | None, hangs: bool, in_graph: bool) -> Condition:
    """Return the condition of a silent node.

    Parameters
    ----------
    alive
        Whether its process exists; None if that cannot be known, as on another host.
    hangs
        Whether bring-up has found the process blocked.
    in_graph
        Whether the ROS graph still has the node. A killed node leaves it about ten seconds later.
    """
    if alive is False or (alive is None and not in_graph):
        return Condition.ENDED
    return Condition.HANGS if hangs else Condition.LATE
