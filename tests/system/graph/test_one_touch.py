"""The main job in a closed loop, as a user does it: a goal goes out, the stylus touches, the instrument reacts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from system.operator_browser import Operator as PageOperator
from system.terminal_operator import Operator

from icu_common.core.goals.results import Outcome
from icu_common.core.panel.panel_layout import load_layout
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_model, image_array
from icu_common.nodes.messages.places import transform_of_pose

ROOT = Path(__file__).resolve().parents[3]
LAYOUT = load_layout(ROOT / "config" / "scopes" / "dso_bench_4.yaml")

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(600)]


def screen_pixels(operator: Operator) -> np.ndarray:
    """Return the picture of the RUN/STOP sign on the screen, found through the published pose and not by the truth."""
    ros, node = operator.ros, operator.node
    poses = ros.collect(node, PoseStamped, "/panel/pose", qos.LATCHED)
    infos = ros.collect(node, CameraInfo, "/stereo/left/camera_info", qos.SENSOR)
    images = ros.collect(node, Image, "/stereo/left/image_raw", qos.SENSOR)
    ros.spin_until(lambda: poses and infos and len(images) > 2, 15.0, lambda: (len(poses), len(infos), len(images)))
    screen = LAYOUT.control("SCREEN")
    left, top = (screen.position_mm[0] - screen.size_mm[0] / 2, screen.position_mm[1] + screen.size_mm[1] / 2)
    corners_mm = np.array([(left, top, 0), (left + 40, top, 0), (left + 40, top - 12, 0), (left, top - 12, 0)])
    camera_from_panel = transform_of_pose(poses[-1].pose)
    pixels = camera_model(infos[-1]).project(camera_from_panel.apply(corners_mm / 1000))
    (u0, v0), (u1, v1) = pixels.min(axis=0).astype(int), pixels.max(axis=0).astype(int)
    picture = image_array(images[-1])[v0:v1, u0:u1].astype(np.int16)
    assert picture.size
    return picture


MOTION = re.compile("G1|G92$")
"""A move, or the frame that the moves behind it are written in."""


def motion_lines(graph: Any, since: int) -> list[str]:
    return [e["text"] for e in graph.board_log()[since:] if e["kind"] == "line" and MOTION.search(e["text"])]


def test_press_of_a_named_control_stops_the_scope(running_graph: Any, operator: Operator) -> None:
    operator.go(0.01, 0.01)
    bench = running_graph.bench()
    before = bench.ask(do="truth")["instrument"]["running"]
    seen_before = screen_pixels(operator)
    log_start, truth_start = len(running_graph.board_log()), len(running_graph.truth_log())

    operator.command.publish(String(data="press:RUN_STOP id=first"))
    result = operator.answer("first")

    assert result.outcome is Outcome.REACHED, result
    assert result.error_m < 0.0005
    events = running_graph.truth_log()[truth_start:]
    assert [e["control"] for e in events if e["event"] == "press"] == ["RUN_STOP"]
    assert bench.ask(do="truth")["instrument"]["running"] is (not before)
    lines = motion_lines(running_graph, log_start)
    assert all(line.endswith(("G1", "G92")) for line in lines), lines
    # Each frame begins at the stylus's position: this far above its deepest position, from the top on.
    deepest = -1.0 - sum(float(line.split("Z")[1].split("G")[0]) for line in lines if line.endswith("G92"))
    assert -40.0 < deepest < -25.0, "the stylus went down to the button, 3 mm above the panel's face at z = -35 mm"
    place = np.array(next(e["tip_base_m"] for e in events if e["event"] == "press")[:2]) * 1000
    sent = [re.fullmatch(r".*X(-?[\d.]+)Y(-?[\d.]+)G53.*", line) for line in lines]
    over = np.array([(float(m[1]) + 359, float(m[2]) + 219) for m in sent if m])  # readings: 0 at the homed corner
    assert np.hypot(*(over[-1] - place)) < 2.0, "the last place that the board was told is where the tip was"

    operator.go(0.01, 0.01)
    changed = np.abs(screen_pixels(operator) - seen_before).mean()
    assert changed > 5.0, f"the picture of the screen's RUN/STOP sign changed by {changed:.1f} of 255"


@pytest.mark.browser
def test_press_on_the_page_changes_the_scope(browser: Any, running_graph: Any) -> None:
    """No other operator is there: the heartbeat that allows motion is the page's."""
    bench = running_graph.bench()
    before = bench.ask(do="truth")["instrument"]["running"]
    truth_start = len(running_graph.truth_log())
    person = PageOperator(browser, running_graph.new_page_address())
    person.takes_control()
    person.sees("#chip-controller", "Ready", within_s=20.0)
    person.selects("RUN_STOP", "Run")
    person.confirms()
    row = person.logs("Press Run.*(done|aborted|refused|no answer)", 40.0)
    assert "done" in row, row
    assert 0 <= float(re.findall(r"([\d.]+) mm", row)[-1]) < 0.5, row
    events = running_graph.truth_log()[truth_start:]
    assert [e["control"] for e in events if e["event"] == "press"] == ["RUN_STOP"]
    assert bench.ask(do="truth")["instrument"]["running"] is (not before)
    person.until(lambda: person.lit() is (not before), 5.0, lambda: "the lamp in the live picture")
    person.leaves()


