"""How the instrument reacts, and what its screen shows."""

from __future__ import annotations

import numpy as np
import pytest

from icu_common.core.panel.panel_layout import rgb
from icu_simulator.core import screen
from icu_simulator.core.instrument import (
    RED,
    SECONDS_PER_DIVISION,
    VOLTS_PER_DIVISION,
    InstrumentState,
    advance,
    engineering,
    press,
    release,
    touch,
    turn,
)

SIZE = screen.SIZE_PX


def test_run_stop_toggles_and_keeps_the_moment() -> None:
    stopped = press(InstrumentState(), "RUN_STOP", 12.5)
    assert not stopped.running
    assert stopped.phase_s == 12.5
    assert stopped.lamp("RUN_STOP", "#22d24a") == RED
    running = press(stopped, "RUN_STOP", 14.0)
    assert running.running
    assert running.lamp("RUN_STOP", "#22d24a") == "#22d24a"


def test_single_stops_by_itself() -> None:
    state = release(press(InstrumentState(running=False), "SINGLE", 2.0), "SINGLE")
    assert state.running
    assert advance(state, 2.5).running
    done = advance(state, 2.7)
    assert not done.running
    assert done.phase_s == pytest.approx(2.6)
    assert advance(done, 9.0) == done


def test_channels_switch_with_their_lamps() -> None:
    state = press(InstrumentState(), "CH2", 1.0)
    assert state.channels == (True, False)
    assert state.lamp("CH2", "#25b7e0") == ""
    assert state.lamp("CH1", "#f4c51e") == "#f4c51e"
    assert press(state, "CH2", 2.0).channels == (True, True)


@pytest.mark.parametrize(("name", "field"), [("MATH", "math"), ("CURSORS", "cursors")])
def test_toggles(name: str, field: str) -> None:
    on = press(InstrumentState(), name, 1.0)
    assert getattr(on, field) is True
    assert getattr(press(on, name, 2.0), field) is False


def test_menus_open_and_close_and_a_touch_chooses() -> None:
    state = press(InstrumentState(), "MENU", 1.0)
    assert state.menu == "MENU"
    # Title and four items share the height: the third cell from the top is the second item.
    assert touch(state, 0.9, 0.5).menu_item == 1
    assert touch(state, 0.9, 0.95).menu_item == -1
    assert touch(state, 0.5, 0.5).marker == (0.5, 0.5)
    assert press(state, "TRIG_MENU", 2.0).menu == "TRIG_MENU"
    assert press(state, "MENU", 2.0).menu == ""


def test_holding_a_button_acts_once_more() -> None:
    state = press(InstrumentState(), "MENU", 1.0)
    assert advance(state, 1.9).menu == "MENU"
    held = advance(state, 2.05)
    assert held.menu == "SYSTEM"
    assert advance(held, 5.0) == held
    free = release(held, "MENU")
    assert free.held == ()
    assert free.acted == ()


def test_auto_set_restores_scales_but_not_knobs() -> None:
    state = turn(press(InstrumentState(), "CH1", 1.0), "CH1_SCALE", -90.0)
    state = press(press(state, "RUN_STOP", 2.0), "AUTO_SET", 3.0)
    fresh = InstrumentState()
    assert (state.channels, state.volts_index, state.running) == (fresh.channels, fresh.volts_index, True)
    assert state.knob_deg("CH1_SCALE") == -90.0
    assert state.note


def test_save_counts() -> None:
    state = press(press(InstrumentState(), "SAVE", 1.0), "SAVE", 2.0)
    assert state.saved == 2
    assert "02" in state.note


def test_scales_step_1_2_5_at_detents() -> None:
    state = InstrumentState()
    assert VOLTS_PER_DIVISION[state.volts_index[0]] == 0.5
    small = turn(state, "CH1_SCALE", 8.0)
    assert small.volts_index == state.volts_index, "before the detent nothing changes"
    seen = []
    for _ in range(3):
        state = turn(state, "CH1_SCALE", -18.0)
        seen.append(VOLTS_PER_DIVISION[state.volts_index[0]])
    assert seen == pytest.approx([0.2, 0.1, 0.05])
    faster = turn(InstrumentState(), "TIME_SCALE", -18.0)
    ratio = SECONDS_PER_DIVISION[faster.time_index] / SECONDS_PER_DIVISION[InstrumentState().time_index]
    assert ratio == pytest.approx(0.5)


def test_many_small_turns_are_one_large_one() -> None:
    state = InstrumentState()
    for _ in range(600):
        state = turn(state, "TRIG_LEVEL", -0.1)
    assert state.trigger_div == turn(InstrumentState(), "TRIG_LEVEL", -60.0).trigger_div
    assert state.knob_deg("TRIG_LEVEL") == pytest.approx(-60.0)
    assert turn(state, "TRIG_LEVEL", -9000.0).trigger_div == 4.0


def test_positions_move_up_clockwise() -> None:
    state = turn(InstrumentState(), "CH2_POSITION", -45.0)
    assert state.position_div[1] == pytest.approx(-0.8)
    assert turn(InstrumentState(), "TIME_POSITION", 90.0).time_position_div == pytest.approx(-2.0)


def test_engineering_notation() -> None:
    assert [engineering(v, "V") for v in (5.0, 0.5, 2e-3)] == ["5 V", "500 mV", "2 mV"]
    assert [engineering(v, "s") for v in (2e-4, 1e-9, 0.05)] == ["200 us", "1 ns", "50 ms"]


def drawn(state: InstrumentState, now_s: float, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((2, 364))
    return screen.with_traces(screen.still_part(state, SIZE), state, now_s, noise)


def test_running_trace_moves_and_stopped_trace_stands() -> None:
    running = InstrumentState()
    assert np.abs(drawn(running, 3.0).astype(int) - drawn(running, 3.2)).max() > 100
    stopped = press(running, "RUN_STOP", 3.0)
    assert np.array_equal(drawn(stopped, 3.1, 1), drawn(stopped, 9.7, 2))


def test_label_says_run_or_stop() -> None:
    running, stopped = InstrumentState(), press(InstrumentState(), "RUN_STOP", 3.0)
    corner = (slice(4, 30), slice(10, 60))
    green, red = (screen.still_part(state, SIZE)[corner].reshape(-1, 3) for state in (running, stopped))
    assert ((green == rgb(screen.GREEN)[::-1]).all(axis=1)).mean() > 0.3
    assert ((red == rgb(RED)[::-1]).all(axis=1)).mean() > 0.3


def test_switched_off_channel_has_no_trace() -> None:
    off = press(InstrumentState(), "CH1", 1.0)
    area = (slice(screen.TOP_PX, screen.TOP_PX + 400), slice(30, 740))
    yellow = np.array(rgb(screen.YELLOW)[::-1])

    def count(state: InstrumentState) -> int:
        return int((drawn(state, 2.0)[area] == yellow).all(axis=2).sum())

    assert count(InstrumentState()) > 500
    assert count(off) == 0


def test_marker_is_drawn_where_the_screen_was_touched() -> None:
    state = touch(press(InstrumentState(), "RUN_STOP", 1.0), 0.25, 0.2)
    change = np.abs(drawn(state, 2.0).astype(int) - drawn(press(InstrumentState(), "RUN_STOP", 1.0), 2.0)).max(axis=2)
    rows, columns = np.nonzero(change > 60)
    assert columns.mean() / SIZE[0] == pytest.approx(0.25, abs=0.01)
    assert 1 - rows.mean() / SIZE[1] == pytest.approx(0.2, abs=0.01)
