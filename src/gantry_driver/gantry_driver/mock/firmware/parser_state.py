"""State of the mock board's parser between lines, and the contents of a checked line."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class ParserModes:
    """The modal groups; numbers are those of the G- and M-codes, probing is 38.2 to 38.5."""

    motion: float = 0
    system: int = 0
    """0 is G54."""
    plane: int = 17
    units: int = 21
    distance: int = 90
    feed_mode: int = 94
    spindle: int = 5
    flood: bool = False
    mist: bool = False

    def copy(self) -> ParserModes:
        """Return an equal object."""
        return ParserModes(
            self.motion,
            self.system,
            self.plane,
            self.units,
            self.distance,
            self.feed_mode,
            self.spindle,
            self.flood,
            self.mist,
        )


@dataclass(slots=True)
class ParserState:
    """State of the parser between lines; mm and mm/min."""

    modes: ParserModes = field(default_factory=ParserModes)
    position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    g92: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    tool_length: float = 0.0
    feed: float = 0.0
    speed: float = 0.0
    tool: int = 0


@dataclass(slots=True)
class CheckedBlock:
    """A line without errors, with its values in mm and machine coordinates."""

    modes: ParserModes
    feed: float
    """mm/min, or 1/min in inverse time."""
    speed: float
    tool: int
    action: float | None = None
    """4, 10, 28, 28.1, 30, 30.1, 53, 92 or 92.1."""
    moves: bool = False
    target: list[float] = field(default_factory=list)
    place: list[float] = field(default_factory=list)
    """New offset for G10 and G92, stored position for G28 and G30."""
    place_index: int = 0
    center: tuple[float, float] = (0.0, 0.0)
    """Arc centre relative to the current position, along the plane's two axes."""
    radius: float = 0.0
    dwell_s: float = 0.0
    tool_length: float | None = None
    program: int | None = None
    """0 for M0, 2 or 30 for the end."""


PLANE_AXES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
"""First, second and normal axis of G17, G18 and G19."""
