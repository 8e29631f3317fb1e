"""The parts of the proof: the tube around a path, its stages and lines, the modes, the clearance, and the record."""

from __future__ import annotations

import bisect
import itertools
import math
import random
import re
from pathlib import Path

import pytest

from gantry_driver.adapters.stylus_record import StylusRecord
from gantry_driver.core.configuration.clearance import TUBE_MM, stopping_way_mm
from gantry_driver.core.configuration.machine_config import DriverConfig, MachineConfig, StylusConfig
from gantry_driver.core.grbl.modes import RequiredModes
from gantry_driver.core.grbl.trajectory_gcode import Waypoint, write_motion
from gantry_driver.core.wire.stages import Script, make_script
from gantry_driver.core.wire.watch import REPORT_LATE_S, SEGMENTS_S, PathWatch, Segment
from gantry_driver.mock.firmware.gcode import check_line
from gantry_driver.mock.firmware.parser_state import ParserState
from gantry_driver.mock.firmware.words import FirmwareGcodeError
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.frames import JOINTS

CONFIG = DriverConfig()
Place = tuple[float, float, float]


ACCELERATION = CONFIG.machine.acceleration_mm_s2


def watch(*places: Place, feed: float = 6000.0, axes: int = 3) -> PathWatch:
    segments = [Segment(start_mm=start, end_mm=end, feed_mm_min=feed) for start, end in itertools.pairwise(places)]
    return PathWatch.along(places[0], segments, axes, 0.0, ACCELERATION)


def script(*points: Place, start: Place = (0.0, 0.0, 0.0), frame: Place | None = None, framed: bool = True) -> Script:
    motion = write_motion(JOINTS, [Waypoint(positions_m=point) for point in points], start, CONFIG)
    return make_script(motion, CONFIG, framed=framed, frame_mm=frame)


# --- the tube ---------------------------------------------------------------------------------------------------------


def test_a_report_on_the_path_is_followed_and_one_beside_it_is_not() -> None:
    tube = watch((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 10.0, 0.0))
    assert tube.check((4.0, 0.9 * TUBE_MM, 0.0), 6000.0, 0.05) is None
    assert tube.check((10.0, 2.0, 0.0), 6000.0, 0.1) is None
    beside = tube.check((10.0, 3.0, -0.5), 6000.0, 0.12)
    assert beside is not None and beside.off_mm == pytest.approx(0.5)
    assert beside.text() == "it reports MPos 10.000, 3.000, -0.500 mm, 0.50 mm off (limit 0.15 mm)"


def test_a_report_too_far_ahead_has_left_out_a_detour() -> None:
    """There and back again by 100 mm takes two seconds at 100 mm/s."""
    places = ((0.0, 0.0, 0.0), (100.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 50.0, 0.0))
    tube = watch(*places)
    assert tube.check((0.0, 0.0, 0.0), 0.0, 0.04) is None
    assert tube.check((0.0, 10.0, 0.0), 6000.0, 0.12) is not None
    tube = watch(*places)
    for step in range(1, 25):
        along = min(4.0 * step, 200.0 - 4.0 * step)
        assert tube.check((along, 0.0, 0.0), 6000.0, 0.04 * step) is None
    assert tube.check((95.0, 0.0, 0.0), 6000.0, 1.05) is None, "on its way back"


def test_a_late_report_may_be_farther_along() -> None:
    tube = watch((0.0, 0.0, 0.0), (100.0, 0.0, 0.0))
    reach_mm = 100.0 * (0.04 + REPORT_LATE_S)
    assert tube.check((reach_mm + TUBE_MM - 0.01, 0.0, 0.0), 6000.0, 0.04) is None
    assert tube.check((99.0, 0.0, 0.0), 6000.0, 0.05) is not None


def test_a_report_that_a_busy_computer_read_late_is_older_than_its_arrival() -> None:
    tube = watch((0.0, 0.0, 0.0), (200.0, 0.0, 0.0))
    assert tube.check((4.0, 0.0, 0.0), 6000.0, 0.84, asked_at=0.04) is None, "read 0.8 s late"
    assert tube.check((86.0, 0.0, 0.0), 6000.0, 0.86, asked_at=0.85) is None


