"""Damaged bytes on the wire: no false done, nothing pressed deeper or elsewhere, no position that is none."""

from __future__ import annotations

import math
import random
import re
from itertools import pairwise

import pytest
from campaign.faults import CONFIG, HOMED, SERVO
from unit.gantry_driver.damaged_wire import DamagedRig, damage_at, machine_mm, off_path_mm

from icu_common.core.goals.results import Outcome

HOVER, DEEP = 0.003, 0.011
TRAVEL = [(0.1, 0.05, 0.0), (0.1, 0.05, HOVER)]
TOUCH = [(0.1, 0.05, DEEP - 0.003), (0.1, 0.05, DEEP)]
PRESS = [(0.1, 0.05, 0.0), (0.1, 0.05, DEEP), (0.1, 0.05, 0.0)]
DEPTH_MM = 1000.0 * DEEP
LATE_S = 0.1
"""Longest time above the planned feed."""


def hovering() -> DamagedRig:
    rig = DamagedRig()
    rig.home()
    assert rig.finish(TRAVEL).outcome is Outcome.REACHED
    return rig


def too_fast_s(rig: DamagedRig, feed_mm_min: float, since_s: float) -> float:
    """Return how long the stylus moved faster than a feed."""
    times = [at for at, _, feed in rig.truth if at >= since_s and feed > 1.01 * feed_mm_min]
    return times[-1] - times[0] if times else 0.0


# --- to the board -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "received",
    [
        b"Z9G1\n",
        b"X0G1\n",
        b"Z0\n",
        b"Z0G0\n",
        b"(0G1\n",
        b";0G1\n",
        b"Z00G1\n",
        b"ZG1\n",
        b"Z0G2\n",
        b"G1\n",
        b"Z4G1\n",
    ],
)
def test_a_damaged_contact_line_is_never_deeper_and_never_done(received: bytes) -> None:
    rig = hovering()
    rig.once(b"Z0G1\n", received)
    answer = rig.finish(TOUCH)
    touched = rig.deepest_mm() > DEPTH_MM - 0.1
    assert (answer.outcome is Outcome.REACHED) <= touched, answer
    assert rig.deepest_mm() <= DEPTH_MM + 0.05
    lifted = rig.mpos()[2] > HOMED[2] - 0.5 or rig.states[-1].endswith("it may still press")
    assert answer.outcome is Outcome.REACHED or (answer.reason and lifted)


def test_a_touch_that_was_not_made_has_a_code() -> None:
    rig = hovering()
    rig.once(b"Z0G1\n", b";0G1\n")
    answer = rig.finish(TOUCH)
    assert answer.code == "touch_unproved" and "instead of" in answer.reason
    assert rig.deepest_mm() < DEPTH_MM - 2.9, "it stayed above"


def test_a_crossing_that_leaves_its_path_is_held_lifted_and_homed_again() -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(b"X-259Y-169G53G1", b"X-25;Y-169G53G1")
    answer = rig.finish(PRESS)
    assert answer.code == "left_path" and answer.reason.startswith("the board left the path: it reports MPos")
    assert dict(answer.details)["off_path_mm"] != "0.000"
    assert rig.deepest_mm() < 0.1, "nothing was touched"
    assert rig.machine.reading_m is None and not rig.machine.homed
    assert rig.machine.reset(rig.now) == "" and rig.machine.phase.state == "unhomed"


def test_an_approach_that_goes_on_stops_above_the_panel() -> None:
    """A slanting path of another program: its last 10.5 mm wait for a report from the part above them."""
    rig = DamagedRig()
    rig.home()
    deep = 0.04
    rig.once(b"Z10.5G1\n", b"Z00.5G1\n")
    answer = rig.finish([(0.1, 0.05, 0.0), (0.14, 0.05, deep)])
    assert answer.code == "left_path"
    assert rig.deepest_mm() < 1000.0 * deep - 0.3


