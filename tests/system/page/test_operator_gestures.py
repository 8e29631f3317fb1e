"""Every gesture, sequences of them, and the teaching of a panel, from the page in a real browser."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from system.conftest import executable
from system.operator_browser import Operator
from system.page_instrument import Instrument
from system.page_rig import axe, instrument, operator
from system.synthetic_scope import LAYOUT, camera, panel_pose

from icu_common.core.panel.panel_layout import load_layout

__all__ = ["instrument", "operator"]  # fixtures
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300), pytest.mark.long]


@pytest.fixture(autouse=True)
def _short(instrument: Instrument) -> None:
    instrument.tell("motion 0.3")


@pytest.fixture
def person(operator: Operator) -> Iterator[Operator]:
    """An operator in control who leaves the machine ready for the next one."""
    yield operator
    operator.sees("#chip-driver", "Idle")
    operator.sees("#chip-controller", "Ready")


def clean(operator: Operator, name: str) -> None:
    """Look at it, and let axe-core look."""
    operator.shoots(name)
    assert axe(operator) == []


def test_a_button_is_pressed_twice_and_long(person: Operator) -> None:
    person.selects("MENU", "Menu")
    clean(person, "gestures_button")
    for gesture, words in (("double", "Double press"), ("long", "Long press")):
        person.confirms(gesture)
        person.logs(f"{words} Menu.*done", 20.0)
    person.page.select_option("#hold-seconds", "1")
    person.confirms("hold")
    person.logs("Hold 1 s Menu.*done", 20.0)
    person.selects("RUN_STOP", "Run / Stop")
    person.sees("#selection-detail", "lamp green")
    person.confirms()
    person.sees("#selection-detail", "lamp off")
    person.sees("[data-seen=RUN_STOP]", "lamp off")
    assert "lamp off" in str(person.page.get_attribute("[data-control=RUN_STOP]", "aria-label"))


def test_a_knob_is_set_by_number_dial_and_clicks(person: Operator, instrument: Instrument) -> None:
    page = person.page
    instrument.tell("unread 1")
    marker = lambda: page.locator("[data-seen=TIME_SCALE]").count()  # noqa: E731
    person.until(lambda: not marker(), 20.0, lambda: page.inner_text("#seen"))
    person.selects("TIME_SCALE", "Time scale")
    assert page.input_value("#set-degrees") == "", "nobody knows where it stands, so nothing is proposed"
    instrument.tell("unread 0")
    person.until(marker, 20.0, lambda: page.inner_text("#seen"))
    person.selects("CH1_SCALE", "Channel 1 scale")
    person.sees("#selection-detail", r"at \+10°")
    assert page.input_value("#set-degrees") == "10"
    page.fill("#set-degrees", "60")
    field = page.locator("#set-degrees").bounding_box()
    page.mouse.move(field["x"] + 20, field["y"] + 20)
    page.mouse.wheel(0, 40)  # to bring what is farther down into sight
    moved = lambda: page.locator("#set-degrees").bounding_box()["y"] < field["y"]  # noqa: E731
    person.until(moved, 20.0, lambda: f"the desk stands still, the field shows {page.input_value('#set-degrees')}")
    assert page.input_value("#set-degrees") == "60"
    person.confirms("set")
    person.logs("Set to 60° Channel 1 scale.*done", 20.0)
    person.sees("#selection-detail", r"at \+60°")
    area = page.locator("#dial").bounding_box()
    middle = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
    page.mouse.move(middle[0], middle[1] - 30)
    page.mouse.down()
    page.mouse.move(middle[0] + 30, middle[1], steps=4)
    page.mouse.up()
    assert page.input_value("#set-degrees") == "-90", "to the right is clockwise"
    clean(person, "gestures_knob")
    person.confirms("set")
    person.sees("#selection-detail", r"at -90°")
    person.confirms("turn")
    person.sees("#selection-detail", r"at -75°")
    page.fill("#set-degrees", "200")
    person.until(lambda: page.is_enabled("[data-act=set]"), 20.0, lambda: page.inner_text("#refusal"))
    page.click("[data-act=set]")
    person.sees("#refusal", "set needs a marked position's name or degrees from -180 to 180, found '200.0'")


def test_a_line_is_drawn_clicked_and_given_by_numbers(person: Operator) -> None:
    page = person.page
    area = page.locator("#controls [data-control=SCREEN]").bounding_box()
    at = lambda x, y: (area["x"] + x * area["width"], area["y"] + y * area["height"])  # noqa: E731
    page.mouse.click(*at(0.5, 0.5))
    person.sees("#selection-name", "Point on the panel")
    page.click("#draw")
    page.mouse.move(*at(0.25, 0.5))
    page.mouse.down()
    page.mouse.move(*at(0.5, 0.4), steps=3)
    person.shoots("gestures_drawing")
    page.mouse.move(*at(0.75, 0.3), steps=3)
    page.mouse.up()
    person.sees("#selection-name", "Line on the touch screen")
    clean(person, "gestures_line")
    person.confirms("drag")
    person.logs(r"Draw \([\d.]+, [\d.]+\) → \([\d.]+, [\d.]+\) mm.*done", 20.0)

    page.click("#draw")
    person.sees("#draw-hint", "where the line begins")
    page.mouse.click(*at(0.3, 0.6))
    person.sees("#draw-hint", "where the line ends")
    page.mouse.click(*at(0.3, 0.2))
    person.sees("#selection-detail", r"from \([\d.]+, [\d.]+\) to \([\d.]+, [\d.]+\) mm")
    page.focus("[data-control=SCREEN]")
    page.keyboard.press("Enter")  # a key has drawn nothing
    person.sees("#selection-name", "Screen")

    page.keyboard.press("d")  # by keyboard alone
    page.keyboard.press("d")
    # By its answer: the name is there already, and a new choice proposes its line once more.
    person.insists(lambda: page.select_option("#chooser", "SCREEN"))
    person.sees("#selection-name", "Screen")
    page.focus("#draw-card summary")
    page.keyboard.press("Enter")
    assert float(page.input_value("#line-to_x_mm")) > float(page.input_value("#line-x_mm"))
    page.fill("#line-to_x_mm", "300")
    page.keyboard.press("Enter")
    person.sees("#refusal", r"must stay on .*\(300, [\d.]+\) mm is off it")
    page.fill("#line-to_x_mm", "120")
    page.keyboard.press("Enter")
    person.sees("#selection-detail", r"to \(120, [\d.]+\) mm")
    person.confirms("drag")
    person.until(lambda: person.page.inner_text("#last").startswith("✓"), 20.0, lambda: page.inner_text("#last"))


def test_gestures_by_touch_in_german_on_a_tablet(browser: Any, instrument: Instrument) -> None:
    view = {"width": 820, "height": 1180}
    operator = Operator(browser, instrument.new_address(), viewport=view, has_touch=True, color_scheme="dark")
    page = operator.page
    try:
        operator.takes_control()
        page.click("#language")
        page.tap("[data-control=CH1_SCALE]")
        operator.sees("#selection-name", "Channel 1 scale")
        page.hover("[data-control=CH1_SCALE]")  # nor does it cover a part of its neighbour then
        clean(operator, "gestures_tablet_german")
        wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0, "nothing to scroll sideways"
    finally:
        page.evaluate("localStorage.removeItem('language')")
        operator.context.close()


def test_two_fingers_in_the_picture_zoom_it_and_leave_stop_in_sight(browser: Any, instrument: Instrument) -> None:
    view = {"width": 820, "height": 1180}
    operator = Operator(browser, instrument.new_address(), viewport=view, has_touch=True, is_mobile=True)
    page = operator.page
    try:
        operator.takes_control()
        stage = page.locator("#stage").bounding_box()
        u, v = stage["x"] + 0.5 * stage["width"], stage["y"] + 0.5 * stage["height"]
        fingers = operator.context.new_cdp_session(page)

        def touch(kind: str, *apart: float) -> None:
            points = [{"x": u + side * px, "y": v, "id": side + 1} for side, px in zip((-1, 1), apart)]
            fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        def pinch(begin: float, end: float) -> float:
            touch("touchStart", begin)
            touch("touchStart", begin, begin)
            for px in np.linspace(begin, end, 20):
                touch("touchMove", px, px)
            touch("touchEnd")
            return float(page.inner_text("#zoom-fit").removesuffix(" %"))

        operator.until(lambda: pinch(40, 120) > 200, 20.0, lambda: page.inner_text("#zoom-fit"))
        seen = page.evaluate("[visualViewport.scale, visualViewport.offsetLeft, visualViewport.offsetTop]")
        assert seen == [1, 0, 0], "a page that is zoomed as a whole shows STOP no more"
        assert "Nothing" in page.inner_text("#selection-name")
        pulled = "getComputedStyle(document.documentElement).overscrollBehaviorY"
        assert page.evaluate(pulled) == "none", "a pull would load the page anew"
        operator.until(lambda: pinch(120, 40) == 100, 20.0, lambda: page.inner_text("#zoom-fit"))
    finally:
        operator.context.close()


# --- sequences, with the real sequencer ---


@pytest.fixture
def sequencer(instrument: Instrument) -> Iterator[None]:
    names = ["-r", "__ns:=/gantry", "-r", "panel/state:=/panel/state"]
    program = [executable("gantry_driver", "sequencer"), "--ros-args", *names, "-p", "check_s:=0.5"]
    running = subprocess.Popen(program, env=instrument.environment)
    try:
        yield
    finally:
        running.send_signal(signal.SIGINT)
        running.wait(60.0)


def begins(operator: Operator, refusal: str = "") -> None:
    """Start it with two clicks; again while the bridge and the sequencer have not found each other yet."""
    page = operator.page
    rows = page.locator("#log tr:not(.nothing)")

    def twice() -> None:
        operator.until(lambda: page.is_enabled("#sequence-start"), 60.0, lambda: page.inner_text("#sequence-said"))
        page.click("#sequence-start")
        assert "Confirm: start" in page.inner_text("#sequence-start")
        page.click("#sequence-start")

    for _ in range(10):
        before = rows.count()
        operator.insists(twice, refusal)
        if refusal:
            return
        operator.until(lambda before=before: rows.count() > before, 15.0, lambda: "a row of the log")
        operator.until(lambda: "… sent" not in rows.first.inner_text(), 15.0, lambda: rows.first.inner_text())
        if not re.search("no (sequencer|gantry controller) listens", rows.first.inner_text()):
            return


def test_a_sequence_is_collected_followed_and_stopped(
    person: Operator, instrument: Instrument, sequencer: None
) -> None:
    page = person.page
    page.click("#tab-sequence")
    page.check("#sequence-collect")
    rows = page.locator("#log tr").count()
    person.selects("MENU", "Menu")
    person.sees("#collecting", "move nothing")
    page.click("[data-act=double]")
    page.click("#tab-machine")  # to see the lamps; what was chosen holds there, too
    person.selects("CH1_SCALE", "Channel 1 scale")
    person.sees("#collecting", "move nothing")
    page.fill("#set-degrees", "60")
    page.click("[data-act=set]")
    page.click("#tab-sequence")
    assert page.input_value("#sequence-text") == "double:MENU\nset:CH1_SCALE:60\n"
    assert page.locator("#log tr").count() == rows, "nothing was sent"
    steps = lambda state: page.locator(f"#sequence-steps [data-state={state}]").count()  # noqa: E731
    begins(person)
    person.sees("#sequence-said", "all 2 steps are done", within_s=20.0)
    assert steps("done") == 2
    person.sees("[data-seen=CH1_SCALE]", r"at \+60°")

    page.fill("#sequence-text", "press:RUN_STOP => lamp:RUN_STOP=violet\npress:SAVE")
    begins(person)
    person.sees("#sequence-said", "ended. step 1 of 2, press:RUN_STOP: not seen in time: lamp:RUN_STOP=violet", 20.0)
    assert (steps("failed"), steps("waiting")) == (1, 1)
    person.sees("#sequence-steps [data-state=failed]", "not seen in time")
    clean(person, "sequence_failed")
    page.fill("#sequence-text", "press:RUN_STOP\npoke:SAVE")
    begins(person, "sequence_wrong")
    person.sees("#refusal", "The sequence is wrong: step 2: gesture 'poke' is none of")

    instrument.tell("motion 60")
    page.fill("#sequence-text", "press:MENU\npress:SAVE")
    begins(person)
    person.sees("#sequence-said", "Step 1 of 2 is running")
    person.shoots("sequence_running")
    page.keyboard.press("Escape")
    person.sees("#sequence-said", "ended. step 1 of 2, press:MENU: aborted: stopped: operator")
    instrument.tell("motion 0.3")
    page.click("[data-call=reset]")
    person.sees("#chip-controller", "Ready")
    page.wait_for_timeout(500)
    assert "Press Save" not in page.inner_text("#log"), "nothing resumes by itself"
    assert "sent the sequence of 2 steps" in page.evaluate(_SENT)
    page.reload()
    person.sees_controls()
    page.click("#tab-sequence")
    person.sees("#sequence-steps [data-state=failed]", "press:MENU")


# Text about a sequence that the sequencer has not reported yet.
_SENT = """async () => {
  const { renderSequence, setSequence } = await import('/page/orders/sequence.js');
  setSequence({ name: '', status: 'sent', number: 0, steps: ['press:MENU', 'press:SAVE'], reason: '', state: 'idle' });
  renderSequence();
  return document.getElementById('sequence-said').textContent;
}"""


def test_a_confirmation_starts_only_the_sequence_that_it_was_asked_for(person: Operator, sequencer: None) -> None:
    page = person.page
    page.click("#tab-sequence")
    rows = page.locator("#log tr").count()
    page.fill("#sequence-text", "press:MENU")
    person.until(lambda: page.is_enabled("#sequence-start"), 60.0, lambda: page.inner_text("#sequence-said"))
    page.click("#sequence-start")
    person.sees("#sequence-start", "Confirm: start 1 step")
    page.evaluate("""() => {
        const event = new MouseEvent('click', { bubbles: true, detail: 1 });
        Object.defineProperty(event, 'timeStamp', { value: performance.now() - 2000 });
        document.getElementById('sequence-start').dispatchEvent(event);
    }""")  # it waited while the page was held up, and was made before the page has asked
    person.sees("#sequence-start", "Confirm: start 1 step")
    page.fill("#sequence-text", "press:RUN_STOP\npress:SAVE")
    page.click("#sequence-start")
    person.sees("#sequence-start", "Confirm: start 2 steps")
    page.fill("#sequence-text", "press:RUN_STOP")
    person.sees("#sequence-start", "^Start 1 step$")
    assert page.locator("#log tr").count() == rows, "nothing was sent"


def test_steps_that_were_written_are_back_after_a_reload_and_start_nothing(
    person: Operator, instrument: Instrument, sequencer: None
) -> None:
    page = person.page
    rows = page.locator("#log tr:not(.nothing)").count()
    page.click("#tab-sequence")
    page.fill("#sequence-text", "press:MENU => effect\n")
    page.check("#sequence-collect")
    person.selects("RUN_STOP", "Run / Stop")
    person.until(lambda: page.is_enabled("[data-act=press]"), 20.0, lambda: page.inner_text("#refusal"))
    page.click("[data-act=press]")
    steps = "press:MENU => effect\npress:RUN_STOP\n"
    assert page.input_value("#sequence-text") == steps
    assert page.inner_text("#sequence-kept") == ""
    page.click("#sequence-start")
    person.sees("#sequence-start", "Confirm: start 2 steps")

    def comes_back(kept: str, tab: Any = page) -> None:
        tab.goto(page.url)
        field = lambda: tab.input_value("#sequence-text")  # noqa: E731
        person.until(lambda: "viewing" in tab.inner_text("#you"), 20.0, lambda: "the page is connected")
        person.until(lambda: field() == kept, 15.0, lambda: f"{field()!r}, {kept!r} is awaited")
        said = tab.text_content("#sequence-kept")
        note = r"Operator \d+ wrote these steps here \(\d\d:\d\d:\d\d\). Nothing starts by itself"
        assert bool(re.search(note, said)) == bool(kept), said

    comes_back(steps)
    person.takes_control()
    page.click("#tab-sequence")
    person.until(lambda: page.is_enabled("#sequence-start"), 60.0, lambda: page.inner_text("#sequence-said"))
    assert page.inner_text("#sequence-start") == "Start 2 steps", "the first click was for what was there then"
    assert not page.is_checked("#sequence-collect")
    assert page.locator("#log tr:not(.nothing)").count() == rows, "nothing was sent"
    clean(person, "sequence_back")
    # Another tab has what was written last; each keeps its own.
    other = page.context.new_page()
    comes_back(steps, other)
    other.click("#tab-sequence")
    other.fill("#sequence-text", "press:SAVE")
    person.until(lambda: other.inner_text("#sequence-kept") == "", 15.0, lambda: "what is new is not back")
    comes_back("press:SAVE", other)
    other.click("#tab-sequence")
    other.click("#sequence-clear")
    comes_back(steps)
    comes_back("", other)
    other.close()
    # Steps that were begun with them keep their marks after a reload, too.
    person.takes_control()
    page.click("#tab-sequence")
    page.fill("#sequence-text", "press:MENU\npress:RUN_STOP")
    begins(person)
    person.sees("#sequence-said", "all 2 steps are done", within_s=20.0)
    person.sees("#banner", "Ready")  # what still moves would be stopped
    comes_back("press:MENU\npress:RUN_STOP")
    assert page.locator("#sequence-steps [data-state=done]").count() == 2
    # At another robot behind the same address there are none, and what cannot be read holds nothing up.
    told = {"robot": "elsewhere/"}
    person.hears("hello", told)
    comes_back("")
    told.clear()
    comes_back("press:MENU\npress:RUN_STOP")
    for spoilt in ('{"text": 7, "at": 7}', "{"):
        page.evaluate(_SPOIL, spoilt)
        comes_back("")


# The stored steps change into other ones.
_SPOIL = """(change) => {
  for (const store of [sessionStorage, localStorage]) {
    store.setItem(Object.keys(store).find((key) => key.startsWith('steps')), change);
  }
}"""


# --- teaching, with the real recognition node ---


@pytest.fixture
def teacher(instrument: Instrument, tmp_path: Path) -> Iterator[Path]:
    """The folder that a recognition node writes into; it gets no live pictures here, only the held one."""
    folder = tmp_path / "scopes"
    names = ["-r", "__ns:=/panel", "-r", "camera_info:=/left/camera_info"]
    given = ["-p", f"layout:={LAYOUT}", "-p", f"teach_folder:={folder}"]
    program = [executable("harris_perception", "recognition"), "--ros-args", *names, *given]
    running = subprocess.Popen(program, env=instrument.environment)
    try:
        yield folder
    finally:
        running.send_signal(signal.SIGINT)
        running.wait(60.0)


def test_an_engineer_teaches_a_panel(person: Operator, teacher: Path) -> None:
    page, layout = person.page, load_layout(LAYOUT)

    def click(x_mm: float, y_mm: float) -> None:
        u, v = camera().project(panel_pose().apply(np.array([x_mm, y_mm, 0.0]) / 1000))[0]
        area = page.locator("#held").bounding_box()
        page.mouse.click(area["x"] + (u + 0.5) / 1280 * area["width"], area["y"] + (v + 0.5) / 720 * area["height"])

    page.click("#tab-teach")
    page.click("#teach-hold")
    person.sees("#teach-next", "Lower left")
    assert not page.is_enabled("[data-act=press]")
    for x, y in ((0, 0), (320, 0), (320, 150), (0, 150)):
        click(x, y)
    names = ("SCREEN", "RUN_STOP", "CH1_SCALE")
    for control in map(layout.control, names):
        page.fill("#teach-name", control.name)
        page.select_option("#teach-kind", control.kind)
        for field, value in (("w", control.size_mm[0]), ("h", control.size_mm[1]), ("z", control.height_mm)):
            page.fill(f"#teach-{field}", f"{value:g}")
        page.click("#teach-add button")
        person.sees("#teach-next", f"Click in the picture: {control.name}")
        click(*control.position_mm)
    person.sees("#teach-next", "Everything has its place")
    clean(person, "teach_pointed")
    assert "Nothing" in page.inner_text("#selection-name"), "a held picture selects nothing"
    page.fill("#teach-model", "Taught scope")
    page.fill("#teach-width", "320")
    page.fill("#teach-height", "150")
    page.click("#teach-write")
    person.sees("#teach-said", "Model: “Taught scope” cannot be used; .* as in pump_2")
    page.fill("#teach-model", "taught_scope")
    page.fill("#teach-controls li >> nth=1 >> input >> nth=0", "5")
    page.press("#teach-controls li >> nth=1 >> input >> nth=0", "Tab")
    deadline, said = time.monotonic() + 90.0, "no recognition is running"
    while "no recognition is running" in said:  # it may still be starting, and compiling where there is no cache yet
        assert time.monotonic() < deadline, said
        page.click("#teach-write")
        said = person.sees("#teach-said", "Nothing written: ", within_s=40.0)
        page.wait_for_timeout(200)
    assert "control 'RUN_STOP' at " in said and "reaches outside the panel 320 x 150 mm" in said
    assert not teacher.exists()
    page.click("#teach-controls li >> nth=1 >> button >> nth=0")
    click(*layout.control("RUN_STOP").position_mm)
    page.click("#teach-write")
    person.sees("#teach-said", "Written: .*taught_scope.yaml", within_s=30.0)
    assert f"--set recognition.template={teacher}/taught_scope.png" in page.inner_text("#teach-command")
    person.logs("Teach taught_scope.*done wrote", 15.0)
    person.shoots("teach_written")
    taught = load_layout(teacher / "taught_scope.yaml")
    for name in names:
        # The synthetic scope draws its controls on the face; a click on a picture of 844 px is half a pixel exact.
        assert taught.control(name).position_mm == pytest.approx(layout.control(name).position_mm, abs=0.6), name
    page.click("#tab-machine")
    person.selects("MENU", "Menu")
    person.until(lambda: page.is_enabled("[data-act=press]"), 15.0, lambda: page.inner_text("#refusal"))
