"""The operator's desk: which actions pages may take, which orders go to the graph, and when to stop.

It has no clock, socket or ROS: every call takes :class:`Now` and returns the effects for the server to carry out.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from icu_common.core.geometry.frames import BASE, CAMERA_LEFT
from icu_common.core.geometry.geometry import Array
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.gesture import Point
from icu_common.core.processes.delays import ResultCode
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access import FLOODING, SHORT, Role, Viewer
from scope_ui_bridge.core.admission import KEPT_PLACES, OfUsers, UserBudget
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.control import HeldJog, OperatorLease, StopCauses
from scope_ui_bridge.core.effects import (
    Broadcast,
    CallService,
    Effect,
    End,
    Heartbeat,
    HoldPicture,
    Now,
    Order,
    Ping,
    Record,
    Send,
    SendCommand,
    SendGoal,
    SendSequence,
    SendTeaching,
    StopNow,
)
from scope_ui_bridge.core.orders import (
    HeldPicture,
    Selection,
    action_text,
    goal_words,
    make_gesture,
    make_selection,
    result_words,
    teaching_text,
)
from scope_ui_bridge.core.records import CommandLog, LogEntry, ParameterChanges, record, result_record, shown
from scope_ui_bridge.core.status import MachineView, PanelView, Recordings, SequenceView
from scope_ui_bridge.core.video import Scene
from scope_ui_bridge.core.wire import Refusal

HEARTBEAT_PERIOD_S = 0.1
"""Seconds between heartbeats.