def clear_of_tall_controls(x: float, y: float) -> bool:
    """Return whether a point is neither on a connector nor so near to a tall control's edge that it is rejected."""
    for control in LAYOUT.controls:
        distance = float(np.hypot(x - control.position_mm[0], y - control.position_mm[1]))
        radius = max(control.size_mm) / 2
        inside = control.kind == "knob" and distance < radius - 3
        if control.height_mm > 5 and not inside and distance < radius + 5:
            return False
    return True


def targets_mm() -> list[tuple[float, float]]:
    """Return targets spread over the whole panel, moved a little to the right where a tall control is in the way."""
    width, height = LAYOUT.size_mm
    places = [
        next((xx, y) for xx in np.arange(x, width, 1.5) if clear_of_tall_controls(xx, y))
        for y in np.linspace(12, height - 12, 4)
        for x in np.linspace(14, width - 14, 6)
    ]
    return [(float(x), float(y)) for x, y in dict.fromkeys(places)]


@pytest.mark.long
def test_touch_error_over_the_whole_panel(running_graph: Any, operator: Operator) -> None:
    errors_mm, reported_mm, durations_s, missed = [], [], [], []
    targets = targets_mm()
    assert len(targets) >= 20
    for x, y in targets:
        start = len(running_graph.truth_log())
        result = operator.touch_panel(x / 1000, y / 1000)
        contacts = [e for e in running_graph.truth_log()[start:] if e["event"] == "contact"]
        if result.outcome is not Outcome.REACHED or not contacts:
            missed.append((x, y, result, contacts))
            continue
        touched = np.array(contacts[0]["tip_panel_mm"][:2])
        errors_mm.append(float(np.hypot(*(touched - (x, y)))))
        reported_mm.append(result.error_m * 1000)
        durations_s.append(result.duration_s)
    assert not missed, missed
    errors = np.array(errors_mm)
    p95 = float(np.percentile(errors, 95))
    print(
        f"\ntouch error over {len(errors)} targets: mean {errors.mean():.3f} mm, p95 {p95:.3f} mm, "
        f"max {errors.max():.3f} mm; reported mean {np.mean(reported_mm):.3f} mm; {np.mean(durations_s):.1f} s a touch"
    )
    assert p95 < 1.0
    assert errors.mean() < 0.5


def test_command_line_presses_and_refuses(running_graph: Any, operator: Operator) -> None:
    start = len(running_graph.truth_log())
    done = running_graph.command("gantry_driver", "gantry_goal", "--control", "SINGLE")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "reached" in done.stdout and "mm" in done.stdout
    assert [e["control"] for e in running_graph.truth_log()[start:] if e["event"] == "press"] == ["SINGLE"]

    log_start = len(running_graph.board_log())
    refused = running_graph.command("gantry_driver", "gantry_goal", "--control", "CH1_IN")
    outside = running_graph.command("gantry_driver", "gantry_goal", "0.9", "0.1")
    assert (refused.returncode, outside.returncode) == (1, 1)
    assert "connector" in refused.stdout + refused.stderr
    assert "outside 0.0000 to 0.3590" in outside.stdout + outside.stderr
    assert motion_lines(running_graph, log_start) == []


