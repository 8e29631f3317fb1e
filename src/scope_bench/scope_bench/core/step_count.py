"""Adds up what every process of a replayed graph has published and taken; see icu_common.nodes.in_step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(slots=True)
class StepCount:
    """The newest counts of each process, and whether anything is still under way between them.

    Attributes
    ----------
    played
        Messages that the player itself has published, by absolute topic name.
    """

    played: Counter[str] = field(default_factory=Counter)
    _counts: dict[int, Mapping[str, Any]] = field(default_factory=dict)
    _before: dict[tuple[int, str], int] = field(default_factory=dict)

    def hear(self, counts: Mapping[str, Any]) -> None:
        """Take the counts that a process tells."""
        self._counts[counts["process"]] = counts

    @property
    def processes(self) -> int:
        """How many have been heard."""
        return len(self._counts)

    def unmatched(self, readers: Mapping[str, int]) -> list[str]:
        """Return topics whose publishers have not found every listener yet.

        Parameters
        ----------
        readers
            Subscriptions that the player's own publishers have found.
        """
        listeners = self._listeners()
        offers = [readers, *(counts["readers"] for counts in self._counts.values())]
        return sorted({t for found in offers for t, n in found.items() if n < listeners[t]})

    def begin(self) -> None:
        """What has been sent and taken so far is of the start, and counts for nothing."""
        self._before = self._owed()

    def under_way(self) -> list[str]:
        """Return the topics of which somebody has not taken everything."""
        return sorted({t for (p, t), owed in self._owed().items() if owed != self._before.get((p, t), 0)})

    def waiting_for(self, processes: int, readers: Mapping[str, int]) -> str:
        """Return what a replay with so many processes cannot begin without yet, "" for nothing; readers as above."""
        reasons = []
        if self.processes < processes:
            reasons.append(
                f"{self.processes} of {processes} processes play in step (was the graph started with "
                "bring_up --in-step?)"
            )
        if missing := self.unmatched(readers):
            reasons.append(f"not all have found each other on {', '.join(missing)}")
        if owed := self.under_way():
            reasons.append(f"not all has been taken that was sent on {', '.join(owed)}")
        return "; ".join(reasons)

    def _listeners(self) -> Counter[str]:
        return sum((Counter(counts["listeners"]) for counts in self._counts.values()), Counter())

    def _owed(self) -> dict[tuple[int, str], int]:
        sent = sum((Counter(counts["sent"]) for counts in self._counts.values()), Counter(self.played))
        return {
            (process, topic): number * sent[topic] - counts["taken"].get(topic, 0)
            for process, counts in self._counts.items()
            for topic, number in counts["listeners"].items()
        }
