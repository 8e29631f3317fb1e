"""Messages of a page, as typed values."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PageMessage:
    """Fields of every message from a page.

    ``seq`` increases with each message of a connection; ``boot`` is the id of the server's run, ``epoch`` of the lease.
    """

    seq: int
    boot: str
    epoch: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Alive(PageMessage):
    """Keep-alive of a page that draws; ``client_ms`` is returned with the bridge's clock, for the round-trip time."""

    client_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Hidden(PageMessage):
    """The page has just been hidden, for example by another tab or a locked screen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Blind(PageMessage):
    """Something moves, and the page has shown no new image for ``silence_ms``."""

    silence_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StopAll(PageMessage):
    """Stop everything; ``press`` identifies one press of the button, which arrives by two paths."""

    press: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease(PageMessage):
    """``step``: take, release, request, grant (hand over) or decline; the last two name the requesting page."""

    step: str
    to: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Select(PageMessage):
    """A control's name, a point or a line, on the image with this stamp; none of them = clear the selection.

    Points are raw pixels. A line goes from ``point_px`` to ``to_px``, or is given on the face as ``line_m`` (x, y to x,
    y).
    """

    camera: str
    stamp_ns: int
    control: str = ""
    point_px: tuple[float, float] | None = None
    to_px: tuple[float, float] | None = None
    line_m: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Act(PageMessage):
    """Confirm a gesture at the selection, based on the image with this stamp.

    ``argument`` is NaN if the gesture has none; ``mark`` is a knob's marked position, in place of an argument.
    """

    gesture: str
    argument: float
    selection: int
    camera: str
    stamp_ns: int
    mark: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveTo(PageMessage):
    """Move to a point in base_link (metres) with the stylus up, based on the image with this stamp."""

    x_m: float
    y_m: float
    camera: str
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Jog(PageMessage):
    """Jog in small steps while this message is repeated; ``dx``, ``dy`` are -1, 0 or 1; both 0 = released."""

    dx: int
    dy: int
    step_m: float
    camera: str
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSequence(PageMessage):
    """Start a sequence: the ``stored`` one of this name, or these steps as on a command line."""

    stored: str
    steps: tuple[str, ...]
    camera: str
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold(PageMessage):
    """Hold the newest left image, to mark a new panel in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointedControl:
    """A control in the held image: centre of its foot in raw pixels, its size and its height above the face in mm."""

    name: str
    kind: str
    pixel: tuple[float, float]
    size_mm: tuple[float, float]
    proud_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Teach(PageMessage):
    """Make a panel from the points marked in the held image: corners from the lower left, counter-clockwise."""

    stamp_ns: int
    model: str
    title: str
    size_mm: tuple[float, float]
    corners: tuple[tuple[float, float], ...]
    controls: tuple[PointedControl, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Call(PageMessage):
    """Call one of SERVICES; ``sent_s`` is the time of sending by the page's estimate of the bridge's clock."""

    service: str
    sent_s: float = math.inf


LEASE_STEPS = ("take", "release", "request", "grant", "decline")
SERVICES = (
    *("home", "reset", "enable", "disable", "calibrate", "add_sample", "solve", "save", "accept_settings"),
    *("record", "end_record"),
)
KINDS = (
    *("alive", "hidden", "blind", "stop", "lease", "select", "act", "move", "jog"),
    *("sequence", "hold", "teach", "call"),
)
CAMERAS = ("left", "right")
