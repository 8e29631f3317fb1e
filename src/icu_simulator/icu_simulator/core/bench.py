"""The whole bench: motor samples in; stylus, contacts, instrument and the log of the ground truth out."""

from __future__ import annotations

import dataclasses
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_simulator.core import instrument
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.mechanics import Errors, Mechanism, draw_errors
from icu_simulator.core.renderer import Moment, base_from_panel
from icu_simulator.core.touch import FACE, BenchTouch, TouchEvent
from icu_simulator.imaging.motion import SAMPLE_S, TipTrack
from icu_simulator.manufacture.layout import deviations, manufactured
from icu_simulator.mechanisms.contact import GlassSensor, contact_diameter_mm
from icu_simulator.mechanisms.drives import Drives
from icu_simulator.mechanisms.switch import BenchStylusSwitch

GAP_S = 1.0
"""Maximum seconds between two motor samples; after a longer gap the path between them is unknown."""
NEAR_MM = 5.0
"""Height in mm above the highest control below which the stylus switch may act soon."""
_HISTORY = 400
_TRACKED = 120
"""Number of newest samples that an exposure may need."""
_STILL_S, _STILL_M = 0.06, 1e-7
_QUIET = ("running", "single_until_s", "phase_s", "held", "acted")
"""Fields of the state that the log writes in its own form or not at all."""


