"""Parts of the guard that need no process: frames, the judgement of a silent node, the clock."""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path

import pytest

from gantry_driver.adapters.guard import clock as clock_module
from gantry_driver.adapters.guard.clock import GuardClock, counts_of_environment
from gantry_driver.core.configuration.machine_config import DriverConfig, MachineConfig, StylusConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.commands import COMMANDS
from gantry_driver.core.guard.messages import (
    MAX_FRAME_BYTES,
    FrameError,
    FrameReader,
    config_of,
    config_values,
    event_of,
    event_values,
    frame,
    waypoint_values,
    waypoints_of,
)
from gantry_driver.core.guard.silence import LATE_S, SilenceWatch, ThreadSample
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import Answered, CloseRequested, Event, Note, Position, StateChanged
from icu_common.adapters.steps.step_layout import BYTES_READ, BYTES_WRITTEN, LEDGER_VARIABLE, StepCounts
from icu_common.adapters.steps.step_ledger import StepLedger
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.results import GoalResult, Outcome

RESULT = GoalResult(
    goal_id="7",
    goal="2 points",
    outcome=Outcome.ABORTED,
    reason="why",
    error_m=0.1,
    duration_s=2.5,
    details=(("a", "b"),),
    code="c",
)


def sent(message: dict[str, object], pieces: int = 1) -> list[dict[str, object]]:
    data, reader = frame(message), FrameReader()
    size = max(1, len(data) // pieces)
    return [m for at in range(0, len(data), size) for m in reader.feed(data[at : at + size])]


@pytest.mark.parametrize("pieces", [1, 2, 7, 1000])
def test_a_frame_arrives_whole_however_it_is_cut(pieces: int) -> None:
    assert sent({"do": "beat", "text": "Ω", "values": [1, 2.5, None]}, pieces) == [
        {"do": "beat", "text": "Ω", "values": [1, 2.5, None]}
    ]


def test_frames_that_arrive_together_come_one_after_the_other() -> None:
    assert [m["n"] for m in FrameReader().feed(frame({"n": 1}) + frame({"n": 2}) + frame({"n": 3})[:5])] == [1, 2]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (struct.pack(">I", MAX_FRAME_BYTES + 1), f"the frame has {MAX_FRAME_BYTES + 1} bytes"),
        (struct.pack(">I", 3) + b"abc", "not JSON"),
        (struct.pack(">I", 2) + b"[]", "not a JSON object"),
        (struct.pack(">I", 10_000) + 10_000 * b"[", "not JSON"),
        (struct.pack(">I", 0), "not JSON"),
    ],
)
def test_what_is_no_frame_is_refused_by_its_length_first(data: bytes, reason: str) -> None:
    with pytest.raises(FrameError, match=reason):
        list(FrameReader().feed(data))


def test_a_message_that_is_too_long_is_not_sent() -> None:
    with pytest.raises(FrameError, match="limit"):
        frame({"text": "x" * MAX_FRAME_BYTES})


@pytest.mark.parametrize(
    "event",
    [
        StateChanged(text="stopped: why"),
        StateChanged(text="stopped: why", logged=False),
        Position(reading_m=(0.1, 0.2, 0.3)),
        Position(reading_m=(0.1, 0.2, 0.3), probe=True),
        Note(level="error", text="what"),
        CloseRequested(reason="silent"),
        Answered(result=RESULT),
    ],
)
def test_every_event_arrives_as_it_was(event: Event) -> None:
    (message,) = sent({"events": [event_values(event)]})
    assert event_of(message["events"][0]) == event  # type: ignore[index]


def test_an_answer_without_a_measured_error_arrives_too() -> None:
    result = GoalResult(goal_id="7", goal="2 points", outcome=Outcome.ACCEPTED)
    (message,) = sent({"events": [event_values(Answered(result=result))]})
    arrived = event_of(message["events"][0])  # type: ignore[index]
    assert isinstance(arrived, Answered) and math.isnan(arrived.result.error_m)
    assert arrived.result.outcome is Outcome.ACCEPTED


