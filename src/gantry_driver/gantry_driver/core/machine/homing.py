"""Homing: the cycle that gives the machine its position, and the check of the position; no I/O and no clock."""

from __future__ import annotations

from gantry_driver.core.board_faults.reports import UNPLACED_REPORTS, no_position_text
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.grbl_messages import Dialect, StatusReport
from gantry_driver.core.grbl.trajectory_gcode import lift_lines, reading_m
from gantry_driver.core.machine.stopping import elsewhere
from gantry_driver.core.machine.streaming import Streaming
from gantry_driver.core.states.machine_states import MachinePhase, Position
from gantry_driver.core.states.reasons import Reason
from gantry_driver.core.states.stylus_state import Stylus
from icu_common.core.reasons.codes import DriverCode
from icu_common.core.reasons.message import Message
from icu_common.core.reasons.state_text import as_message

OFFSET_WITHIN_S = 1.0
"""Maximum seconds after homing for two reports with a work offset; a board without one moves, but runs no program."""
HOME = "$H"
HOMING_LEAST_S = 0.2
"""Minimum seconds of a homing cycle, with three pull-offs of an axis; any other line is answered earlier."""
HOMING_FIRST = 22, 4
"""Setting, and its bit, with which ``$X`` does not unlock a grblHAL board that has not been homed."""


class Homing(Streaming):
    """One board that can find its position."""

    def __init__(self, config: DriverConfig, *, active: bool = True, left_down: bool = False) -> None:
        super().__init__(config, active=active, left_down=left_down)
        self._homed_mm: tuple[float, ...] | None = None
        """Position of the board in the last report after a homing cycle."""
        self._homed_at = 0.0

    def home(self, now: float) -> str:
        """Begin a homing cycle."""
        if self.phase not in (MachinePhase.UNHOMED, MachinePhase.IDLE) and not self._misplaced:
            return Message("homing.driver", state_text=as_message(self.state_text))
        if refusal := self._permission(now) or self._unlock_refusal():
            return refusal
        self._forget_position()
        self._homed_mm = None
        self._enter(MachinePhase.HOMING, now)
        self._marker_done = False
        if self.config.stylus.kind != "z_axis":
            # The stylus may be down, and a locked board accepts no M3 or M9: unlock, lift, and only then travel.
            for text in ("$X", *lift_lines(self.config)):
                self._order_stylus(self.session.queue(text, answer_within_s=self._answer_time()))
        # Only GRBL is known to drop the tool length and the selected coordinate system at a reset. Other firmwares
        # report the sum as their work offset. Only after both are cancelled does it equal G54's, with which a program
        # is checked.
        ends: tuple[str, ...] = () if self.dialect is Dialect.GRBL else ("G49", "G54")
        if ends and self._is_servo():
            ends = (*ends, *lift_lines(self.config))  # grblHAL switches the spindle off before it homes
        for text in (HOME, *ends):
            self._marker = self.session.queue(text, answer_within_s=self._answer_time()).number
        return ""

    def _unlock_refusal(self) -> str:
        """Return why the board accepts no line that lifts the stylus; homing itself lifts only a Z axis."""
        number, bit = HOMING_FIRST
        value = self._settings.get(number, "")
        locked = self.dialect is Dialect.GRBLHAL and value.isdecimal() and int(value) & bit
        if self.config.stylus.kind == "z_axis" or self.homed or not locked:
            return ""
        return Message("homing.board_must_homed_before_takes", number=number, value=value, number_2=number)

    def _report_homing(self, report: StatusReport, now: float) -> None:
        if not self._marker_done or report.state == "Home":
            return
        if report.state != "Idle":
            self._to_alarm(Message("homing.after_homing_board", state_text=report.state_text), now)
            return
        if report.mpos_mm is None:  # a work position; its offset comes with one of the next reports, or never
            if self.session.unplaced_reports > UNPLACED_REPORTS:
                self._halt(no_position_text(self._settings), now)
            return
        if self._homed_mm != report.mpos_mm:
            self._homed_mm, self._homed_at = report.mpos_mm, now
            self.session.poll_now()
            return  # All later motion relies on this position, so two reports must agree.
        if not self.session.wco_is_sure and now - self._homed_at < OFFSET_WITHIN_S:
            self.session.poll_now()  # So must the work offset of programs, which comes with every tenth report.
            return
        # A stage whose stylus is not a Z axis may have none; its Z then keeps its value from power-up.
        expected = self.config.machine.homed_mpos_mm()[: 3 if self.config.stylus.kind == "z_axis" else 2]
        if elsewhere(report.mpos_mm, expected):
            found = ", ".join(f"{v:.3f}" for v in report.mpos_mm[:3])
            text = Message(
                "homing.homed_mpos_configuration_says",
                found_mm=found,
                expected_mm=", ".join(f"{v:g}" for v in expected),
            )
            self._enter(MachinePhase.MISMATCH, now, Reason(code=DriverCode.HOMED_ELSEWHERE, text=text))
            self._misplaced = True
            return
        self.homed, self._stylus = True, Stylus.lifted(self.config.stylus.kind)
        self.session.executed_all()
        self.reading_m = reading_m(report.mpos_mm, False, self.config)
        self._append_position(report)
        self._enter(MachinePhase.IDLE, now)

    def _append_position(self, report: StatusReport) -> None:
        assert self.reading_m is not None
        self.probe = "P" in report.pins if self.config.probe == "stylus_switch" else None
        self._events.append(Position(reading_m=self.reading_m, probe=self.probe))
