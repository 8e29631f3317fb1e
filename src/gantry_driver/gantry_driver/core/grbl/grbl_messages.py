"""Messages of the board as values: bytes in, frozen messages out, in any chunks; noise becomes :class:`Garbage`.

Source: GRBL 1.1 interface documents; grblHAL, FluidNC and Marlin where they differ.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

from icu_common.core.reasons.message import Message

MAX_LINE = 1024
"""Maximum kept bytes of a line; the longest valid lines (help texts of grblHAL) are far shorter."""


class Dialect(str, Enum):
    """The firmwares that the driver distinguishes."""

    UNKNOWN = "unknown"
    GRBL = "GRBL"
    GRBL_0 = "GRBL0"
    GRBLHAL = "grblHAL"
    FLUIDNC = "FluidNC"
    MARLIN = "Marlin"


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblMessage:
    """Base of all messages of a board."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OkAnswer(GrblMessage):
    """``ok``: the board has accepted the oldest unanswered line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorAnswer(GrblMessage):
    """``error:N``: the board has rejected the oldest unanswered line."""

    code: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm(GrblMessage):
    """``ALARM:N``."""

    code: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Banner(GrblMessage):
    """Banner of a board that has started or was reset."""

    dialect: Dialect
    version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusReport(GrblMessage):
    """A status report.

    Parameters
    ----------
    state, substate
        ``Hold:0`` gives ``Hold`` and 0; substate is -1 if there is none.
    mpos_mm, wpos_mm, wco_mm
        Machine position, work position and the offset between them; None if the report has none.
    planner_free, rx_free
        From ``Bf``; -1 if the report has none.
    overrides_percent
        Feed, rapid and spindle, from ``Ov``; None if the report has none.
    feed_mm_min, spindle
        From ``FS`` or ``F``; None if the report has none.
    pins
        Letters of the active input pins, from ``Pn``; empty if the report has none.
    """

    state: str
    substate: int = -1
    mpos_mm: tuple[float, ...] | None = None
    wpos_mm: tuple[float, ...] | None = None
    wco_mm: tuple[float, ...] | None = None
    planner_free: int = -1
    rx_free: int = -1
    overrides_percent: tuple[float, ...] | None = None
    feed_mm_min: float | None = None
    spindle: float | None = None
    pins: str = ""

    @property
    def state_text(self) -> str:
        return self.state if self.substate < 0 else f"{self.state}:{self.substate}"


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingValue(GrblMessage):
    """One line of ``$$``; ``text`` as printed."""

    number: int
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StartupLine(GrblMessage):
    """Line that the board runs after a reset, with its name (``$N0``); ``text`` is empty if it runs none."""

    name: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildOptions(GrblMessage):
    """``[OPT:flags,planner,rx]``: the sizes of receive buffer and planner, 0 if the firmware reports none."""

    rx_bytes: int
    planner_blocks: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback(GrblMessage):
    """Any other ``[KEY:text]``."""

    key: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Firmware(GrblMessage):
    """Marlin's answer to ``M115``, or grblHAL's ``[FIRMWARE:..]``."""

    dialect: Dialect
    version: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Garbage(GrblMessage):
    """A line that is none of the above: noise, or two lines with the newline between them lost."""

    raw: bytes


class LineReader:
    """Splits bytes into lines; the result does not depend on the chunks in which the bytes arrive."""

    def __init__(self) -> None:
        self._partial = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines completed by ``data``, without line ends and without empty lines.

        A line longer than ``MAX_LINE`` is truncated.
        """
        lines = []
        for part in data.splitlines(keepends=True):
            body = part.rstrip(b"\r\n")
            self._partial += body[: MAX_LINE - len(self._partial)]
            if len(body) < len(part):
                if self._partial:
                    lines.append(bytes(self._partial))
                self._partial.clear()
        return lines

    def clear(self) -> None:
        """Drop an incomplete line, for example after the port was reopened."""
        self._partial.clear()


_ERROR = re.compile(r"error:\s*(\d{1,3})\Z", re.IGNORECASE)
_ALARM = re.compile(r"ALARM:\s*(\d{1,3})\Z", re.IGNORECASE)
_GRBL = re.compile(r"Grbl(HAL)? (\d[\w.]*)(.*)", re.IGNORECASE)
_MARLIN = re.compile(r"(?:echo:)?\s*Marlin\s+([\w.-]+)")
_SETTING = re.compile(r"\$(\d{1,4})=([^\s()]*)")
_STARTUP = re.compile(r"(\$(?:N\d|/macros/\w+))=(.*)\Z")
_FEEDBACK = re.compile(r"\[([A-Za-z][A-Za-z0-9]*):(.*)\]\Z")
_NUMBERS = re.compile(r"-?\d{1,7}(\.\d{1,4})?(,-?\d{1,7}(\.\d{1,4})?)*\Z")
_PINS = re.compile(r"[A-Z]*\Z")
_STATES = {"Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep", "Tool"}