class Bench:
    """Follows motor samples; times are seconds of one monotonic clock.

    Parameters
    ----------
    layout
        The nominal panel.
    config
        The bench; its seed draws the hidden errors.
    """

    def __init__(self, layout: PanelLayout, config: BenchConfig) -> None:
        self.nominal = layout
        self.layout = manufactured(layout, config.manufacture, config.seed)
        """The panel as manufactured: the surface that is touched, and the reference for a touch."""
        self.config = config
        self.errors: Errors = draw_errors(config.mechanics, np.random.default_rng(config.seed))
        self._drives = Drives(config.mechanisms, config.seed)
        self._mechanism = Mechanism(config.mechanics, config.stylus, self.errors, self._drives)
        self.moved: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.panel_from: Transform = base_from_panel(config.panel)
        self.state = InstrumentState()
        self.touch = self._make_touch(config)
        self._switch = BenchStylusSwitch(config.stylus.switch)
        self._glass = GlassSensor()
        self._records: list[dict[str, Any]] = []
        self._history: deque[tuple[float, Array, Array]] = deque(maxlen=_HISTORY)
        self._commanded: Array | None = None
        self._last_s = -np.inf
        self._log_layout()

    def _make_touch(self, config: BenchConfig) -> BenchTouch:
        radius_mm = config.stylus.ball_diameter_mm / 2
        spring, mechanisms = config.stylus.spring, config.mechanisms
        return BenchTouch(self.layout, radius_mm, self._react, self._knob_deg, config.keys, spring, mechanisms)

    def _log_layout(self) -> None:
        """Log the true panel if it differs from the nominal one."""
        if self.layout is not self.nominal:
            time_s = self._last_s if np.isfinite(self._last_s) else 0.0
            controls = deviations(self.nominal, self.layout)
            self._records.append({"time_s": time_s, "event": "layout", "controls": controls})

    def feed(self, mpos_mm: npt.ArrayLike, spindle: float, coolant: bool, time_s: float) -> None:
        """Process one motor sample.

        Parameters
        ----------
        mpos_mm
            (3,) true positions in the frame of the homed machine.
        spindle, coolant
            The tool pins.
        time_s
            Time of the sample; samples that go back in time are ignored.
        """
        if time_s < self._last_s:
            return
        self._commanded = self._mechanism.tip(mpos_mm, spindle, coolant, time_s)
        panel_mm = self.panel_from.inverse().apply(self._commanded) * 1000
        if time_s - self._last_s > GAP_S:
            self.touch.place(panel_mm, time_s)
        else:
            self.touch.move(panel_mm, time_s, self._last_s)
        self._slide()
        self._switch.compress(self.touch.compression_mm)
        if self.config.mechanisms.glass.enabled:
            self._feel_glass(time_s)
        self._last_s = time_s
        self._history.append((time_s, self.tip_base(), self._mechanism.carriage))
        self.advance(time_s)

    def _feel_glass(self, time_s: float) -> None:
        """Update a capacitive screen's decision whether the contact is a touch."""
        glass, touch = self.config.mechanisms.glass, self.touch
        on_screen = any(c.name == touch.contact and c.kind == "touch_area" for c in self.layout.controls)
        diameter = contact_diameter_mm(touch.force_n, touch.radius_mm, glass) if on_screen else 0.0
        if self._glass.feel(diameter, time_s, glass):
            self._react(
                TouchEvent(
                    kind="screen",
                    control=touch.contact,
                    time_s=time_s,
                    tip_mm=touch.tip_mm,
                    overtravel_mm=touch.compression_mm,
                    force_n=touch.force_n,
                )
            )

    def _slide(self) -> None:
        """Move the panel by the distance that the stylus has pushed it since the last sample."""
        dx, dy = self.touch.take_slide()
        if dx or dy:
            away = self.panel_from.rotation @ np.array([dx, dy, 0.0]) / 1000
            x, y, turn = self.moved
            self.moved = (x + float(away[0]), y + float(away[1]), turn)
            self.panel_from = base_from_panel(self.config.panel, self.moved)

    @property
    def switch_closed(self) -> bool:
        """Whether the switch in the stylus connects the board's probe input to ground."""
        return self._switch.closed

    def switch_is_near(self) -> bool:
        """Return whether the stylus has a switch and is so low that it may act soon."""
        return self.config.stylus.switch.enabled and self.touch.is_near(NEAR_MM)

    def _knob_deg(self, name: str) -> float:
        return self.state.knob_deg(name)

    def advance(self, time_s: float) -> None:
        """Advance the instrument's own time."""
        self._become(instrument.advance(self.state, time_s), time_s)

    def tip_base(self) -> Array:
        """Return the current true centre of the ball, (3,) metres in base_link."""
        return self.panel_from.apply(np.asarray(self.touch.tip_mm) / 1000)

    def _places_at(self, time_s: float) -> tuple[Array, Array]:
        """Return ball centre (3,) and carriage position (2,), m in base_link, interpolated between samples."""
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

    def track(self, time_s: float, half_s: float) -> TipTrack:
        """Return the path of the tip from ``half_s`` before a time to ``half_s`` after it."""
        times = np.linspace(-half_s, half_s, 2 * max(int(np.ceil(half_s / SAMPLE_S)), 1) + 1)
        newest = list(self._history)[-_TRACKED:]
        if not newest:
            return TipTrack(times_s=times, tips=np.zeros((len(times), 3)))
        seconds = np.array([sample[0] for sample in newest]) - time_s
        tips = np.array([sample[1] for sample in newest])
        return TipTrack(times_s=times, tips=np.stack([np.interp(times, seconds, tip) for tip in tips.T], axis=-1))

    def moment(self, time_s: float, half_s: float = 0.0) -> Moment:
        """Return the scene at ``time_s``, and the stylus's path for ``half_s`` before and after it."""
        tip, carriage = self._places_at(time_s)
        return Moment(
            tip=(float(tip[0]), float(tip[1]), float(tip[2])),
            state=self.state,
            now_s=time_s,
            sunk_mm=self.touch.sunk_mm(),
            carriage=(float(carriage[0]), float(carriage[1])),
            crossing=bool(np.abs(carriage - self._places_at(time_s - _STILL_S)[1]).max() > _STILL_M),
            track=self.track(time_s, half_s) if half_s > 0 else None,
        )

    def move_panel(self, dx_m: float, dy_m: float, turn_deg: float) -> None:
        """Push the panel by this translation and rotation."""
        x, y, turn = self.moved
        self.moved = (x + dx_m, y + dy_m, turn + turn_deg)
        self._stand_anew()

    def reconfigure(self, config: BenchConfig) -> None:
        """Apply another configuration; the mechanism keeps its errors and its play unless their bounds changed.

        Raises
        ------
        ConfigError
            If it does not fit the panel; the configuration then stays unchanged.
        """
        self.touch.rebuild_keys(config.keys, config.stylus.spring)
        old, self.config = self.config, config
        if config.mechanics.still() != old.mechanics.still() or config.stylus.still() != old.stylus.still():
            self.errors = draw_errors(config.mechanics, np.random.default_rng(config.seed))
            self._mechanism = Mechanism(config.mechanics, config.stylus, self.errors, self._drives)
            self.touch.radius_mm = config.stylus.ball_diameter_mm / 2
        self._mechanism.shift(config.mechanics)
        self._drives.configure(config.mechanisms)
        self.touch.mechanisms = config.mechanisms
        self._switch.config = config.stylus.switch
        if config.manufacture != old.manufacture:
            self.layout = manufactured(self.nominal, config.manufacture, config.seed)
            self.touch = self._make_touch(config)
            self._log_layout()
        if config.panel != old.panel or config.manufacture != old.manufacture:
            self._stand_anew()

    def _stand_anew(self) -> None:
        self.panel_from = base_from_panel(self.config.panel, self.moved)
        if self._commanded is not None:
            self.touch.place(self.panel_from.inverse().apply(self._commanded) * 1000, self._last_s)

    def take_records(self) -> list[dict[str, Any]]:
        """Return the events since the last call, for the log; ``time_s`` is still on the monotonic clock."""
        records, self._records = self._records, []
        return records

    def truth(self) -> dict[str, Any]:
        """Return the complete physical ground truth at the newest sample."""
        commanded = self._commanded if self._commanded is not None else np.zeros(3)
        return {
            "tip_base_m": self.tip_base().tolist(),
            "tip_panel_mm": list(self.touch.tip_mm),
            "commanded_base_m": commanded.tolist(),
            "carriage_m": self._mechanism.carriage.tolist(),
            "contact": self.touch.contact,
            "compression_mm": self.touch.compression_mm,
            "switch_closed": self.switch_closed,
            "force_n": self.touch.force_n,
            "side_force_n": self.touch.side_force_n,
            "sinking_mm": self.touch.sinking_mm,
            "warmer_k": self._drives.rise_k(self._last_s) if np.isfinite(self._last_s) else 0.0,
            "base_from_panel": matrix(self.panel_from),
            "controls": deviations(self.nominal, self.layout),
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
            "force_n": round(event.force_n, 3),
        }
        if event.control and event.control != FACE:
            control = self.layout.control(event.control)
            record["control_mm"] = [round(v, 4) for v in (*control.position_mm, control.height_mm)]
        state, time_s = self.state, event.time_s
        if event.kind == "press":
            state = instrument.press(state, event.control, time_s)
        elif event.kind == "unpress":
            state = instrument.release(state, event.control)
        elif event.kind == "turn":
            detent_deg = self.layout.control(event.control).detent_deg
            state = instrument.turn(state, event.control, event.degrees, detent_deg)
        elif event.kind in self._screen_events() and event.control:
            state = self._touched_screen(event)
        if event.kind == "release":
            record["turned_deg"] = round(event.degrees, 3)
        # Turning and dragging continue from step to step; the log has their sum at the release.
        if event.kind not in ("turn", "drag"):
            self._records.append(record)
        self._become(state, time_s)

    def _screen_events(self) -> tuple[str, ...]:
        if not self.config.mechanisms.glass.enabled:
            return "contact", "drag"
        return ("screen", "drag") if self._glass.touched else ("screen",)

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