def test_a_feed_above_the_highest_of_the_path_has_left_it() -> None:
    tube = watch((0.0, 0.0, 0.0), (100.0, 0.0, 0.0), feed=600.0)
    assert tube.check((0.5, 0.0, 0.0), 600.0, 0.04) is None
    fast = tube.check((0.6, 0.0, 0.0), 700.0, 0.05)
    assert fast is not None and fast.text() == "it reports a feed of 700 mm/min (limit 660 mm/min)"


def test_a_path_that_stands_still_may_not_move() -> None:
    tube = watch((5.0, 5.0, 0.0))
    assert tube.check((5.0, 5.0, 0.01), 0.0, 1.0) is None
    moved = tube.check((5.0, 6.0, 0.0), 0.0, 2.0)
    assert moved is not None and moved.off_mm == pytest.approx(1.0)


def test_an_axis_that_the_board_does_not_have_is_not_compared() -> None:
    tube = watch((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), axes=2)
    assert tube.check((5.0, 0.0, -33.0), 6000.0, 0.05) is None


def test_an_old_report_that_fits_the_way_back_waits_for_a_second_one() -> None:
    """The stylus rises again; the report of 0.35 s ago, on its way down at 600 mm/min, has the place 1.2 mm ahead."""
    up = watch((0.0, 0.0, -32.933), (0.0, 0.0, -28.933), feed=3000.0)
    for at, z, feed in [(0.04, -32.848, 493.0), (0.06, -32.605, 973.0), (0.08, -32.195, 1457.0)]:
        assert up.check((0.0, 0.0, z), feed, at, asked_at=at - 0.005) is None and not up.early
    assert up.check((0.0, 0.0, -30.983), 600.0, 0.1, asked_at=0.095) is None and up.early
    assert up.check((0.0, 0.0, -31.635), 1933.0, 0.1, asked_at=0.095) is None and not up.early


def test_a_board_that_reports_no_feed_is_compared_by_the_feed_of_the_path() -> None:
    up = watch((0.0, 0.0, 0.0), (0.0, 0.0, 30.0), feed=3000.0)
    for step in range(1, 6):
        assert up.check((0.0, 0.0, 1.0 * step), None, 0.02 * step) is None and not up.early
    assert up.check((0.0, 0.0, 7.5), None, 0.12) is None and up.early


def motion(rng: random.Random) -> tuple[list[Place], list[float], list[tuple[float, Place, float]]]:
    """Return a random path, its feeds (mm/min), and its motion from rest to rest every 0.1 ms: time, place, speed."""
    places, feeds = [(0.0, 0.0, 0.0)], []
    kind = rng.choice(["up and down", "across", "dense", "any"])
    for _ in range(rng.randint(1, 40 if kind == "dense" else 6)):
        x, y, z = places[-1]
        reach = 1.0 if kind == "dense" else rng.choice([2.0, 40.0])
        by = [rng.uniform(-reach, reach) for _ in range(3)]
        by = {"up and down": [0.0, 0.0, by[2]], "across": [*by[:2], 0.0]}.get(kind, by)
        places.append((x + by[0], y + by[1], z + by[2]))
        feeds.append(rng.choice([300.0, 600.0, 1800.0, 3000.0] if by[2] else [900.0, 3600.0, 9000.0, 12000.0]))
    pace, squares, limits = 0.002, [], []
    spots: list[Place] = []
    for (start, end), feed in zip(itertools.pairwise(places), feeds):
        length = math.dist(start, end)
        count = max(1, round(length / pace))
        limit = min(a * length / abs(e - s) for a, s, e in zip(ACCELERATION, start, end) if e != s)
        corner = rng.uniform(0.0, 1.0) * (feed / 60.0) ** 2
        for number in range(count):
            share = number / count
            spots.append(tuple(s + share * (e - s) for s, e in zip(start, end)))  # type: ignore[arg-type]
            squares.append(corner if number == 0 else (feed / 60.0) ** 2)
            limits.append(2.0 * limit * length / count)
    spots.append(places[-1])
    squares[0] = 0.0
    squares.append(0.0)
    for number, gain in enumerate(limits):
        squares[number + 1] = min(squares[number + 1], squares[number] + gain)
    for number, gain in reversed(list(enumerate(limits))):
        squares[number] = min(squares[number], squares[number + 1] + gain)
    now, states = 0.0, [(0.0, spots[0], 0.0)]
    for number in range(len(limits)):
        speed = (math.sqrt(squares[number]) + math.sqrt(squares[number + 1])) / 2.0
        now += math.dist(spots[number], spots[number + 1]) / speed
        states.append((now, spots[number + 1], math.sqrt(squares[number + 1])))
    return places, feeds, states


