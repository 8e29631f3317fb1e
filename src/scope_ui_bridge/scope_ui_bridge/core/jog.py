"""Moving on while a button is held: small steps of bounded length, each an ordinary goal, until the page falls silent.

No step begins unless the page has asked again a moment ago, so what is left to go when the button, the page or the link
is let go is at most the step under way.
"""

from __future__ import annotations

from dataclasses import dataclass

from scope_ui_bridge.core import wire


@dataclass(slots=True, kw_only=True)
class HeldJog:
    """A direction that a page holds; ``xy`` (m, base_link) is where the step under way goes."""

    viewer: str
    entry: int
    dx: int
    dy: int
    step_m: float
    xy: tuple[float, float]
    until_s: float

    def same(self, viewer: str, message: wire.Jog) -> bool:
        """Tell whether a message holds on to this direction."""
        return (self.viewer, self.dx, self.dy, self.step_m) == (viewer, message.dx, message.dy, message.step_m)

    def advance(self) -> tuple[float, float]:
        """Return where the next step goes."""
        self.xy = (self.xy[0] + self.dx * self.step_m, self.xy[1] + self.dy * self.step_m)
        return self.xy
