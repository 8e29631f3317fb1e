"""The operator's desk: which actions pages may take, which orders go to the graph, and when to stop.

It has no clock, socket or ROS: every call takes :class:`Now` and returns the effects for the server to carry out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from icu_common.core.reasons.codes import CODE, ControllerCode
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access import FLOODING, SHORT, Role
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.desk.actions import Actions
from scope_ui_bridge.core.desk.answers import Answers
from scope_ui_bridge.core.desk.chosen import Chosen
from scope_ui_bridge.core.desk.early_reset import EarlyReset
from scope_ui_bridge.core.desk.handover import Handover
from scope_ui_bridge.core.desk.motions import Motions
from scope_ui_bridge.core.desk.order_book import OrderBook
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.desk.state_feed import StateFeed
from scope_ui_bridge.core.desk.stops import Stops
from scope_ui_bridge.core.desk.supervision import Supervision
from scope_ui_bridge.core.desk.tip_path import TipPath
from scope_ui_bridge.core.effects import Effect, End, MachineOrder, Now, Record, SendToViewer
from scope_ui_bridge.core.orders import HeldPicture
from scope_ui_bridge.core.records import ParameterChanges, record
from scope_ui_bridge.core.video import VideoScene
from scope_ui_bridge.core.wire import Refusal


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
    scene
        Initial geometry.
    """

    def __init__(
        self, config: BridgeConfig, boot_id: str, title: str = "", robot: str = "", scene: VideoScene | None = None
    ) -> None:
        self._state = state = DeskState(config=config, boot_id=boot_id, scene=scene or VideoScene())
        self.scene, self.machine, self.panel = state.scene, state.machine, state.panel
        self.sequence, self.recordings, self.lease = state.sequence, state.recordings, state.lease
        self.parameters = ParameterChanges(state.log)
        self.chosen = Chosen(state)
        self._stops = Stops(state)
        self._handover = Handover(state, self._stops, self.chosen)
        self._supervision = Supervision(state, self._stops, self._handover)
        self._book = OrderBook(state)
        self._motions = Motions(state, self._book)
        early = EarlyReset(state, self._book)
        self._actions = Actions(state, self._book, self.chosen, early)
        self._feed = StateFeed(state, self.chosen, title, robot)
        self.answers = Answers(state, self._motions, early)
        self.tip_path = TipPath(state, self.chosen)
        self._stop_unexplained = False
        """Whether the controller has stopped, and the code of this state has not been reported yet."""

    @property
    def config(self) -> BridgeConfig:
        """Limits in force."""
        return self._state.config

    @config.setter
    def config(self, config: BridgeConfig) -> None:
        self._state.config = config

    # --- pages -----------------------------------------------------------------------------------------------------

    def begun(self, now: Now) -> list[Effect]:
        """Return this run's first line in the audit file: no page has control, however the last run ended."""
        return [Record(record=record("the bridge", "start", self._state.boot_id, now))]

    @property
    def has_viewers(self) -> bool:
        """Whether a page is connected; may be read from any thread."""
        return bool(self._state.pages)

    def join(self, name: str, role: Role = Role.OPERATOR, by_password: bool = False) -> tuple[str, dict[str, Any]]:
        """Add a page of the user ``name``; return its id and the first message for it.

        ``by_password`` is whether its user signs in by password or by token.

        Raises
        ------
        Refusal
            ``too_many_viewers``.
        """
        viewer = self._state.pages.add(name, role, self.config.max_viewers)
        return viewer, self._feed.hello(viewer, by_password)

    def had_control(self, name: str) -> bool:
        """Return whether a user has or has had control; connection slots are reserved for these users."""
        return self._state.pages.had_control(name)

    def signed_in(self, viewer: str, until_s: float) -> None:
        """Set the end of a page's sign-in, in monotonic seconds; signing in again before it extends it."""
        self._state.pages[viewer].signed_in_until_s = until_s

    def leave(self, viewer: str, now: Now, code: str = "stopped_page_gone") -> list[Effect]:
        """Remove a page; stop if it was the operator's and something moves. ``code`` is the reason for its end."""
        effects = self._handover.lose(viewer, code, now)
        self._state.pages.remove(viewer)
        return effects

    def pong(self, viewer: str) -> None:
        """Record that the browser of a page has answered a :class:`Ping`."""
        if viewer == self.lease.holder:
            self._state.causes.answered()

    # --- messages of pages -----------------------------------------------------------------------------------------

    def message(self, viewer: str, text: str | bytes, now: Now) -> list[Effect]:
        """Process one text of a page and return its effects; an invalid text is answered and moves nothing.

        Size and rate are limited before the text is read, except for a possible stop.
        """
        seq: int | None = None
        selected, page = self.chosen.selection, self._state.pages[viewer]
        longest = wire.MAX_BYTES if viewer == self.lease.holder else SHORT
        try:
            unlimited = page.may_stop(text, now.mono_s)
            if not unlimited:
                page.limit(len(text), longest, now.mono_s)
            message = wire.decode(text)
            if isinstance(message, wire.StopAll):  # before every other check: a stop is always accepted
                effects = self.stop(page.name, now, press=message.press)
                return [*effects, _answer(viewer, message.seq)]
            if unlimited:
                page.limit(len(text), longest, now.mono_s)
            seq = message.seq
            page.admit(message, self._state.boot_id)
            return self._dispatch(viewer, message, now)
        except Refusal as refusal:
            if refusal.code == FLOODING:
                return [End(viewer=viewer)]
            if refusal.code == "rate_limited" and not page.may_tell_rate(now.mono_s):
                return []
            gone = selected is not None and self.chosen.selection is None
            told: list[Effect] = [self.chosen.shown()] if gone else []
            seq = wire.seq_of(text) if seq is None else seq
            answer = {"type": "answer", "seq": seq, "ok": False, **refusal.message()}
            return [*told, SendToViewer(viewer=viewer, message=answer)]

    def _dispatch(self, viewer: str, message: wire.PageMessage, now: Now) -> list[Effect]:
        if isinstance(message, wire.Alive):
            return self._alive(viewer, message, now)
        if isinstance(message, wire.Hidden):
            return self._hidden(viewer, now)
        if isinstance(message, wire.Blind):
            if viewer != self.lease.holder or not self.moving:
                return []
            silence_s, limit_s = message.silence_ms / 1e3, self.config.frame_stale_s
            return self._stops.unseen("stopped_page_blind", silence_s, limit_s, now)
        if isinstance(message, wire.Lease):
            effects = self._handover.step(viewer, message, now)
            return [*effects, self._feed.state_effect(now), _answer(viewer, message.seq)]
        self.lease.check(viewer, message.epoch)
        self._state.pages[viewer].check_after_stop(message.seq)
        return [*self._order(viewer, message, now), _answer(viewer, message.seq)]

    def _order(self, viewer: str, message: wire.PageMessage, now: Now) -> list[Effect]:
        if isinstance(message, wire.Select):
            return self.chosen.select(message, now)
        if isinstance(message, wire.Act):
            return self._actions.act(viewer, message, now)
        if isinstance(message, wire.MoveTo):
            return self._motions.move(viewer, message, now)
        if isinstance(message, wire.Jog):
            return self._motions.jog(viewer, message, now)
        if isinstance(message, wire.RunSequence):
            return self._actions.run_sequence(viewer, message, now)
        if isinstance(message, (wire.Hold, wire.Teach)):
            return self._actions.teach(viewer, message, now)
        assert isinstance(message, wire.Call)
        return self._actions.call(viewer, message, now)

    def _alive(self, viewer: str, message: wire.Alive, now: Now) -> list[Effect]:
        self.lease.alive(viewer, now.mono_s)
        if viewer == self.lease.holder:
            self._state.causes.alive()
        clocks = {"bridge_ms": now.mono_s * 1e3, "wall_ms": now.wall_s * 1e3}
        left_s = self._state.pages[viewer].signed_in_until_s - now.mono_s
        ends = {"sign_in_ends_s": round(left_s, 1)} if left_s <= self.config.sign_in_warning_s else {}
        return [
            SendToViewer(viewer=viewer, message={"type": "alive", "client_ms": message.client_ms, **clocks, **ends})
        ]

    def _hidden(self, viewer: str, now: Now) -> list[Effect]:
        if viewer != self.lease.holder:
            return []
        self._state.causes.hidden()
        return self._handover.lose(viewer, "stopped_page_hidden", now) if self.moving else []

    # --- stops, orders and time ------------------------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """Whether the machine moves or a motion has been ordered."""
        return self._state.moving

    @property
    def stops(self) -> int:
        """Number of stops since the start."""
        return self._state.stops

    def stop(self, who: str, now: Now, press: str = "") -> list[Effect]:
        """Stop; ``press`` identifies one press of the button, which arrives by two paths."""
        return self._stops.stop(who, now, press=press)

    def stop_overtakes(self, viewer: str, who: str, seq: int) -> None:
        """Refuse orders of ``who``'s page up to ``seq``: a STOP pressed after them arrived first by a faster path."""
        if viewer in self._state.pages and self._state.pages[viewer].name == who:
            self._state.pages[viewer].stopped(seq)

    def still_wanted(self, order: MachineOrder, now: Now) -> bool:
        """Return whether an order may still be sent, see :meth:`OrderBook.still_wanted`."""
        return self._book.still_wanted(order, now)

    def tick(self, now: Now) -> list[Effect]:
        """Return the periodic effects (heartbeat, watchdogs, timeouts, state for the pages); call every 50 ms."""
        state = self._state
        state.ros_ns, state.now_s, state.ticked_s = now.ros_ns, now.mono_s, now.mono_s
        effects = self._supervision.tick(now) + self.answers.tick(now)
        state.machine.expire(now)
        state.panel.expire(state.config.recognition_max_age_s, now)
        return effects + self._feed.tick(now)

    # --- reports of the graph --------------------------------------------------------------------------------------

    def set_state(self, part: str, text: str) -> None:
        """Set the state of driver, controller, calibration or sequencer; empty if the node is missing."""
        self.machine.set_state(part, text)
        if part == "controller":
            self._stop_unexplained = self.machine.state(part)[0] == "stopped"
            self._explain_stop()
        if part == "sequencer":
            self.sequence.set_state(text)

    def set_report(self, part: str, text: str, values: Mapping[str, str], message: str = "") -> None:
        """Set the code and its values that a part has reported with the text of a state."""
        self.machine.set_report(part, text, values, message)
        self._explain_stop()

    def _explain_stop(self) -> None:
        """Record a stop that the controller has requested at rest: no result of a goal contains its cause."""
        reported = self.machine.reported("controller")
        if not self._stop_unexplained or reported is None:
            return
        self._stop_unexplained = False
        if reported.get(CODE) in (ControllerCode.CONFLICT, ControllerCode.FAILED):
            self._state.causes.aborted(self.machine.state("controller")[1], self._state.now_s)

    def said(self, line: dict[str, Any]) -> None:
        """Keep a log line of a program of the graph (wall_ms, level, name, text) for the engineers' consoles."""
        self._feed.add_line(line)

    def picture_held(self, viewer: str, held: HeldPicture | None) -> list[Effect]:
        """Set the held image, and send its stamp and size to the page that requested it."""
        self._state.held = held
        if held is None:
            return [SendToViewer(viewer=viewer, message={"type": "held", "stamp": ""})]
        size = {"width": held.width, "height": held.height}
        return [SendToViewer(viewer=viewer, message={"type": "held", "stamp": str(held.stamp_ns), **size})]


def _answer(viewer: str, seq: int) -> SendToViewer:
    return SendToViewer(viewer=viewer, message={"type": "answer", "seq": seq, "ok": True})
