"""The operator's desk: what pages may do, what goes out to the graph, and when to stop. Messages in, effects out.

No clock, socket or ROS here: every call gets :class:`Now` and returns the effects for the server to carry out.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from icu_common.core.frames import CAMERA_LEFT
from icu_common.core.geometry import Array, Transform
from icu_common.core.gesture import Gesture, GestureError, Point, parse_gesture
from icu_common.core.results import GoalResult, Outcome
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.effects import (
    Broadcast,
    CallService,
    Effect,
    Heartbeat,
    Now,
    Order,
    Record,
    Send,
    SendCommand,
    SendGoal,
    StopNow,
)
from scope_ui_bridge.core.lease import OperatorLease
from scope_ui_bridge.core.refusal import Refusal
from scope_ui_bridge.core.scene import Scene, moved_m

HEARTBEAT_PERIOD_S = 0.2
STATE_PERIOD_S = (0.1, 1.0)
_MESSAGES_PER_S, _BURST = 40.0, 80.0
_SAME_STOP_S = 0.5
_MOVING = {
    "driver": {"moving", "homing"},
    "controller": {"moving", "looking", "touching"},
    "calibration": {"calibrating"},
}
GESTURES_OF = {
    "button": ("press", "hold"),
    "knob": ("turn", "press"),
    "touch_area": ("press", "hold"),
    "connector": (),
    "point": ("press", "hold"),
}
_WATCHDOG = "Watchdog"


def split_state(text: str) -> tuple[str, str]:
    """Split ``state: reason`` or ``calibrating 3/12`` into the state's name and the rest."""
    name, _, reason = text.partition(":")
    head, _, progress = name.strip().partition(" ")
    return head, (reason.strip() or progress.strip())


@dataclass(frozen=True, slots=True, kw_only=True)
class LogEntry:
    """One line of the command log; ``status``: sent, accepted, reached, aborted, rejected, done, failed, no_answer."""

    entry: int
    goal_id: str
    wall_ms: int
    who: str
    action: str
    target: str
    status: str
    reason: str = ""
    error_mm: float | None = None
    duration_s: float | None = None
    sent_mono_s: float = 0.0

    def message(self) -> dict[str, Any]:
        """Return what the page gets."""
        fields = ("entry", "wall_ms", "who", "action", "target", "status", "reason", "error_mm", "duration_s")
        return {name: getattr(self, name) for name in fields}


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """What the operator has chosen, and where the panel was then."""

    number: int
    camera: str
    control: str
    kind: str
    label: str
    pixel: tuple[float, float] | None
    in_panel: Array
    camera_from_panel: Transform

    def message(self) -> dict[str, Any]:
        """Return what the page gets."""
        x_mm, y_mm = (round(float(v) * 1000, 1) for v in self.in_panel[:2])
        return {
            "number": self.number,
            "camera": self.camera,
            "control": self.control,
            "kind": self.kind,
            "label": self.label,
            "pixel": list(self.pixel) if self.pixel else None,
            "panel_mm": [x_mm, y_mm],
            "gestures": list(GESTURES_OF.get(self.kind, ())),
        }


@dataclass(slots=True)
class _Viewer:
    name: str
    last_seq: int = -1
    tokens: float = _BURST
    refilled_s: float = 0.0
    told_rate_s: float = -math.inf


