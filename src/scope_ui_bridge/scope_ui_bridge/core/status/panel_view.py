"""State of the panel for the pages: lit lamps, angles of knobs, time of a screen's last change."""

from __future__ import annotations

import math
from typing import Any

from icu_common.core.panel.panel_state import PanelSeen
from scope_ui_bridge.core.effects import Now


class PanelView:
    """Newest state of the panel; ``message`` is replaced only if people would see a difference."""

    def __init__(self) -> None:
        self.seen: PanelSeen | None = None
        self.message: list[dict[str, Any]] = []
        self._changed: dict[str, tuple[int, int]] = {}
        self._shown_s = -math.inf

    def show(self, seen: PanelSeen, now: Now) -> None:
        """Set the newest state."""
        self.seen, self._shown_s = seen, now.graph_s
        shown = []
        for control in seen.controls:
            shown.append(
                {
                    "name": control.name,
                    "kind": control.kind,
                    "hidden_by": control.hidden_by,
                    "lamp": control.lamp,
                    # Whole degrees, because changes below that are noise.
                    "angle_deg": None if math.isnan(control.angle_deg) else round(control.angle_deg),
                    "changed_ms": self._changed_ms(control.name, control.changed_ns, now),
                    "detent_deg": control.detent_deg,
                    "marks": dict(control.marks),
                }
            )
        self.message = shown

    def expire(self, limit_s: float, now: Now) -> None:
        """Discard the state of a panel not seen for ``limit_s``: a lamp may have changed since."""
        if now.graph_s - self._shown_s > limit_s:
            self.message = []

    def _changed_ms(self, name: str, changed_ns: int, now: Now) -> int:
        """Return the wall time of a change in ms, 0 for none; the graph's clock may be a recording's."""
        if not changed_ns:
            return 0
        known = self._changed.get(name)
        if known is None or known[0] != changed_ns:
            known = changed_ns, round(now.wall_s * 1e3 - (now.ros_ns - changed_ns) / 1e6)
            self._changed[name] = known
        return known[1]
