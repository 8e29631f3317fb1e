"""Intent of a trajectory, and its form in ``header.frame_id``: ``turn/`` or ``turn/NAME``."""

from __future__ import annotations

from enum import Enum


class Intent(str, Enum):
    """Purpose of a trajectory; the driver's guard allows each intent a different use of the space at the panel."""

    MOVE = "move"
    """Nothing is touched."""
    PRESS = "press"
    """Straight down to the panel and up. A trajectory without an intent counts as a press."""
    TURN = "turn"
    """A knob is turned: sideways in contact."""
    DRAG = "drag"
    """A line is drawn on a screen: sideways in contact."""

    def __str__(self) -> str:
        return self.value


def frame_of(intent: Intent) -> str:
    """Return the ``frame_id`` of a trajectory that uses its stamp as its name."""
    return f"{intent}/"


def read_frame(frame_id: str, stamp_ns: int) -> tuple[str, Intent]:
    """Return a trajectory's name and intent.

    Examples
    --------
    >>> read_frame("turn/", 17)
    ('17', <Intent.TURN: 'turn'>)
    >>> read_frame("drag/7", 17)
    ('7', <Intent.DRAG: 'drag'>)
    >>> read_frame("first", 17)
    ('first', <Intent.PRESS: 'press'>)
    """
    kind, slash, name = frame_id.partition("/")
    if not slash or kind not in {intent.value for intent in Intent}:
        return frame_id or str(stamp_ns), Intent.PRESS
    return name or str(stamp_ns), Intent(kind)
