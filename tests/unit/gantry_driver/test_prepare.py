"""What gantry_prepare advises where it cannot go on: the driver takes each service that it names."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
from unit.gantry_driver.protocol_board import Board, Rig

from gantry_driver.cli import gantry_prepare
from gantry_driver.core.machine_config import DriverConfig, MachineConfig


class Heard:
    """An operator's session that has heard the driver's state and nothing else."""

    def __init__(self, text: str) -> None:
        self.text = text

    def latest(self, _topic: str) -> str:
        return self.text

    def wait_for(self, condition: Callable[[], Any], _until: float, _missing: Any) -> Any:
        assert condition()
        return True

    def wait_until_heard(self, _until: float) -> None:
        pass


def refused(text: str) -> str:
    """Return why gantry_prepare gives up with a driver in that state."""
    session: Any = Heard(text)
    with pytest.raises(gantry_prepare.Failed) as error:
        gantry_prepare._Steps(session, time.monotonic() + 1.0).connect()
    return str(error.value)


def other_steps() -> Rig:
    """Return a new machine: its board's steps are not those of the configuration."""
    board = Board()
    board.settings[100] = "250.000"
    return Rig(board=board).connect()


def test_settings_that_differ_are_written_accepted_or_corrected() -> None:
    rig = other_steps()
    said = refused(rig.states[-1])
    assert "the driver is 'mismatch: $100 is 250.000, the configuration says 80'" in said
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
    said = refused(rig.states[-1])
    assert "homed at MPos -359.000" in said and "gantry/reset" in said and "pull_off_mm" in said
    assert "settings" not in said and "nothing to accept" in rig.machine.accept_settings(rig.now)
    assert rig.machine.reset(rig.now) == "" and rig.state == "unhomed"


def test_a_mismatch_that_says_itself_what_to_do_gets_no_other_advice() -> None:
    board = Board()
    board.startup[1] = "G91 G0 X5"
    rig = Rig(board=board).connect()
    assert refused(rig.states[-1]) == f"the driver is {rig.states[-1]!r}"


@pytest.mark.parametrize("state", ["stopped: stop requested", "alarm: ALARM:1 (hard limit)"])
def test_a_stop_and_an_alarm_are_left_by_reset(state: str) -> None:
    assert refused(state) == f"the driver is {state!r}; look at the machine, then call gantry/reset"
