"""A board that was reset obeys no line in transit, and no rest of one; the board is the mock's own parser."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gantry_driver.core.configuration.machine_config import DriverConfig, StylusConfig
from gantry_driver.core.grbl.lines import GrblLine
from gantry_driver.core.grbl.trajectory_gcode import Waypoint, lift_lines, write_motion
from gantry_driver.core.program.gcode_check import Bounds, ProgramChecker
from gantry_driver.core.wire.stages import make_script
from gantry_driver.mock.firmware.gcode import check_line
from gantry_driver.mock.firmware.parser_state import ParserState
from gantry_driver.mock.firmware.words import FirmwareGcodeError
from icu_common.core.geometry.frames import JOINTS

PLACES = [[-100.0, -100.0, -10.0] for _ in range(8)]
BOUNDS = Bounds(low_mm=(-360.0, -220.0, -60.0), high_mm=(0.0, 0.0, 0.0), rapid_mm_min=(12000.0, 12000.0, 3000.0))
PROGRAM = """G21 G90
G0 X-100 Y-50
G1 X-110 F900
Y-60.5
G2 X-120 Y-60.5 I-5 F600
X-130 R5
G93 G1 X-140 F30
Y-70 F60
G94 G53 G1 Z-5 F300
G92 X0 Y0
G91
X1 Y1 F300
M3 S800
G4 P0.25
M8
F700
G20
G0 X0.1
G1 X0.1 F10
M30""".splitlines()


def obeyed(text: str) -> bool:
    """Whether a board that was reset would move, lower a stylus, or take a feed; its positions are not the old ones."""
    try:
        block = check_line(text, ParserState(), PLACES, mist=True)
    except FirmwareGcodeError:
        return False
    modes = block.modes
    goes = (block.moves and modes.motion != 80) or block.action in (10, 28, 30, 28.1, 30.1)
    return goes or block.feed > 0 or modes.spindle != 5 or modes.flood or modes.mist


def check(lines: Sequence[str]) -> None:
    for text in lines:
        assert GrblLine.of(1, text, 1.0).alone or not obeyed(text), text
        for cut in range(1, len(text)):
            assert not obeyed(text[cut:]), f"{text[cut:]!r}, the rest of {text!r}"


def lines_of(names: Sequence[str], way: Sequence[Waypoint], config: DriverConfig) -> list[str]:
    motion = write_motion(names, way, (0.0, 0.0, 0.0), config)
    return make_script(motion, config, framed=True, frame_mm=None).lines(config)


def test_what_used_to_be_sent_would_be_obeyed() -> None:
    assert obeyed("G53G1X-123Y-43F9000") and obeyed("X-123Y-43F9000") and obeyed("Y-68") and obeyed("M3S800")


@given(
    st.sampled_from(["z_axis", "servo_m3", "solenoid_m8"]),
    st.lists(st.tuples(st.floats(0, 0.35), st.floats(0, 0.21), st.floats(0, 0.02), st.floats(0.01, 0.04)), min_size=1),
)
def test_paths(kind: str, points: list[tuple[float, float, float, float]]) -> None:
    config = DriverConfig(stylus=StylusConfig(kind=kind))
    if kind != "z_axis":  # only up and down
        points = [(x, y, 0.02 * round(z / 0.02), speed) for x, y, z, speed in points]
    way = [Waypoint(positions_m=point[:3], velocities_m_s=(point[3],)) for point in points]
    check([*lines_of(JOINTS, way, config), *lift_lines(config)])


def test_programs() -> None:
    lines = [line.text for line in ProgramChecker(BOUNDS, (-50.0, -50.0, -1.0)).check_all(PROGRAM)]
    assert lines == [
        *("G21G90", "F17234X-100Y-50G1", "F900X-110G1", "Y-60.5G1", "F600X-120Y-60.5I-5G2", "X-130R5G2"),
        *("F300X-140G1", "F570Y-70G1", "F300Z-5G53G1", "X0Y0G92", "G91", "X1Y1G1", "M3S800", "G4P0.25", "M8", "G20"),
        *("F678.503937X0.1G1", "F10X0.1G1", "M30"),
    ]
    check(lines)


@pytest.mark.parametrize("speeds", [(0.1, 0.1, 0.1), (0.1, 0.1003, 0.0998), (0.1, 0.05, 0.1)])
def test_a_feed_is_sent_where_it_changes(speeds: tuple[float, ...]) -> None:
    way = [Waypoint(positions_m=(0.01 * (k + 1),), velocities_m_s=(speed,)) for k, speed in enumerate(speeds)]
    lines = lines_of(JOINTS[:1], way, DriverConfig())
    fed = [line.startswith("F") for line in lines[1:-1]]
    assert fed == [True, *(abs(b - a) > 0.001 for a, b in itertools.pairwise(speeds))]
