"""A new user's whole way at the page, with the whole graph on the simulated bench; each step leaves a screenshot.

Sign in, take control, calibrate with the guide, recognise, press, turn, run sequences, stop, hand over, record. An
engineer at a tablet signs in by password, in German, teaches the panel and stops a motion. Then the replay, and the
replay seen through the taught panel. Started by ``make story``; the pictures are in ``artifacts/story``.
"""

from __future__ import annotations

import contextlib
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.ros_rig import domain_of_worker
from system.conftest import ROOT, RunningGraph, executable, wait_for
from system.operator_browser import Operator

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_common.core.panel.panel_layout import load_layout

SHOTS = ROOT / "artifacts" / "story"
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.alone, pytest.mark.long, pytest.mark.timeout(900)]


def test_from_the_first_sign_in_to_the_replay(browser: Any, new_graph: RunningGraph, tmp_path: Path) -> None:
    graph = new_graph
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
    runs_sequences(operator)
    stops(operator)
    second = hands_over(operator, Operator(browser, graph.new_page_address()))
    folder = records(second)
    operator.leaves()
    second.page.click("#lease-release")
    second.leaves()
    taught = an_engineer_teaches(browser, graph)
    replays(browser, folder, graph, tmp_path, taught)


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
    shown = "async () => (await import('/page/connection/desk.js')).desk.video.shown?.camera"
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


def runs_sequences(operator: Operator) -> None:
    """Collect one by clicking, then run a stored one, each step checked on the panel."""
    page = operator.page
    operator.sees("#chip-controller", "Ready", within_s=20.0)
    page.click("#tab-sequence")
    page.check("#sequence-collect")
    page.select_option("#sequence-check", "effect")
    operator.selects("RUN_STOP", "Run")
    page.click("[data-act=press]")
    page.select_option("#sequence-check", "")
    operator.selects("CH1_SCALE", "scale")
    page.click("[data-act=click] >> nth=1")
    assert page.input_value("#sequence-text") == "press:RUN_STOP => effect\nclick:CH1_SCALE:1\n"
    page.uncheck("#sequence-collect")
    lit = operator.lit()
    starts_sequence(operator)
    operator.sees("#sequence-said", "all 2 steps are done|ended|refused|no answer", within_s=90.0)
    operator.shoots("09_sequence_collected", SHOTS)
    assert "all 2 steps are done" in page.inner_text("#sequence-said"), page.inner_text("#sequence-said")
    operator.until(lambda: operator.lit() != lit, 5.0, lambda: "RUN/STOP changes in the live picture")
    assert operator.lit(), "the stored sequence begins with a trace that runs"
    page.select_option("#sequence-choice", "hold_and_save")
    starts_sequence(operator)
    operator.sees("#sequence-said", "Step 2 of 3", within_s=60.0)
    operator.shoots("10_sequence_at_work", SHOTS)
    operator.sees("#sequence-said", "all 3 steps are done|ended|refused|no answer", within_s=90.0)
    assert "all 3 steps are done" in page.inner_text("#sequence-said"), page.inner_text("#sequence-said")
    assert operator.lit(), "stopped, saved, and running again"


def starts_sequence(operator: Operator) -> None:
    page = operator.page
    rows = page.locator("#log tr:not(.nothing)")
    before = rows.count()

    def twice() -> None:
        operator.until(lambda: page.is_enabled("#sequence-start"), 20.0, lambda: page.inner_text("#sequence-said"))
        page.click("#sequence-start")
        page.click("#sequence-start")

    operator.insists(twice)
    operator.until(lambda: rows.count() > before, 15.0, lambda: "a row of the log")


def stops(operator: Operator) -> None:
    page = operator.page
    operator.sees("#chip-controller", "Ready", within_s=20.0)
    operator.selects("MENU", "Menu")
    operator.confirms()
    operator.sees("#chip-driver", "Moving", within_s=10.0)
    page.click("#stop")
    operator.sees("#banner", "STOPPED – STOP was pressed by Operator 1")
    assert "aborted" in operator.logs("Press Menu.*(done|aborted)", 10.0)
    operator.shoots("11_stopped", SHOTS)
    operator.until(lambda: resets(operator), 20.0, lambda: page.inner_text("#log"))
    operator.sees("#chip-controller", "Ready", within_s=20.0)


