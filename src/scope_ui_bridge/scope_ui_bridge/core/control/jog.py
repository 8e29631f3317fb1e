"""Jog: while a button is held, small steps of bounded length, each an ordinary goal, until the page falls silent.

A step starts only if the page has renewed its request recently. So after the button, the page or the link is lost, at
most the current step remains.
"""

from __future__ import annotations

from dataclasses import dataclass

from scope_ui_bridge.core import wire


@dataclass(slots=True, kw_only=True)
class HeldJog:
    """A direction that a page holds; ``xy`` (m, base_link) is the end of the current step."""

    viewer: str
    entry: int
    dx: int
    dy: int
    step_m: float
    xy: tuple[float, float]
    until_s: float

    def same(self, viewer: str, message: wire.Jog) -> bool:
        """Return whether a message renews this direction."""
        return (self.viewer, self.dx, self.dy, self.step_m) == (viewer, message.dx, message.dy, message.step_m)

    def advance(self) -> tuple[float, float]:
        """Return the end of the next step."""
        self.xy = (self.xy[0] + self.dx * self.step_m, self.xy[1] + self.dy * self.step_m)
        return self.xy
