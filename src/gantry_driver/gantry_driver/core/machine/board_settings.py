"""The board's settings: read, compared with the configuration, accepted, written; no I/O and no clock."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from gantry_driver.core.board_faults.reports import position_mask
from gantry_driver.core.grbl.grbl_messages import Dialect
from gantry_driver.core.grbl.settings_profile import differences, lines_to_write
from gantry_driver.core.machine.connection import Connection
from gantry_driver.core.states.machine_states import MachinePhase, Note
from gantry_driver.core.states.reasons import Why
from icu_common.core.reasons.message import Message, joined, quoted
from icu_common.core.reasons.state_text import as_message

READING_SETTINGS = (3, 23, 27, 100, 101, 102, 130, 131, 132)
"""Directions, homing corner, pull-off, steps and travel: a change makes a calibration of the readings invalid."""

IDLE_DELAY, STAYS_ON = 1, "255"
"""Setting of the delay in milliseconds after which idle motors are released, and its value for never."""
READ_SETTINGS = "$$"
_MACROS = ("$/macros/startup_line0", "$/macros/startup_line1", "$/macros/after_reset")
READ_STARTUP = {"$N": ("$N0", "$N1"), **{name: (name,) for name in _MACROS}}
"""Queries for the lines that a board runs after a reset, and the names in the answers; FluidNC calls them macros."""
STARTUP_TRIES = 5
KEPT_TO_ITSELF = {Dialect.FLUIDNC: frozenset({13, 23, 27})}
"""Settings that not every version of a firmware reports (units, corner and pull-off): the homed position shows them."""


class BoardSettings(Connection):
    """One board whose settings are compared with the required ones."""

    def settings_text(self) -> str:
        """Return the board's settings on which readings depend, ``$100=80 ...``; empty until they are known."""
        if READING_SETTINGS[-1] not in self._settings:
            return ""  # boards list settings in ascending order: the remaining ones have not arrived
        known = [number for number in READING_SETTINGS if self._settings.get(number)]
        return " ".join(f"${number}={self._settings[number].split()[0]}" for number in known)

    @property
    def settings(self) -> dict[int, str]:
        """The board's settings as it printed them."""
        return dict(self._settings)

    def expected_settings(self) -> dict[int, float]:
        """Return the required settings of the board, without those that its firmware does not report."""
        kept = KEPT_TO_ITSELF.get(self.dialect, frozenset()) - self._settings.keys()
        expected = {n: value for n, value in self.config.expected_settings().items() if n not in kept}
        return expected | position_mask(self._settings, self.dialect)

    def accept_settings(self, now: float) -> str:
        """Accept the present differences between the board's settings and the configuration, and no others."""
        if self.phase is not MachinePhase.MISMATCH or not self._settings or self._misplaced:
            return Message("settings.nothing_accept_driver", state_text=as_message(self.state_text))
        self._accepted_mismatch = self._mismatch
        self._enter(MachinePhase.UNHOMED, now)
        return ""

    def write_settings(self, now: float, profile: Mapping[int, float] | None = None) -> str:
        """Write the configured settings, or those of a profile, to the board, and read all settings back.

        Only settings that differ are written. The machine is unhomed afterwards: steps or travel may have changed.
        """
        if self.phase not in (MachinePhase.MISMATCH, MachinePhase.UNHOMED, MachinePhase.IDLE) or self._rests_extended():
            return Message("settings.settings_written_board_rest_stylus", state_text=as_message(self.state_text))
        wanted = dict(profile if profile is not None else self.expected_settings())
        lines = lines_to_write(self._settings, wanted) if self._settings else []
        if not lines:
            known = Message("settings.these_settings") if self._settings else Message("settings.board_no_settings")
            return joined([Message("settings.nothing_write", known=known), *self._startup_lines()])
        self._forget_position()
        self._profile = wanted
        self._kept = {number: text for number, text in self._settings.items() if number not in wanted}
        self._enter(
            MachinePhase.WRITING,
            now,
            Message("settings.writing", lines=", ".join(text.partition("=")[0] for text in lines)),
        )
        for text in lines:
            self._marker = self.session.queue(text).number
        return ""

    def _read_settings(self, now: float, reason: Why) -> None:
        self._settings, self._startup, self._startup_tries = {}, {}, 0
        self._enter(MachinePhase.SETTINGS, now, reason)
        self._marker = self.session.queue(READ_SETTINGS).number

    def _startup_missing(self) -> list[str]:
        names = _MACROS if self.dialect is Dialect.FLUIDNC else READ_STARTUP["$N"]
        return [name for name in names if name not in self._startup]

    def _read_startup(self, now: float) -> None:
        """Request the missing lines that the board runs after a reset; noise may have damaged an answer."""
        missing = self._startup_missing()
        if not missing or self._startup_tries == STARTUP_TRIES:
            self._check_settings(now)
            return
        self._startup_tries += 1
        for question, names in READ_STARTUP.items():
            if not set(names).isdisjoint(missing):
                self._marker = self.session.queue(question).number

    def _startup_lines(self) -> list[str]:
        """Return a sentence for each line that the board runs after a reset, and so after a stop."""
        found: list[str] = []
        for name, text in sorted(self._startup.items()):
            if text and name in _MACROS:
                found.append(Message("settings.runs_after_reset_must_empty", name=name, text=quoted(text)))
            elif text:
                found.append(Message("settings.runs_after_each_reset_must", name=name, text=quoted(text), name_2=name))
        if missing := ", ".join(self._startup_missing()):
            found.append(Message("settings.could_not_read_noise_line", missing=missing))
        return found

    @abstractmethod
    def _lift_left(self, now: float) -> bool:
        """Start to lift a stylus that was left down; return whether the board's settings allow it."""

    def _check_settings(self, now: float) -> None:
        if not self._settings:
            self._close(Message("settings.board_told_no_settings"), now)
            return
        wrong = differences(self._settings, self.expected_settings())
        self._settings_differ = bool(wrong)
        kept, self._kept = self._kept, {}
        changed = (n for n in kept if n in self._settings and self._settings[n] != kept[n])
        # A damaged line may have written a setting other than the intended one.
        wrong += [Message("settings.became_write_back", n=n, settings=self._settings[n], kept=kept[n]) for n in changed]
        self._mismatch = joined([*wrong, *self._startup_lines()])
        if (idle := self._settings.get(IDLE_DELAY)) is not None and idle.partition(".")[0] != STAYS_ON:
            text = Message("settings.motors_let_go_can_pushed", idle_delay=IDLE_DELAY, idle=idle, stays_on=STAYS_ON)
            self._events.append(Note(level="warn", text=text))
        profile, self._profile = self._profile, {}
        for setting in differences(self._settings, profile, Message("settings.written")):
            self._events.append(Note(level="error", text=Message("settings.not_kept", setting=setting)))
        if not self._blocked() and self._lift_left(now):
            return
        if self._latched:
            # Neither a lost link nor a reset of the board clears a stop.
            self._enter(MachinePhase.STOPPED, now, self._latched)
        elif self._blocked():
            self._enter(MachinePhase.MISMATCH, now, self._mismatch)
        else:
            self._enter(MachinePhase.UNHOMED, now, self.reason)