def resets(operator: Operator) -> bool:
    """Press Reset if it is there, which is refused until the stop is complete; return whether it is no longer there."""
    if operator.page.is_visible("#reset"):
        operator.page.click("#reset", timeout=2_000)
    operator.page.wait_for_timeout(500)
    return not operator.page.is_visible("#reset")


def hands_over(first: Operator, second: Operator) -> Operator:
    second.sees("#lease-text", "Operator 1 is in control")
    second.page.click("#lease-request")
    first.sees("#lease-text", "Operator 2 asks for control")
    first.shoots("12_asked_for_control", SHOTS)
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
    operator.shoots("13_recording", SHOTS)
    page.click("#tab-machine")
    page.click("[data-call=end_record]")
    operator.logs(r"End recording.*done recorded to \S+: [1-9]\d* messages", 60.0)
    assert (folder / "metadata.yaml").is_file()
    return folder


def an_engineer_teaches(browser: Any, graph: RunningGraph) -> Path:
    """Sign in by password, in German, at a dark tablet; point at the panel; stop a motion. Return the new layout."""
    password = [executable("scope_ui_bridge", "page_admin"), "password", "Eva", "--role", "engineer"]
    password += ["--file", str(graph.folder / "state" / "passwords")]
    subprocess.run(password, input="a long sentence nobody guesses\n", text=True, check=True, timeout=30)
    tablet: dict[str, Any] = {"viewport": {"width": 820, "height": 1180}, "has_touch": True, "color_scheme": "dark"}
    address = graph.page_address().partition("?")[0]
    engineer = Operator(browser, address, locale="de-DE", **tablet)
    page = engineer.page
    engineer.sees("body", "Anmelden")
    page.fill("#name", "Eva")
    page.fill("#password", "a long sentence nobody guesses")
    page.click(".by-password button")
    engineer.sees_controls()
    page.click("#lease-take")
    engineer.sees("#lease-text", "Sie bedienen")
    page.click("#tab-teach")
    page.click("#teach-hold")
    engineer.sees("#teach-next", "Unten links|unten links")
    layout = load_layout(ROOT / "config" / "scopes" / "dso_bench_4.yaml")
    u, v = outline_px(page).T
    for corner in (np.argmin(u - v), np.argmax(u + v), np.argmax(u - v), np.argmin(u + v)):
        points_at(page, float(u[corner]), float(v[corner]))
    names = ("SCREEN", "RUN_STOP", "MENU", "CH1")
    for control in map(layout.control, names):
        page.fill("#teach-name", control.name)
        page.select_option("#teach-kind", control.kind)
        for field, value in (("w", control.size_mm[0]), ("h", control.size_mm[1]), ("z", control.height_mm)):
            page.fill(f"#teach-{field}", f"{value:g}")
        page.click("#teach-add button")
        engineer.sees("#teach-next", control.name)
        points_at(page, *button_px(page, control.name))
    engineer.shoots("14_taught_by_pointing", SHOTS)
    for field, text in (
        ("model", "story_scope"),
        ("title", "Taught in the story"),
        ("width", "320"),
        ("height", "150"),
    ):
        page.fill(f"#teach-{field}", text)
    page.click("#teach-write")
    engineer.sees("#teach-said", "Geschrieben|geschrieben", within_s=60.0)
    page.locator("#teach-command").scroll_into_view_if_needed()
    engineer.shoots("15_taught", SHOTS)
    taught = load_layout(graph.scopes / "story_scope.yaml")
    for name in names:
        off = np.subtract(taught.control(name).position_mm, layout.control(name).position_mm)
        print(f"{name} was taught {off.round(1)} mm from its place")
        assert np.hypot(*off) < 3.0, "pointed at the middle of its top, 3 mm above the face"
    page.click("#tab-machine")
    engineer.sees("#chip-controller", "Bereit", within_s=20.0)
    engineer.selects("MATH", "Math")
    engineer.confirms()
    engineer.sees("#chip-driver", "Bewegt sich", within_s=10.0)
    page.tap("#stop")
    engineer.sees("#banner", "GESTOPPT – Eva hat STOP gedrückt")
    row = engineer.logs("Drücken Math.*(erledigt|abgebrochen)", 10.0)
    assert "abgebrochen" in row and "the driver" not in row, row
    engineer.shoots("16_stopped_german", SHOTS)
    engineer.until(lambda: resets(engineer), 20.0, lambda: page.inner_text("#log"))
    engineer.sees("#chip-controller", "Bereit", within_s=20.0)
    engineer.leaves()
    return graph.scopes / "story_scope.yaml"


