"""Whether a board has kept its position while no driver was connected; no I/O and no clock."""

from __future__ import annotations

from gantry_driver.core.grbl_messages import Report

SAME_MM = 0.01
"""Difference between two reports of a board at rest; a motor step is less."""


class KeptPlace:
    """Compares what a board reports at rest before the reset of a connection, and after it.

    A board that has lost its power starts locked (``$22=1``), or sends a banner that no driver has asked for. One that
    reports the same place, unlocked, before and after a reset was not moved by it, and counts from its last homing.
    """

    def __init__(self) -> None:
        self._before: tuple[float, ...] | None = None
        self._unlocked = False
        self.mpos_mm: tuple[float, ...] | None = None
        """The position that was kept, mm; None where it is not known to be one."""
        self.unlocked = False
        """Whether the board takes lines since the reset, as its newest report shows."""

    def before_reset(self, report: Report) -> None:
        """Take a report of a board that answers without a banner and does not move."""
        self._unlocked = report.state in ("Idle", "Hold")
        self._before = report.mpos_mm if self._unlocked else None

    def was_reset(self, *, expected: bool) -> None:
        """Take a banner; one that no driver has asked for ends what was known."""
        if not expected:
            self._before, self._unlocked = None, False
        self.mpos_mm, self.unlocked = None, False

    def after_reset(self, report: Report) -> None:
        """Take a report after the banner."""
        self.unlocked = self._unlocked and report.state == "Idle"
        place, before = report.mpos_mm, self._before
        same = (
            place is not None
            and before is not None
            and len(place) == len(before)
            and all(abs(a - b) <= SAME_MM for a, b in zip(place, before))
        )
        if not same:
            self._before = None
        self.mpos_mm = place if same and self.unlocked else None
