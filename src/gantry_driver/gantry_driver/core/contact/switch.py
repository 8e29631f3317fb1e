"""The switch in the stylus as evidence: open in the air, closed in contact, in two reports each."""

from __future__ import annotations

from dataclasses import dataclass

REPORTS = 2
"""Number of successive reports that must agree: one damaged byte adds or removes the letter of the pin."""


@dataclass(slots=True)
class StylusSwitch:
    """Follows the reports of the pin.

    Examples
    --------
    >>> switch = StylusSwitch()
    >>> for probe in (False, False):
    ...     switch.take(probe)
    >>> switch.goes_down()
    >>> for probe in (False, True, True):
    ...     switch.take(probe)
    >>> switch.closed
    True
    """

    closed: bool | None = None
    """Whether the switch has closed since the descent began; None without a switch, or if it was not open before."""
    _last: bool | None = None
    _count: int = 0

    def take(self, probe: bool | None) -> None:
        """Take one report; None: there is no switch."""
        self._count = self._count + 1 if probe is self._last else 1
        self._last = probe
        if probe is None:
            self.closed = None
        elif self.closed is False and probe and self._count >= REPORTS:
            self.closed = True

    def goes_down(self) -> None:
        """Begin a descent: a switch that is closed in the air proves nothing."""
        self.closed = False if self._last is False and self._count >= REPORTS else None
