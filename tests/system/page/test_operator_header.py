"""The header of the page at every width: no state covers a link, a button or another state."""

from __future__ import annotations

from typing import Any

import pytest
from system.operator_browser import Operator
from system.page_instrument import Instrument
from system.page_rig import instrument

__all__ = ["instrument"]  # fixture
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300), pytest.mark.long]

WIDTHS = (360, 390, 640, 820, 1000, 1024, 1280, 1440, 1600, 1920)
SLOW = {"simulation_factor": 0.42}
STOPPED = {"driver": {"state": "stopped", "reason": ""}, "controller": {"state": "waiting", "reason": ""}}

# Each visible button and state of the header whose middle or corner is outside the window or under another element.
_COVERED = """() => {
  const parts = [...document.querySelectorAll('.top button, .top .chip')].filter((e) => e.checkVisibility());
  const covered = (e) => {
    const { left, right, top, bottom } = e.getBoundingClientRect();
    const corners = [left + 6, right - 6].flatMap((x) => [top + 6, bottom - 6].map((y) => [x, y]));
    return [[(left + right) / 2, (top + bottom) / 2], ...corners]
      .some(([x, y]) => !e.contains(document.elementFromPoint(x, y)));
  };
  return [parts.length, parts.filter(covered).map((e) => e.id || e.textContent)];
}"""
_RECORD = """async (running) => {
  const { desk } = await import('/page/connection/desk.js');
  (await import('/page/reports/recordings.js')).setRecordings(running);
  desk.changed();
}"""


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_slow_simulations_state_leaves_help_and_language_in_reach(
    browser: Any, instrument: Instrument, language: str
) -> None:
    operator = Operator(browser, instrument.new_address(), viewport={"width": 1440, "height": 900})
    page = operator.page
    told: dict[str, Any] = dict(SLOW)
    operator.hears("state", told)
    page.reload()
    operator.sees_controls()
    operator.reads(language)
    factor = "0.42 of real time" if language == "en" else "0,42 der Echtzeit"
    covered: list[str] = []
    for name, states, wanted in (("slow", SLOW, "✓"), ("stopped", SLOW | STOPPED, "■")):
        told.update(states)
        operator.sees("#chip-driver", wanted)
        for recording in (False, True):
            page.evaluate(_RECORD, [{"who": "Ada", "for_s": 3723, "at_least": False}] if recording else [])
            for width in WIDTHS:
                page.set_viewport_size({"width": width, "height": 900})
                page.evaluate("scrollTo(0, 0)")
                operator.sees("#chip-simulation", factor)
                count, found = page.evaluate(_COVERED)
                where = f"{width}_{name}_{'recording' if recording else 'idle'}"
                assert count >= 10, f"{where}: three links, STOP, and at least six states"
                covered += [f"{where}: {part}" for part in found]
                operator.shoots(f"header_{language}_{where}")
    assert "\n".join(covered) == ""
    operator.leaves()
