"""The mock board's probe input: a switch that the bench closes, G38.2 to G38.5, $6, alarms 4 and 5.

Sources: probe.c, motion_control.c (mc_probe_cycle) and report.c of gnea/grbl 1.1h.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import pytest
from unit.gantry_driver.mock_rig import FREE, Rig
from unit.gantry_driver.mock_service import Running, expect, wait_for

from icu_simulator.adapters.bench.motion_client import MotionClient

OK = b"ok\r\n"
CONTACT_MM = -20.0
SAMPLE_S = 0.004


class SprungStylus:
    """Closes the input while the motor is below a height, looking every 4 ms as the bench does."""

    def __init__(self, rig: Rig, closed_below: bool = True, height_mm: float = CONTACT_MM) -> None:
        self.rig, self.closed_below, self.height_mm = rig, closed_below, height_mm
        self.feel()

    def feel(self) -> None:
        below = self.rig.machine.truth()["mpos"][2] <= self.height_mm
        self.rig.board.set_probe(below == self.closed_below)

    def send(self, line: bytes, seconds: float) -> bytes:
        answer = self.rig.send(line)
        for _ in range(round(seconds / SAMPLE_S)):
            answer += self.rig.run(SAMPLE_S)
            self.feel()
        return answer + self.rig.run(0.1)


def probed_mm(answer: bytes) -> tuple[float, int]:
    match = re.search(rb"\[PRB:-359.000,-219.000,(-[\d.]+):([01])\]\r\n", answer)
    assert match, answer
    return float(match[1]), int(match[2])


def test_a_closed_switch_is_reported_before_the_other_pins() -> None:
    rig = Rig(settings=FREE | {21: 0})
    assert b"|Pn:" not in rig.send(b"?")
    rig.board.set_probe(True)
    assert b"|Pn:P" in rig.send(b"?")
    rig.machine.inject("limit", {"axis": "Y"})
    assert b"|Pn:PY" in rig.send(b"?")
    rig.board.set_probe(False)
    assert b"|Pn:Y" in rig.send(b"?")


def test_with_6_the_input_counts_while_it_is_open() -> None:
    rig = Rig(settings=FREE | {6: 1})
    assert b"|Pn:P" in rig.send(b"?"), "no switch at all looks like a touch, so a broken wire is seen"
    rig.board.set_probe(True)
    assert b"|Pn:" not in rig.send(b"?")
    assert rig.send(b"$6=0\n", 0.5) == OK
    assert b"|Pn:P" in rig.send(b"?")


@pytest.mark.parametrize(("setting", "closed_below"), [(0, True), (1, False)])
@pytest.mark.parametrize("word", [b"G38.2", b"G38.3"])
def test_probing_towards_ends_where_the_switch_acts(word: bytes, setting: int, closed_below: bool) -> None:
    rig = Rig.homed(settings={6: setting})
    stylus = SprungStylus(rig, closed_below)
    answer = stylus.send(word + b"Z-40F300\n", 5.0)
    height, success = probed_mm(answer)
    # 5 mm/s and samples every 4 ms: the input is at most 0.02 mm late.
    assert CONTACT_MM - 0.025 <= height <= CONTACT_MM
    assert success == 1 and answer.endswith(OK) and b"ALARM" not in answer
    state, position = rig.report()
    assert state == "Idle"
    # It comes to rest behind it: 5 mm/s at the z axis's acceleration.
    way = 5.0**2 / (2 * rig.machine.board.eeprom.values[122])
    assert position[2] == pytest.approx(height - way, abs=0.02)
    assert b"|Pn:P" in rig.send(b"?")
    assert rig.send(b"$#\n", 0.2).count(b"[PRB:-359.000,-219.000,%.3f:1]" % height) == 1


@pytest.mark.parametrize("word", [b"G38.4", b"G38.5"])
def test_probing_away_ends_where_the_switch_lets_go(word: bytes) -> None:
    rig = Rig.homed()
    stylus = SprungStylus(rig)
    assert stylus.send(b"G53G1Z-24F1800\n", 2.0).endswith(OK)
    height, success = probed_mm(stylus.send(word + b"Z-10F300\n", 4.0))
    assert success == 1
    assert CONTACT_MM <= height <= CONTACT_MM + 0.025


def test_while_it_probes_away_the_pin_is_reported_the_other_way_round() -> None:
    """As the core does: probe_configure_invert_mask() turns what report.c prints, until the cycle ends."""
    rig = Rig.homed()
    stylus = SprungStylus(rig)
    stylus.send(b"G53G1Z-24F1800\n", 2.0)
    assert b"|Pn:P" in rig.send(b"?")
    stylus.send(b"G38.4Z-10F60\n", 0.5)
    report = rig.send(b"?", 0.01)
    assert b"<Run|" in report and b"|Pn:" not in report
    stylus.send(b"", 5.0)
    report = rig.send(b"?", 0.01)
    assert b"<Idle|" in report and b"|Pn:" not in report, "away, and the normal way round again"


@pytest.mark.parametrize(("word", "closed"), [(b"G38.2", True), (b"G38.3", True), (b"G38.4", False), (b"G38.5", False)])
def test_a_switch_that_stands_wrong_at_the_begin_is_alarm_4(word: bytes, closed: bool) -> None:
    rig = Rig.homed()
    rig.board.set_probe(closed)
    assert rig.send(word + b"Z-40F300\n", 1.0) == b"ALARM:4\r\nok\r\n"
    state, position = rig.report()
    assert (state, position[2]) == ("Alarm", -1.0), "and nothing has moved"
    assert (b"|Pn:P" in rig.send(b"?")) == closed, "reported the normal way round"


@pytest.mark.parametrize(
    ("word", "closed", "alarm"),
    [
        (b"G38.2", False, b"ALARM:5\r\n"),
        (b"G38.3", False, b""),
        (b"G38.4", True, b"ALARM:5\r\n"),
        (b"G38.5", True, b""),
    ],
)
def test_a_switch_that_never_acts_is_alarm_5_where_it_must(word: bytes, closed: bool, alarm: bytes) -> None:
    rig = Rig.homed()
    rig.board.set_probe(closed)
    assert rig.send(word + b"Z-5F300\n", 5.0) == alarm + b"[PRB:-359.000,-219.000,-5.000:0]\r\n" + OK
    assert rig.report()[0] == ("Alarm" if alarm else "Idle")


def test_a_switch_that_bounces_is_taken_once() -> None:
    rig = Rig.homed()
    rig.send(b"G38.2Z-40F300\n", 1.0)
    for closed in (True, False, True, False, True):
        rig.board.set_probe(closed)
        rig.run(0.0005)
    answer = rig.run(2.0)
    assert answer.count(b"[PRB:") == 1
    height, success = probed_mm(answer)
    assert success == 1 and height == pytest.approx(-1 - 5.0 * 1.0, abs=0.15)


def test_a_switch_does_nothing_to_an_ordinary_move() -> None:
    rig = Rig.homed()
    assert rig.send(b"G53G1Z-11F300\n", 0.5) == OK
    rig.board.set_probe(True)
    assert rig.run(3.0) == b""
    assert rig.report() == ("Idle", (-359.0, -219.0, -11.0))


def test_a_reset_while_it_probes_away_turns_the_report_back() -> None:
    rig = Rig.homed()
    rig.board.set_probe(True)
    rig.send(b"G38.4Z-10F60\n", 0.5)
    rig.send(b"\x18", 1.0)
    assert b"|Pn:P" in rig.send(b"?")


def test_the_bench_sets_the_input_over_the_motion_socket_and_a_lost_bench_lets_it_go(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        running = Running(tmp_path, stack, stepped=True, settings=FREE)
        bench = MotionClient(running.truth_path)
        assert bench.connect()
        stack.callback(bench.close)
        port = running.open()
        wait_for(lambda: running.control.ask(do="state")["open"] is True)
        bench.advance(1.0)
        expect(port, b"help]\r\n")
        bench.set_probe(True)
        bench.set_probe(True)
        # Bytes and the input come on different ways: the report is asked for until it has it.
        bench.advance(1.1)
        port.write(b"?")
        wait_for(lambda: bench.advance(1.1) == [] and bench.received == 1)
        bench.advance(1.2)
        assert b"|Pn:P" in expect(port, b">\r\n")
        bench.close()
        other = MotionClient(running.truth_path)
        assert other.connect()
        stack.callback(other.close)
        assert other.probe_closed is False
        other.advance(1.3)
        port.write(b"?")
        wait_for(lambda: other.advance(1.3) == [] and other.received == 2)
        other.advance(1.4)
        assert b"|Pn:" not in expect(port, b">\r\n")


def test_the_bench_sets_the_input_in_real_time(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        running = Running(tmp_path, stack, settings=FREE)
        bench = MotionClient(running.truth_path)
        assert bench.connect()
        stack.callback(bench.close)
        port = running.open()
        expect(port, b"help]\r\n")
        bench.set_probe(True)

        def reported() -> bool:
            port.write(b"?")
            return b"|Pn:P" in expect(port, b">\r\n")

        wait_for(reported)
