"""The figures of wire.md and damage-campaign.md are those of the code, and a press costs what the document says."""

from __future__ import annotations

import random
import re
from pathlib import Path

import numpy as np
import pytest
from campaign import damage_judge as judge
from campaign.damage_phases import HOLD_S, HOVER_MM, MOTION, OVERTRAVEL_MM
from campaign.damage_rig import ANSWER_EXTRA_S, ANSWER_FACTOR
from campaign.other_damage import LATE_S
from campaign.virtual_link import VirtualRig

from gantry_driver.core.configuration import clearance
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.contact.config import ContactConfig
from gantry_driver.core.grbl import lines
from gantry_driver.core.grbl.trajectory_gcode import Waypoint, write_motion
from gantry_driver.core.machine import homing, machine, proof
from gantry_driver.core.motion import motion_plan
from gantry_driver.core.motion.motion_plan import Path as Plan
from gantry_driver.core.motion.targets import TouchConfig
from gantry_driver.core.program.arcs import CHORD_MM
from gantry_driver.core.wire import stages, watch
from icu_common.core.geometry.frames import JOINTS

CONFIG = DriverConfig(enabled_at_start=True)
BOARD = CONFIG.machine
HZ, SPEED, SLOWING = CONFIG.touch_status_rate_hz, BOARD.max_rate_mm_min[2] / 60.0, BOARD.acceleration_mm_s2[2]
STOP_MM = clearance.stopping_way_mm(BOARD.max_rate_mm_min[2], SLOWING, BOARD.travel_mm[2], HZ)
COUNTS = {2: "twice", 3: "three times", 4: "four times"}
FOLDER = Path(__file__).resolve().parents[4] / "docs" / "decisions"

WIRE = [
    f"{watch.TUBE_MM:g} mm: two motor steps of 1/{BOARD.steps_per_mm[0]:g} mm",
    f"to the arrival of this one and {watch.REPORT_LATE_S:g} s.",
    f"The board's speed in a report is at most {watch.SEGMENTS_S:g} s ahead of its position",
    f"{watch.FEED_SHARE:g} times the highest feed of the part",
    f"will be in {watch.PREPARED_S:g} s, and {watch.FEED_MM_MIN:g} mm/min",
    f"twice the expected time and {stages.SURPLUS_S:g} s",
    f"Reports come at {HZ:g} Hz (`touch_status_rate_hz`)",
    f"chords of at most {CHORD_MM:g} mm from them",
    f"less {watch.PREPARED_S:g} s, for GRBL drops",
    f"at rest elsewhere for {proof.ELSEWHERE_S:g} s ends the goal",
    f"are sent up to {COUNTS[proof.CONFIRM_TRIES]}, then the goal ends with `modes_differ`",
    f"asked for again for {proof.ELSEWHERE_S:g} s",
    f"(1 / touch_status_rate_hz + {clearance.REPORT_WAY_S:g} s + {clearance.LOOK_AHEAD_S:g} s)",
    f"{clearance.LOOK_AHEAD_S:g} s are GRBL's step segment buffer",
    f"With {SPEED:g} mm/s, {SLOWING:g} mm/s^2 and {HZ:g} Hz that is {STOP_MM:.1f} mm",
    f"`clearance_m` is {1000.0 * CONFIG.clearance_m:g} mm",
    f"`hover_m` of {1000.0 * TouchConfig().hover_m:g} mm and the {1000.0 * ContactConfig().key_travel_m:g} mm",
    f"Of the lines sent {lines.ARRIVED_S:g} s ago or earlier",
    f"gets a `$G` after every {proof.ASK_EVERY} lines",
    f"`$H` was answered after {homing.HOMING_LEAST_S:g} s or later",
    f"homing waits up to {homing.OFFSET_WITHIN_S:g} s for them",
    f"within {machine.BUILD_WITHIN_S:g} s; otherwise the board may be homing",
]
CAMPAIGN = [
    f"its end is more than {judge.END_MM:g} mm away",
    f"never visited within {judge.TUBE_MM:g} mm",
    f"more than {judge.IN_CONTACT_MM:g} mm (in contact) or {judge.IN_THE_AIR_MM:g} mm (in the air) off its path",
    f"more than {judge.CONTROL_MM:g} mm from the contact",
    f"more than {judge.DEEPER_MM:g} mm deeper",
    f"longer than {1000.0 * judge.TOO_FAST_S:g} ms",
    f"more than {judge.BRAKING_S:g} s after the answer of a stop",
    f"in the last {judge.SEEN_WITHIN_S:g} s",
    f"more than {judge.STILL_MM:g} mm at rest and {judge.MOVING_MM:g} mm in motion",
    f"within {COUNTS[round(ANSWER_FACTOR)]} its planned duration and {ANSWER_EXTRA_S:g} s",
    f"lower to {HOVER_MM:g} mm above the panel",
    f"the hold of {HOLD_S:g} s",
    f"a line behind the next one, or {LATE_S:g} s late",
]