def parse_line(raw: bytes) -> GrblMessage:
    """Return the message in a line (without its end); never raises.

    Examples
    --------
    >>> parse_line(b"error:20")
    ErrorAnswer(code=20)
    >>> parse_line(b"<Hold:0|MPos:1.000,2.000,-3.000|FS:0,0>").state_text
    'Hold:0'
    """
    try:
        text = raw.decode("ascii").strip()
    except UnicodeDecodeError:
        # A banner damaged by noise still shows that the board was reset; no other damaged line is interpreted.
        return _banner(raw.decode("ascii", "replace")) or Garbage(raw=raw)
    if text == "ok":
        return OkAnswer()
    if match := _ERROR.match(text):
        return ErrorAnswer(code=int(match[1]))
    if match := _ALARM.match(text):
        return Alarm(code=int(match[1]))
    if text.startswith("<"):
        return _report(text) or _banner(text) or Garbage(raw=raw)
    if match := _SETTING.match(text):
        return SettingValue(number=int(match[1]), text=match[2])
    if match := _STARTUP.match(text):
        return StartupLine(name=match[1], text=match[2].strip())
    if match := _FEEDBACK.match(text):
        return _feedback(match[1], match[2])
    if "FIRMWARE_NAME:Marlin" in text:
        return Firmware(dialect=Dialect.MARLIN, version=text.partition("FIRMWARE_NAME:")[2].split(" SOURCE")[0])
    return _banner(text) or Garbage(raw=raw)


def _banner(text: str) -> Banner | None:
    if match := _GRBL.search(text):
        dialect = Dialect.GRBL_0 if match[2].startswith("0.") else Dialect.GRBL
        if match[1]:
            dialect = Dialect.GRBLHAL
        elif "FluidNC" in match[3]:
            dialect = Dialect.FLUIDNC
        return Banner(dialect=dialect, version=match[2])
    if match := _MARLIN.search(text):
        return Banner(dialect=Dialect.MARLIN, version=match[1])
    return None


def _feedback(key: str, value: str) -> GrblMessage:
    if key == "OPT":
        _, *sizes = [*value.split(","), "", ""]
        planner, rx = (int(size) if size.isdigit() else 0 for size in sizes[:2])
        return BuildOptions(rx_bytes=rx, planner_blocks=planner)
    if key == "FIRMWARE":
        return Firmware(dialect=Dialect.GRBLHAL if "grblhal" in value.lower() else Dialect.UNKNOWN, version=value)
    if key == "VER" and "FluidNC" in value:
        return Firmware(dialect=Dialect.FLUIDNC, version=value)
    return Feedback(key=key, text=value)


def _numbers(text: str, least: int) -> tuple[float, ...] | None:
    """Return the numbers of a field, None if one is not in the boards' format: no exponent, no plus, no blank."""
    if text.count(",") + 1 < least or not _NUMBERS.match(text):
        return None
    return tuple(map(float, text.split(",")))


def _position(text: str) -> tuple[float, ...] | None:
    """Return the numbers of a position, None if X, Y and Z do not have the same number of decimals.

    GRBL 1.1h, grblHAL (report.c) and FluidNC (Report.cpp) print X, Y and Z with the same number of decimals. So this
    detects a lost or doubled digit after the point. In inches, FluidNC prints rotary axes with another number.
    """
    decimals = {len(number.partition(".")[2]) for number in text.split(",")[:3]}
    return _numbers(text, 3) if len(decimals) == 1 else None


def _report(text: str) -> StatusReport | None:
    """Return the report, or None if a part on which the driver depends is damaged."""
    if not text.endswith(">") or "<" in text[1:]:
        return None
    head, *fields = text[1:-1].split("|")
    state, _, sub = head.partition(":")
    if state not in _STATES or (sub and not sub.isdigit()):
        return None
    found: dict[str, str] = {}
    for item in fields:
        key, colon, value = item.partition(":")
        if not colon or key in found:
            return None
        found[key] = value
    points: dict[str, tuple[float, ...] | None] = {}
    for key in ("MPos", "WPos", "WCO"):
        points[key] = _position(found[key]) if key in found else None
        if key in found and points[key] is None:
            return None
    if points["MPos"] is None and points["WPos"] is None:
        return None
    buffers = _numbers(found.get("Bf", "-1,-1"), 2)
    overrides = _numbers(found["Ov"], 3) if "Ov" in found else None
    if ("Ov" in found) != (overrides is not None):
        return None
    speeds = _numbers(found.get("FS", found.get("F", "0")), 1)
    pins = found.get("Pn", "")
    if buffers is None or speeds is None or not _PINS.match(pins):
        return None
    return StatusReport(
        state=state,
        substate=int(sub) if sub else -1,
        mpos_mm=points["MPos"],
        wpos_mm=points["WPos"],
        wco_mm=points["WCO"],
        planner_free=int(buffers[0]),
        rx_free=int(buffers[1]),
        overrides_percent=overrides,
        feed_mm_min=speeds[0] if "FS" in found or "F" in found else None,
        spindle=speeds[1] if "FS" in found and len(speeds) > 1 else None,
        pins=pins,
    )


