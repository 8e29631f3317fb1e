"""Sizes of the board's buffers, learnt from what its reports (``Bf:``) say is free; no I/O and no clock."""

from __future__ import annotations

from dataclasses import dataclass, field

from gantry_driver.core.grbl_messages import Report


@dataclass(slots=True)
class Buffer:
    """One buffer: its size and what was free in the report before; -1 for unknown."""

    size: int = -1
    free_before: int = -1

    def note(self, free: int, *, empty: bool) -> None:
        """Take the next report.

        The largest free size since the banner is the size. One larger report may be damaged, so the second one counts,
        and two equal ones of an empty buffer count whatever was believed before.
        """
        if free >= 0:
            if self.size < 0 or (empty and free == self.free_before):
                self.size = free
            else:
                self.size = max(self.size, min(free, self.free_before))
        self.free_before = free

    def held(self, free: int) -> int:
        """Return how much of it is used where ``free`` is free, at least 0."""
        return max(self.size - free, 0)


@dataclass(slots=True)
class BoardBuffers:
    """The planner's blocks and the receive buffer's bytes."""

    planner: Buffer = field(default_factory=Buffer)
    rx: Buffer = field(default_factory=Buffer)

    @property
    def reported(self) -> bool:
        """Whether reports have said how full they are (``Bf:``)."""
        return self.rx.size >= 0

    def note(self, report: Report, *, in_flight: bool) -> None:
        """Take the next report; ``in_flight``: whether lines are sent and not answered."""
        empty = report.state == "Idle" and not in_flight
        self.planner.note(report.planner_free, empty=empty)
        self.rx.note(report.rx_free, empty=empty)
