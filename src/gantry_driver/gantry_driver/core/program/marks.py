"""Distances along a program's path at which its lines end."""

from __future__ import annotations

from bisect import bisect_right

BLOCK_MM = 0.05
"""Length in mm from which a move surely makes a block; a move shorter than half a motor step makes none."""


class LineMarks:
    """Line numbers in order, with the distance along the path at the end of each line."""

    def __init__(self) -> None:
        self._numbers: list[int] = []
        self._along_mm: list[float] = []
        self._movers: list[int] = []
        """Indices of the lines that surely make a block."""
        self._executed_mm = 0.0

    def append(self, number: int, along_mm: float) -> None:
        """Note the last queued line."""
        if along_mm - (self._along_mm[-1] if self._along_mm else 0.0) > BLOCK_MM:
            self._movers.append(len(self._numbers))
        self._numbers.append(number)
        self._along_mm.append(along_mm)

    def along_mm(self, number: int) -> float:
        """Return the distance along the path after the lines up to a number.

        Examples
        --------
        >>> marks = LineMarks()
        >>> marks.append(7, 2.5)
        >>> marks.along_mm(6), marks.along_mm(8)
        (0.0, 2.5)
        """
        index = bisect_right(self._numbers, number)
        return self._along_mm[index - 1] if index else 0.0

    def executed_mm(self, acknowledged: int, waiting: int) -> float:
        """Return the distance that the board has surely executed, from this report and the previous one.

        Parameters
        ----------
        acknowledged
            Number of the last line that the board has acknowledged.
        waiting
            Maximum number of blocks in its planner, -1 if unknown.
        """
        before = self._executed_mm
        movers = bisect_right(self._movers, bisect_right(self._numbers, acknowledged) - 1) - waiting
        self._executed_mm = self._along_mm[self._movers[movers - 1]] if waiting >= 0 and movers > 0 else 0.0
        return min(before, self._executed_mm)