When the next beat arrives late, the driver's newest beat is at most that delay plus 0.1 s old. So 0.5 s of the driver's
timeout (0.6 s) remain for the delay of a bridge on a busy computer.
"""
STATE_PERIOD_S = (0.1, 1.0)
_SAME_STOP_S = 0.5
_WATCHDOG, _RECORDER = "Watchdog", "bag_record"
_TIP_SEEN_NS = 1_000_000_000
_CLOCK_JUMP_NS = 100_000_000
_SETS_OUT_S = 1.0
"""How long a published path may precede the `moving` state; the driver rejects it afterwards."""
_MAX_LINES = 40  # per tick
_KEPT_LINES = 100  # for engineers who connect later
_REMEMBERED = 32  # users who have or have had control
_FOR_ENGINEERS = ("accept_settings",)
_MOVE = ("home", "calibrate")


class Desk:
    """All pages and the machine that they operate.

    Parameters
    ----------
    config
        Limits; may be replaced while running.
    boot_id
        Id of this run of the server; messages for another run are refused.
    title
        Name of the instrument as shown to people.
    robot
        Id of this robot, constant over restarts: a browser may reach another robot under the same address.
    """

    def __init__(self, config: BridgeConfig, boot_id: str, title: str = "", robot: str = "") -> None:
        self.config = config
        self.boot_id = boot_id
        self.title = title
        self.robot = robot
        self.scene = Scene()
        self.machine = MachineView()
        self.panel = PanelView()
        self.sequence = SequenceView()
        self.recordings = Recordings()
        self.held: HeldPicture | None = None
        self.lease = OperatorLease()
        self.stops = 0
        self._causes = StopCauses()
        self._viewers: dict[str, Viewer] = {}
        self._viewer_count = 0
        self._budgets = OfUsers(UserBudget)
        self._had_control: deque[str] = deque(maxlen=_REMEMBERED)
        self._log = CommandLog()
        self.parameters = ParameterChanges(self._log)
        self._selection: Selection | None = None
        self._selection_count = 0
        self._jog: HeldJog | None = None
        self._refused_jog: tuple[HeldJog, str] | None = None
        self._last_goal_ns = 0
        self._last_stop = (-math.inf, "", 0)
        self._wanted_stop_s = -math.inf
        self._presses: deque[str] = deque(maxlen=64)
        self._last_heartbeat_s = -math.inf
        self._sets_out_until_s = -math.inf
        self._last_state: tuple[float, dict[str, Any]] = (-math.inf, {})
        empty: dict[str, Any] = {"facts": {}, "panel": [], "sequence": {}, "recordings": []}
        self._told = {"limits": self._limits(), **empty}
        self._now_s = 0.0
        self._ticked_s = math.inf
        self._ros_ns = 0
        self._said: list[dict[str, Any]] = []
        self._passed_on: deque[dict[str, Any]] = deque(maxlen=_KEPT_LINES)

    # --- pages -----------------------------------------------------------------------------------------------------

    def begun(self, now: Now) -> list[Effect]:
        """Return this run's first line in the audit file: no page has control, however the last run ended."""
        return [Record(record=record("the bridge", "start", self.boot_id, now))]

    @property
    def has_viewers(self) -> bool:
        """Whether a page is connected; may be read from any thread."""
        return bool(self._viewers)

    def join(self, name: str, role: Role = Role.OPERATOR, by_password: bool = False) -> tuple[str, dict[str, Any]]:
        """Add a page of the user ``name``; return its id and the first message for it.

        ``by_password`` is whether its user signs in by password or by token.

        Raises
        ------
        Refusal
            ``too_many_viewers``.
        """
        kept = KEPT_PLACES if self.had_control(name) else 0
        if len(self._viewers) >= self.config.max_viewers + kept:
            raise Refusal("too_many_viewers", limit=self.config.max_viewers)
        self._viewer_count += 1
        viewer = f"v{self._viewer_count}"
        self._viewers[viewer] = Viewer(name, role, user=self._budgets[name])
        return viewer, {
            "type": "hello",
            "boot": self.boot_id,
            "you": {"id": viewer, "name": name, "role": role.value, "by_password": by_password},
            "title": self.title,
            "robot": self.robot,
            "replay": self.config.replay,
            "facts": self.machine.facts,
            "panel": self.panel.message,
            "sequence": self.sequence.message(),
            "sequences": self.sequence.stored_message(),
            "recordings": self.recordings.message(self._now_s),
            "limits": self._limits(),
            "log": self._log.messages(),
            "console": list(self._passed_on) if role is Role.ENGINEER else [],
            "selection": self._selection.message() if self._selection else None,
            "state": self._snapshot_now(),
        }

    def had_control(self, name: str) -> bool:
        """Return whether a user has or has had control; connection slots are reserved for these users."""
        return name in self._had_control

    def _limits(self) -> dict[str, float]:
        return {
            "amber_ms": self.config.frame_amber_s * 1e3,
            "max_age_ms": self.config.frame_max_age_s * 1e3,
            "stale_ms": self.config.frame_stale_s * 1e3,
            "jog_step_mm": self.config.jog_step_max_m * 1e3,
        }

    def signed_in(self, viewer: str, until_s: float) -> None:
        """Set the end of a page's sign-in, in monotonic seconds; signing in again before it extends it."""
        self._viewers[viewer].signed_in_until_s = until_s

    def leave(self, viewer: str, now: Now, code: str = "stopped_page_gone") -> list[Effect]:
        """Remove a page; stop if it was the operator's and something moves. ``code`` is the reason for its end."""
        effects = self._lose_lease(viewer, code, now)
        self._viewers.pop(viewer, None)
        return effects

    def message(self, viewer: str, text: str | bytes, now: Now) -> list[Effect]:
        """Process one text of a page and return its effects; an invalid text is answered and moves nothing.

        Size and rate are limited before the text is read, except for a possible stop.
        """
        seq: int | None = None
        selected, page = self._selection, self._viewers[viewer]
        longest = wire.MAX_BYTES if viewer == self.lease.holder else SHORT
        try:
            unlimited = page.may_stop(text, now.mono_s)
            if not unlimited:
                page.limit(len(text), longest, now.mono_s)
            message = wire.decode(text)
            if isinstance(message, wire.Stop):  # before every other check: a stop is always accepted
                effects = self.stop(page.name, now, press=message.press)
                return [*effects, self._answer(viewer, message.seq)]
            if unlimited:
                page.limit(len(text), longest, now.mono_s)
            seq = message.seq
            page.admit(message, self.boot_id)
            return self._dispatch(viewer, message, now)
        except Refusal as refusal:
            if refusal.code == FLOODING:
                return [End(viewer=viewer)]
            if refusal.code == "rate_limited" and not page.may_tell_rate(now.mono_s):
                return []
            gone = selected is not None and self._selection is None
            told: list[Effect] = [_selection_shown(None)] if gone else []
            seq = wire.seq_of(text) if seq is None else seq
            answer = {"type": "answer", "seq": seq, "ok": False, **refusal.message()}
            return [*told, Send(viewer=viewer, message=answer)]

    def _dispatch(self, viewer: str, message: wire.Message, now: Now) -> list[Effect]:
        if isinstance(message, wire.Alive):
            self.lease.alive(viewer, now.mono_s)
            if viewer == self.lease.holder:
                self._causes.alive()
            clocks = {"bridge_ms": now.mono_s * 1e3, "wall_ms": now.wall_s * 1e3}
            left_s = self._viewers[viewer].signed_in_until_s - now.mono_s
            ends = {"sign_in_ends_s": round(left_s, 1)} if left_s <= self.config.sign_in_warning_s else {}
            return [Send(viewer=viewer, message={"type": "alive", "client_ms": message.client_ms, **clocks, **ends})]
        if isinstance(message, wire.Hidden):
            if viewer != self.lease.holder:
                return []
            self._causes.hidden()
            return self._lose_lease(viewer, "stopped_page_hidden", now) if self.moving else []
        if isinstance(message, wire.Blind):
            if viewer != self.lease.holder or not self.moving:
                return []
            return self._stop_unseen("stopped_page_blind", message.silence_ms / 1e3, now)
        if isinstance(message, wire.Lease):
            return [*self._lease_step(viewer, message, now), self._answer(viewer, message.seq)]
        self.lease.check(viewer, message.epoch)
        self._viewers[viewer].check_after_stop(message.seq)
        effects: list[Effect]
        if isinstance(message, wire.Select):
            effects = self._select(message, now)
        elif isinstance(message, wire.Act):
            effects = self._act(viewer, message, now)
        elif isinstance(message, wire.Move):
            effects = self._move(viewer, message, now)
        elif isinstance(message, wire.Jog):
            effects = self._hold_jog(viewer, message, now)
        elif isinstance(message, wire.RunSequence):
            effects = self._run_sequence(viewer, message, now)
        elif isinstance(message, (wire.Hold, wire.Teach)):
            effects = self._teach(viewer, message, now)
        else:
            assert isinstance(message, wire.Call)
            effects = self._call(viewer, message, now)
        return [*effects, self._answer(viewer, message.seq)]

    @staticmethod
    def _answer(viewer: str, seq: int) -> Send:
        return Send(viewer=viewer, message={"type": "answer", "seq": seq, "ok": True})

    # --- stop, lease, keep-alive -----------------------------------------------------------------------------------

    def stop(self, who: str, now: Now, code: str = "", press: str = "", silence_s: float = 0.0) -> list[Effect]:
        """Stop; ``code`` is the cause if it was not a person, ``silence_s`` how long a signal was missing.

        One press of the button arrives by two paths; ``press`` (or half a second) identifies it. The stop has already
        been sent then: a second stop would end the driver's lifting of the stylus (docs/decisions/stopping.md).
        """
        self.stops += 1
        self._jog = None
        if press and press in self._presses:
            return []
        self._wanted_stop_s = now.mono_s
        self._presses.append(press)
        last_s, last_who, last_entry = self._last_stop
        if who == last_who and now.mono_s - last_s < _SAME_STOP_S and last_entry == self._log.count:
            return []
        self._causes.stopped(code, who, silence_s, now.mono_s)
        goal_id = f"service-stop-{self._log.count + 1}"
        entry = self._log.add(who, "stop", code, now, status="sent", goal_id=goal_id)
        self._last_stop = (now.mono_s, who, entry.entry)
        return [StopNow(entry=entry.entry, record=record(who, "stop", code, now)), shown(entry)]

    def stop_overtakes(self, viewer: str, who: str, seq: int) -> None:
        """Refuse orders of ``who``'s page up to ``seq``: a STOP pressed after them arrived first by a faster path."""
        if viewer in self._viewers and self._viewers[viewer].name == who:
            self._viewers[viewer].stopped(seq)

    def tick(self, now: Now) -> list[Effect]:
        """Return the periodic effects (heartbeat, watchdogs, timeouts, state for the pages); call every 50 ms."""
        effects: list[Effect] = []
        self._ros_ns, self._now_s, self._ticked_s = now.ros_ns, now.mono_s, now.mono_s
        self._causes.tick(self.machine.state("driver")[0], now.mono_s)
        silence = self.lease.silence_s(now.mono_s)
        if (
            silence <= self.config.keepalive_fresh_s
            and now.mono_s - self._last_heartbeat_s >= HEARTBEAT_PERIOD_S - 0.01
        ):
            self._last_heartbeat_s = now.mono_s
            effects.append(Heartbeat())
        if self._causes.wants_ping(silence):
            effects.append(Ping(viewer=self.lease.holder))
        effects += self._watch(silence, now)
        if self.machine.state("driver")[0] == "stopped":  # its answer to the stop may be lost on an overloaded computer
            for number in self._log.open_entries("stop"):
                effects += self.service_answered(number, True, "", now)
        effects += self._log.expire(self.machine.active, self.config.answer_timeout_s, now)
        if self._log.goal(self.sequence.run_id) is None:
            self.sequence.ended(self.sequence.run_id, "no_answer", "")
        self.machine.expire(now)
        self.panel.expire(self.config.recognition_max_age_s, now)
        effects += self._pass_on()
        state = self._snapshot(now)
        fastest, slowest = STATE_PERIOD_S
        age = now.mono_s - self._last_state[0]
        if age >= slowest or (age >= fastest - 0.01 and state != self._last_state[1]):
            self._last_state = (now.mono_s, state)
            effects.append(Broadcast(message={"type": "state", **state}))
        return effects

    def pong(self, viewer: str) -> None:
        """Record that the browser of a page has answered a :class:`Ping`."""
        if viewer == self.lease.holder:
            self._causes.answered()

    def said(self, line: dict[str, Any]) -> None:
        """Keep a log line of a program of the graph (wall_ms, level, name, text) for the engineers' consoles."""
        if len(self._said) < _MAX_LINES:
            self._said.append(line)

    def _pass_on(self) -> list[Effect]:
        lines, self._said = self._said, []
        self._passed_on.extend(lines)
        engineers = [viewer for viewer, page in self._viewers.items() if page.role is Role.ENGINEER]
        effects: list[Effect] = []
        if lines:
            effects += [Send(viewer=viewer, message={"type": "console", "lines": lines}) for viewer in engineers]
        for kind, key, value in (
            ("limits", "limits", self._limits()),
            ("facts", "facts", dict(self.machine.facts)),
            ("panel", "controls", self.panel.message),
            ("sequence", "sequence", self.sequence.message()),
            ("recordings", "recordings", self.recordings.message(self._now_s)),
        ):
            if value != self._told[kind]:
                self._told[kind] = value
                effects.append(Broadcast(message={"type": kind, key: value}))
        return effects

    def _watch(self, silence_s: float, now: Now) -> list[Effect]:
        blind_s = self.machine.blind_s(now)
        if not self.lease.holder:
            return []
        if (silence_s >= self.config.silence_stop_s and self.moving) or silence_s >= self.config.lease_timeout_s:
            return self._lose_lease(self.lease.holder, self._causes.of_silence(now.mono_s), now, silence_s)
        if blind_s >= self.config.picture_stop_s:
            return self._stop_unseen(self._causes.of_blindness(now.mono_s), blind_s, now)
        return []

    def _stop_unseen(self, code: str, silence_s: float, now: Now) -> list[Effect]:
        if self._last_stop[1:] == (_WATCHDOG, self._log.count):  # nothing was started since
            return []
        return self.stop(_WATCHDOG, now, code, silence_s=silence_s)

    def _lose_lease(self, viewer: str, code: str, now: Now, silence_s: float = 0.0) -> list[Effect]:
        moving = self.moving
        if not self.lease.release(viewer):
            return []
        effects = self.stop(_WATCHDOG, now, code, silence_s=silence_s) if moving else []
        own = code == "stopped_released"
        reason = {} if own else {"reason": code.removeprefix("stopped_").replace("_", " ")}
        passed = self._passed(self._name(viewer), "release control" if own else "lose control", viewer, now, **reason)
        return [*effects, passed, *self._clear_selection()]

    def _passed(self, who: str, command: str, page: str, now: Now, target: str = "", **more: str) -> Record:
        """Return the line of the audit file about a change of control; ``page`` is the page that got or had it."""
        passed = {"result": "done", "page": page, "epoch": self.lease.epoch}
        return Record(record=record(who, command, target, now) | passed | more)

    def _lease_step(self, viewer: str, message: wire.Lease, now: Now) -> list[Effect]:
        step = message.step
        if step in ("take", "request"):
            if self.config.replay:
                raise Refusal("replay")
            self._viewers[viewer].need(Role.OPERATOR)
        epoch = self.lease.epoch
        if step == "take":
            self.lease.take(viewer, now.mono_s)
        elif step == "request":
            self.lease.request(viewer, now.mono_s)
        elif step == "release":
            return self._lose_lease(viewer, "stopped_released", now) + [self._state_effect(now)]
        elif step == "decline":
            self.lease.decline(viewer, message.to)
        else:
            if self.moving:
                raise Refusal("busy_moving")
            self.lease.grant(viewer, message.to, now.mono_s)
        if self.lease.epoch == epoch:
            return [self._state_effect(now)]
        holder_name = self._name(self.lease.holder)
        if holder_name not in self._had_control:
            self._had_control.append(holder_name)
        given = step == "grant"
        command, holder = "hand over control" if given else "take control", self.lease.holder
        passed = self._passed(self._name(viewer), command, holder, now, self._name(holder) if given else "")
        return [passed, *self._clear_selection(), self._state_effect(now)]

    def _clear_selection(self) -> list[Effect]:
        had = self._selection is not None
        self._selection = None
        return [_selection_shown(None)] if had else []

    def still_wanted(self, order: Order, now: Now) -> bool:
        """Return whether an order may still be sent: no stop and no change of control since, and not given up.

        A jog step must also still be held, or recently requested. A bridge that was suspended sends nothing until its
        next tick has checked whether the page is still there.
        """
        if now.mono_s - self._ticked_s > self.config.silence_stop_s:
            return False
        held = self._jog is not None and self._jog.entry == order.entry and now.mono_s <= self._jog.until_s
        if now.mono_s > order.until_s and not held:
            return False
        same_hands = order.epoch == self.lease.epoch and bool(self.lease.holder)
        return order.stops == self.stops and same_hands and self._log.open_entry(order.entry) is not None

    # --- selection and actuation -----------------------------------------------------------------------------------

    def _select(self, message: wire.Select, now: Now) -> list[Effect]:
        if not message.control and message.point_px is None and message.line_m is None:
            return self._clear_selection()
        # A refused click clears the selection: a confirmation after it would not mean the previous one.
        self._selection = None
        self.machine.check_frame(message.camera, message.stamp_ns, self.config, now)
        pose = self.machine.check_recognition(self.scene.camera_from_panel, self.config, now)
        self._selection = make_selection(self._selection_count + 1, message, self.scene, pose, self.panel.seen)
        self._selection_count += 1
        return [_selection_shown(self._selection)]

    def _act(self, viewer: str, message: wire.Act, now: Now) -> list[Effect]:
        selection = self._selection
        if selection is None or selection.number != message.selection:
            raise Refusal("selection_gone")
        if selection.faces != self.scene.faces:  # another panel may have a control of the same name
            self._selection = None
            raise Refusal("selection_gone")
        goal_id = f"ui-{self.boot_id[:6]}-{self._log.count + 1}"
        gesture = make_gesture(selection, message, self.panel.seen, goal_id)
        self.machine.check_frame(message.camera, message.stamp_ns, self.config, now)
        pose = self.machine.check_recognition(self.scene.camera_from_panel, self.config, now)
        self._check_ready()
        moved = selection.moved_m(pose, self.scene.camera_from_base)
        if moved > self.config.panel_moved_limit_m:
            self._selection = None
            raise Refusal(
                "panel_moved", moved_mm=round(moved * 1e3, 1), limit_mm=round(self.config.panel_moved_limit_m * 1e3, 1)
            )
        seen = {"camera": message.camera, "frame": str(message.stamp_ns)}
        action = action_text(gesture)
        if isinstance(gesture.target, Point) and gesture.kind == "press":
            entry = self._goal_entry(viewer, action, selection.name, now)
            place = gesture.target.x, gesture.target.y
            return [self._goal(entry, CAMERA_LEFT, place, gesture.text(), seen, now), shown(entry)]
        entry = self._log.add(self._name(viewer), action, selection.name, now, status="sent", goal_id=goal_id)
        return [SendCommand(**self._marks(entry, gesture.text(), seen, now), text=gesture.text()), shown(entry)]

    def _check_ready(self) -> None:
        self.sequence.check_idle()
        self.machine.check_ready()
        if self._log.waiting:
            raise Refusal("busy_pending")

    def _run_sequence(self, viewer: str, message: wire.RunSequence, now: Now) -> list[Effect]:
        name, sequence = self.sequence.chosen(message, [face.name for face in self.scene.faces], self.panel.seen)
        self.machine.check_frame(message.camera, message.stamp_ns, self.config, now)
        self.machine.check_recognition(self.scene.camera_from_panel, self.config, now)
        self._check_ready()
        run_id = f"ui-{self.boot_id[:6]}-{self._log.count + 1}"
        entry = self._log.add(
            self._name(viewer), f"sequence {len(sequence.steps)}", name, now, status="sent", goal_id=run_id
        )
        self.sequence.started(run_id, entry.who, name, sequence)
        seen = {"camera": message.camera, "frame": str(message.stamp_ns)}
        marks = self._marks(entry, " ; ".join(step.text() for step in sequence.steps), seen, now)
        return [SendSequence(**marks, text=f"id: {run_id}\n{sequence.text()}"), shown(entry)]

    def _teach(self, viewer: str, message: wire.Hold | wire.Teach, now: Now) -> list[Effect]:
        self._viewers[viewer].need(Role.ENGINEER)
        if self.moving:
            raise Refusal("busy_moving")
        if self._log.at_work("teach"):  # it uses the image that is held now
            raise Refusal("busy_pending")
        if isinstance(message, wire.Hold):
            return [HoldPicture(viewer=viewer)]
        goal_id = f"service-{self.boot_id[:6]}-{self._log.count + 1}"
        text = teaching_text(message, self.held, goal_id)
        entry = self._log.add(self._name(viewer), "teach", message.model, now, status="sent", goal_id=goal_id)
        return [SendTeaching(**self._marks(entry, f"teach {text}", {}, now), text=text), shown(entry)]

    def picture_held(self, viewer: str, held: HeldPicture | None) -> list[Effect]:
        """Set the held image, and send its stamp and size to the page that requested it."""
        self.held = held
        if held is None:
            return [Send(viewer=viewer, message={"type": "held", "stamp": ""})]
        size = {"width": held.width, "height": held.height}
        return [Send(viewer=viewer, message={"type": "held", "stamp": str(held.stamp_ns), **size})]

    def taught(self, result: GoalResult, now: Now) -> list[Effect]:
        """Process perception's answer to a lesson."""
        known = self._log.goal(result.goal_id)
        if known is None:
            return []
        done = result.outcome is Outcome.REACHED
        details = {**dict(result.details), "type": "taught", "ok": done, "reason": result.reason}
        return [Broadcast(message=details), *self._log.ended(known, result, now)]

    def set_state(self, part: str, text: str) -> None:
        """Set the state of driver, controller, calibration or sequencer; empty if the node is missing."""
        self.machine.set_state(part, text)
        state, reason = self.machine.state(part)
        if part == "controller" and state == "stopped":  # at rest, no result of a goal contains the cause
            self._causes.aborted(reason, self._now_s)
        if part == "sequencer":
            self.sequence.set_state(text)

    def sequence_result(self, result: GoalResult, now: Now) -> list[Effect]:
        """Process a result of the sequencer, for a sequence from here or from another client."""
        self.sequence.result(result)
        return self.result(result, now)

    def _move(self, viewer: str, message: wire.Move, now: Now) -> list[Effect]:
        self._check_move(message.camera, message.stamp_ns, now)
        place = f"({message.x_m * 1e3:.1f}, {message.y_m * 1e3:.1f}) mm"
        entry = self._goal_entry(viewer, "move", place, now)
        seen = {"camera": message.camera, "frame": str(message.stamp_ns)}
        return [self._goal(entry, BASE, (message.x_m, message.y_m), f"move {place}", seen, now), shown(entry)]

    def _check_move(self, camera: str, stamp_ns: int, now: Now) -> None:
        self.machine.check_frame(camera, stamp_ns, self.config, now)
        self.sequence.check_idle()
        if self._log.waiting:
            raise Refusal("busy_pending")
        self.machine.check_at_rest()

    def _hold_jog(self, viewer: str, message: wire.Jog, now: Now) -> list[Effect]:
        if message.dx == message.dy == 0:
            self._jog = self._refused_jog = None
            return []
        self.machine.check_frame(message.camera, message.stamp_ns, self.config, now)
        if self._refused_jog is not None and self._refused_jog[0].same(viewer, message):
            raise Refusal("jog_refused", what=self._refused_jog[1])
        if self._jog is not None and self._jog.same(viewer, message):
            self._jog.until_s = now.mono_s + self.config.jog_hold_s
            return []
        self._check_move(message.camera, message.stamp_ns, now)
        if not 0 < message.step_m <= self.config.jog_step_max_m:
            limit_mm = round(self.config.jog_step_max_m * 1e3, 1)
            raise Refusal("jog_step", step_mm=round(message.step_m * 1e3, 3), limit_mm=limit_mm)
        position = self.machine.position
        if position is None or not all(math.isfinite(value) for value in position):
            raise Refusal("position_unknown")
        direction = " ".join(
            f"{'+' if sign > 0 else '-'}{axis}" for axis, sign in zip("xy", (message.dx, message.dy)) if sign
        )
        entry = self._goal_entry(viewer, "jog", direction, now)
        self._refused_jog = None
        self._jog = HeldJog(
            viewer=viewer,
            entry=entry.entry,
            dx=message.dx,
            dy=message.dy,
            step_m=message.step_m,
            xy=position[:2],
            until_s=now.mono_s + self.config.jog_hold_s,
        )
        return [self._jog_step(entry, now), shown(entry)]

    def _jog_step(self, entry: LogEntry, now: Now, *, again: bool = False) -> Order:
        assert self._jog is not None
        x, y = self._jog.xy if again else self._jog.advance()
        goal = self._goal(entry, BASE, (x, y), f"jog ({x * 1e3:.1f}, {y * 1e3:.1f}) mm", {}, now)
        return replace(goal, until_s=self._jog.until_s)

    def _goal_entry(self, viewer: str, action: str, target: str, now: Now) -> LogEntry:
        goal_id = str(self._new_stamp_ns(now))
        return self._log.add(self._name(viewer), action, target, now, status="sent", goal_id=goal_id)

    def _new_stamp_ns(self, now: Now) -> int:
        """Return a stamp later than the last one, unless the clock was set back: future stamps are refused."""
        later_ns = self._last_goal_ns + 1
        self._last_goal_ns = later_ns if 0 < later_ns - now.ros_ns < _CLOCK_JUMP_NS else now.ros_ns
        return self._last_goal_ns

    def _goal(
        self, entry: LogEntry, frame: str, point: tuple[float, float], text: str, seen: dict[str, str], now: Now
    ) -> SendGoal:
        return SendGoal(**self._marks(entry, text, seen, now), frame=frame, point=point, stamp_ns=int(entry.goal_id))

    def _marks(self, entry: LogEntry, text: str, more: dict[str, str], now: Now) -> dict[str, Any]:
        written = record(entry.who, text, entry.target, now) | more | {"goal_id": entry.goal_id}
        return {"entry": entry.entry, "stops": self.stops, "epoch": self.lease.epoch, "record": written}

    def _call(self, viewer: str, message: wire.Call, now: Now) -> list[Effect]:
        service, late_s = message.service, now.mono_s - message.sent_s
        limit_s = 2 * self.config.frame_max_age_s  # all other orders name an image; a link may be too slow for images
        if late_s > limit_s and service != "disable":
            raise Refusal("came_late", late_ms=round(late_s * 1e3), limit_ms=round(limit_s * 1e3))
        # Another page's STOP can overtake this call on a slow link: a reset would undo a stop that its sender has not
        # seen.
        if message.sent_s < self._wanted_stop_s and service != "disable":
            raise Refusal("before_stop")
        if service in _MOVE:
            self.machine.check_still()
        if service in _FOR_ENGINEERS:
            self._viewers[viewer].need(Role.ENGINEER)
        goal_id = f"service-{self._log.count + 1}"
        entry = self._log.add(self._name(viewer), service, "", now, status="sent", goal_id=goal_id)
        return [CallService(**self._marks(entry, service, {}, now), service=service), shown(entry)]

    # --- answers ---------------------------------------------------------------------------------------------------

    def order_failed(self, order: Order, reason: str, now: Now) -> list[Effect]:
        """Record that an order was not sent (no controller, audit file not writable, stopped meanwhile)."""
        entry = self._log.open_entry(order.entry)
        if entry is None:
            return []
        if self._jog is not None and self._jog.entry == order.entry:
            self._jog = None
        self.sequence.ended(entry.goal_id, "failed", reason)
        changed = self._log.update(entry, status="failed", reason=reason)
        return [shown(changed), result_record(changed, now)]

    def service_answered(self, number: int, success: bool, text: str, now: Now) -> list[Effect]:
        """Process the answer of a service to log entry ``number``, or of the driver to a stop."""
        entry = self._log.open_entry(number) or self._log.given_up(number=number)
        if entry is None:
            return []
        refused = "failed" if entry.action == "stop" else "rejected"  # a stop is never refused
        changed = self._log.update(entry, status="done" if success else refused, reason=text)
        return [shown(changed), result_record(changed, now)]

    def recording_ended(self, success: bool, text: str, now: Now) -> list[Effect]:
        """Record that a recording has ended by itself."""
        entry = self._log.add(_RECORDER, "end_record", "", now, status="done" if success else "failed")
        changed = self._log.update(entry, reason=text)
        return [shown(changed), result_record(changed, now)]

    def result(self, result: GoalResult, now: Now) -> list[Effect]:
        """Process a result of the controller, for a command from here or from another client."""
        if result.outcome is Outcome.ABORTED:
            self._causes.aborted(result.reason, now.mono_s)
        known = self._log.goal(result.goal_id) or self._log.given_up(goal_id=result.goal_id)
        if known is None:
            if result.outcome.final and result.outcome is not Outcome.REJECTED:
                return []  # the end of a goal that this log no longer contains
            who = self.sequence.owner_of(result.goal_id) or "Graph"
            action, target = goal_words(result.goal.partition(" id=")[0], self.scene.faces)
            known = self._log.add(who, action, target, now, status="accepted", goal_id=result.goal_id)
        jog = self._jog
        if jog is not None and jog.entry == known.entry and result.outcome.final:
            # A step that reached the controller too late is sent again: the button is still held.
            late = result.outcome is Outcome.REJECTED and result.code == ResultCode.STALE
            goes_on = late or result.outcome is Outcome.REACHED
            if goes_on and now.mono_s < jog.until_s and self.lease.holder == jog.viewer:
                goal_id = str(self._new_stamp_ns(now))
                known = self._log.update(known, goal_id=goal_id, sent_s=now.graph_s, status="sent")
                return [self._jog_step(known, now, again=late)]
            self._jog = None
            if result.outcome is not Outcome.REACHED:  # as at a limit: the same held direction is not tried again
                self._refused_jog = (jog, result.reason)
        return self._log.ended(known, result_words(result, self.scene.faces), now)

    def set_path(self, path: Array) -> None:
        """Set the path published for the tip, (N, 3) m in base_link; it starts at the tip's position."""
        start = self._tip()
        self.scene.path = path if start is None else np.vstack([start, path])
        self._sets_out_until_s = self._now_s + _SETS_OUT_S

    def _tip(self) -> Array | None:
        position = self.machine.position
        if position is None or not all(math.isfinite(value) for value in position):
            return None
        return np.array([*position[:2], -position[2]])

    def path(self, camera: str) -> dict[str, Any]:
        """Return the tip's path in pixels: the current one, or the planned one (``planned``) to the selection.

        While a goal waits for its first path, none is shown, not even the last one.
        """
        if self.moving:
            self._sets_out_until_s = -math.inf
            return {"path": self.scene.base_line(camera, self.scene.path), "planned": False}
        if self._now_s >= self._sets_out_until_s:
            self.scene.path = None
        selection, start, points = self._selection, self._tip(), None
        if selection is not None and start is not None:
            points = self.scene.way_to(start, selection.anchors)
        return {"path": self.scene.base_line(camera, points), "planned": True}

    # --- state for the pages ---------------------------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """Whether the machine moves or a motion has been ordered."""
        return self.machine.active or self._log.motion_waiting

    def _snapshot(self, now: Now) -> dict[str, Any]:
        try:
            self.machine.check_recognition(self.scene.camera_from_panel, self.config, now)
            self.sequence.check_idle()
            self.machine.check_ready()
            refusal = None
        except Refusal as why:
            refusal = why.message()
        return self._snapshot_now() | {"refusal": refusal}

    def _snapshot_now(self) -> dict[str, Any]:
        lease = self.lease
        return {
            **self.machine.message(),
            "moving": self.moving,
            "stop_cause": self._causes.message(*self.machine.state("driver")),
            "lease": {
                "epoch": lease.epoch,
                "holder": lease.holder,
                "holder_name": self._name(lease.holder),
                "requester": lease.requester,
                "requester_name": self._name(lease.requester),
            },
            "tip_seen": self.scene.tip_ns > 0 and abs(self._ros_ns - self.scene.tip_ns) < _TIP_SEEN_NS,
            "viewers": len(self._viewers),
            "refusal": None,
        }

    def _state_effect(self, now: Now) -> Broadcast:
        state = self._snapshot(now)
        self._last_state = (now.mono_s, state)
        return Broadcast(message={"type": "state", **state})

    def _name(self, viewer: str) -> str:
        return self._viewers[viewer].name if viewer in self._viewers else ""


def _selection_shown(selection: Selection | None) -> Broadcast:
    return Broadcast(message={"type": "selection", "selection": selection.message() if selection else None})
