"""Every gesture from the page in a real browser: presses, clicks and positions of a knob, lines on the touch screen."""

from __future__ import annotations

from typing import Any

import pytest
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
