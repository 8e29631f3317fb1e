"""The present selection, the same on all pages."""

from __future__ import annotations

from icu_common.core.geometry.geometry import Transform
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import Broadcast, Effect, Now
from scope_ui_bridge.core.orders import Selection, make_selection
from scope_ui_bridge.core.wire import Refusal


class Chosen:
    """Holds the selection; ``count`` numbers the selections of this run."""

    def __init__(self, state: DeskState) -> None:
        self._state = state
        self.selection: Selection | None = None
        self.count = 0

    def select(self, message: wire.Select, now: Now) -> list[Effect]:
        """Select what a page requests, or nothing."""
        if not message.control and message.point_px is None and message.line_m is None:
            return self.clear()
        # A refused click clears the selection: a confirmation after it would not mean the previous one.
        self.selection = None
        state = self._state
        state.machine.check_frame(message.camera, message.stamp_ns, state.config, now)
        pose = state.machine.check_recognition(state.scene.camera_from_panel, state.config, now)
        self.selection = make_selection(self.count + 1, message, state.scene, pose, state.panel.seen)
        self.count += 1
        return [self.shown()]

    def confirmed(self, number: int) -> Selection:
        """Return the selection that a page confirms by its number.

        Raises
        ------
        Refusal
            ``selection_gone``.
        """
        selection = self.selection
        if selection is None or selection.number != number:
            raise Refusal("selection_gone")
        if selection.faces != self._state.scene.faces:  # another panel may have a control of the same name
            self.selection = None
            raise Refusal("selection_gone")
        return selection

    def check_unmoved(self, selection: Selection, camera_from_panel: Transform) -> None:
        """Refuse and clear a selection whose panel has moved: ``panel_moved``."""
        moved = selection.moved_m(camera_from_panel, self._state.scene.camera_from_base)
        limit = self._state.config.panel_moved_limit_m
        if moved > limit:
            self.selection = None
            raise Refusal("panel_moved", moved_mm=round(moved * 1e3, 1), limit_mm=round(limit * 1e3, 1))

    def clear(self) -> list[Effect]:
        """Select nothing; return the effects that show it."""
        had = self.selection is not None
        self.selection = None
        return [self.shown()] if had else []

    def shown(self) -> Broadcast:
        """Return the message that shows the selection on all pages."""
        selection = self.selection.message() if self.selection else None
        return Broadcast(message={"type": "selection", "selection": selection})
