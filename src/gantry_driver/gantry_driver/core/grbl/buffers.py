"""Sizes of the board's buffers, learnt from the free space in its reports (``Bf:``); no I/O and no clock."""

from __future__ import annotations

from dataclasses import dataclass, field

from gantry_driver.core.grbl.grbl_messages import StatusReport


@dataclass(slots=True)
class Buffer:
    """One buffer: its size, and the free space in the previous report; -1 if unknown."""

    size: int = -1
    free_before: int = -1

    def note(self, free: int, *, empty: bool) -> None:
        """Take the next report.

        The largest free space since the banner is the size. A single larger report may be damaged, so the second one
        counts. Two equal reports of an empty buffer replace any earlier size.
        """
        if free >= 0:
            if self.size < 0 or (empty and free == self.free_before):
                self.size = free
            else:
                self.size = max(self.size, min(free, self.free_before))
        self.free_before = free

    def held(self, free: int) -> int:
        """Return the used space when ``free`` is free, at least 0."""
        return max(self.size - free, 0)


@dataclass(slots=True)
class BoardBuffers:
    """The planner's blocks and the receive buffer's bytes."""

    planner: Buffer = field(default_factory=Buffer)
    rx: Buffer = field(default_factory=Buffer)

    @property
    def reported(self) -> bool:
        """Whether reports have shown how full the buffers are (``Bf:``)."""
        return self.rx.size >= 0

    def note(self, report: StatusReport, *, in_flight: bool) -> None:
        """Take the next report; ``in_flight``: whether lines are sent and not answered."""
        empty = report.state == "Idle" and not in_flight
        self.planner.note(report.planner_free, empty=empty)
        self.rx.note(report.rx_free, empty=empty)