def plain(name: str) -> str:
    """Return a document with single spaces in place of line ends."""
    return " ".join((FOLDER / name).read_text().split())


@pytest.mark.parametrize(
    ("name", "text"), [*(("wire.md", text) for text in WIRE), *(("damage-campaign.md", text) for text in CAMPAIGN)]
)
def test_a_figure_of_the_document_is_that_of_the_code(name: str, text: str) -> None:
    assert text in plain(name)


def test_the_document_states_the_factor_of_the_time_limit() -> None:
    """Ten metres at the highest feed: start, stop and surplus hardly count."""
    far = DriverConfig(machine=type(BOARD)(travel_mm=(5000.0, 5000.0, 60.0)))
    points = [Waypoint(positions_m=(x, 0.05, 0.0)) for x in (4.9, 0.1)]
    motion = write_motion(JOINTS, points, (0.1, 0.05, 0.0), far)
    limit_s = stages.make_script(motion, far, framed=True, frame_mm=None).limit_s
    assert limit_s == pytest.approx(2.0 * 9.6 / far.feed_m_s + stages.SURPLUS_S, abs=1.5)


def duration_s(rig: VirtualRig, plan: Plan) -> float:
    """Return the time from the order to the answer."""
    count, begun = len(rig.results), rig.now
    way = [
        Waypoint(positions_m=tuple(point), time_s=time)
        for point, time in zip(plan.points.tolist(), plan.times_s.tolist())
    ]
    rig.machine.run(str(begun), JOINTS, way, age_s=0.0, now=begun)
    rig.until(lambda: any(result.outcome.final for result in rig.results[count:]), 30.0)
    assert rig.results[-1].outcome.value == "reached", rig.results[-1]
    return rig.now - begun


def test_a_press_takes_as_long_as_the_document_says() -> None:
    """In virtual time; ten places on a panel 29 mm below the readings' zero, each order at another time of a poll."""
    rng, rig = random.Random("cost 0"), VirtualRig(CONFIG, 0)
    rig.home()
    rig.run_for(1.0)
    sums = [0.0, 0.0, 0.0]
    panel_mm = 29.0
    for _ in range(10):
        aim = np.array([rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.17)])
        sums[0] += duration_s(rig, motion_plan.travel(here(rig), aim, (panel_mm - HOVER_MM) / 1000.0, MOTION))
        rig.run_for(0.5 + rng.random() * 0.1)
        sums[1] += duration_s(rig, motion_plan.plunge(here(rig), (panel_mm + OVERTRAVEL_MM) / 1000.0, MOTION))
        rig.run_for(HOLD_S)
        sums[2] += duration_s(rig, motion_plan.lift(here(rig), MOTION))
        rig.run_for(0.5 + rng.random() * 0.1)
    rows = re.findall(r"\| ([\d.]+) s \| ([\d.]+) s", (FOLDER / "wire.md").read_text().partition("## What it costs")[2])
    before, now = zip(*((float(old), float(new)) for old, new in rows))
    measured = [total / 10.0 for total in sums]
    assert [*measured, sum(measured)] == pytest.approx(now, abs=0.006), measured
    assert sum(now[:3]) == pytest.approx(now[3], abs=0.002) and sum(before[:3]) == pytest.approx(before[3], abs=0.002)
    assert sum(measured) - before[3] <= 0.08, "limit of the cost of a press"


def here(rig: VirtualRig) -> np.ndarray:
    """Return the last reading."""
    assert rig.machine.reading_m is not None
    return np.array(rig.machine.reading_m)
