"""What must be so wherever one is on the page: what is not seen as of now is told so, and Esc stops from anywhere."""

from __future__ import annotations

import signal

import pytest
from system.operator_browser import Operator
from system.test_operator_desk import instrument, operator
from system.test_operator_page import Instrument

__all__ = ["instrument", "operator"]  # fixtures
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300)]

# A sequence at work and what a calibration tells, as the bridge would send them.
_AT_WORK = """async () => {
  const { desk } = await import('/page/desk.js');
  const steps = ['press:MENU', 'press:SINGLE', 'press:SAVE'];
  const run = { name: 'capture', who: 'Ada', number: 2, status: 'accepted', reason: '', state: 'step 2 of 3' };
  const calibration = { rms_mm: '0.08', held_out_max_mm: '0.1', predicted_sigma_mm: '0.05' };
  const facts = { calibration, driver: { lines_sent: '17' } };
  desk.link.dispatchEvent(new CustomEvent('sequence', { detail: { sequence: { ...run, steps } } }));
  desk.link.dispatchEvent(new CustomEvent('facts', { detail: { facts } }));
}"""


def test_without_a_link_sequence_and_calibration_are_not_told_as_of_now(
    operator: Operator, instrument: Instrument
) -> None:
    page = operator.page
    signs = lambda steps: page.locator(f"{steps} li .icon").all_inner_texts()  # noqa: E731
    page.evaluate(_AT_WORK)
    page.click("#tab-sequence")
    operator.sees("#sequence-said", "Step 2 of 3 is at work. STOP ends the sequence")
    assert signs("#sequence-steps") == ["✓", "▶", "○"]
    page.click("#tab-calibrate")
    operator.sees("#calibration-text", "Calibrated – rms 0.08 mm")
    operator.sees("#guide-numbers", "measured 0.080 mm rms")
    assert signs("#panel-calibrate")[0] == "✓"
    instrument.bridge.send_signal(signal.SIGSTOP)
    try:
        operator.sees("#calibration-text", "^There is no link to the bridge.$")
        assert signs("#panel-calibrate") == ["?"] * 4
        assert page.inner_text("#guide-numbers") == page.inner_text("#camera-coverage") == ""
        assert page.locator("#panel-calibrate li .unseen").all_text_contents() == ["unknown"] * 4
        operator.shoots("calibrate_without_link")
        page.click("#tab-sequence")
        operator.sees("#sequence-said", "^There is no link to the bridge.$")
        assert signs("#sequence-steps") == ["✓", "?", "?"], "what was done is done"
        assert page.locator("#sequence-steps .unseen").all_text_contents() == ["done", "unknown", "unknown"]
        operator.sees("#lease-text", "^There is no link to the bridge.$")
        page.click("#tab-console")
        assert page.inner_text("#driver-facts") == ""
        operator.shoots("sequence_without_link")
    finally:
        instrument.bridge.send_signal(signal.SIGCONT)
    page.click("#tab-calibrate")
    operator.sees("#calibration-text", "Calibrated – rms 0.08 mm")
    operator.until(lambda: signs("#panel-calibrate")[0] == "✓", 20.0, lambda: page.inner_text("#panel-calibrate"))


def test_escape_stops_at_once_from_everywhere(operator: Operator) -> None:
    page, keyboard = operator.page, operator.page.keyboard
    stops: list[str] = []
    page.on("request", lambda request: stops.append(request.url) if "/stop?" in request.url else None)

    def new_stops() -> int:
        """Return how many were sent since the last look, once all that happened on the page has been told."""
        with page.expect_response("**/session"):
            page.evaluate("async () => { await fetch('/session'); }")
        found = len(stops)
        stops.clear()
        return found

    def escapes(where: str) -> None:
        keyboard.down("Escape")
        assert new_stops() == 1, f"{where}: when the key goes down"
        keyboard.up("Escape")
        assert new_stops() == 0, f"{where}: one press is one stop"

    operator.selects("CH1_SCALE", "Channel 1 scale")
    is_open = "(id) => document.getElementById(id).matches(':open')"
    for choice, tab in (
        ("chooser", "machine"),
        ("turn-degrees", "machine"),
        ("jog-step", "move"),
        ("sequence-check", "sequence"),
    ):
        page.click(f"#tab-{tab}")
        for opens in (lambda: page.click(f"#{choice}"), lambda: keyboard.press("Alt+ArrowDown")):  # noqa: B023
            page.focus(f"#{choice}")
            opens()
            operator.until(lambda: page.evaluate(is_open, choice), 15.0, lambda: f"{choice} is open")  # noqa: B023
            operator.shoots(f"open_{choice}")
            escapes(choice)
            operator.until(lambda: not page.evaluate(is_open, choice), 15.0, lambda: f"{choice} is shut")  # noqa: B023
            assert page.evaluate("document.activeElement.id") == choice
        page.click(f"#{choice}")
        box = page.locator("#stop").bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        assert new_stops() == 1, f"STOP beside the open {choice} is no click that only shuts it"
        page.mouse.up()
        assert new_stops() == 0
        if page.evaluate(is_open, choice):
            escapes(choice)
    for tab, field in (
        *(("machine", "log-search"), ("machine", "set-degrees"), ("machine", "click-count"), ("move", "go-x")),
        *(("sequence", "sequence-text"), ("sequence", "sequence-collect"), ("teach", "teach-name")),
    ):
        page.click(f"#tab-{tab}")
        page.focus(f"#{field}")
        if field != "sequence-collect":
            keyboard.type("1")
        escapes(field)
    page.click("#help-open")
    escapes("help")
    assert page.is_hidden("#help")
    operator.selects("SCREEN", "Screen|Point")
    page.focus("#draw-card summary")
    keyboard.press("Enter")
    escapes("details")
    # A browser that draws the list itself takes the press for its end, and lets the page know of its release alone.
    release = "new KeyboardEvent('keyup', { key: 'Escape', bubbles: true })"
    up = f"(id) => document.getElementById(id).dispatchEvent({release})"
    page.evaluate(up, "chooser")
    assert new_stops() == 1
    page.evaluate(up, "desk")
    assert new_stops() == 0, "a press that was meant for the browser, as for its search, is released anywhere"
    operator.hits("#reset")
    operator.sees("#chip-driver", "Idle")
