"""Causes of an aborted motion whose reports contradict the sent lines."""

from __future__ import annotations

from enum import Enum


class MotionFault(str, Enum):
    """Machine-readable cause in ``GoalResult.code`` of an aborted motion; look at the panel before a repetition."""

    LEFT_PATH = "left_path"
    """A report showed the board off its path, or faster than planned: its position counts as lost."""
    TOUCH_UNPROVED = "touch_unproved"
    """The board came to rest at a position other than the end of a stage: the path's target was not touched."""
    MODES_DIFFER = "modes_differ"
    """``$G`` or the work offset did not show the modes, the feed or the frame that were sent."""
    OVERDUE = "overdue"
    """The motion took more than twice the expected time."""
    LOST_ANSWER = "lost_answer"
    """A line or its answer was lost on the wire."""

    def __str__(self) -> str:
        return self.value