def outline_px(page: Any) -> Any:
    """Return the panel's outline as it is drawn over the picture, (N, 2) px."""
    drawn = str(page.get_attribute(".layer-outline .over", "d"))
    return np.array([float(number) for number in re.findall(r"-?[\d.]+", drawn)]).reshape(-1, 2)


def button_px(page: Any, name: str) -> tuple[float, float]:
    """Return the middle of a control in the picture."""
    read = "(button) => ['left', 'width', 'top', 'height'].map((side) => parseFloat(button.style[side]) / 100)"
    left, width, top, height = page.locator(f"#controls [data-control={name}]").evaluate(read)
    return (left + width / 2) * 1280, (top + height / 2) * 720


def points_at(page: Any, u: float, v: float) -> None:
    """Click into the held picture."""
    page.locator("#held").scroll_into_view_if_needed()
    area = page.locator("#held").bounding_box()
    page.mouse.click(area["x"] + (u + 0.5) / 1280 * area["width"], area["y"] + (v + 0.5) / 720 * area["height"])


def replays(browser: Any, folder: Path, graph: RunningGraph, tmp_path: Path, taught: Path) -> None:
    # in a graph of its own, as a person would look at it later
    environment = graph.environment | {"ROS_DOMAIN_ID": str(domain_of_worker(100, 40))}
    with playing(environment, folder, tmp_path, []) as address:
        viewer = Operator(browser, address)
        viewer.sees_controls()
        viewer.sees("#banner", "REPLAY of a recorded session", within_s=15.0)
        assert viewer.page.is_hidden("#lease-take")
        viewer.until(lambda: viewer.page.is_hidden("#stale"), 5.0, lambda: viewer.page.inner_text("#stale"))
        viewer.page.wait_for_selector(".layer-path .over:not(.planned)", state="attached", timeout=60_000)
        viewer.logs("Go to.*(in progress|done)|move to .*(in progress|done)", 30.0)
        viewer.shoots("17_replayed", SHOTS)
        viewer.leaves()
    given = {"layout": taught, "template": taught.with_suffix(".png"), "template_px_per_mm": 4.0}
    again = ["--only", "recognition", "--set", f"ui_bridge.layout={taught}"]
    again += [word for name, value in given.items() for word in ("--set", f"recognition.{name}={value}")]
    with playing(environment, folder, tmp_path, again) as address:
        viewer = Operator(browser, address)
        viewer.page.wait_for_selector("[data-control=CH1]", timeout=60_000)
        assert viewer.page.locator("#controls button").count() == 4, "the controls that were taught"
        percent = re.findall(r"\d+ ?%", viewer.sees("#chip-recognition", r"\d+ ?%", within_s=20.0))
        print(f"the taught panel is recognised with {percent[0]}")
        viewer.shoots("18_taught_panel_recognised", SHOTS)
        viewer.leaves()


@contextlib.contextmanager
def playing(environment: dict[str, str], folder: Path, tmp_path: Path, more: list[str]) -> Iterator[str]:
    """Run the page on a bag and yield its address; with ``more`` programs nothing of the panel comes from the bag."""
    command = [executable("icu_bringup", "bring_up"), "--only", "ui_bridge", "--state", str(tmp_path), "--verbose"]
    command += ["--set", "ui_bridge.replay=true", "--set", "ui_bridge.port=0", *more]
    output = tmp_path / f"replay_{len(more)}.log"
    with output.open("wb") as out:
        started = [subprocess.Popen(command, env=environment, stdout=out, stderr=subprocess.STDOUT)]
    try:
        found = wait_for(lambda: re.findall(r"http://\S+\?token=\S+", output.read_text()), 30.0, "the page's address")
        play = [executable("icu_bringup", "bag_play"), str(folder), "--loop"]
        with BagReader(folder) as bag:
            play += ["--exclude", *(topic.name for topic in bag.topics if "/panel/" in topic.name)] if more else []
        quiet = subprocess.DEVNULL
        started.append(subprocess.Popen(play, env=environment, stdin=quiet, stdout=quiet))
        yield str(found[0])
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGINT)
            process.wait(20.0)
