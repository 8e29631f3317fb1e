"""Advice of gantry_prepare where it cannot continue: the driver accepts each service that it names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from unit.gantry_driver.protocol_board import Board, Rig

from gantry_driver.cli import gantry_prepare
from gantry_driver.cli.operator_session import TimedOut
from gantry_driver.core.configuration.machine_config import DriverConfig, MachineConfig
from icu_common.core.processes.processor_load import ProcessorLoad, ProgramLoad


class Heard:
    """An operator's session that has received the driver's state with its code, and nothing else."""

    def __init__(self, text: str, code: str | None) -> None:
        self.text, self.code = text, code

    def code_of(self, _topic: str, text: str) -> str | None:
        return self.code if text == self.text else None

    def latest(self, _topic: str) -> str:
        return self.text

    def wait_for(self, condition: Callable[[], Any], _until: float, _missing: Any) -> Any:
        if not condition():
            raise TimedOut
        return True

    def wait_until_heard(self, _until: float) -> None:
        pass


def refused(text: str, code: str | None = "") -> str:
    """Return why gantry_prepare gives up with a driver in that state."""
    session: Any = Heard(text, code)
    with pytest.raises(gantry_prepare.PreparationFailed) as error:
        gantry_prepare._PreparationSteps(session, 1.0, growth=1.0).connect()
    return str(error.value)


def other_steps() -> Rig:
    """Return a new machine: its board's steps are not those of the configuration."""
    board = Board()
    board.settings[100] = "250.000"
    return Rig(board=board).connect()


def test_settings_that_differ_are_written_accepted_or_corrected() -> None:
    rig = other_steps()
    said = refused(rig.states[-1], rig.code())
    assert "the driver is 'mismatch: $100 is 250.000; expected 80 (the configuration)'" in said
    for way in ("gantry/write_settings", "gantry_gcode settings --write", "gantry/accept_settings", "machine.*"):
        assert way in said
    assert "gantry/reset" not in said and "nothing to reset" in rig.machine.reset(rig.now)
    assert rig.machine.write_settings(rig.now) == ""
    rig.until(lambda: rig.state == "unhomed")
    rig = other_steps()
    assert rig.machine.accept_settings(rig.now) == "" and rig.state == "unhomed"


def test_a_machine_that_homed_elsewhere_is_reset_and_homed_once_more() -> None:
    board = Board()
    board.settings[27] = "2.000"
    rig = Rig(DriverConfig(enabled_at_start=True, machine=MachineConfig(pull_off_mm=2.0)), board).connect()
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch")
    said = refused(rig.states[-1], rig.code())
    assert "homed at MPos -359.000" in said and "gantry/reset" in said and "pull_off_mm" in said
    assert "settings" not in said and "nothing to accept" in rig.machine.accept_settings(rig.now)
    assert rig.machine.reset(rig.now) == "" and rig.state == "unhomed"


def test_a_mismatch_that_says_itself_what_to_do_gets_no_other_advice() -> None:
    board = Board()
    board.startup[1] = "G91 G0 X5"
    rig = Rig(board=board).connect()
    assert refused(rig.states[-1], rig.code()) == f"the driver is {rig.states[-1]!r}"


@pytest.mark.parametrize("code", [None, "", "driver.of_a_newer_program"])
def test_no_advice_is_taken_from_the_words_of_a_mismatch(code: str | None) -> None:
    text = "mismatch: $110 is 500.000; expected 12000 (the configuration)"
    assert refused(text, code) == f"the driver is {text!r}"


@pytest.mark.parametrize("state", ["stopped: stop requested", "alarm: ALARM:1 (hard limit)"])
def test_a_stop_and_an_alarm_are_left_by_reset(state: str) -> None:
    assert refused(state) == f"the driver is {state!r}; look at the machine, then call gantry/reset"


class Waiting:
    """A session in which nothing happens until ``comes_s`` of a clock that only waits move."""

    def __init__(self, comes_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
        self.comes_s, self.now = comes_s, 1000.0
        monkeypatch.setattr(gantry_prepare.time, "monotonic", lambda: self.now)

    def wait_for(self, condition: Callable[[], Any], until: float, missing: Callable[[], str]) -> Any:
        if value := condition():
            return value
        if 1000.0 + self.comes_s <= until:
            self.now = max(self.now, 1000.0 + self.comes_s)
            return "came"
        self.now = until + 0.1
        raise TimedOut(missing())


class Meter:
    def __init__(self, percent: float) -> None:
        self.load = ProcessorLoad(
            cores=2, load_average=9.0, programs=(ProgramLoad(name="cc1plus", percent=percent, own=False),)
        )

    def measure(self, then: Callable[[ProcessorLoad | None], object]) -> None:
        then(self.load)


@pytest.mark.parametrize(
    ("comes_s", "percent", "growth", "said"),
    [
        (390.0, 195.0, 4.0, []),
        (700.0, 195.0, 4.0, ["2 times"]),
        (1500.0, 195.0, 4.0, ["2 times", "4 times"]),
    ],
)
def test_limits_grow_on_a_busy_computer(
    comes_s: float,
    percent: float,
    growth: float,
    said: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    session: Any = Waiting(comes_s, monkeypatch)
    meter: Any = Meter(percent)
    steps = gantry_prepare._PreparationSteps(session, 400.0, growth, meter)
    assert steps.wait(lambda: None, "no answer") == "came"
    lines = capsys.readouterr().out.splitlines()
    load = "load 9.0 on 2 cores, the robot uses 0 %, other programs 195 %: cc1plus 195 %"
    busy = f"no answer; the computer is busy ({load}): all limits are"
    assert lines == [f"{busy} {words} as long now" for words in said]


@pytest.mark.parametrize(
    ("comes_s", "percent", "growth"),
    [(700.0, 100.0, 4.0), (1700.0, 195.0, 4.0), (700.0, 195.0, 1.0)],
)
def test_limits_hold_on_a_free_computer_beyond_the_bound_and_where_a_person_gave_one(
    comes_s: float, percent: float, growth: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    session: Any = Waiting(comes_s, monkeypatch)
    meter: Any = Meter(percent)
    with pytest.raises(TimedOut, match="no answer"):
        gantry_prepare._PreparationSteps(session, 400.0, growth, meter).wait(lambda: None, "no answer")
    assert session.now < 1000.0 + comes_s