def knob_deg(running_graph: Any, name: str) -> float:
    return float(dict(running_graph.bench().ask(do="truth")["instrument"]["knobs"]).get(name, 0.0))


def test_a_knob_is_set_by_its_marker(running_graph: Any, operator: Operator) -> None:
    operator.command.publish(String(data="set:TIME_SCALE:60 id=set"))
    result = operator.answer("set")
    assert result.outcome is Outcome.REACHED, result
    assert knob_deg(running_graph, "TIME_SCALE") == pytest.approx(60, abs=3)


def test_a_sequence_checks_each_step_and_stops_at_the_first_that_fails(running_graph: Any, operator: Operator) -> None:
    operator.go(0.01, 0.01)
    running = running_graph.bench().ask(do="truth")["instrument"]["running"]
    lamp = "red" if running else "green"
    before = knob_deg(running_graph, "CH1_SCALE")
    steps = ["click:CH1_SCALE:2", f"press:RUN_STOP => lamp:RUN_STOP={lamp}, effect"]
    done = running_graph.command("gantry_driver", "gantry_sequence", *steps, within_s=120.0)
    assert done.returncode == 0, done.stdout + done.stderr
    assert running_graph.bench().ask(do="truth")["instrument"]["running"] is (not running)
    assert knob_deg(running_graph, "CH1_SCALE") - before == pytest.approx(-36, abs=3)

    start = len(running_graph.truth_log())
    steps = [f"press:CURSORS => lamp:RUN_STOP={'green' if lamp == 'red' else 'red'}", "press:MATH"]
    failed = running_graph.command("gantry_driver", "gantry_sequence", *steps, within_s=120.0)
    assert failed.returncode == 1 and "step 1 of 2" in failed.stderr, failed.stdout + failed.stderr
    assert [e["control"] for e in running_graph.truth_log()[start:] if e["event"] == "press"] == ["CURSORS"]


def test_stop_in_the_middle_of_a_move_keeps_the_position(running_graph: Any, operator: Operator) -> None:
    goal = operator.start_long_move()
    assert operator.call("/gantry/stop").success
    result = operator.answer(goal, 10.0)
    assert result.outcome is Outcome.ABORTED and "stop" in result.reason
    operator.ros.spin_until(lambda: operator.driver_state.startswith("stopped"), 10.0)
    operator.ros.spin_until(lambda: operator.state.startswith("stopped"), 5.0)
    refused = operator.answer(operator.move(0.02, 0.02), 10.0)
    assert refused.outcome is Outcome.REJECTED and "stopped" in refused.reason

    operator.reset()
    assert operator.answer(operator.move(0.05, 0.05)).outcome is Outcome.REACHED  # without homing again
    bench = running_graph.bench().ask(do="truth")
    assert np.allclose(bench["tip_base_m"][:2], (0.05, 0.05), atol=0.002), bench["tip_base_m"]


def test_a_lost_heartbeat_stops_the_motion(running_graph: Any, operator: Operator) -> None:
    goal = operator.start_long_move()
    operator.beating = False
    result = operator.answer(goal, 10.0)
    assert result.outcome is Outcome.ABORTED and "heartbeat" in result.reason, result
    operator.ros.spin_until(lambda: operator.driver_state.startswith("stopped"), 10.0)
    operator.beating = True
    assert "heartbeat" in operator.driver_state
    operator.reset()


def test_nothing_listens_beyond_this_host(running_graph: Any) -> None:
    listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    port = f"{running_graph.port:04X}"
    addresses = {
        fields[1].split(":")[0] for fields in listening if fields[1].endswith(":" + port) and fields[3] == "0A"
    }
    assert addresses == {"0100007F"}, "the page is served on 127.0.0.1 alone"
    assert (running_graph.folder / "state" / "sign_in").stat().st_mode & 0o077 == 0