@pytest.mark.parametrize("seed", range(60))
def test_no_report_of_a_motion_along_the_path_is_early(seed: int) -> None:
    """The reported feed is ahead of the position by up to GRBL's segment buffer; reports come and are read at once, or
    late."""
    rng = random.Random(f"motion {seed}")
    places, feeds, states = motion(rng)
    segments = [
        Segment(start_mm=start, end_mm=end, feed_mm_min=feed)
        for (start, end), feed in zip(itertools.pairwise(places), feeds)
    ]
    tube = PathWatch.along(places[0], segments, 3, 0.0, ACCELERATION)
    times = [state[0] for state in states]
    constant, late = rng.uniform(0.0, SEGMENTS_S), rng.random() < 0.3
    asked = 0.0
    while asked < times[-1] + 0.05:
        asked += rng.choice([0.005, 0.02, 0.02, 0.04])
        made = asked + rng.uniform(0.0, 0.004)
        read = made + rng.uniform(0.0, 0.3 if late else 0.02)
        ahead = constant if seed % 2 else rng.uniform(0.0, SEGMENTS_S)
        place = states[min(bisect.bisect_right(times, made), len(states) - 1)][1]
        speed = states[min(bisect.bisect_right(times, made + ahead), len(states) - 1)][2]
        rounded = tuple(round(value * 400.0) / 400.0 for value in place)
        assert tube.check(rounded, float(round(60.0 * speed)), read, asked_at=asked) is None
        assert not tube.early, f"{place} at {made:.3f} s"


# --- stages and their lines -------------------------------------------------------------------------------------------


def test_a_path_in_the_air_is_one_stage_and_is_written_as_it_always_was() -> None:
    made = script((0.1, 0.05, 0.0), (0.2, 0.05, 0.0))
    assert made.lines(CONFIG) == ["G21G90G94", "F9000X-259Y-169G53G1", "X-159G53G1", "G4P0"]
    assert len(made.stages) == 1 and made.origin_mm is None


def test_a_path_stops_at_every_extreme_of_z() -> None:
    made = script((0.1, 0.0, 0.0), (0.1, 0.0, 0.03), (0.1, 0.0, 0.028), (0.1, 0.0, 0.03), (0.12, 0.0, 0.03))
    ends = [stage.end_mm for stage in made.stages]
    assert ends == [
        (-259.0, -219.0, -1.0),
        *((-259.0, -219.0, -31.0), (-259.0, -219.0, -29.0), (-259.0, -219.0, -31.0)),
        (-239.0, -219.0, -31.0),
    ]
    assert made.origin_mm == (-460.0, -320.0, -31.0)


def test_a_way_down_that_goes_sideways_stops_above_its_end() -> None:
    made = script((0.1, 0.0, 0.03))
    assert [stage.end_mm for stage in made.stages] == [
        (-359.0, -219.0, -1.0),
        (-294.0, -219.0, -20.5),
        (-259.0, -219.0, -31.0),
    ]


def test_a_path_that_turns_back_stops_there() -> None:
    made = script((0.1, 0.0, 0.0), (0.05, 0.0, 0.0), (0.05, 0.05, 0.0))
    assert [stage.end_mm for stage in made.stages] == [(-259.0, -219.0, -1.0), (-309.0, -169.0, -1.0)]


def test_a_retreat_in_the_frame_of_its_touch_is_not_asked_for_its_modes() -> None:
    made = script((0.1, 0.05, 0.0), start=(0.1, 0.05, 0.011), frame=(-460.0, -320.0, -12.0))
    assert made.lines(CONFIG) == ["G21G90G94", "F1800Z11G1", "G92.1", "G4P0"]


def test_a_board_that_keeps_offsets_over_a_reset_gets_no_frame_but_the_same_stops() -> None:
    lines = script((0.1, 0.05, 0.02), start=(0.1, 0.05, 0.0), framed=False).lines(CONFIG)
    assert lines == ["F1800G21G90G94", "$G", "Z-10.5G53G1", "Z-21G53G1", "G4P0"]


