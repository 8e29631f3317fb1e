"""A new user's whole way at the page, with the whole graph on the simulated bench; each step leaves a screenshot.

Sign in, take control, calibrate with the guide, recognise, press, turn, stop, hand over, record, replay. Started
by ``make story``; the pictures are in ``artifacts/story``.
"""

from __future__ import annotations

import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from system.conftest import ROOT, RunningGraph, executable, wait_for
from system.operator_browser import Operator

SHOTS = ROOT / "artifacts" / "story"
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.alone, pytest.mark.story, pytest.mark.timeout(600)]


def test_from_the_first_sign_in_to_the_replay(browser: Any, started_graph: RunningGraph, tmp_path: Path) -> None:
    graph = started_graph
    operator = Operator(browser, graph.page_address())
    operator.page.wait_for_selector("#stage:not(.empty)", timeout=30_000)
    operator.sees("#chip-driver", "Not homed", within_s=30.0)
    operator.shoots("01_signed_in", SHOTS)
    operator.page.click("#lease-take")
    operator.sees("#lease-text", "You are in control")
    calibrates(operator)
    graph.prepared = True
    recognises(operator)
    presses(operator)
    turns(operator)
    stops(operator)
    second = hands_over(operator, Operator(browser, graph.new_page_address()))
    folder = records(second)
    operator.leaves()
    second.leaves()
    replays(browser, folder, graph, tmp_path)


def calibrates(operator: Operator) -> None:
    page = operator.page
    page.click("#tab-calibrate")
    assert page.get_attribute("#guide-machine", "data-done") == "no", "the guide says what is missing"
    page.click("#tab-machine")
    page.click("[data-call=enable]")
    operator.logs("Enable.*done", 10.0)
    page.click("[data-call=home]")
    page.click("[data-call=home]")
    operator.sees("#chip-driver", "Homing")
    operator.sees("#chip-driver", "Idle", within_s=60.0)
    page.click("#tab-calibrate")
    operator.until(lambda: page.get_attribute("#guide-machine", "data-done") == "yes", 5.0, lambda: "the first step")
    page.click("[data-call=calibrate]")
    page.click("[data-call=calibrate]")
    places = page.locator("#coverage circle")
    operator.until(lambda: places.count() >= 6, 120.0, lambda: page.inner_text("#panel-calibrate"))
    page.locator("#coverage-text").scroll_into_view_if_needed()
    operator.shoots("02_calibrating", SHOTS)
    operator.sees("#chip-calibration", "Calibrated", within_s=150.0)
    numbers = operator.sees("#guide-numbers", r"\d")
    rms, held_out, predicted = map(float, re.findall(r"(\d+\.\d+) mm", numbers))
    print(f"calibration: rms {rms}, held out {held_out}, predicted {predicted} mm at {places.count()} places")
    assert 0 < rms < 0.25 and 0 < held_out < 0.25 and 0 < predicted < 0.25
    assert page.get_attribute("#guide-result", "data-done") == "yes"
    x_low, x_high, y_low, y_high = map(float, re.findall(r"\d+", operator.sees("#coverage-text", r"\d+ … \d+")))
    assert x_high - x_low > 100 and y_high - y_low > 60, "the places cover the travel"
    page.locator("#coverage-text").scroll_into_view_if_needed()
    operator.shoots("03_calibrated", SHOTS)


def recognises(operator: Operator) -> None:
    page = operator.page
    operator.sees_controls()
    percent = int(re.findall(r"(\d+) ?%", operator.sees("#chip-recognition", r"\d+ ?%", within_s=20.0))[0])
    assert percent > 50
    assert page.locator("#controls button").count() > 20
    for layer in ("corners", "edges"):
        page.click(f"[data-layer={layer}]")
        page.wait_for_selector(f".layer-{layer} .over", state="attached", timeout=15_000)
    lines = str(page.get_attribute(".layer-edges .over", "d")).count("M")
    assert lines > 40, "edges of the panel"
    operator.shoots("04_recognised", SHOTS)
    page.click("[data-camera=right]")
    page.wait_for_selector(".layer-edges .over", state="attached", timeout=15_000)
    page.click("[data-camera=left]")
    shown = "async () => (await import('/page/desk.js')).desk.video.shown?.camera"
    operator.until(lambda: page.evaluate(shown) == "left", 15.0, lambda: "the left picture again")
    for layer in ("corners", "edges"):
        page.click(f"[data-layer={layer}]")


def presses(operator: Operator) -> None:
    page = operator.page
    operator.sees("#chip-controller", "Ready", within_s=20.0)
    lit = operator.lit()
    operator.selects("RUN_STOP", "Run")
    page.wait_for_selector(".layer-path .planned.over", state="attached")
    operator.shoots("05_selected", SHOTS)
    operator.confirms()
    page.wait_for_selector(".layer-path .over:not(.planned)", state="attached", timeout=10_000)
    operator.shoots("06_moving", SHOTS)
    row = operator.logs("Press Run.*(done|aborted|refused|no answer)", 40.0)
    assert "done" in row, row
    error_mm = float(re.findall(r"([\d.]+) mm", row)[-1])
    print(f"measured error of the touch: {error_mm} mm")
    assert error_mm < 1.0
    operator.until(lambda: operator.lit() != lit, 5.0, lambda: "RUN/STOP changes in the live picture")
    operator.shoots("07_pressed", SHOTS)


