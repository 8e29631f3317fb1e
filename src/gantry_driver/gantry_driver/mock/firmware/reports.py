"""Texts of the mock board, in the formats of GRBL 1.1's interface document (doc/markdown/interface.md)."""

from __future__ import annotations

from collections.abc import Sequence

from gantry_driver.mock.firmware.floats import print_number
from gantry_driver.mock.firmware.parser_state import ParserState
from gantry_driver.mock.settings import Eeprom, shown

INCH_PER_MM = 0.0393701  # from nuts_bolts.h
BANNERS = {
    "GRBL": "\r\nGrbl 1.1h ['$' for help]",
    "grblHAL": "\r\nGrblHAL 1.1f ['$' or '$HELP' for help]",
    "FluidNC": "\r\nGrbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]",
}
MACROS = {f"MACROS{name.upper()}": f"$/macros/{name}=" for name in ("startup_line0", "startup_line1", "after_reset")}
"""FluidNC's answers to the queries that replace ``$N``, by the queries as this parser collects them."""
FLUIDNC_SETTINGS = (10, 20, 21, 22, 23, 30, 32, *(base + axis for base in (100, 110, 120, 130) for axis in range(3)))
"""Settings of its config file that FluidNC reports by number."""
HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"
UNLOCK_HINT = "[MSG:'$H'|'$X' to unlock]"
RESET_HINT = "[MSG:Reset to continue]"
UNLOCKED = "[MSG:Caution: Unlocked]"
CHECK_ON, CHECK_OFF = "[MSG:Enabled]", "[MSG:Disabled]"
CHECK_DOOR, CHECK_LIMITS = "[MSG:Check Door]", "[MSG:Check Limits]"
PROGRAM_END, SLEEPING, RESTORING = "[MSG:Pgm End]", "[MSG:Sleeping]", "[MSG:Restoring defaults]"


def coordinates(values_mm: Sequence[float], inches: bool) -> str:
    """Return coordinates in the format of reports: three decimals in mm, four in inches."""
    if inches:
        return ",".join(print_number(v * INCH_PER_MM, 4) for v in values_mm)
    return ",".join(print_number(v, 3) for v in values_mm)


def rate(mm_per_min: float, inches: bool) -> str:
    """Return a feed rate in the format of reports."""
    return print_number(mm_per_min * INCH_PER_MM, 1) if inches else print_number(mm_per_min, 0)


def speed(rpm: float) -> str:
    """Return a spindle's speed in the format of reports."""
    return print_number(rpm, 0)


def settings(eeprom: Eeprom, dialect: str) -> list[str]:
    """Return the answer to ``$$``."""
    told = FLUIDNC_SETTINGS if dialect == "FluidNC" else eeprom.values
    return [f"${number}={shown(number, eeprom.values[number])}" for number in told]


def parameters(
    eeprom: Eeprom, state: ParserState, probe_mm: Sequence[float], probe_ok: bool, inches: bool
) -> list[str]:
    """Return the answer to ``$#``."""
    names = [f"G{54 + i}" for i in range(len(eeprom.systems) - 2)] + ["G28", "G30"]
    lines = [f"[{name}:{coordinates(place, inches)}]" for name, place in zip(names, eeprom.systems)]
    lines.append(f"[G92:{coordinates(state.g92, inches)}]")
    lines.append(f"[TLO:{coordinates([state.tool_length], inches)}]")
    lines.append(probe(probe_mm, probe_ok, inches))
    return lines


def probe(probe_mm: Sequence[float], ok: bool, inches: bool) -> str:
    """Return the line of a probing cycle."""
    return f"[PRB:{coordinates(probe_mm, inches)}:{int(ok)}]"


def modes(state: ParserState, inches: bool) -> str:
    """Return the answer to ``$G``."""
    m = state.modes
    coolant = " ".join(name for name, on in (("M7", m.mist), ("M8", m.flood)) if on) or "M9"
    return (
        f"[GC:G{m.motion:g} G{54 + m.system} G{m.plane} G{m.units} G{m.distance} G{m.feed_mode}"
        f" M{m.spindle} {coolant} T{state.tool} F{rate(state.feed, inches)} S{speed(state.speed)}]"
    )


def build_info(eeprom: Eeprom, mist: bool, planner: int, receive: int, dialect: str) -> list[str]:
    """Return the answer to ``$I``."""
    if dialect == "grblHAL":
        options = f"[OPT:V{'M' * mist}NZ,{planner},{receive},3,0]"
        return [f"[VER:1.1f.20240812:{eeprom.build_info}]", options, "[NEWOPT:ENUMS,RT-]", "[FIRMWARE:grblHAL]"]
    if dialect == "FluidNC":
        return ["[VER:3.7 FluidNC v3.7.8:]", "[OPT:PHS]", "[MSG: Machine: gantry]"]
    return [f"[VER:1.1h.20190830:{eeprom.build_info}]", f"[OPT:V{'M' * mist},{planner},{receive}]"]
