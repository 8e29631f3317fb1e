"""Log lines for a board that resets itself: the first reset at once, the others that follow it closely as a count."""

from __future__ import annotations

from dataclasses import dataclass

from gantry_driver.core.machine_states import Note

RESETS_APART_S = 5.0
"""Seconds without a reset after which the count is logged, and the next reset gets a line of its own."""


@dataclass(slots=True)
class ResetLog:
    """Resets since the first of a row; times are seconds of the machine's clock."""

    first_at: float = 0.0
    last_at: float = 0.0
    more: int = 0
    lost: int = 0
    in_a_row: bool = False

    def reset(self, reason: str, lost: int, now: float) -> list[Note]:
        """Return what to log of a reset with ``lost`` lines unanswered."""
        if self.in_a_row:
            self.more, self.lost, self.last_at = self.more + 1, self.lost + lost, now
            return []
        self.first_at = self.last_at = now
        self.more, self.lost, self.in_a_row = 0, 0, True
        return [Note(level="error", text=f"{reason}; {lost} lines unanswered")]

    def tick(self, now: float) -> list[Note]:
        """Return the line with the count once the row is over."""
        if not self.in_a_row or now - self.last_at < RESETS_APART_S:
            return []
        self.in_a_row = False
        if not self.more:
            return []
        within_s = self.last_at - self.first_at
        text = f"the board was reset by itself {self.more} more times within {within_s:.1f} s"
        return [Note(level="error", text=f"{text}; {self.lost} lines unanswered")]
