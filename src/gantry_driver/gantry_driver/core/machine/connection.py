"""Connection to one board: the port is opened or lost, the firmware is identified; no I/O and no clock."""

from __future__ import annotations

import math

from gantry_driver.core.board_faults.kept_place import KeptPlace
from gantry_driver.core.board_faults.reports import with_quote
from gantry_driver.core.grbl.grbl_messages import Dialect, Firmware, StatusReport
from gantry_driver.core.grbl.session import HOLD
from gantry_driver.core.machine.board_state import BoardState
from gantry_driver.core.states.machine_states import CloseRequested, MachinePhase
from gantry_driver.core.states.reasons import Why
from icu_common.core.goals.results import Outcome
from icu_common.core.reasons.message import Message

HOLD_REPEAT_S = 0.2
"""Seconds after which a hold that no report shows is sent again."""
ASK_ALONE_S = 0.2
"""Seconds without a `?` after a query to a firmware without real-time bytes, so that no `?` gets into its line."""
LEFT_WAIT_S = 0.05
"""Seconds to wait for a banner if the machine was left moving or pressing; then the driver requests the board's state.
It sends no hold before a report shows motion: the loader of a board that restarts may read holds as commands."""
REFUSED = {
    Dialect.MARLIN: Message("link.firmware_marlin_no_feed_hold"),
    Dialect.GRBL_0: Message("link.firmware_grbl_before_1_1"),
}
"""Unsupported firmwares, and the reasons."""


class Connection(BoardState):
    """One board on one port whose firmware is identified."""

    def opened(self, now: float) -> None:
        """Handle an opened port: wait for a banner, or request the state of a board that is already running."""
        self.connects += 1
        self._asked_again = False
        # An attempt takes far longer than the pause after it, so the reason stays visible during the next attempt.
        self._synchronise(now, self._unanswered)
        self._heard_bytes = 0
        self._kept_place = KeptPlace()
        # A machine that may move or press must not wait for a banner that may never arrive.
        left = self._left_down or self.left_moving
        wait_s = min(self.config.banner_wait_s, LEFT_WAIT_S if left else math.inf)
        self._probe_from = now + wait_s
        if self._latched:
            # The stop was requested without a port: a board that still executes buffered lines is held at once.
            self.session.realtime(HOLD)

    def closed(self, reason: str, now: float) -> None:
        """Handle a lost port: abort the goal and discard the position."""
        self.left_moving = self.left_moving or not self.at_rest
        self._finish(Outcome.ABORTED, Message("guard.link_lost", reason=reason), now)
        self._forget_position()
        self._unanswered = ""
        self.session.start(now)
        self._enter(MachinePhase.CLOSED, now, reason)

    def _synchronise(self, now: float, reason: Why) -> None:
        self.session.start(now)
        self.dialect, self.firmware, self._settings, self._probed = Dialect.UNKNOWN, "", {}, 0.0
        self._critical = False
        self._probe_from = now
        self._enter(MachinePhase.SYNCHRONISE, now, reason)

    def _report_synchronise(self, report: StatusReport, now: float) -> None:
        # The board was already running. A motion is held first: a reset during it would lose the position.
        if self.session.awaiting_banner:
            return
        if report.state in ("Run", "Jog") or (report.state == "Hold" and report.substate == 1):
            if now - self._hold_sent >= HOLD_REPEAT_S:
                self._hold_sent = now
                self.session.realtime(HOLD)
            return
        self._kept_place.before_reset(report)
        self.session.polling = False
        self.session.soft_reset(now)

    def _report_connecting(self, report: StatusReport, now: float) -> None:
        """Note why the board accepts no lines; it answers none until then."""
        self._kept_place.after_reset(report)
        question = {"Door": Message("link.safety_door_open"), "Hold": Message("link.hold_button_pressed")}.get(
            report.state
        )
        self._suspended = (
            Message("link.board_reports", state_text=report.state_text, question=question) if question else ""
        )
        self._say_if_changed()

    def _rouse(self, age: float, now: float) -> None:
        # A board that sends no banner and does not answer `?` may run Marlin, which has no real-time bytes ...
        if age > self.config.connect_timeout_s / 2 and not self._probed:
            self._probed = now
            self.session.realtime(b"\n")  # Ends the line that `?` started there.
            self.session.queue("M115")
        # ... or it runs GRBL, in a homing cycle or after a limit alarm, and reacts only to a reset.
        silent = self.session.last_report_at is None and not self.session.awaiting_banner
        if silent and age > 0.75 * self.config.connect_timeout_s:
            self.session.soft_reset(now)

    def _on_firmware(self, firmware: Firmware, now: float) -> None:
        if firmware.dialect in REFUSED:
            if self.phase is MachinePhase.SYNCHRONISE:
                self.firmware = firmware.version
                self._refuse(firmware.dialect, now)
            return
        if firmware.dialect is not Dialect.UNKNOWN:
            self.dialect = firmware.dialect
        self.firmware = firmware.version

    def _refuse(self, dialect: Dialect, now: float) -> None:
        self.dialect, self._mismatch, self._settings_differ = dialect, REFUSED[dialect], False
        self.session.polling = False
        self._enter(MachinePhase.IDENTIFY, now)
        self._enter(MachinePhase.MISMATCH, now, self._mismatch)

    def _identify(self, now: float, reason: Why) -> None:
        self._settings, self.left_moving = {}, False
        self._enter(MachinePhase.IDENTIFY, now, "" if reason == self._unanswered else reason)
        self._unanswered = ""
        self.session.polling = True
        self._marker = self.session.queue("$I").number

    def _no_answer_text(self) -> str:
        """Return a text on a board that was silent for too long, and what to check if no board seems to be there."""
        text = Message(
            "link.no_answer_while", connect_timeout_s=self.config.connect_timeout_s, waiting_for=self._waiting_for()
        )
        if self.phase is not MachinePhase.SYNCHRONISE:
            return Message("text.more", first=text, second=self._suspended) if self._suspended else text
        if unread := self.session.unread_report:
            return with_quote(text, unread)
        if not self._heard_bytes:
            return Message("link.board_power_port", text=text, port=self.config.port)
        return Message(
            "link.bytes_came_no_grbl_line",
            text=text,
            heard_bytes=self._heard_bytes,
            baud=self.config.baud,
            port=self.config.port,
        )

    def _waiting_for(self) -> str:
        return {
            MachinePhase.SYNCHRONISE: Message("link.waiting_banner"),
            MachinePhase.IDENTIFY: Message("link.asking_build"),
            MachinePhase.SETTINGS: Message("link.reading_settings"),
            MachinePhase.WRITING: Message("link.writing_settings"),
        }.get(self.phase) or Message("state.named", state=self.phase.state)

    def _close(self, reason: str, now: float) -> None:
        self._events.append(CloseRequested(reason=reason))
        self.closed(reason, now)