def test_a_configuration_and_points_arrive_as_they_were() -> None:
    config = DriverConfig(
        port="/dev/x",
        stylus=StylusConfig(kind="servo_m3"),
        machine=MachineConfig(travel_mm=(1.0, 2.0, 9.0), pull_off_mm=0.5),
    )
    points = [Waypoint(positions_m=(0.1, 0.2), velocities_m_s=(), time_s=0.5), Waypoint(positions_m=())]
    (message,) = sent({"config": config_values(config), "points": waypoint_values(points)})
    assert config_of(message["config"]) == config  # type: ignore[arg-type]
    assert waypoints_of(message["points"]) == points  # type: ignore[arg-type]


def test_the_longest_trajectory_fits_into_a_frame() -> None:
    third = 1.0 / 3.0
    point = Waypoint(positions_m=(third,) * 3, velocities_m_s=(third,) * 3, time_s=third)
    assert len(frame({"points": waypoint_values([point] * 10_000)})) < MAX_FRAME_BYTES


def test_the_commands_do_with_a_machine_what_their_names_say() -> None:
    machine = Machine(DriverConfig())
    assert COMMANDS["home"](machine, 0.0, {}) == "the driver is disconnected: not opened yet"
    assert COMMANDS["enable"](machine, 0.0, {"on": True}) == "" and machine.enabled
    COMMANDS["activate"](machine, 0.0, {"on": False})
    assert not machine.active
    COMMANDS["configure"](machine, 0.0, {"config": config_values(DriverConfig(feed_m_s=0.01))})
    assert machine.config.feed_m_s == 0.01
    machine.take_events()
    point = waypoint_values([Waypoint(positions_m=(0.1, 0.1, 0.0))])
    COMMANDS["run"](machine, 0.0, {"goal_id": "g", "names": list(JOINTS), "points": point, "age_s": 0.0})
    (answer,) = machine.take_events()
    assert isinstance(answer, Answered) and answer.result.reason == "the driver is disconnected: not opened yet"
    status = COMMANDS["status"](machine, 0.0, {})
    assert status["state"] == "disconnected: not opened yet" and ("homed", "False") in status["values"]


# --- the judgement of a silent node -----------------------------------------------------------------------------------


def look_for(watch: SilenceWatch, seconds: float, thread: ThreadSample | None, step_s: float = 0.01) -> float | None:
    """Look every 10 ms; return the seconds after which the node counted as hung."""
    now, ran_ns = watch_start(watch), 0
    for count in range(1, int(seconds / step_s) + 1):
        sample = {} if thread is None else {1: thread}
        if thread is not None and thread.cpu_ns < 0:  # one that runs
            ran_ns += 1_000_000
            sample = {1: ThreadSample(runnable=True, cpu_ns=ran_ns)}
        if watch.look(now + count * step_s, sample if watch.wants_sample else None):
            return count * step_s
    return None


def watch_start(watch: SilenceWatch) -> float:
    watch.beat(100.0)
    return 100.0


SLEEPS = ThreadSample(runnable=False, cpu_ns=5)
RUNS = ThreadSample(runnable=True, cpu_ns=-1)
WAITS = ThreadSample(runnable=True, cpu_ns=5)


@pytest.mark.parametrize(("thread", "at_s"), [(None, 0.1), (SLEEPS, 0.1), (RUNS, 0.1), (WAITS, LATE_S)])
def test_only_a_node_that_waits_for_the_processor_is_excused_and_not_for_ever(
    thread: ThreadSample | None, at_s: float
) -> None:
    found = look_for(SilenceWatch(0.1, 0.0), 2.0, thread)
    assert found is not None and at_s <= found <= at_s + 0.0201


def test_a_node_that_gets_a_share_of_the_processor_is_excused_for_the_rest() -> None:
    """The node runs for 5 of each 20 ms and waits for 15: it counts as hung after a run of 0.1 s, or at the bound."""
    watch, found = SilenceWatch(0.1, 0.0, late_s=5.0), None
    watch.beat(100.0)
    for count in range(1, 200):
        ran, waited = 5_000_000 * count, 15_000_000 * count
        sample = {1: ThreadSample(runnable=True, cpu_ns=ran, waited_ns=waited)}
        if watch.look(100.0 + 0.02 * count, sample if watch.wants_sample else None):
            found = 0.02 * count
            break
    assert found == pytest.approx(0.26, abs=0.05), "0.06 s before the first look, then a quarter of the time"


