"""Programs from files are compared with their own path: a damaged byte that moves elsewhere is held and lifted."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from campaign.faults import HOMED
from unit.gantry_driver.damaged_wire import DamagedRig

from gantry_driver.core.configuration.clearance import TUBE_MM
from gantry_driver.core.program.arcs import CHORD_MM, Arc
from gantry_driver.core.program.gcode_check import Bounds, ProgramChecker
from gantry_driver.core.program.polyline import Polyline
from gantry_driver.core.wire.watch import PathWatch
from icu_common.core.goals.results import GoalResult, Outcome

PROGRAM = ["G53 G0 X-259 Y-169", "G53 G1 Z-5 F600", "G53 G1 X-219 F1200", "G53 G1 Z-11 F600", "G53 G1 Z-1 F1200"]
DEEP_MM, PLAN_FEED = 10.0, 1200.0
LATE_S = 0.1


def run(rig: DamagedRig, source: list[str], within_s: float = 120.0) -> GoalResult:
    rig.results.clear()
    accepted = rig.machine.run_program("p", source, rig.now)
    assert accepted.outcome is Outcome.ACCEPTED, accepted
    rig.until(lambda: rig.results and rig.results[-1].outcome.final, within_s)
    answer = rig.results[-1]
    rig.until(lambda: rig.machine.connected and rig.machine.at_rest, 60.0)
    return answer


def homed() -> DamagedRig:
    rig = DamagedRig()
    rig.home()
    rig.until(lambda: rig.machine.session.wco_is_sure, 10.0)
    return rig


# --- what a damaged program does --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sent", "received", "deepest_mm"),
    [
        (b"X-219G53G1", b"X-259G53G1", 10.0),  # stays where it is, and the next touch is 40 mm off: too early a report
        (b"X-219G53G1", b"X-299G53G1", 4.2),
        (b"X-219G53G1", b"Y-219G53G1", 4.2),
        (b"Z-11G53G1", b"Z-41G53G1", 12.0),
        (b"Z-11G53G1", b"X-11G53G1", 4.2),
    ],
)
def test_a_damaged_line_of_a_program_is_held_lifted_and_reported(
    sent: bytes, received: bytes, deepest_mm: float
) -> None:
    rig = homed()
    rig.once(sent, received)
    answer = run(rig, PROGRAM)
    assert answer.code == "left_path" and answer.reason.startswith("the board left the path"), answer
    assert rig.deepest_mm() <= deepest_mm
    assert rig.mpos()[2] > HOMED[2] - 0.1, "lifted"
    assert not rig.machine.homed and rig.machine.reading_m is None


def test_a_feed_that_was_damaged_does_not_last() -> None:
    rig = homed()
    rig.once(b"F600Z-11", b"F6000Z-11")
    answer = run(rig, PROGRAM)
    assert answer.code == "left_path" and "a feed of" in answer.reason, answer
    downward = [after[0] for before, after in pairwise(rig.truth) if after[1][2] < before[1][2] and after[2] > 630.0]
    touching = [t for t in downward if t > next(t for t, place, _ in rig.truth if place[0] > -219.1)]
    assert touching and touching[-1] - touching[0] <= LATE_S
    assert rig.mpos()[2] > HOMED[2] - 0.1


def test_a_program_without_damage_is_done() -> None:
    rig = homed()
    arcs = ["G17 G21 G90", "G53 G0 X-200 Y-100", "G91", "G1 Z-4 F600", "G2 X20 I10 F900", "G3 X-20 I-10 Z2", "G0 X5"]
    dabs = ["G1 Z-2 F1500", "G1 Z2 F1500"] * 20
    answer = run(rig, [*arcs, *dabs, "G0 Z2", "G90"])
    assert answer.outcome is Outcome.REACHED, answer
    assert rig.machine.counts.disbelieved == 0


def test_a_program_of_many_short_lines_is_done() -> None:
    rig = homed()
    circle = [
        f"G53 G1 X{-200 + 30 * math.cos(n / 40):.3f} Y{-100 + 30 * math.sin(n / 40):.3f} F4000" for n in range(600)
    ]
    answer = run(rig, ["G53 G1 X-170 Y-100 F6000", *circle])
    assert answer.outcome is Outcome.REACHED, answer
    assert rig.machine.counts.disbelieved == 0


# --- the parts --------------------------------------------------------------------------------------------------------


def test_a_path_has_the_lines_of_its_program() -> None:
    bounds = Bounds(low_mm=(-300.0, -200.0, -80.0), high_mm=(0.0, 0.0, 0.0), rapid_mm_min=(9000.0, 9000.0, 3000.0))
    checker = ProgramChecker(bounds, (-100.0, -100.0, -1.0))
    lines = list(checker.check_all(["G91", "G1 X10 F600", "G20", "G1 Y1 F20", "G2 X1 I0.5 F40"]))
    assert [line.along_mm for line in lines] == pytest.approx([0.0, 10.0, 10.0, 35.4, 35.4 + 12.7 * math.pi], rel=1e-2)
    assert checker.path.points[1] == pytest.approx((-90.0, -100.0, -1.0))
    assert checker.path.points[2] == pytest.approx((-90.0, -74.6, -1.0))
    assert checker.path.end_mm == pytest.approx((-64.6, -74.6, -1.0))
    assert checker.path.feeds[1:3] == pytest.approx([600.0, 508.0]) and checker.path.highest_feed == 1016.0


@pytest.mark.parametrize("clockwise", [True, False])
def test_the_chords_of_an_arc_stay_close_to_it(clockwise: bool) -> None:
    arc = Arc(start=(10.0, 0.0, 0.0), end=(0.0, 10.0, 3.0), plane=(0, 1, 2), centre=(0.0, 0.0), clockwise=clockwise)
    points = [(10.0, 0.0, 0.0), *arc.chords()]
    for before, after in pairwise(points):
        middle = [(a + b) / 2 for a, b in zip(before, after)]
        assert math.hypot(*middle[:2]) == pytest.approx(10.0, abs=CHORD_MM + 1e-9)
    quarters = 3 if clockwise else 1
    assert sum(math.dist(a, b) for a, b in pairwise(points)) == pytest.approx(arc.length, rel=2e-3)
    assert abs(arc.sweep) == pytest.approx(quarters * math.pi / 2)


def test_what_was_not_sent_cannot_have_been_driven_and_what_was_executed_is_past() -> None:
    path = Polyline((0.0, 0.0, 0.0), 3)
    for end in [(0.0, 0.0, -5.0), (0.0, 0.0, 0.0), (9.0, 0.0, 0.0)]:
        path.append(end, 600.0)
    watch = PathWatch(path, 0.0)
    watch.bound(0.0, 5.0)
    assert watch.check((1.0, 0.0, 0.0), 600.0, 9.0) is not None
    watch.bound(0.0, 19.0)
    assert watch.check((1.0, 0.0, 0.0), 600.0, 9.0) is None
    watch.bound(19.0, 19.0)
    assert watch.check((0.0, 0.0, -3.0), 600.0, 9.1) is not None, "that is behind it"
    assert watch.check((9.0 - TUBE_MM, 0.0, 0.0), 600.0, 9.1) is None
