"""Log lines for a board that resets itself: one for a row of resets that follow each other closely."""

from __future__ import annotations

from dataclasses import dataclass, field

from gantry_driver.core.states.machine_states import Note
from icu_common.core.reasons.message import Message

RESETS_APART_S = 5.0
"""Seconds without a reset that end a row; the next reset gets a line of its own."""


@dataclass(slots=True)
class ResetLog:
    """Resets since the first of a row; times are seconds of the machine's clock.

    The first reset is logged at once. The diagnostics count the later ones of the row (``resets``). These get a second
    line only if lines of a program or goal were lost with them.
    """

    first_at: float = 0.0
    last_at: float = 0.0
    more: int = 0
    lost: int = 0
    in_a_row: bool = False
    states: set[str] = field(default_factory=set)
    """States reported in this row."""

    def reset(self, reason: str, lost: int, now: float) -> list[Note]:
        """Return the log text of a reset with ``lost`` unanswered lines."""
        if self.in_a_row:
            self.more, self.lost, self.last_at = self.more + 1, self.lost + lost, now
            return []
        self.first_at = self.last_at = now
        self.more, self.lost, self.in_a_row = 0, 0, True
        self.states.clear()
        return [Note(level="error", text=Message("board.lines_unanswered", reason=reason, lost=lost))]

    def repeats(self, state: str) -> bool:
        """Note a state that is reported; return whether the row has had it before."""
        if not self.in_a_row:
            return False
        before = len(self.states)
        self.states.add(state)
        return len(self.states) == before

    def tick(self, now: float) -> list[Note]:
        """Return the line with the count of lost lines, if any, once the row is over."""
        if not self.in_a_row or now - self.last_at < RESETS_APART_S:
            return []
        self.in_a_row = False
        if not self.lost:
            return []
        within_s = self.last_at - self.first_at
        text = Message("board.board_reset_itself_more_times", more=self.more, within_s=within_s)
        return [Note(level="error", text=Message("board.lines_unanswered", reason=text, lost=self.lost))]
