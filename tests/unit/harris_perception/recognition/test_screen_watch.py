"""False and missed changes of the bench's screen over an hour of simulated time; only the screen is drawn."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest
from support.parameter_files import CONFIG

from harris_perception.core.recognition.screen_watch import ScreenCells
from harris_perception.core.recognition.state_config import StateConfig
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core import screen
from icu_simulator.core.instrument import InstrumentState, advance, press

RATE_HZ = 5.0
HOUR_S = 3600.0
JITTER_PX = 0.15
"""Scatter of the panel's pose in the screen's own pixels."""
NOISE = 1.6
IN_WORKSHOP = (66.0, 55.0, 46.0)
"""Light that the glass reflects in room ``workshop``: grey levels of cells without anything drawn."""
SHADOW_HALF_MM = 6.0


class WatchedScreen:
    """The screen as the left camera sees its cells, five times a second.

    ``reflected`` is the room's light in its glass (blue, green, red), and ``shadow_mm`` the middle, along x, of the
    arm's shadow on it.
    """

    def __init__(self, seed: int, reflected: tuple[float, float, float] = (15.0, 15.0, 15.0)) -> None:
        self._reflected, self.shadow_mm = np.array(reflected), math.inf
        print(f"seed {seed}")
        layout = load_layout(CONFIG / "scopes" / "dso_bench_4.yaml")
        control = next(c for c in layout.controls if c.kind == "touch_area")
        self.watch = ScreenCells(control, StateConfig())
        places = self.watch.points_m[:, :2] * 1e3 - control.position_mm
        width, height = screen.SIZE_PX
        self._x_mm = places[:, 0]
        self._x = ((places[:, 0] / control.size_mm[0] + 0.5) * width - 0.5).astype(np.float32)
        self._y = ((0.5 - places[:, 1] / control.size_mm[1]) * height - 0.5).astype(np.float32)
        self._rng = np.random.default_rng(seed)
        self._still_of: InstrumentState | None = None
        self.count = 0

    def look(self, state: InstrumentState) -> int:
        """Take one image; return the stamp of the last change, 0 for none."""
        if state != self._still_of:
            self._still_of, self._still = state, screen.still_part(state, screen.SIZE_PX)
        self.count += 1
        now_s = self.now_s + self._rng.uniform(-0.01, 0.01)
        drawn = screen.with_traces(self._still, state, now_s, self._rng.standard_normal((2, 364)))
        drawn = cv2.GaussianBlur(drawn, (0, 0), 1.17)  # lens and pixels, as Renderer
        x, y = self._rng.normal(0.0, JITTER_PX, 2).astype(np.float32)
        seen = cv2.remap(drawn, (self._x + x)[None], (self._y + y)[None], cv2.INTER_LINEAR)[0] * 0.9
        seen = seen + self._reflected * self._light()
        seen = seen + self._rng.normal(0.0, NOISE, seen.shape)
        self.watch.add(seen, np.zeros(len(seen), bool), self.stamp_ns, 1.0)
        return self.watch.changed_ns

    def _light(self) -> np.ndarray:
        """Return the share of light (N, 1) that the arm's soft shadow leaves, as in the bench."""
        off_mm = np.abs(self._x_mm - self.shadow_mm)
        return 1.0 - 0.35 * np.clip((SHADOW_HALF_MM + 2.0 - off_mm) / 4.0, 0.0, 1.0)[:, None]

    @property
    def now_s(self) -> float:
        return self.count / RATE_HZ

    @property
    def stamp_ns(self) -> int:
        return 10**12 + round(1e9 * self.now_s)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_an_hour_of_running_traces_changes_no_screen() -> None:
    watched = WatchedScreen(1)
    changes: list[int] = []
    for _ in range(round(HOUR_S * RATE_HZ)):
        changed = watched.look(InstrumentState())
        if changed and changed not in changes:
            changes.append(changed)
    images = watched.count
    print(f"{len(changes)} false changes in {images} images")
    assert len(changes) < 0.001 * images / (4.0 * RATE_HZ), "of the looks for an effect, four seconds each, under 0.1 %"