@pytest.mark.parametrize("received", [b"F12000", b"F18000", b"F180"])
def test_another_feed_is_not_driven(received: bytes) -> None:
    rig = hovering()
    rig.once(b"F1800", received)
    since = rig.now
    answer = rig.finish(TOUCH)
    assert answer.outcome is Outcome.REACHED, "the modes were sent again"
    assert too_fast_s(rig, 1800.0, since) == 0.0


def test_a_rapid_move_is_held() -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(b"Y-169G53G1", b"Y-169G53G0")
    since = rig.now
    answer = rig.finish(PRESS)
    assert answer.code == "left_path" and "a feed of" in answer.reason
    assert too_fast_s(rig, 9000.0, since) <= LATE_S


@pytest.mark.parametrize("received", [b"G20G90", b"G21G91", b"G21G9"])
def test_modes_that_the_board_does_not_have_are_sent_again(received: bytes) -> None:
    rig = hovering()
    rig.once(b"G21G90", received)
    answer = rig.finish(TOUCH)
    assert answer.outcome is Outcome.REACHED or answer.reason.startswith("error:")
    assert rig.deepest_mm() <= DEPTH_MM + 0.05


@pytest.mark.parametrize(("sent", "received"), [(b"$G\n", b"6v$G\n"), (b"F1800", b"F18%0"), (b"Z8G92", b"Z8F92")])
def test_an_order_of_modes_that_the_board_refuses_is_sent_again(sent: bytes, received: bytes) -> None:
    rig = hovering()
    rig.once(sent, received)
    assert rig.finish(TOUCH).outcome is Outcome.REACHED
    assert rig.deepest_mm() == pytest.approx(DEPTH_MM, abs=0.02)


def test_a_line_that_moves_is_not_sent_again() -> None:
    rig = hovering()
    rig.once(b"Z0G1\n", b"%0G1\n")
    answer = rig.finish(TOUCH)
    assert answer.outcome is Outcome.ABORTED and "error:" in answer.reason
    assert rig.deepest_mm() < DEPTH_MM - 2.9


def test_orders_of_modes_that_are_refused_each_time_end_the_goal() -> None:
    rig = hovering()
    rig.to_board = lambda data: data.replace(b"$G\n", b"%G\n")
    answer = rig.finish(TOUCH)
    assert answer.outcome is Outcome.ABORTED and "error:" in answer.reason
    assert rig.deepest_mm() < DEPTH_MM - 2.9


def test_a_request_for_a_report_that_raises_the_feed_is_set_back_while_the_next_ones_are_lost() -> None:
    """A burst of noise over 0.2 s: one request becomes 0x91 (feed + 10 %), and those after it are not answered."""
    rig = DamagedRig()
    rig.home()
    rig.go([(0.3, 0.05, 0.0)], "long")
    rig.run_for(1.0)
    since, raised = rig.now, list[float]()

    def damage(data: bytes) -> bytes:
        if not raised and b"?" in data:
            raised.append(rig.now)
            return data.replace(b"?", b"\x91", 1)
        # the noise lasts for four more bytes
        left = 5 - len(raised)
        raised.extend([rig.now] * min(left, len(data)))
        return b"\xd5" * min(left, len(data)) + data[left:] if left > 0 else data

    rig.to_board = damage
    rig.until(lambda: rig.results and rig.results[-1].outcome.final, 30.0)
    assert len(raised) >= 5
    assert too_fast_s(rig, 9000.0, since) <= LATE_S


def test_a_feed_that_rises_with_each_order_to_set_it_back_is_stopped() -> None:
    """A stuck bit makes each 0x90 a 0x91."""
    rig = DamagedRig()
    rig.home()
    begun = math.inf

    def stuck(data: bytes) -> bytes:
        nonlocal begun
        if b"\x90" in data:
            begun = min(begun, rig.now)
        return data.replace(b"\x90", b"\x91") if rig.now < begun + 0.5 else data

    rig.to_board = stuck
    since = rig.now
    answer = rig.finish([(0.3, 0.2, 0.0)])
    assert answer.outcome is Outcome.ABORTED and "feed override rises" in answer.reason, answer
    assert begun < math.inf and too_fast_s(rig, 9000.0, since) <= LATE_S