class Desk:
    """All pages and the machine they look at.

    Parameters
    ----------
    config
        Limits; may be replaced while running.
    boot_id
        Names this run of the server; messages of pages that knew another run are refused.
    title
        The instrument's name for people.
    """

    def __init__(self, config: BridgeConfig, boot_id: str, title: str = "") -> None:
        self.config = config
        self.boot_id = boot_id
        self.title = title
        self.scene = Scene()
        self.lease = OperatorLease()
        self.stops = 0
        self._viewers: dict[str, _Viewer] = {}
        self._viewer_count = 0
        self._states = {"driver": "", "controller": "", "calibration": ""}
        self._confidence = math.nan
        self._confidence_s = -math.inf
        self._position: tuple[float, float, float] | None = None
        self._frames: dict[str, deque[int]] = {camera: deque(maxlen=90) for camera in wire.CAMERAS}
        self._log: deque[LogEntry] = deque(maxlen=200)
        self._pending: dict[str, LogEntry] = {}
        self._entry_count = 0
        self._selection: Selection | None = None
        self._selection_count = 0
        self._last_goal_ns = 0
        self._last_stop = (-math.inf, "", 0)
        self._presses: deque[str] = deque(maxlen=64)
        self._last_heartbeat_s = -math.inf
        self._last_active_s = -math.inf
        self._last_state: tuple[float, dict[str, Any]] = (-math.inf, {})

    # --- pages -----------------------------------------------------------------------------------------------------

    def join(self, name: str) -> tuple[str, dict[str, Any]]:
        """Add a page of the user ``name``; return its id and the first message for it.

        Raises
        ------
        Refusal
            ``too_many_viewers``.
        """
        if len(self._viewers) >= self.config.max_viewers:
            raise Refusal("too_many_viewers", limit=self.config.max_viewers)
        self._viewer_count += 1
        viewer = f"v{self._viewer_count}"
        self._viewers[viewer] = _Viewer(name)
        limits = {
            "amber_ms": self.config.frame_amber_s * 1e3,
            "max_age_ms": self.config.frame_max_age_s * 1e3,
            "stale_ms": self.config.frame_stale_s * 1e3,
        }
        return viewer, {
            "type": "hello",
            "boot": self.boot_id,
            "you": {"id": viewer, "name": name},
            "title": self.title,
            "limits": limits,
            "log": [entry.message() for entry in self._log],
            "selection": self._selection.message() if self._selection else None,
            "state": self._snapshot_now(),
        }

    def leave(self, viewer: str, now: Now) -> list[Effect]:
        """Remove a page; when it was the operator's and something moves, stop."""
        self._viewers.pop(viewer, None)
        return self._lose_lease(viewer, "stopped_page_gone", now)

    def message(self, viewer: str, text: str | bytes, now: Now) -> list[Effect]:
        """Take one text of a page and return what is to be done; anything bad is answered, nothing moves."""
        seq: int | None = None
        try:
            message = wire.decode(text)
            seq = message.seq
            if isinstance(message, wire.Stop):  # before every other check: a stop is always good
                effects = self.stop(self._viewers[viewer].name, now, press=message.press)
                return [*effects, self._answer(viewer, seq)]
            self._admit(viewer, message, now)
            return self._dispatch(viewer, message, now)
        except Refusal as refusal:
            if refusal.code == "rate_limited" and not self._may_tell_rate(viewer, now):
                return []
            return [Send(viewer=viewer, message={"type": "answer", "seq": seq, "ok": False, **refusal.message()})]

    def _admit(self, viewer: str, message: wire.Message, now: Now) -> None:
        state = self._viewers[viewer]
        state.tokens = min(_BURST, state.tokens + (now.mono_s - state.refilled_s) * _MESSAGES_PER_S)
        state.refilled_s = now.mono_s
        if state.tokens < 1:
            raise Refusal("rate_limited", limit=_MESSAGES_PER_S)
        state.tokens -= 1
        if message.boot != self.boot_id:
            raise Refusal("old_boot")
        if message.seq <= state.last_seq:
            raise Refusal("replayed", found=message.seq, last=state.last_seq)
        state.last_seq = message.seq

    def _may_tell_rate(self, viewer: str, now: Now) -> bool:
        state = self._viewers[viewer]
        if now.mono_s - state.told_rate_s < 1.0:
            return False
        state.told_rate_s = now.mono_s
        return True

    def _dispatch(self, viewer: str, message: wire.Message, now: Now) -> list[Effect]:
        if isinstance(message, wire.Alive):
            self.lease.alive(viewer, now.mono_s)
            return [Send(viewer=viewer, message={"type": "alive", "client_ms": message.client_ms})]
        if isinstance(message, wire.Lease):
            return [*self._lease_step(viewer, message.step, now), self._answer(viewer, message.seq)]
        self.lease.check(viewer, message.epoch)
        if isinstance(message, wire.Select):
            return [*self._select(message, now), self._answer(viewer, message.seq)]
        if isinstance(message, wire.Act):
            return [*self._act(viewer, message, now), self._answer(viewer, message.seq)]
        assert isinstance(message, wire.Call)
        return [*self._call(viewer, message.service, now), self._answer(viewer, message.seq)]

    @staticmethod
    def _answer(viewer: str, seq: int) -> Send:
        return Send(viewer=viewer, message={"type": "answer", "seq": seq, "ok": True})

    # --- stop, lease, keep-alive -----------------------------------------------------------------------------------

    def stop(self, who: str, now: Now, code: str = "", press: str = "") -> list[Effect]:
        """Stop, for whoever asks; ``code`` says why when it was not a person.

        One press of the button arrives on two ways, which ``press`` (or half a second) tells. The stop has gone out
        then; a second one would end the driver's lifting of the stylus (docs/decisions/stopping.md).
        """
        self.stops += 1
        last_s, last_who, last_entry = self._last_stop
        quick = who == last_who and now.mono_s - last_s < _SAME_STOP_S and last_entry == self._entry_count
        if quick or (press and press in self._presses):
            return []
        self._presses.append(press)
        entry = self._new_entry(who, "stop", code, now, status="done")
        self._last_stop = (now.mono_s, who, entry.entry)
        return [StopNow(record=self._record(who, "stop", code, now)), self._shown(entry)]

    def tick(self, now: Now) -> list[Effect]:
        """Call every 50 ms: heartbeat, watchdog, answers that did not come, state for the pages."""
        effects: list[Effect] = []
        silence = self.lease.silence_s(now.mono_s)
        if (
            silence <= self.config.keepalive_fresh_s
            and now.mono_s - self._last_heartbeat_s >= HEARTBEAT_PERIOD_S - 0.01
        ):
            self._last_heartbeat_s = now.mono_s
            effects.append(Heartbeat())
        if self.lease.holder and (
            (silence >= self.config.silence_stop_s and self.moving) or silence >= self.config.lease_timeout_s
        ):
            effects += self._lose_lease(self.lease.holder, "stopped_page_silent", now)
        effects += self._expire(now)
        state = self._snapshot(now)
        fastest, slowest = STATE_PERIOD_S
        age = now.mono_s - self._last_state[0]
        if age >= slowest or (age >= fastest - 0.01 and state != self._last_state[1]):
            self._last_state = (now.mono_s, state)
            effects.append(Broadcast(message={"type": "state", **state}))
        return effects

    def _lose_lease(self, viewer: str, code: str, now: Now) -> list[Effect]:
        moving = self.moving
        if not self.lease.release(viewer):
            return []
        effects = self.stop(_WATCHDOG, now, code) if moving else []
        return effects + self._clear_selection()

    def _lease_step(self, viewer: str, step: str, now: Now) -> list[Effect]:
        epoch = self.lease.epoch
        if step == "take":
            self.lease.take(viewer, now.mono_s)
        elif step == "request":
            self.lease.request(viewer, now.mono_s)
        elif step == "release":
            return self._lose_lease(viewer, "stopped_released", now) + [self._state_effect(now)]
        elif step == "decline":
            self.lease.decline(viewer)
        else:
            if self.moving:
                raise Refusal("busy_moving")
            self.lease.grant(viewer, now.mono_s)
        cleared = self._clear_selection() if self.lease.epoch != epoch else []
        return [*cleared, self._state_effect(now)]

    def _clear_selection(self) -> list[Effect]:
        had = self._selection is not None
        self._selection = None
        return [Broadcast(message={"type": "selection", "selection": None})] if had else []

    def still_wanted(self, order: Order) -> bool:
        """Tell whether an order may still go out: no stop and no change of hands since it was made."""
        return order.stops == self.stops and order.epoch == self.lease.epoch and bool(self.lease.holder)

    # --- selection and actuation -----------------------------------------------------------------------------------

    def frame_offered(self, camera: str, stamp_ns: int) -> None:
        """Note that pages may have got the picture with this stamp."""
        self._frames[camera].append(stamp_ns)

    def _check_frame(self, camera: str, stamp_ns: int, now: Now) -> None:
        if stamp_ns not in self._frames[camera]:
            raise Refusal("frame_unknown", stamp=str(stamp_ns))
        age_s = (now.ros_ns - stamp_ns) / 1e9
        if age_s > self.config.frame_max_age_s:
            raise Refusal("frame_old", age_ms=round(age_s * 1e3), limit_ms=round(self.config.frame_max_age_s * 1e3))

    def _check_recognition(self, now: Now) -> Transform:
        pose = self.scene.camera_from_panel
        if pose is None or math.isnan(self._confidence):
            raise Refusal("panel_not_seen")
        silence_s = now.mono_s - self._confidence_s
        if silence_s > self.config.recognition_max_age_s:
            raise Refusal("recognition_silent", age_s=round(silence_s, 1), limit_s=self.config.recognition_max_age_s)
        if not self._confidence >= self.config.min_confidence:
            raise Refusal(
                "low_confidence", confidence=round(self._confidence, 2), limit=round(self.config.min_confidence, 2)
            )
        return pose

    def _check_ready(self) -> None:
        state, reason = split_state(self._states["controller"])
        if not state:
            raise Refusal("no_controller")
        if state != "ready":
            raise Refusal("not_ready", state=state, reason=reason)

    def _select(self, message: wire.Select, now: Now) -> list[Effect]:
        if not message.control and message.point_px is None:
            return self._clear_selection()
        self._check_frame(message.camera, message.stamp_ns, now)
        pose = self._check_recognition(now)
        if message.control:
            face = self.scene.face(message.control)
            if face is None:
                raise Refusal("unknown_control", control=message.control)
            if not GESTURES_OF.get(face.kind):
                raise Refusal("not_operable", control=face.label, kind=face.kind)
            found = (face.name, face.kind, face.label, np.array(face.centre))
        else:
            assert message.point_px is not None
            found = ("", "point", "", self._on_panel(message.camera, message.point_px))
        self._selection_count += 1
        self._selection = Selection(
            number=self._selection_count,
            camera=message.camera,
            control=found[0],
            kind=found[1],
            label=found[2],
            pixel=message.point_px,
            in_panel=found[3],
            camera_from_panel=pose,
        )
        return [Broadcast(message={"type": "selection", "selection": self._selection.message()})]

    def _on_panel(self, camera: str, pixel: tuple[float, float]) -> Array:
        if camera != "left":  # a pixel goal has no other frame than the left camera's
            raise Refusal("point_needs_left")
        point = self.scene.panel_point(pixel)
        if point is None:
            raise Refusal("panel_not_seen")
        if not self.scene.on_panel(point):
            raise Refusal("off_panel", x_mm=round(point[0] * 1e3), y_mm=round(point[1] * 1e3))
        return point

    def _act(self, viewer: str, message: wire.Act, now: Now) -> list[Effect]:
        selection = self._selection
        if selection is None or selection.number != message.selection:
            raise Refusal("selection_gone")
        if message.gesture not in GESTURES_OF.get(selection.kind, ()):
            raise Refusal("wrong_gesture", gesture=message.gesture, kind=selection.kind)
        self._check_frame(message.camera, message.stamp_ns, now)
        pose = self._check_recognition(now)
        self._check_ready()
        if self._pending:
            raise Refusal("busy_pending")
        moved = moved_m(selection.camera_from_panel, pose, selection.in_panel)
        if moved > self.config.panel_moved_limit_m:
            self._selection = None
            raise Refusal(
                "panel_moved", moved_mm=round(moved * 1e3, 1), limit_mm=round(self.config.panel_moved_limit_m * 1e3, 1)
            )
        return self._order(viewer, selection, message, now)

    def _order(self, viewer: str, selection: Selection, message: wire.Act, now: Now) -> list[Effect]:
        who = self._viewers[viewer].name
        target: str | Point = selection.control
        if not selection.control:
            assert selection.pixel is not None
            target = Point(x=selection.pixel[0], y=selection.pixel[1], frame=CAMERA_LEFT)
        goal_id = f"ui-{self.boot_id[:6]}-{self._entry_count + 1}"
        gesture = Gesture(kind=message.gesture, target=target, argument=message.argument, id=goal_id)
        try:
            parse_gesture(gesture.text())
        except GestureError as error:
            raise Refusal("malformed", what=str(error)) from error
        as_goal = isinstance(target, Point) and gesture.kind == "press"
        if as_goal:
            self._last_goal_ns = max(now.ros_ns, self._last_goal_ns + 1)
            goal_id = str(self._last_goal_ns)
        action = gesture.kind if math.isnan(gesture.argument) else f"{gesture.kind} {gesture.argument:g}"
        name = selection.label or selection.control
        if not name:
            name = "({:.1f}, {:.1f}) mm".format(*selection.message()["panel_mm"])
        entry = self._new_entry(who, action, name, now, status="sent", goal_id=goal_id)
        record = self._record(who, gesture.text(), name, now) | {
            "camera": message.camera,
            "frame": str(message.stamp_ns),
            "goal_id": goal_id,
        }
        marks: dict[str, Any] = {"entry": entry.entry, "stops": self.stops, "epoch": self.lease.epoch, "record": record}
        order: Effect
        if as_goal:
            assert selection.pixel is not None
            order = SendGoal(**marks, pixel=selection.pixel, stamp_ns=self._last_goal_ns)
        else:
            order = SendCommand(**marks, text=gesture.text())
        return [order, self._shown(entry)]

    def _call(self, viewer: str, service: str, now: Now) -> list[Effect]:
        who = self._viewers[viewer].name
        entry = self._new_entry(who, service, "", now, status="sent", goal_id=f"service-{self._entry_count + 1}")
        record = self._record(who, service, "", now)
        order = CallService(entry=entry.entry, stops=self.stops, epoch=self.lease.epoch, record=record, service=service)
        return [order, self._shown(entry)]

    # --- the log ---------------------------------------------------------------------------------------------------

    def _new_entry(self, who: str, action: str, target: str, now: Now, *, status: str, goal_id: str = "") -> LogEntry:
        self._entry_count += 1
        entry = LogEntry(
            entry=self._entry_count,
            goal_id=goal_id,
            wall_ms=round(now.wall_s * 1e3),
            who=who,
            action=action,
            target=target,
            status=status,
            sent_mono_s=now.mono_s,
        )
        self._log.append(entry)
        if status in ("sent", "accepted"):
            self._pending[goal_id] = entry
        return entry

    def _update(self, entry: LogEntry, **changes: Any) -> LogEntry:
        changed = replace(entry, **changes)
        for index, old in enumerate(self._log):
            if old.entry == entry.entry:
                self._log[index] = changed
        if changed.status in ("sent", "accepted"):
            self._pending[changed.goal_id] = changed
        else:
            self._pending.pop(changed.goal_id, None)
        return changed

    @staticmethod
    def _shown(entry: LogEntry) -> Broadcast:
        return Broadcast(message={"type": "log", "entry": entry.message()})

    @staticmethod
    def _record(who: str, command: str, target: str, now: Now) -> dict[str, Any]:
        return {"wall_s": round(now.wall_s, 3), "who": who, "command": command, "target": target}

    def _expire(self, now: Now) -> list[Effect]:
        effects: list[Effect] = []
        if self._active:
            self._last_active_s = now.mono_s
        for entry in list(self._pending.values()):
            # An accepted goal may take its time, but not while the controller rests: then its end was lost.
            since_s = max(entry.sent_mono_s, self._last_active_s if entry.status == "accepted" else -math.inf)
            if now.mono_s - since_s > self.config.answer_timeout_s:
                effects.append(self._shown(self._update(entry, status="no_answer")))
        return effects

    def order_failed(self, order: Order, reason: str) -> list[Effect]:
        """Note that an order did not go out (no controller, audit file not writable, stopped in between)."""
        entry = next((e for e in self._pending.values() if e.entry == order.entry), None)
        return [self._shown(self._update(entry, status="failed", reason=reason))] if entry else []

    def service_answered(self, number: int, success: bool, text: str, now: Now) -> list[Effect]:
        """Note the answer of a service that log entry ``number`` asked."""
        entry = next((e for e in self._pending.values() if e.entry == number), None)
        if entry is None:
            return []
        changed = self._update(entry, status="done" if success else "rejected", reason=text)
        return [self._shown(changed), self._result_record(changed, now)]

    def result(self, result: GoalResult, now: Now) -> list[Effect]:
        """Note an answer of the controller, to this page's commands or anybody's."""
        known = self._pending.get(result.goal_id)
        if known is None:
            if result.outcome.final and result.outcome is not Outcome.REJECTED:
                return []  # the end of something whose beginning was long ago
            known = self._new_entry("Graph", result.goal, "", now, status="accepted", goal_id=result.goal_id)
        measured = math.isfinite(result.error_m)
        changed = self._update(
            known,
            status=result.outcome.value,
            reason=result.reason,
            error_mm=round(result.error_m * 1e3, 3) if measured else None,
            duration_s=round(result.duration_s, 2) if math.isfinite(result.duration_s) else None,
        )
        return [self._shown(changed), self._result_record(changed, now)]

    def _result_record(self, entry: LogEntry, now: Now) -> Record:
        record = self._record(entry.who, entry.action, entry.target, now)
        return Record(
            record=record
            | {"result": entry.status, "reason": entry.reason, "error_mm": entry.error_mm, "goal_id": entry.goal_id}
        )

    # --- what the graph says ---------------------------------------------------------------------------------------

    def set_state(self, part: str, text: str) -> None:
        """``part`` is driver, controller or calibration; text as on its state topic."""
        self._states[part] = text

    def set_confidence(self, confidence: float, now: Now) -> None:
        """Note the recognition's confidence, 0 = not recognised."""
        self._confidence, self._confidence_s = confidence, now.mono_s

    def set_position(self, x_m: float, y_m: float, stylus_m: float) -> None:
        """Note where the tip is: x, y in base_link, the stylus's extension; metres."""
        self._position = (x_m, y_m, stylus_m)

    @property
    def _active(self) -> bool:
        return any(split_state(self._states[part])[0] in names for part, names in _MOVING.items())

    @property
    def moving(self) -> bool:
        """Whether something moves or is about to."""
        return self._active or any(not entry.goal_id.startswith("service-") for entry in self._pending.values())

    def _snapshot(self, now: Now) -> dict[str, Any]:
        try:
            self._check_recognition(now)
            self._check_ready()
            refusal = None
        except Refusal as why:
            refusal = why.message()
        return self._snapshot_now() | {"refusal": refusal}

    def _snapshot_now(self) -> dict[str, Any]:
        states = {part: dict(zip(("state", "reason"), split_state(text))) for part, text in self._states.items()}
        x, y, stylus = self._position or (math.nan,) * 3
        lease = self.lease
        return {
            **states,
            "confidence": None if math.isnan(self._confidence) else round(self._confidence, 2),
            "position_mm": [round(x * 1e3, 2), round(y * 1e3, 2), round(stylus * 1e3, 2)] if self._position else None,
            "moving": self.moving,
            "lease": {
                "epoch": lease.epoch,
                "holder": lease.holder,
                "holder_name": self._name(lease.holder),
                "requester": lease.requester,
                "requester_name": self._name(lease.requester),
            },
            "viewers": len(self._viewers),
            "refusal": None,
        }

    def _state_effect(self, now: Now) -> Broadcast:
        state = self._snapshot(now)
        self._last_state = (now.mono_s, state)
        return Broadcast(message={"type": "state", **state})

    def _name(self, viewer: str) -> str:
        return self._viewers[viewer].name if viewer in self._viewers else ""