def turns(operator: Operator) -> None:
    operator.sees("#chip-controller", "Ready", within_s=20.0)
    operator.selects("CH1_SCALE", "scale")
    operator.page.select_option("#turn-degrees", "30")
    operator.confirms("turn")
    row = operator.logs("Turn ↺ 30°.*(done|aborted|refused|no answer)", 60.0)
    assert "done" in row, row
    operator.shoots("08_turned", SHOTS)


def stops(operator: Operator) -> None:
    page = operator.page
    operator.sees("#chip-controller", "Ready", within_s=20.0)
    operator.selects("MENU", "Menu")
    operator.confirms()
    operator.sees("#chip-driver", "Moving", within_s=10.0)
    page.click("#stop")
    operator.sees("#banner", "STOPPED – STOP was pressed by Operator 1")
    assert "aborted" in operator.logs("Press Menu.*(done|aborted)", 10.0)
    operator.shoots("09_stopped", SHOTS)
    page.click("#reset")
    operator.sees("#chip-driver", "Idle", within_s=20.0)
    operator.sees("#chip-controller", "Ready", within_s=20.0)


def hands_over(first: Operator, second: Operator) -> Operator:
    second.sees("#lease-text", "Operator 1 is in control")
    second.page.click("#lease-request")
    first.sees("#lease-text", "Operator 2 asks for control")
    first.shoots("10_asked_for_control", SHOTS)
    first.page.click("#lease-grant")
    second.sees("#lease-text", "You are in control")
    first.sees("#lease-text", "Operator 2 is in control")
    assert not first.page.is_enabled("[data-act=press]")
    return second


def records(operator: Operator) -> Path:
    page = operator.page
    page.click("#tab-machine")
    page.click("[data-call=record]")
    folder = Path(re.findall(r"recording to (\S+)", operator.logs("Record.*done recording to", 40.0))[0])
    # The recorder finds the topics by and by; pictures in the file show that it has.
    size = lambda: sum(file.stat().st_size for file in folder.glob("*.mcap"))  # noqa: E731
    operator.until(lambda: size() > 300_000, 40.0, lambda: f"pictures in the bag: {size()} bytes")
    # A move: while a busy machine also records, a touch may not see its tip often enough, and says so.
    page.click("#tab-move")
    page.fill("#go-x", "150")
    page.fill("#go-y", "80")
    operator.until(lambda: page.is_enabled("#go"), 20.0, lambda: page.inner_text("#move-why"))
    page.click("#go")
    row = operator.logs(r"Go to \(150.0, 80.0\) mm.*(done|aborted|refused|no answer)", 40.0)
    assert "done" in row and "Operator 2" in row, row
    operator.shoots("11_recording", SHOTS)
    page.click("#tab-machine")
    page.click("[data-call=end_record]")
    operator.logs(r"End recording.*done recorded to \S+: [1-9]\d* messages", 60.0)
    assert (folder / "metadata.yaml").is_file()
    return folder


def replays(browser: Any, folder: Path, graph: RunningGraph, tmp_path: Path) -> None:
    # in a graph of its own, as somebody would look at it later
    environment = graph.environment | {"ROS_DOMAIN_ID": str(50 + int(graph.environment["ROS_DOMAIN_ID"]))}
    bridge_only = [executable("scope_bench", "bring_up"), "--only", "ui_bridge", "--state", str(tmp_path), "--verbose"]
    bridge_only += ["--set", "ui_bridge.replay=true", "--set", "ui_bridge.port=0"]
    output = tmp_path / "replay.log"
    with output.open("wb") as out:
        started = [subprocess.Popen(bridge_only, env=environment, stdout=out, stderr=subprocess.STDOUT)]
    try:
        found = wait_for(lambda: re.findall(r"http://\S+\?token=\S+", output.read_text()), 30.0, "the page's address")
        play = [executable("scope_bench", "bag_play"), str(folder), "--loop"]
        quiet = subprocess.DEVNULL
        started.append(subprocess.Popen(play, env=environment, stdin=quiet, stdout=quiet))
        viewer = Operator(browser, found[0])
        viewer.sees_controls()
        viewer.sees("#banner", "REPLAY of a recorded session", within_s=15.0)
        assert viewer.page.is_hidden("#lease-take")
        viewer.until(lambda: "STALE" not in viewer.page.inner_text("#stale"), 5.0, lambda: "live")
        viewer.page.wait_for_selector(".layer-path .over:not(.planned)", state="attached", timeout=60_000)
        viewer.logs("Go to.*(in work|done)", 30.0)
        viewer.shoots("12_replayed", SHOTS)
        viewer.leaves()
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGINT)
            process.wait(20.0)