def test_a_node_that_beats_is_never_hung() -> None:
    watch = SilenceWatch(0.1, 0.0)
    for count in range(100):
        assert not watch.look(0.09 * count + 0.08)
        watch.beat(0.09 * (count + 1))


def test_time_in_which_the_guard_itself_was_held_up_does_not_count() -> None:
    watch = SilenceWatch(0.1, 0.0)
    watch.beat(0.0)
    assert not watch.look(60.0) and watch.silent_s == pytest.approx(0.05)


def test_a_longer_limit_than_the_bound_of_excuses_holds() -> None:
    found = look_for(SilenceWatch(0.7, 0.0), 2.0, WAITS)
    assert found is not None and 0.7 <= found <= 0.73


# --- the clock --------------------------------------------------------------------------------------------------------


def test_the_steady_clock_is_used_until_a_node_has_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_module, "steady_s", lambda: 50.0)
    clock = GuardClock()
    assert clock() == 50.0
    clock.begin(None)
    clock.tell(3.0)
    assert clock() == 50.0


def test_simulated_time_stands_still_between_steps_and_goes_on_without_a_node(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = [50.0]
    monkeypatch.setattr(clock_module, "steady_s", lambda: wall[0])
    clock = GuardClock()
    clock.begin(0.0)
    assert clock() == 0.0, "not known yet"
    clock.tell(1000.0)
    wall[0] = 60.0
    assert clock() == 1000.0
    clock.leave()
    wall[0] = 62.0
    assert clock() == pytest.approx(1002.0)


@pytest.mark.parametrize("first_s", [0.0, 1000.5])
def test_a_successor_finds_the_clock_where_it_is(monkeypatch: pytest.MonkeyPatch, first_s: float) -> None:
    wall = [50.0]
    monkeypatch.setattr(clock_module, "steady_s", lambda: wall[0])
    clock = GuardClock()
    clock.begin(1000.0)
    clock.leave()
    wall[0] = 52.0
    clock.begin(first_s)
    assert clock() == pytest.approx(1002.0)
    clock.tell(1000.5)
    assert clock() == pytest.approx(1002.0)
    clock.tell(1001.5)
    assert clock() == pytest.approx(1003.0)


def test_a_simulation_in_steps_goes_on_by_its_ledger(tmp_path: Path) -> None:
    ledger = StepLedger(tmp_path / "ledger")
    ledger.time_ns = 1_000_000_000_000
    clock = GuardClock(StepCounts(tmp_path / "ledger"))
    clock.begin(1000.0)
    ledger.time_ns = 1_000_500_000_000
    assert clock() == 1000.0 and not clock.wants_turns, "the node passes the steps on"
    clock.leave()
    assert clock() == 1000.5 and clock.wants_turns
    clock.rejoin()
    assert clock() == 1000.5
    clock.tell(1000.4)
    assert clock() == 1000.5, "never back"


def test_bytes_without_a_node_are_counted_as_the_ledger_counts(tmp_path: Path) -> None:
    ledger = StepLedger(tmp_path / "ledger")
    ledger.register()
    ledger.finish(BYTES_READ, 5)
    clock = GuardClock(StepCounts(tmp_path / "ledger"))
    clock.begin(1.0)
    assert not clock.count_alone(1, 1)
    clock.leave()
    assert clock.count_alone(3, 2) and clock.count_alone(4, 0)
    assert ledger.finished(BYTES_READ) == 12
    assert ledger.finished(BYTES_WRITTEN) == 0, "a topic that nobody has counted is not made"
    assert len(ledger.processes()) == 2 and set(ledger.processes().values()) == {os.getpid()}
    ledger.finish(BYTES_WRITTEN, 1)
    clock.count_alone(0, 2)
    assert ledger.finished(BYTES_WRITTEN) == 3


def test_a_file_that_is_no_ledger_is_not_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "short").write_bytes(b"short")
    for name in ("short", "none"):
        monkeypatch.setenv(LEDGER_VARIABLE, str(tmp_path / name))
        assert counts_of_environment() is None
    monkeypatch.delenv(LEDGER_VARIABLE)
    assert counts_of_environment() is None