def test_a_frame_that_the_board_does_not_have_is_sent_again() -> None:
    rig = hovering()
    rig.once(b"Z8G92", b"Z6G92")
    assert rig.finish(TOUCH).outcome is Outcome.REACHED
    assert rig.deepest_mm() == pytest.approx(DEPTH_MM, abs=0.02)


def test_a_feed_of_a_millimetre_a_minute_ends_after_twice_the_time() -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(b"F9000X", b"F9X")
    answer = rig.finish(PRESS)
    assert answer.code == "overdue" and answer.duration_s < 12.0, answer
    assert "twice the expected time" in answer.reason


@pytest.mark.parametrize("received", [b"F1(00", b"F1x00"])
@pytest.mark.parametrize("sent", [b"F1800", b"F9000"])
def test_a_feed_that_becomes_a_comment_or_a_coordinate_does_not_creep(sent: bytes, received: bytes) -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(sent, received)
    answer = rig.finish(PRESS)
    assert rig.to_board is None, "it was sent"
    assert answer.outcome is Outcome.REACHED or answer.reason, answer
    assert answer.duration_s < 12.0, "at 1 mm/min the last 3 mm alone take 180 s"
    assert rig.deepest_mm() <= DEPTH_MM + 0.05


@pytest.mark.parametrize(("received", "deeper_mm"), [(b"Z-42G53G1", 2.0), (b"X-12G53G1", 0.05)])
@pytest.mark.parametrize("dialect", ["grblHAL", "FluidNC"])
def test_a_damaged_contact_line_of_a_board_without_the_frame_is_held(
    dialect: str, received: bytes, deeper_mm: float
) -> None:
    """The line has machine coordinates there, so only the watch limits the depth."""
    rig = DamagedRig(dialect=dialect)
    rig.home()
    assert rig.finish(TRAVEL).outcome is Outcome.REACHED
    rig.once(b"Z-12G53G1", received)
    answer = rig.finish(TOUCH)
    assert rig.to_board is None and answer.code in ("left_path", "touch_unproved"), answer
    assert rig.deepest_mm() <= DEPTH_MM + deeper_mm
    assert rig.mpos()[2] > HOMED[2] - 0.1, "lifted"


def test_a_homing_that_was_another_question_is_none() -> None:
    rig = DamagedRig()
    rig.until(lambda: rig.machine.phase.state == "unhomed", 20.0)
    rig.once(b"$H", b"$I")
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 20.0)
    assert "so it has not homed" in rig.states[-1] and not rig.machine.homed


def test_a_setting_that_was_not_to_be_written_blocks_motion() -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(b"$12=", b"$11=")
    assert rig.machine.write_settings(rig.now, {12: 0.003}) == ""
    rig.until(lambda: rig.machine.phase.state == "mismatch", 20.0)
    assert "$11 became 0.003, it was 0.010: write it back" in rig.states[-1]


def test_a_servo_that_was_not_lowered_has_not_touched() -> None:
    rig = DamagedRig(SERVO)
    rig.home()
    rig.once(b"M3S800", b"M3S80")
    answer = rig.finish([(0.1, 0.05, 0.0), (0.1, 0.05, 0.02)])
    assert answer.outcome is Outcome.REACHED and rig.servo() == 800.0, "it was sent again"


def test_a_retreat_that_goes_down_is_held_and_made_again() -> None:
    rig = DamagedRig()
    rig.home()
    assert rig.finish([(0.1, 0.05, 0.0), (0.1, 0.05, 0.005)]).outcome is Outcome.REACHED
    rig.once(b"Z-1G53G1", b"Z-11G53G1")
    rig.stop("operator")
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 20.0)
    assert rig.states[-1] == "stopped: operator" and rig.mpos()[2] == pytest.approx(-1.0, abs=0.01)
    assert rig.deepest_mm() < 8.0


def test_a_lost_answer_is_reported_while_the_path_runs() -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(b"ok\r\n", b"ox\r\n", "from_board")
    answer = rig.finish([(0.01 * k, 0.0, 0.0) for k in range(1, 31)])
    assert answer.code == "lost_answer" and answer.duration_s < 1.0


