"""Behaviour of the oscilloscope: changes of its state when a control is pressed, held, turned or touched."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

VOLTS_PER_DIVISION = tuple(m * 10.0**e for e in range(-3, 2) for m in (1, 2, 5))[:12]
"""Vertical scales, 1 mV to 5 V."""
SECONDS_PER_DIVISION = tuple(m * 10.0**e for e in range(-9, 1) for m in (1, 2, 5))
"""Time scales, 1 ns to 5 s."""
SCALE_DETENT_DEG = 18.0
POSITION_DETENT_DEG = 9.0
POSITION_STEP = 0.2
"""Divisions per detent of a position or level knob."""
RED = "#e02b20"
HOLD_S = 1.0
"""Seconds after which a held button acts a second time, in its own way."""
SINGLE_S = 0.6
"""Seconds for which a single acquisition waits for its trigger."""

MENUS = {
    "MENU": ("DISPLAY", "SYSTEM", "LANGUAGE", "HELP"),
    "SYSTEM": ("SELF TEST", "UPDATE", "FACTORY", "ABOUT"),
    "TRIG_MENU": ("EDGE", "PULSE", "VIDEO", "SLOPE"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentState:
    """Complete state of the instrument.

    ``phase_s`` is the signal time of a stopped trace. ``marker`` is the last touch on the screen as shares of its width
    and height from its lower left corner. ``knobs`` has the rotation of each knob in degrees, counter-clockwise
    positive. ``held`` are the pressed buttons, ``lit`` the lamps switched by a press.
    """

    running: bool = True
    single_until_s: float = 0.0
    phase_s: float = 0.0
    channels: tuple[bool, bool] = (True, True)
    volts_index: tuple[int, int] = (8, 9)
    time_index: int = 16
    position_div: tuple[float, float] = (1.6, -1.8)
    time_position_div: float = 0.0
    trigger_div: float = 1.6
    math: bool = False
    cursors: bool = False
    menu: str = ""
    menu_item: int = -1
    marker: tuple[float, float] | None = None
    saved: int = 0
    note: str = ""
    knobs: tuple[tuple[str, float], ...] = ()
    held: tuple[tuple[str, float], ...] = ()
    acted: tuple[str, ...] = ()
    lit: tuple[str, ...] = ()

    def knob_deg(self, name: str) -> float:
        """Return the rotation of a knob in degrees."""
        return dict(self.knobs).get(name, 0.0)

    def lamp(self, name: str, lit_colour: str) -> str:
        """Return the current colour of a control's lamp, "" if it is dark."""
        if name == "RUN_STOP":
            return lit_colour if self.running else RED
        if name in ("CH1", "CH2"):
            return lit_colour if self.channels[name == "CH2"] else ""
        return lit_colour if name in self.lit else ""


def press(state: InstrumentState, name: str, now_s: float) -> InstrumentState:
    """Process a button that was pressed far enough at ``now_s``."""
    state = dataclasses.replace(state, held=(*state.held, (name, now_s)), note="")
    if name == "RUN_STOP":
        return dataclasses.replace(state, running=not state.running, phase_s=now_s, single_until_s=0.0)
    if name == "SINGLE":
        return dataclasses.replace(state, running=True, single_until_s=now_s + SINGLE_S)
    if name == "AUTO_SET":
        fresh = InstrumentState(knobs=state.knobs, held=state.held, saved=state.saved, acted=state.acted)
        return dataclasses.replace(fresh, note="AUTO SET DONE")
    if name in ("CH1", "CH2"):
        first, second = state.channels
        return dataclasses.replace(state, channels=(not first, second) if name == "CH1" else (first, not second))
    if name == "MATH":
        return dataclasses.replace(state, math=not state.math)
    if name == "CURSORS":
        return dataclasses.replace(state, cursors=not state.cursors)
    if name == "SAVE":
        return dataclasses.replace(state, saved=state.saved + 1, note=f"SAVED WAVEFORM {state.saved + 1:02d}")
    if name in MENUS:
        opened = "" if state.menu in (name, "SYSTEM") else name
        return dataclasses.replace(state, menu=opened, menu_item=-1)
    # A button without a function in this instrument switches its own lamp.
    lit = tuple(n for n in state.lit if n != name) if name in state.lit else (*state.lit, name)
    return dataclasses.replace(state, lit=lit)


