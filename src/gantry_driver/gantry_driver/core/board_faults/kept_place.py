"""Check whether a board kept its position while no driver was connected; no I/O and no clock."""

from __future__ import annotations

from gantry_driver.core.grbl.grbl_messages import StatusReport

SAME_MM = 0.01
"""Maximum difference between two reports of a board at rest; a motor step is smaller."""


class KeptPlace:
    """Compares a board's reports at rest before and after the reset of a new connection.

    A board that lost its power starts locked (``$22=1``), or sends a banner without a request. A board that is unlocked
    and reports the same position before and after the reset still counts its steps from the last homing.
    """

    def __init__(self) -> None:
        self._before: tuple[float, ...] | None = None
        self._unlocked = False
        self.mpos_mm: tuple[float, ...] | None = None
        """Kept position in mm, None if it may have been lost."""
        self.unlocked = False
        """Whether the board's newest report shows that it accepts lines after the reset."""

    def before_reset(self, report: StatusReport) -> None:
        """Note a report of a board that answers without a banner and does not move."""
        self._unlocked = report.state in ("Idle", "Hold")
        self._before = report.mpos_mm if self._unlocked else None

    def was_reset(self, *, expected: bool) -> None:
        """Note a banner; one without a request discards the position."""
        if not expected:
            self._before, self._unlocked = None, False
        self.mpos_mm, self.unlocked = None, False

    def after_reset(self, report: StatusReport) -> None:
        """Note a report after the banner."""
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