def mute_of_buffers() -> DamagedRig:
    """Return the rig with a homed board whose reports have no ``Bf:``."""
    rig = DamagedRig()
    rig.board.eeprom.values[10] = 1
    rig.home()
    return rig


def lose_answer(rig: DamagedRig, number: int) -> None:
    """Spoil the board's ``ok`` of this number."""
    left = number

    def lose(data: bytes) -> bytes:
        nonlocal left
        before, left = left, left - data.count(b"ok\r\n")
        return data.replace(b"ok\r\n", b"ox\r\n", 1) if before > 0 >= left else data

    rig.from_board = lose


@pytest.mark.parametrize("which", [3, 8, 30])
def test_a_lost_answer_of_a_board_that_does_not_report_its_buffers_is_found_while_the_path_runs(which: int) -> None:
    rig = mute_of_buffers()
    lose_answer(rig, which)
    answer = rig.finish([(0.005 * k, 0.001 * (k % 2), 0.0) for k in range(1, 71)])
    assert answer.code == "lost_answer" and "out of turn" in answer.reason, answer
    stopped_at = rig.mpos()[0] - HOMED[0]
    assert stopped_at < 5.0 * (which + 45), "well before its end at 350 mm"


def test_a_lost_answer_at_the_end_of_a_path_is_found_as_soon_as_the_board_rests() -> None:
    rig = mute_of_buffers()
    lose_answer(rig, 3)
    answer = rig.finish([(0.02, 0.0, 0.0), (0.04, 0.01, 0.0)])
    assert answer.code == "lost_answer"
    ran = [at for (at, place, _), (_, after, _) in pairwise(rig.truth) if place != after]
    assert rig.answered_at - ran[-1] < 0.8


def test_a_board_that_does_not_report_its_buffers_follows_paths_and_programs_with_dwells() -> None:
    rig = mute_of_buffers()
    path = [(0.005 * k, 0.001 * (k % 2), 0.0) for k in range(1, 71)]
    assert rig.finish([*path, *PRESS]).outcome is Outcome.REACHED
    rig.until(lambda: rig.machine.session.wco_is_sure, 10.0)
    rig.results.clear()
    lines = [f"G53 G1 X{-100 - k} F3000" for k in range(45)]
    rig.machine.run_program("p", [*lines, "G4 P1.5", *lines, "G4 P0.2"], rig.now)
    rig.until(lambda: rig.results and rig.results[-1].outcome.final, 60.0)
    assert rig.results[-1].outcome is Outcome.REACHED, rig.results[-1]


# --- from the board ---------------------------------------------------------------------------------------------------


def test_a_report_with_a_comma_in_a_number_is_not_published() -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(b"-259.000", b"-259,000", "from_board")
    assert rig.finish(PRESS).outcome is Outcome.REACHED
    assert rig.from_board is None, "one report was spoilt"
    assert all(math.dist(told, true) < 10.0 for told, true in rig.published)


def test_one_report_beside_the_path_holds_and_the_next_lets_go() -> None:
    rig = DamagedRig()
    rig.home()
    rig.once(b"|MPos:-259.0", b"|MPos:-250.0", "from_board")
    answer = rig.finish(PRESS)
    assert answer.outcome is Outcome.REACHED and rig.machine.counts.disbelieved == 1
    assert any(entry["byte"] == ord("!") for entry in rig.lines(0, "realtime")), "it was held"
    assert all(math.dist(told, true) < 6.0 for told, true in rig.published)


def test_a_damaged_banner_at_rest_publishes_no_position_of_a_board_that_was_reset() -> None:
    rig = DamagedRig()
    rig.home()
    rig.run_for(0.5)
    told = len(rig.published)
    rig.once(b"Grbl", b"Gr\xe2l", "from_board")
    rig.fault("brown_out")
    rig.run_for(3.0)
    assert all(math.dist(reading, (0.0, 0.0, 0.0)) < 0.1 for reading, _ in rig.published[told:])
    assert not rig.machine.homed