ALARM_TEXTS = {
    1: Message("grbl.hard_limit_switch_position_lost"),
    2: Message("grbl.target_beyond_soft_limits"),
    3: Message("grbl.reset_while_moving_position_lost"),
    4: Message("grbl.probe_not_initial_state"),
    5: Message("grbl.probe_did_not_make_contact"),
    6: Message("grbl.homing_reset_during_cycle"),
    7: Message("grbl.homing_door_opened"),
    8: Message("grbl.homing_pull_off_did_not"),
    9: Message("grbl.homing_no_switch_found"),
    10: Message("grbl.emergency_stop_second_axis"),
}
_ALARM_TEXTS_OF = {
    Dialect.GRBLHAL: {
        10: Message("grbl.emergency_stop_pressed"),
        11: Message("grbl.must_homed_first"),
        12: Message("grbl.limit_switch_engaged"),
        14: Message("grbl.spindle_not_speed"),
        17: Message("grbl.motor_fault"),
    },
    Dialect.FLUIDNC: {
        10: Message("grbl.spindle_fault"),
        11: Message("grbl.control_limit_input_active_start"),
        12: Message("grbl.homing_switch_not_clear"),
        13: Message("grbl.hard_stop"),
        14: Message("grbl.must_homed_first"),
    },
}
"""Meanings, in other firmwares, of numbers that GRBL does not use or uses differently (grblHAL: alarms.c, FluidNC:
Protocol.h)."""
ERROR_TEXTS = {
    1: Message("grbl.letter_expected"),
    2: Message("grbl.bad_number"),
    3: Message("grbl.statement_not_known"),
    4: Message("grbl.value_must_not_negative"),
    5: Message("grbl.homing_not_enabled"),
    6: Message("grbl.step_pulse_shorter_3_us"),
    7: Message("grbl.eeprom_read_failed"),
    8: Message("grbl.allowed_only_while_idle"),
    9: Message("grbl.locked_alarm"),
    10: Message("grbl.soft_limits_need_homing"),
    11: Message("grbl.line_too_long"),
    12: Message("grbl.step_rate_above_firmware_maximum"),
    13: Message("grbl.safety_door_open"),
    14: Message("grbl.too_long_stored"),
    15: Message("grbl.jog_beyond_travel"),
    16: Message("grbl.bad_jog"),
    17: Message("grbl.laser_mode_needs_pwm"),
    18: Message("grbl.reset_signal_held_fluidnc_no"),
    20: Message("grbl.command_not_supported"),
    21: Message("grbl.two_commands_one_modal_group"),
    22: Message("grbl.no_feed_rate"),
    23: Message("grbl.integer_expected"),
    24: Message("grbl.two_commands_use_axis_words"),
    25: Message("grbl.word_given_twice"),
    26: Message("grbl.no_axis_words"),
    27: Message("grbl.line_number_out_range"),
    28: Message("grbl.value_word_missing"),
    29: Message("grbl.coordinate_system_beyond_g_59"),
    30: Message("grbl.g_53_needs_g_0"),
    31: Message("grbl.axis_words_without_use"),
    32: Message("grbl.arc_without_axis_word_plane"),
    33: Message("grbl.arc_target"),
    34: Message("grbl.arc_radius"),
    35: Message("grbl.arc_offsets"),
    36: Message("grbl.unused_value_words"),
    37: Message("grbl.g_43_1_takes_axis"),
    38: Message("grbl.tool_number_too_large"),
    45: Message("grbl.limit_switch_engaged_only_homing"),
    46: Message("grbl.must_homed_first"),
    50: Message("grbl.emergency_stop_pressed"),
}


def alarm_text(code: int, dialect: Dialect) -> str:
    """Return ``ALARM:N (meaning)``."""
    texts = ALARM_TEXTS | _ALARM_TEXTS_OF.get(dialect, {})
    return Message("grbl.alarm", code=code, texts=texts.get(code, Message("grbl.see_manual_firmware")))


def error_text(code: int) -> str:
    """Return ``error:N (meaning)``."""
    return Message("grbl.error", code=code, error_texts=ERROR_TEXTS.get(code, Message("grbl.see_manual_firmware")))
