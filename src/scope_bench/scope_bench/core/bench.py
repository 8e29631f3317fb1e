"""The bench as a whole: motor samples in; stylus, contacts, instrument and the log of the truth out."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry import Array, Transform
from icu_common.core.panel_layout import PanelLayout
from scope_bench.core import instrument
from scope_bench.core.configuration import BenchConfig
from scope_bench.core.instrument import InstrumentState
from scope_bench.core.mechanics import Errors, Mechanism, draw_errors
from scope_bench.core.renderer import Moment, base_from_panel
from scope_bench.core.touch import Touch, TouchEvent

GAP_S = 1.0
"""After a longer silence of the motors the way between two samples is unknown."""
_HISTORY = 400
_STILL_S, _STILL_M = 0.06, 1e-7
_QUIET = ("running", "single_until_s", "phase_s", "held", "acted")
"""Fields of the state that the log writes in its own words or not at all."""


class Bench:
    """Follows motor samples; times are seconds of one monotonic clock.

    Parameters
    ----------
    layout
        The panel.
    config
        The bench; its seed draws the hidden errors.
    """

    def __init__(self, layout: PanelLayout, config: BenchConfig) -> None:
        self.layout = layout
        self.config = config
        self.errors: Errors = draw_errors(config.mechanics, np.random.default_rng(config.seed))
        self._mechanism = Mechanism(config.mechanics, config.stylus, self.errors)
        self.moved: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.panel_from: Transform = base_from_panel(config.panel)
        self.state = InstrumentState()
        self.touch = Touch(layout, config.stylus.ball_diameter_mm / 2, self._react, self._knob_deg)
        self._records: list[dict[str, Any]] = []
        self._history: deque[tuple[float, Array, Array]] = deque(maxlen=_HISTORY)
        self._commanded: Array | None = None
        self._last_s = -np.inf

    def feed(self, mpos_mm: npt.ArrayLike, spindle: float, coolant: bool, time_s: float) -> None:
        """Take one sample of the motors.

        Parameters
        ----------
        mpos_mm
            (3,) true positions in the frame of the homed machine.
        spindle, coolant
            The tool pins.
        time_s
            When; samples that go back in time are ignored.
        """
        if time_s < self._last_s:
            return
        self._commanded = self._mechanism.tip(mpos_mm, spindle, coolant, time_s)
        panel_mm = self.panel_from.inverse().apply(self._commanded) * 1000
        if time_s - self._last_s > GAP_S:
            self.touch.place(panel_mm, time_s)
        else:
            self.touch.move(panel_mm, time_s, self._last_s)
        self._last_s = time_s
        self._history.append((time_s, self.tip_base(), self._mechanism.carriage))
        self.advance(time_s)

    def _knob_deg(self, name: str) -> float:
        return self.state.knob_deg(name)

    def advance(self, time_s: float) -> None:
        """Let the instrument's own time pass."""
        self._become(instrument.advance(self.state, time_s), time_s)

    def tip_base(self) -> Array:
        """Return the ball's true centre now, (3,) metres in base_link."""
        return self.panel_from.apply(np.asarray(self.touch.tip_mm) / 1000)

    def _places_at(self, time_s: float) -> tuple[Array, Array]:
        """Return the ball's centre (3,) and the carriage's place (2,), m in base_link, between the samples around."""
        if not self._history:
            return np.zeros(3), np.zeros(2)
        later = self._history[-1]
        for earlier in reversed(self._history):
            if earlier[0] <= time_s:
                span = later[0] - earlier[0]
                share = min((time_s - earlier[0]) / span, 1.0) if span > 0 else 0.0
                tip, carriage = (a + (b - a) * share for a, b in zip(earlier[1:], later[1:]))
                return np.asarray(tip), np.asarray(carriage)
            later = earlier
        return later[1], later[2]

    def moment(self, time_s: float) -> Moment:
        """Return what a camera sees at ``time_s``."""
        tip, carriage = self._places_at(time_s)
        return Moment(
            tip=(float(tip[0]), float(tip[1]), float(tip[2])),
            state=self.state,
            now_s=time_s,
            sunk_mm=self.touch.sunk_mm(),
            carriage=(float(carriage[0]), float(carriage[1])),
            crossing=bool(np.abs(carriage - self._places_at(time_s - _STILL_S)[1]).max() > _STILL_M),
        )

    def move_panel(self, dx_m: float, dy_m: float, turn_deg: float) -> None:
        """Push the panel along by so much."""
        x, y, turn = self.moved
        self.moved = (x + dx_m, y + dy_m, turn + turn_deg)
        self._stand_anew()

    def reconfigure(self, config: BenchConfig) -> None:
        """Take another configuration; the mechanism keeps its errors unless their bounds changed."""
        old, self.config = self.config, config
        if config.mechanics != old.mechanics or config.stylus != old.stylus:
            self.errors = draw_errors(config.mechanics, np.random.default_rng(config.seed))
            self._mechanism = Mechanism(config.mechanics, config.stylus, self.errors)
            self.touch.radius_mm = config.stylus.ball_diameter_mm / 2
        if config.panel != old.panel:
            self._stand_anew()

    def _stand_anew(self) -> None:
        self.panel_from = base_from_panel(self.config.panel, self.moved)
        if self._commanded is not None:
            self.touch.place(self.panel_from.inverse().apply(self._commanded) * 1000, self._last_s)

    def take_records(self) -> list[dict[str, Any]]:
        """Return what has happened since the last call, for the log; ``time_s`` is still on the monotonic clock."""
        records, self._records = self._records, []
        return records

    def truth(self) -> dict[str, Any]:
        """Return the whole physical truth at the newest sample."""
        commanded = self._commanded if self._commanded is not None else np.zeros(3)
        return {
            "tip_base_m": self.tip_base().tolist(),
            "tip_panel_mm": list(self.touch.tip_mm),
            "commanded_base_m": commanded.tolist(),
            "carriage_m": self._mechanism.carriage.tolist(),
            "contact": self.touch.contact,
            "base_from_panel": matrix(self.panel_from),
            "instrument": dataclasses.asdict(self.state),
            "errors": {
                "play_mm": self.errors.play_mm.tolist(),
                "base_from_carriage": self.errors.base_from_carriage.tolist(),
                "lean": self.errors.lean.tolist(),
            },
        }

    def _react(self, event: TouchEvent) -> None:
        tip_m = self.panel_from.apply(np.asarray(event.tip_mm) / 1000)
        record: dict[str, Any] = {
            "time_s": event.time_s,
            "event": event.kind,
            "control": event.control,
            "tip_base_m": [round(float(v), 7) for v in tip_m],
            "tip_panel_mm": [round(v, 4) for v in event.tip_mm],
            "overtravel_mm": round(event.overtravel_mm, 4),
        }
        state, time_s = self.state, event.time_s
        if event.kind == "press":
            state = instrument.press(state, event.control, time_s)
        elif event.kind == "unpress":
            state = instrument.release(state, event.control)
        elif event.kind == "turn":
            detent_deg = self.layout.control(event.control).detent_deg
            state = instrument.turn(state, event.control, event.degrees, detent_deg)
        elif event.kind in ("contact", "drag") and event.control:
            state = self._touched_screen(event)
        if event.kind == "release":
            record["turned_deg"] = round(event.degrees, 3)
        # Turning and dragging go on from step to step; the log has their sum at the release.
        if event.kind not in ("turn", "drag"):
            self._records.append(record)
        self._become(state, time_s)

    def _touched_screen(self, event: TouchEvent) -> InstrumentState:
        for control in self.layout.controls:
            if control.name == event.control and control.kind == "touch_area":
                x = (event.tip_mm[0] - control.position_mm[0]) / control.size_mm[0] + 0.5
                y = (event.tip_mm[1] - control.position_mm[1]) / control.size_mm[1] + 0.5
                return instrument.touch(self.state, min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0))
        return self.state

    def _become(self, state: InstrumentState, time_s: float) -> None:
        old, self.state = self.state, state
        if state == old:
            return
        before, after = dataclasses.asdict(old), dataclasses.asdict(state)
        changes = {
            key: after[key] for key in after if after[key] != before[key] and key not in _QUIET and key != "knobs"
        }
        if state.running != old.running:
            changes["running"] = state.running
        if changes:
            self._records.append({"time_s": time_s, "event": "instrument", "changes": changes})


def matrix(transform: Transform) -> dict[str, Any]:
    """Return a transform for JSON."""
    return {"rotation": transform.rotation.tolist(), "translation_m": transform.translation.tolist()}