def test_a_late_copy_of_a_report_at_rest_holds_and_publishes_nothing() -> None:
    """A report of the motion that has just ended arrives a second time: the machine holds, its position stays."""
    rig = DamagedRig()
    rig.home()
    seen: list[bytes] = []

    def keep(data: bytes) -> bytes:
        seen.extend(re.findall(rb"<Run[^>]*>\r\n", data))
        return data

    rig.from_board = keep
    assert rig.finish([(0.1, 0.05, 0.0), (0.1, 0.05, 0.005)]).outcome is Outcome.REACHED
    rig.run_for(0.05)
    told, disbelieved = len(rig.published), rig.machine.counts.disbelieved
    seen[:] = [seen[-4]]  # 0.08 s before the end: 2 mm above it
    rig.from_board = lambda data: data + seen.pop() if seen else data
    rig.until(lambda: rig.states[-1].startswith("stopped"), 20.0)
    assert rig.states[-1] == "stopped: the board is in Run without a command from here", "a pendant may move it"
    assert rig.machine.counts.disbelieved == disbelieved + 1 and rig.machine.homed
    assert max(math.dist(reading, true) for reading, true in rig.published[told:]) < 1.0


@pytest.mark.parametrize("cut", [b"G53G1Z-21F1800", b"Z0G1", b"$H", b"$J=G91X10F600"])
def test_a_line_that_a_killed_program_has_cut_off_moves_nothing(cut: bytes) -> None:
    """The board keeps half a line and its power; the next connection must not end the line and so execute it."""
    rig = DamagedRig()
    rig.home()
    place = rig.mpos()
    rig._write(cut)
    rig._close()
    rig.machine.closed("killed", rig.now)
    rig._open = True
    rig.machine.opened(rig.now)
    rig.until(lambda: rig.machine.phase.name == "UNHOMED", 30.0)
    rig.run_for(2.0)
    assert rig.mpos() == place and not rig.machine.homed


# --- seeded -----------------------------------------------------------------------------------------------------------

GESTURES = {
    "press": [TRAVEL, TOUCH, [(0.1, 0.05, 0.0)]],
    "double": [TRAVEL, [*TOUCH, (0.1, 0.05, DEEP - 0.002), (0.1, 0.05, DEEP)], [(0.1, 0.05, 0.0)]],
    "drag": [TRAVEL, [(0.1, 0.05, DEEP)], [(0.12, 0.06, DEEP), (0.12, 0.08, DEEP)], [(0.12, 0.08, 0.0)]],
    "one path": [[*PRESS, (0.14, 0.05, 0.0), (0.14, 0.05, DEEP), (0.14, 0.05, 0.0)]],
}
BYTES = {"to_board": 420, "from_board": 9000}


@pytest.mark.parametrize("direction", sorted(BYTES))
@pytest.mark.parametrize("seed", range(60))
def test_one_damage_is_harmless_or_reported(seed: int, direction: str) -> None:
    rng = random.Random(seed)
    name = rng.choice(sorted(GESTURES))
    rig = DamagedRig(CONFIG, seed)
    rig.home()
    setattr(rig, direction, damage_at(rng, rng.randrange(BYTES[direction])))
    rig.truth.clear()
    places = [machine_mm(point) for path in GESTURES[name] for point in path]
    for path in GESTURES[name]:
        since = len(rig.truth)
        answer = rig.finish(path)
        if answer.outcome is not Outcome.REACHED:
            assert answer.reason, answer
            break
        for point in path:
            nearest = min(math.dist(place, machine_mm(point)) for _, place, _ in rig.truth[since:])
            assert nearest < 0.3, f"{name}: never at {point}, the nearest was {nearest:.2f} mm off"
        assert math.dist(rig.mpos(), machine_mm(path[-1])) < 0.05, f"{name}: a false done at {rig.mpos()}"
    assert rig.deepest_mm() <= DEPTH_MM + 0.5
    for _, place, _ in rig.truth:
        if HOMED[2] - place[2] > DEPTH_MM - 0.5:
            assert off_path_mm(place, places) < 3.0, f"{name}: pressed at {place}"
    for told, true in rig.published:
        assert math.dist(told, true) < 6.0, f"{name}: published {told} at {true}"