def test_the_time_of_a_path_counts_with_the_rate_of_a_slow_axis() -> None:
    slow = DriverConfig(machine=MachineConfig(max_rate_mm_min=(12000.0, 12000.0, 300.0)))
    motion = write_motion(JOINTS, [Waypoint(positions_m=(0.0, 0.0, 0.05))], (0.0, 0.0, 0.0), slow)
    limit_s = make_script(motion, slow, framed=True, frame_mm=None).limit_s
    assert 2.0 * 10.0 < limit_s < 2.0 * 10.0 + 4.0, "50 mm at 5 mm/s, though the feed is 30 mm/s"


def flips(line: str) -> set[str]:
    """Return what the board's parser may get of a line with one damaged byte: flipped, lost, doubled or swapped."""
    data = line.encode()
    found = [data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :] for at in range(len(data)) for bit in range(8)]
    found += [data[:at] + data[at + 1 :] for at in range(len(data))]
    found += [data[:at] + data[at : at + 1] + data[at:] for at in range(len(data))]
    found += [data[:at] + data[at : at + 2][::-1] + data[at + 2 :] for at in range(len(data) - 1)]
    texts = set()
    for changed in found:
        kept = bytes(byte for byte in changed if 0x20 < byte < 0x80 and byte not in b"?!~/")
        text = re.sub(r"\(.*?(\)|\Z)", "", kept.decode()).partition(";")[0].upper()
        texts.add(text)
    return texts


def test_no_damaged_byte_of_a_line_in_contact_names_a_deeper_place() -> None:
    made = script((0.1, 0.0, 0.0), (0.1, 0.0, 0.0365), (0.2, 0.123, 0.0365), (0.2, 0.123, 0.0))
    lines = [line for line in made.lines(CONFIG) if line.endswith("G1") and "G53" not in line]
    assert "Z0G1" in lines and any("Y" in line for line in lines)
    assert made.origin_mm is not None
    for line in lines:
        for text in flips(line):
            state = ParserState()
            state.feed, state.modes.motion, state.position = 1800.0, 1, [-259.0, -219.0, -29.5]
            state.g92 = list(made.origin_mm)
            try:
                block = check_line(text, state, [[0.0, 0.0, 0.0]] * 8)
            except (FirmwareGcodeError, ValueError):
                continue
            if block.moves and block.target[2] > -60.0:
                assert block.target[2] >= made.origin_mm[2] - 1e-6, f"{line} as {text} goes to {block.target}"


# --- modes, clearance, record -----------------------------------------------------------------------------------------


def test_modes_are_compared_by_words_and_numbers() -> None:
    wanted = RequiredModes(words=frozenset({"G21", "M3"}), feed_mm_min=1800.4, spindle=800.0)
    assert wanted.missing("G1 G54 G17 G21 G90 G94 M3 M9 T0 F1800 S800.") == ""
    assert wanted.missing("G1 G54 G17 G20 G90 G94 M3 M9 T0 F18000 S80") == "G21 F1800.4 S800"
    assert wanted.missing("") == "G21 M3 F1800.4 S800"


def test_the_clearance_must_stop_a_damaged_approach() -> None:
    needed = stopping_way_mm(3000.0, 400.0, 60.0, 50.0)
    assert needed == pytest.approx(0.15 + 50.0 * (0.02 + 0.02 + 0.05) + 50.0**2 / 800.0)
    with pytest.raises(ConfigError, match=r"clearance_m = 0\.005; expected 0\.0088 m .* raise clearance_m .* hover_m"):
        DriverConfig(clearance_m=0.005)
    with pytest.raises(ConfigError, match="touch_status_rate_hz"):
        DriverConfig(touch_status_rate_hz=15.0)
    slow = MachineConfig(max_rate_mm_min=(12000.0, 12000.0, 1500.0))
    assert DriverConfig(clearance_m=0.006, machine=slow).clearance_m == 0.006
    assert DriverConfig(clearance_m=0.001, stylus=StylusConfig(kind="servo_m3")).clearance_m == 0.001


def test_the_record_outlives_the_driver_and_doubt_counts_as_down(tmp_path: Path) -> None:
    record = StylusRecord(tmp_path / "state" / "stylus")
    assert not record.may_be_down(), "nothing was left"
    record.write(True)
    assert StylusRecord(tmp_path / "state" / "stylus").may_be_down()
    record.write(False)
    assert not record.may_be_down()
    (tmp_path / "state" / "stylus").write_bytes(b"\xff\0")
    assert record.may_be_down(), "an unreadable file tells nothing"
    StylusRecord(None).write(True)
    assert [path.name for path in tmp_path.iterdir()] == ["state"]
