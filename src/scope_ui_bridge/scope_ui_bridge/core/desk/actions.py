"""Gestures, sequences, lessons and services that a page orders; moves are in ``motions``."""

from __future__ import annotations

from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.panel.gesture import Point
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access import Role
from scope_ui_bridge.core.desk.chosen import Chosen
from scope_ui_bridge.core.desk.early_reset import RESET, EarlyReset
from scope_ui_bridge.core.desk.order_book import OrderBook
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import (
    CallService,
    Effect,
    HoldPicture,
    Now,
    SendCommand,
    SendSequence,
    SendTeaching,
)
from scope_ui_bridge.core.orders import action_text, make_gesture, teaching_text
from scope_ui_bridge.core.records import shown
from scope_ui_bridge.core.wire import Refusal

_FOR_ENGINEERS = ("accept_settings",)
_MOVE = ("home", "calibrate")


class Actions:
    """Checks each order of the page in control and makes its effects."""

    def __init__(self, state: DeskState, book: OrderBook, chosen: Chosen, early: EarlyReset) -> None:
        self._state = state
        self._book = book
        self._early = early
        self._chosen = chosen

    def act(self, viewer: str, message: wire.Act, now: Now) -> list[Effect]:
        """Order a gesture at the selection."""
        state, book = self._state, self._book
        selection = self._chosen.confirmed(message.selection)
        goal_id = book.next_id("ui")
        gesture = make_gesture(selection, message, state.panel.seen, goal_id)
        state.machine.check_frame(message.camera, message.stamp_ns, state.config, now)
        pose = state.machine.check_recognition(state.scene.camera_from_panel, state.config, now)
        book.check_ready()
        self._chosen.check_unmoved(selection, pose)
        seen = {"camera": message.camera, "frame": str(message.stamp_ns)}
        action = action_text(gesture)
        if isinstance(gesture.target, Point) and gesture.kind == "press":
            entry = book.enter_goal(viewer, action, selection.name, now)
            place = gesture.target.x, gesture.target.y
            return [book.goal(entry, CAMERA_LEFT, place, gesture.text(), seen, now), shown(entry)]
        entry = book.enter(viewer, action, selection.name, goal_id, now)
        return [SendCommand(**book.marks(entry, gesture.text(), seen, now), text=gesture.text()), shown(entry)]

    def run_sequence(self, viewer: str, message: wire.RunSequence, now: Now) -> list[Effect]:
        """Start a sequence."""
        state, book = self._state, self._book
        name, sequence = state.sequence.chosen(message, [face.name for face in state.scene.faces], state.panel.seen)
        state.machine.check_frame(message.camera, message.stamp_ns, state.config, now)
        state.machine.check_recognition(state.scene.camera_from_panel, state.config, now)
        book.check_ready()
        run_id = book.next_id("ui")
        entry = book.enter(viewer, f"sequence {len(sequence.steps)}", name, run_id, now)
        state.sequence.started(run_id, entry.who, name, sequence)
        seen = {"camera": message.camera, "frame": str(message.stamp_ns)}
        marks = book.marks(entry, " ; ".join(step.text() for step in sequence.steps), seen, now)
        return [SendSequence(**marks, text=f"id: {run_id}\n{sequence.text()}"), shown(entry)]

    def teach(self, viewer: str, message: wire.Hold | wire.Teach, now: Now) -> list[Effect]:
        """Hold an image for a lesson, or order the lesson."""
        state, book = self._state, self._book
        state.pages[viewer].need(Role.ENGINEER)
        if state.moving:
            raise Refusal("busy_moving")
        if state.log.at_work("teach"):  # it uses the image that is held now
            raise Refusal("busy_pending")
        if isinstance(message, wire.Hold):
            return [HoldPicture(viewer=viewer)]
        goal_id = book.next_id("service")
        text = teaching_text(message, state.held, goal_id)
        entry = book.enter(viewer, "teach", message.model, goal_id, now)
        return [SendTeaching(**book.marks(entry, f"teach {text}", {}, now), text=text), shown(entry)]

    def call(self, viewer: str, message: wire.Call, now: Now) -> list[Effect]:
        """Order a call of a service."""
        state, book = self._state, self._book
        service, late_s = message.service, now.mono_s - message.sent_s
        # All other orders name an image; a link may be too slow for images.
        limit_s = 2 * state.config.frame_max_age_s
        if late_s > limit_s and service != "disable":
            raise Refusal("came_late", late_ms=round(late_s * 1e3), limit_ms=round(limit_s * 1e3))
        # Another page's STOP can overtake this call on a slow link: a reset would undo a stop that its sender has not
        # seen.
        if message.sent_s < state.stop_wanted_s and service != "disable":
            raise Refusal("before_stop")
        if service in _MOVE:
            state.machine.check_still()
        if service in _FOR_ENGINEERS:
            state.pages[viewer].need(Role.ENGINEER)
        if service == RESET and self._early.waits(now):
            return []
        entry = book.enter(viewer, service, "", f"service-{state.log.count + 1}", now)
        order = CallService(**book.marks(entry, service, {}, now), service=service)
        if service == RESET:
            self._early.ordered(order, now)
        return [order, shown(entry)]
