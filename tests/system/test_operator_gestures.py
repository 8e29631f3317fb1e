"""Every gesture, and sequences of them, from the page in a real browser."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest
from system.conftest import executable
from system.operator_browser import Operator
from system.test_operator_desk import axe, instrument, operator
from system.test_operator_page import Instrument

__all__ = ["instrument", "operator"]  # fixtures
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300)]


@pytest.fixture(autouse=True)
def _short(instrument: Instrument) -> None:
    instrument.tell("motion 0.3")


def clean(operator: Operator, name: str) -> None:
    """Look at it, and let axe-core look."""
    operator.shoots(name)
    assert axe(operator) == []


def test_a_button_is_pressed_twice_and_long(operator: Operator) -> None:
    operator.selects("MENU", "Menu")
    clean(operator, "gestures_button")
    for gesture, words in (("double", "Double press"), ("long", "Long press")):
        operator.confirms(gesture)
        operator.logs(f"{words} Menu.*done", 10.0)
    operator.selects("RUN_STOP", "Run / Stop")
    operator.sees("#selection-detail", "lamp green")
    operator.confirms()
    operator.sees("#selection-detail", "lamp off")
    operator.sees("[data-seen=RUN_STOP]", "lamp off")
    assert "lamp off" in str(operator.page.get_attribute("[data-control=RUN_STOP]", "aria-label"))


def test_a_knob_is_set_by_number_dial_and_clicks(operator: Operator) -> None:
    page = operator.page
    operator.selects("CH1_SCALE", "Channel 1 scale")
    operator.sees("#selection-detail", r"at \+10°")
    assert page.input_value("#set-degrees") == "10"
    page.fill("#set-degrees", "60")
    operator.confirms("set")
    operator.logs("Set to 60° Channel 1 scale.*done", 10.0)
    operator.sees("#selection-detail", r"at \+60°")
    area = page.locator("#dial").bounding_box()
    middle = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
    page.mouse.move(middle[0], middle[1] - 30)
    page.mouse.down()
    page.mouse.move(middle[0] + 30, middle[1], steps=4)
    page.mouse.up()
    assert page.input_value("#set-degrees") == "-90", "to the right is clockwise"
    clean(operator, "gestures_knob")
    operator.confirms("set")
    operator.sees("#selection-detail", r"at -90°")
    operator.confirms("turn")
    operator.sees("#selection-detail", r"at -75°")
    page.fill("#set-degrees", "200")
    operator.until(lambda: page.is_enabled("[data-act=set]"), 10.0, lambda: page.inner_text("#refusal"))
    page.click("[data-act=set]")
    operator.sees("#refusal", "set needs a marked position's name or degrees from -180 to 180, found '200.0'")


def test_a_line_is_drawn_clicked_and_given_by_numbers(operator: Operator) -> None:
    page = operator.page
    area = page.locator("#controls [data-control=SCREEN]").bounding_box()
    at = lambda x, y: (area["x"] + x * area["width"], area["y"] + y * area["height"])  # noqa: E731
    page.mouse.click(*at(0.5, 0.5))
    operator.sees("#selection-name", "Point on the panel")
    page.click("#draw")
    page.mouse.move(*at(0.25, 0.5))
    page.mouse.down()
    page.mouse.move(*at(0.5, 0.4), steps=3)
    operator.shoots("gestures_drawing")
    page.mouse.move(*at(0.75, 0.3), steps=3)
    page.mouse.up()
    operator.sees("#selection-name", "Line on the touch screen")
    clean(operator, "gestures_line")
    operator.confirms("drag")
    operator.logs(r"Draw \([\d.]+, [\d.]+\) → \([\d.]+, [\d.]+\) mm.*done", 10.0)

    page.click("#draw")
    operator.sees("#draw-hint", "where the line begins")
    page.mouse.click(*at(0.3, 0.6))
    operator.sees("#draw-hint", "where the line ends")
    page.mouse.click(*at(0.3, 0.2))
    operator.sees("#selection-detail", r"from \([\d.]+, [\d.]+\) to \([\d.]+, [\d.]+\) mm")

    page.keyboard.press("d")  # by keyboard alone
    page.keyboard.press("d")
    page.select_option("#chooser", "SCREEN")
    operator.sees("#selection-name", "Screen")
    page.focus("#draw-card summary")
    page.keyboard.press("Enter")
    assert float(page.input_value("#line-to_x_mm")) > float(page.input_value("#line-x_mm"))
    page.fill("#line-to_x_mm", "300")
    page.keyboard.press("Enter")
    operator.sees("#refusal", r"must stay on .*\(300, [\d.]+\) mm is beside it")
    page.fill("#line-to_x_mm", "120")
    page.keyboard.press("Enter")
    operator.sees("#selection-detail", r"to \(120, [\d.]+\) mm")
    operator.confirms("drag")
    operator.until(lambda: operator.page.inner_text("#last").startswith("✓"), 10.0, lambda: page.inner_text("#last"))


def test_gestures_by_touch_in_german_on_a_tablet(browser: Any, instrument: Instrument) -> None:
    view = {"width": 820, "height": 1180}
    operator = Operator(browser, instrument.new_address(), viewport=view, has_touch=True, color_scheme="dark")
    page = operator.page
    try:
        operator.takes_control()
        page.click("#language")
        page.tap("[data-control=CH1_SCALE]")
        operator.sees("#selection-name", "Channel 1 scale")
        clean(operator, "gestures_tablet_german")
        wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0, "nothing to scroll sideways"
        page.tap("[data-act=double]")
        operator.logs("Doppelt drücken.*erledigt", 10.0)
    finally:
        page.evaluate("localStorage.removeItem('language')")
        operator.context.close()


# --- sequences, with the real sequencer ---


@pytest.fixture
def sequencer(instrument: Instrument) -> Iterator[None]:
    names = ["-r", "__ns:=/gantry", "-r", "panel/state:=/panel/state"]
    program = [executable("gantry_driver", "sequencer"), "--ros-args", *names]
    running = subprocess.Popen(program, env=instrument.environment)
    try:
        yield
    finally:
        running.send_signal(signal.SIGINT)
        running.wait(10.0)


def begins(operator: Operator) -> None:
    """Start it with two clicks."""
    page = operator.page
    operator.until(lambda: page.is_enabled("#sequence-start"), 10.0, lambda: page.inner_text("#sequence-said"))
    page.click("#sequence-start")
    assert "Confirm: start" in page.inner_text("#sequence-start")
    page.click("#sequence-start")


def test_a_sequence_is_collected_followed_and_stopped(
    operator: Operator, instrument: Instrument, sequencer: None
) -> None:
    page = operator.page
    page.click("#tab-sequence")
    page.check("#sequence-collect")
    operator.selects("MENU", "Menu")
    operator.sees("#collecting", "move nothing")
    page.click("[data-act=double]")
    operator.selects("CH1_SCALE", "Channel 1 scale")
    page.fill("#set-degrees", "60")
    page.click("[data-act=set]")
    assert page.input_value("#sequence-text") == "double:MENU\nset:CH1_SCALE:60\n"
    assert "Double press" not in page.inner_text("#log"), "nothing was sent"
    steps = lambda state: page.locator(f"#sequence-steps [data-state={state}]").count()  # noqa: E731
    for _ in range(5):  # the sequencer may still be starting
        begins(operator)
        operator.logs(r"Sequence \(2\).*(in work|done|not sent)", 10.0)
        if "not sent" not in page.inner_text("#log tr >> nth=0"):
            break
    operator.sees("#sequence-said", "all 2 steps are done", within_s=20.0)
    assert steps("done") == 2
    operator.sees("[data-seen=CH1_SCALE]", r"at \+60°")

    page.fill("#sequence-text", "press:RUN_STOP => lamp:RUN_STOP=violet\npress:SAVE")
    begins(operator)
    operator.sees("#sequence-said", "ended. step 1 of 2, press:RUN_STOP: not seen in time: lamp:RUN_STOP=violet", 20.0)
    assert (steps("failed"), steps("waiting")) == (1, 1)
    operator.sees("#sequence-steps [data-state=failed]", "not seen in time")
    clean(operator, "sequence_failed")
    page.fill("#sequence-text", "press:RUN_STOP\npoke:SAVE")
    begins(operator)
    operator.sees("#refusal", "The sequence is wrong: step 2: gesture 'poke' is none of")

    instrument.tell("motion 8")
    page.fill("#sequence-text", "press:MENU\npress:SAVE")
    begins(operator)
    operator.sees("#sequence-said", "Step 1 of 2 is at work")
    operator.shoots("sequence_running")
    page.keyboard.press("Escape")
    operator.sees("#sequence-said", "ended. step 1 of 2, press:MENU: aborted: stopped: operator")
    instrument.tell("motion 0.3")
    page.click("[data-call=reset]")
    operator.sees("#chip-controller", "Ready")
    page.wait_for_timeout(500)
    assert "press:SAVE" not in page.inner_text("#log"), "nothing resumes by itself"
    page.reload()
    operator.sees_controls()
    page.click("#tab-sequence")
    operator.sees("#sequence-steps [data-state=failed]", "press:MENU")