def release(state: InstrumentState, name: str) -> InstrumentState:
    """Process a released button."""
    return dataclasses.replace(
        state,
        held=tuple(pair for pair in state.held if pair[0] != name),
        acted=tuple(other for other in state.acted if other != name),
    )


def advance(state: InstrumentState, now_s: float) -> InstrumentState:
    """Advance time: a single acquisition ends, a held button acts again (once per hold)."""
    if state.single_until_s and now_s >= state.single_until_s:
        state = dataclasses.replace(state, running=False, phase_s=state.single_until_s, single_until_s=0.0)
    for name, since_s in state.held:
        if now_s - since_s >= HOLD_S and name not in state.acted:
            state = dataclasses.replace(state, acted=(*state.acted, name))
            if name == "MENU":
                state = dataclasses.replace(state, menu="SYSTEM", menu_item=-1)
            elif name == "SAVE":
                state = dataclasses.replace(state, saved=0, note="MEMORY CLEARED")
    return state


def turn(state: InstrumentState, name: str, degrees: float, detent_deg: float = 0.0) -> InstrumentState:
    """Turn a knob by ``degrees``, counter-clockwise positive; its value changes at its detents.

    The detents are ``detent_deg`` apart, as in the layout; 0: the usual distance for the knob's kind.
    Clockwise gives fewer volts or seconds per division, and moves traces and levels up or right.
    """
    before = state.knob_deg(name)
    after = before + degrees
    knobs = {**dict(state.knobs), name: after}
    state = dataclasses.replace(state, knobs=tuple(sorted(knobs.items())))
    pitch = detent_deg or (SCALE_DETENT_DEG if name.endswith("_SCALE") else POSITION_DETENT_DEG)
    steps = round(after / pitch) - round(before / pitch)
    if not steps:
        return state
    if name == "TIME_SCALE":
        return dataclasses.replace(state, time_index=_clamped(state.time_index + steps, SECONDS_PER_DIVISION))
    if name in ("CH1_SCALE", "CH2_SCALE"):
        volts = list(state.volts_index)
        channel = int(name == "CH2_SCALE")
        volts[channel] = _clamped(volts[channel] + steps, VOLTS_PER_DIVISION)
        return dataclasses.replace(state, volts_index=(volts[0], volts[1]))
    moved = -steps * POSITION_STEP
    if name in ("CH1_POSITION", "CH2_POSITION"):
        positions = list(state.position_div)
        channel = int(name == "CH2_POSITION")
        positions[channel] = _bounded(positions[channel] + moved, 4.0)
        return dataclasses.replace(state, position_div=(positions[0], positions[1]))
    if name == "TIME_POSITION":
        return dataclasses.replace(state, time_position_div=_bounded(state.time_position_div + moved, 6.0))
    if name == "TRIG_LEVEL":
        return dataclasses.replace(state, trigger_div=_bounded(state.trigger_div + moved, 4.0))
    return state


def touch(state: InstrumentState, x_share: float, y_share: float) -> InstrumentState:
    """Process a touch on the screen: choose an item of the open menu, or set the marker."""
    if state.menu and x_share > MENU_LEFT_SHARE:
        items = MENUS[state.menu]
        index = int((1 - y_share) * (len(items) + 1)) - 1
        return dataclasses.replace(state, menu_item=index if 0 <= index < len(items) else state.menu_item)
    return dataclasses.replace(state, marker=(x_share, y_share))


MENU_LEFT_SHARE = 0.8
"""Left edge of the menu as a share of the screen's width."""


def _clamped(index: int, table: tuple[float, ...]) -> int:
    return min(max(index, 0), len(table) - 1)


def _bounded(value: float, limit: float) -> float:
    return round(min(max(value, -limit), limit), 3)


def engineering(value: float, unit: str) -> str:
    """Write a value with three digits and a prefix, for example ``500 mV``."""
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "u"), (1e-9, "n")):
        if abs(value) >= factor * 0.9995 or factor == 1e-9:
            return f"{value / factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"