@pytest.mark.parametrize("seed", (1, 2, 3))
@pytest.mark.parametrize("name", ["AUTO_SET", "SAVE", "MENU", "CURSORS", "SINGLE"])
def test_what_a_key_changes_on_a_running_screen_is_seen(name: str, seed: int) -> None:
    watched, state = WatchedScreen(seed), InstrumentState()
    for _ in range(round(15 * RATE_HZ)):
        assert watched.look(state) == 0
    after = press(state, name, watched.now_s)
    if name == "SINGLE":  # it waits for its trigger first
        after = dataclasses.replace(after, running=False, phase_s=after.single_until_s, single_until_s=0.0)
    begin = watched.stamp_ns
    assert [watched.look(after) for _ in range(5)][-1] > begin, "within a second"


@pytest.mark.parametrize("seed", (1, 2, 3))
def test_single_presses_on_an_instrument_that_has_just_stopped_are_seen(seed: int) -> None:
    """The trace runs for 0.6 s after each press, so before, its cells failed to last, or had not rested for 6 s."""
    watched, state = WatchedScreen(seed), InstrumentState()
    for _ in range(round(15 * RATE_HZ)):
        assert watched.look(state) == 0
    for name in ("RUN_STOP", "SINGLE", "SINGLE", "SINGLE"):
        state, begin = press(state, name, watched.now_s), watched.stamp_ns
        for _ in range(round(3 * RATE_HZ)):
            state = advance(state, watched.now_s)
            watched.look(state)
        assert watched.watch.changed_ns > begin, name


@pytest.mark.timeout(600)
@pytest.mark.parametrize("period_s", (2.6, 4.6))
def test_a_reading_renewed_on_a_still_screen_is_no_change(period_s: float) -> None:
    watched, stopped = WatchedScreen(1), InstrumentState(running=False, phase_s=2.8)
    for _ in range(round(HOUR_S / 12 * RATE_HZ)):
        reading = int(watched.now_s // period_s)
        assert watched.look(dataclasses.replace(stopped, note=f"{reading % 2 * 11111 + 45678} MV")) == 0, watched.now_s


@pytest.mark.parametrize("seed", (1, 2))
def test_the_arms_shadow_that_moves_over_a_stopped_screen_is_no_change(seed: int) -> None:
    """Before, there were about two changes in 30 s, and a touch without effect was answered by one of them."""
    watched, stopped = WatchedScreen(seed, IN_WORKSHOP), InstrumentState(running=False, phase_s=2.8)
    for _ in range(round(10 * RATE_HZ)):
        assert watched.look(stopped) == 0
    positions = np.random.default_rng(seed)
    for _ in range(75):
        watched.shadow_mm = positions.uniform(-60.0, 60.0)
        for _ in range(round(1.6 * RATE_HZ)):
            assert watched.look(stopped) == 0, (watched.now_s, watched.shadow_mm)


@pytest.mark.parametrize("seed", (1, 2, 3))
@pytest.mark.parametrize("name, presses", [("AUTO_SET", 1), ("SAVE", 1), ("MENU", 2), ("CURSORS", 2)])
def test_what_a_key_changes_on_a_stopped_screen_beside_the_arms_shadow_is_seen(
    name: str, presses: int, seed: int
) -> None:
    watched, state = WatchedScreen(seed, IN_WORKSHOP), InstrumentState(running=False, phase_s=2.8)
    for _ in range(presses):  # a second press undoes what the first one has drawn
        watched.shadow_mm = math.inf
        for _ in range(round(10 * RATE_HZ)):
            watched.look(state)
        watched.shadow_mm = 30.0
        for _ in range(round(1.6 * RATE_HZ)):
            watched.look(state)
        state, begin = press(state, name, watched.now_s), watched.stamp_ns
        assert [watched.look(state) for _ in range(5)][-1] > begin, "within a second"
