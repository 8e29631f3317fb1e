"""A short campaign of seeded faults; ``make campaign`` runs the full one. A failure's number is its seed."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from campaign.faults import CONFIG, FAULTS, SERVO, config_of, fault_of, run_seed
from campaign.port_rig import PortRig
from campaign.run import main
from campaign.virtual_link import VirtualRig

from gantry_driver.core.configuration.machine_config import DriverConfig, MachineConfig
from gantry_driver.core.grbl.grbl_messages import StatusReport
from gantry_driver.core.machine.machine import Machine
from icu_common.core.goals.results import Outcome

pytestmark = pytest.mark.long

SHORT = 6 * len(FAULTS)
LINK_FAULTS = ("unplug", "full", "vanishes", "operator stop")


@pytest.mark.parametrize("seed", range(SHORT))
def test_promises_hold_under_a_fault(seed: int) -> None:
    print(f"seed {seed}: {fault_of(seed).name}")
    run_seed(seed, VirtualRig(config_of(seed), seed))


ELSEWHERE = [
    (seed, dialect)
    for seed in range(2 * len(FAULTS))
    for dialect in ("grblHAL", "FluidNC")
    if (fault_of(seed).name, dialect) != ("EEPROM pause", "FluidNC")  # which keeps its settings in a file
]


@pytest.mark.parametrize(("seed", "dialect"), ELSEWHERE)
def test_promises_hold_under_a_fault_of_another_firmware(seed: int, dialect: str) -> None:
    run_seed(seed, VirtualRig(CONFIG, seed, dialect))


def test_programs_go_where_they_were_checked_though_the_board_keeps_offsets_over_resets() -> None:
    rig = VirtualRig(CONFIG, 0, "grblHAL")
    rig.until(lambda: rig.machine.phase.state == "unhomed", 20.0)
    rig.board.parser.g92, rig.board.parser.tool_length, rig.board.parser.modes.system = [10.0, 0.0, 0.0], 5.0, 1
    rig.board.eeprom.systems[1][:] = [50.0, 50.0, 0.0]
    rig.home()

    def program(*lines: str) -> tuple[float, float, float]:
        rig.results.clear()
        rig.run_for(1.5)  # the offset comes with a report
        accepted = rig.machine.run_program("p", lines, rig.now)
        assert accepted.outcome is Outcome.ACCEPTED, accepted.reason
        rig.until(lambda: rig.results and rig.results[-1].outcome.final, 20.0)
        assert rig.results[-1].outcome is Outcome.REACHED, rig.results[-1]
        return rig.mpos()

    assert program("G0 X-110 Y-100") == pytest.approx((-100.0, -100.0, -1.0), abs=0.02)
    rig.board.parser.g92 = rig.board.eeprom.g92 = [20.0, 0.0, 0.0]  # another sender
    rig.stop("operator")
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 20.0)
    assert rig.board.parser.g92 == [20.0, 0.0, 0.0], "the reset has kept it"
    rig.machine.reset(rig.now)
    assert program("G0 X-110 Y-100") == pytest.approx((-90.0, -100.0, -1.0), abs=0.02)
    assert rig.board.parser.tool_length == 0.0 and rig.board.parser.modes.system == 0
    refused = rig.machine.run_program("p", ["G92.1", "G0 X-100"], rig.now)
    assert refused.outcome is Outcome.REJECTED and "G92" in refused.reason


def test_a_servo_is_held_up_after_homing_on_a_board_that_switches_it_off() -> None:
    rig = VirtualRig(SERVO, 0, "grblHAL")
    rig.home()
    assert rig.servo() == SERVO.stylus.servo_up


@pytest.mark.parametrize("dialect", ["GRBL", "FluidNC"])
def test_an_alarm_over_a_touch_tells_that_the_servo_was_not_lifted(dialect: str) -> None:
    rig = VirtualRig(SERVO, 0, dialect)
    rig.until(lambda: rig.machine.phase.state in ("unhomed", "mismatch"), 20.0)
    rig.machine.accept_settings(rig.now)  # FluidNC has no $31
    rig.home()
    rig.go([(0.1, 0.1, 0.02)], "down")
    rig.until(lambda: len(rig.results) == 2, 20.0)
    rig.fault("alarm", number=1)
    rig.until(lambda: rig.machine.phase.state == "alarm", 5.0)
    assert rig.servo() == (800.0 if dialect == "FluidNC" else 0.0)
    assert rig.states[-1].endswith("; the board did not lift the stylus, it may still press")


@pytest.mark.parametrize("seed", [s for s in range(len(FAULTS)) if fault_of(s).name in LINK_FAULTS])
def test_promises_hold_on_a_real_port(seed: int, tmp_path: Path) -> None:
    print(f"seed {seed}: {fault_of(seed).name}")
    config = dataclasses.replace(config_of(seed), status_timeout_s=10.0)  # the board may be held up, too
    with PortRig(config, seed, tmp_path) as rig:
        run_seed(seed, rig)


def test_one_seed_is_one_run() -> None:
    for seed in range(len(FAULTS)):
        journals = []
        for _ in range(2):
            rig = VirtualRig(config_of(seed), seed)
            run_seed(seed, rig)
            journals.append(list(rig.board.journal.entries))
        assert journals[0] == journals[1], f"seed {seed}"


def test_the_judge_sees_a_false_done(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """A driver that says done at the first report; the run is named with its seed and how to repeat it."""

    def done(machine: Machine, report: StatusReport, now: float) -> None:
        machine._finish(Outcome.REACHED, "", now, 0.0)

    with monkeypatch.context() as patch:
        patch.setattr(Machine, "_report_moving", done)
        assert main(["--seeds", "0:1"]) == 1
    said = capsys.readouterr().out
    assert "seed 0 (none): AssertionError: a false done" in said and "CAMPAIGN_SEEDS=0:1" in said
    assert main(["--seeds", "0:1"]) == 0


def test_a_program_is_checked_with_the_offset_that_the_board_has_stored() -> None:
    rig = VirtualRig(CONFIG, 0)
    rig.board.eeprom.systems[0][:] = [-359.0, -219.0, 0.0]
    rig.home()
    rig.run_for(1.0)
    refused = rig.machine.run_program("p", ["G0 X-5"], rig.now)
    assert refused.reason == "line 1, column 4: X = -364.000 mm (machine) is outside -359 to 0 mm (ALARM:2)"
    assert rig.machine.run_program("p", ["G0 X20 Y10"], rig.now).outcome is Outcome.ACCEPTED
    rig.until(lambda: rig.results and rig.results[-1].outcome is Outcome.REACHED, 10.0)
    assert rig.mpos() == pytest.approx((-339.0, -209.0, -1.0), abs=0.02)


def test_the_retreat_has_the_time_that_a_slow_axis_takes() -> None:
    """The board slows down what is faster than its $112."""
    machine = MachineConfig(max_rate_mm_min=(12000.0, 12000.0, 600.0))
    rig = VirtualRig(DriverConfig(enabled_at_start=True, machine=machine), 0)
    rig.board.eeprom.values[112] = 600.0
    rig.home()
    rig.go([(0.0, 0.0, 0.055)], "down")
    rig.until(lambda: rig.mpos()[2] < -53.0, 20.0)
    rig.stop("operator")
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 20.0)
    assert rig.mpos()[2] == pytest.approx(-1.0, abs=0.01)
    assert rig.states[-1] == "stopped: operator"


def test_a_retreat_under_way_keeps_its_time_when_the_speed_is_changed() -> None:
    config = DriverConfig(enabled_at_start=True, stylus_feed_m_s=0.01)
    rig = VirtualRig(config, 0)
    rig.home()
    rig.go([(0.0, 0.0, 0.055)], "down")
    rig.until(lambda: rig.mpos()[2] < -53.0, 20.0)
    rig.stop("operator")
    rig.until(lambda: rig.machine.phase.name == "LIFTING", 10.0)
    rig.machine.configure(dataclasses.replace(config, stylus_feed_m_s=0.03), rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 20.0)
    assert rig.mpos()[2] == pytest.approx(-1.0, abs=0.01)
    assert rig.states[-1] == "stopped: operator"


def test_a_place_between_two_motor_steps_is_reached_at_the_nearer() -> None:
    """Nearer no board can be; with a tolerance below that each goal ended in a stop."""
    config = DriverConfig(enabled_at_start=True, arrival_tolerance_m=1e-6)
    rig = VirtualRig(config, 0)
    rig.home()
    rig.go([(0.106006, 0.056006, 0.011001)], "between")
    rig.until(lambda: len(rig.results) == 2, 20.0)
    assert rig.results[-1].outcome is Outcome.REACHED, rig.results[-1].reason
    assert rig.results[-1].error_m == pytest.approx(8.5e-6, abs=1e-6)
