"""The page's other tools in a real browser: languages, zoom, comparing, moving, plots, search, and WCAG by axe-core."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import axe_playwright_python
import pytest
from system.operator_browser import Operator
from system.test_operator_page import PATIENT, Instrument

AXE = Path(axe_playwright_python.__file__).parent / "axe.min.js"
WCAG = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def instrument(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instrument]:
    made = Instrument(tmp_path_factory.mktemp("instrument"), PATIENT | {"token_role": "engineer"})
    made.tell("heartbeat_timeout 9")
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def operator(browser: Any, instrument: Instrument) -> Iterator[Operator]:
    person = Operator(browser, instrument.new_address())
    try:
        person.takes_control()
        yield person
        assert person.complaints == []
    finally:
        person.context.close()  # its page goes away, and with it the control


def axe(operator: Operator) -> list[str]:
    """Return what axe-core finds wrong: rule, and where.

    The size of the targets in the picture is the instrument's: for small controls WCAG 2.5.8 asks for an equivalent of
    full size, which the list of controls beside the picture is.
    """
    # Through the debugger, which the page's own security policy does not hinder.
    operator.page.evaluate(AXE.read_text() + "; null")
    found = operator.page.evaluate("(tags) => axe.run(document, {runOnly: tags})", WCAG)
    problems = []
    for violation in found["violations"]:
        places = [str(node["target"]) for node in violation["nodes"]]
        if violation["id"] == "target-size":
            places = [place for place in places if "data-control" not in place]
        problems += [f"{violation['id']}: {place}" for place in places]
    return problems


@pytest.mark.parametrize(("scheme", "size"), [("light", (1280, 800)), ("dark", (820, 1180))])
def test_axe_finds_nothing_in_any_tab(browser: Any, instrument: Instrument, scheme: str, size: tuple[int, int]) -> None:
    view = dict(zip(("width", "height"), size))
    address = instrument.new_address()
    stranger = Operator(browser, address.partition("?")[0], color_scheme=scheme, viewport=view)
    assert axe(stranger) == []
    stranger.leaves()
    operator = Operator(browser, address, color_scheme=scheme, viewport=view, has_touch=size[0] < 1000)
    try:
        operator.takes_control()
        operator.selects("CH1_SCALE", "Channel 1 scale")
        found = []
        for tab in ("machine", "move", "calibrate", "plots", "console"):
            operator.page.click(f"#tab-{tab}")
            found += [f"{tab}: {problem}" for problem in axe(operator)]
            operator.shoots(f"tab_{tab}_{scheme}")
        operator.page.click("#help-open")
        found += [f"help: {problem}" for problem in axe(operator)]
        operator.page.click("#help-close")
        operator.page.click("#freeze")
        found += [f"frozen: {problem}" for problem in axe(operator)]
        assert found == []
    finally:
        operator.context.close()


def test_the_page_speaks_german(operator: Operator) -> None:
    page = operator.page
    page.click("#language")
    operator.sees("#lease-text", "Sie bedienen")
    assert page.get_attribute("html", "lang") == "de"
    assert page.get_attribute("#tabs", "aria-label") == "Maschine, Fahren, Verläufe"
    assert "Drehknopf" in str(page.get_attribute("[data-control=CH1_SCALE]", "aria-label"))
    operator.selects("MENU", "Menu")
    operator.shoots("german")
    wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wide <= 0
    page.reload()
    operator.sees("#lease-text", "Niemand bedient|Sie bedienen")
    page.click("#language")
    operator.sees("#chip-driver", "Machine")
    operator.until(lambda: not page.is_hidden("#lease-take"), 5.0, lambda: page.inner_text("#lease-text"))
    page.click("#lease-take")
    operator.sees("#lease-text", "You are in control")


def test_zoom_pan_and_a_click_in_the_zoomed_picture(operator: Operator) -> None:
    page = operator.page
    stage = page.locator("#stage").bounding_box()
    page.mouse.move(stage["x"] + 0.64 * stage["width"], stage["y"] + 0.32 * stage["height"])
    page.mouse.wheel(0, -400)
    operator.sees("#zoom-fit", "272 %")
    before = page.locator("[data-control=RUN_STOP]").bounding_box()
    assert before["width"] > 40
    page.mouse.down()
    page.mouse.move(stage["x"] + 0.5 * stage["width"], stage["y"] + 0.4 * stage["height"], steps=5)
    page.mouse.up()
    after = page.locator("[data-control=RUN_STOP]").bounding_box()
    assert after["x"] - before["x"] == pytest.approx(-0.14 * stage["width"], abs=8)
    assert "Nothing" in page.inner_text("#selection-name"), "a drag selects nothing"
    operator.selects("RUN_STOP", "Run / Stop")
    page.keyboard.press("0")
    operator.sees("#zoom-fit", "100 %")


def test_the_picture_before_is_compared_and_nothing_moves_meanwhile(operator: Operator) -> None:
    page = operator.page
    assert not page.is_enabled("#compare")
    operator.selects("RUN_STOP", "Run / Stop")
    lit = operator.lit()
    operator.confirms()
    operator.logs("Press Run / Stop.*done", 10.0)
    operator.until(lambda: operator.lit() != lit, 5.0, lambda: "the button changes")
    page.click("#compare")
    assert page.input_value("#wipe") == "50"
    page.fill("#wipe", "100")
    green = page.evaluate(
        """() => { const c = document.getElementById('before');
            const b = document.querySelector('[data-control=RUN_STOP]').style;
            const x = parseFloat(b.left) / 100 * c.width, y = parseFloat(b.top) / 100 * c.height;
            return [...c.getContext('2d').getImageData(x + 8, y + 6, 1, 1).data]; }"""
    )
    assert (green[1] > 1.3 * max(green[0], green[2])) == lit, "the picture before is kept"
    assert not page.is_enabled("[data-act=press]")
    operator.sees("#refusal", "lies over the live one")
    page.click("#compare")
    operator.until(lambda: page.is_enabled("[data-act=press]"), 5.0, lambda: page.inner_text("#refusal"))
    with page.expect_download() as saved:
        page.click("#snapshot")
    assert re.fullmatch(r"picture_[\d_-]+\.png", saved.value.suggested_filename)
    assert Path(saved.value.path()).read_bytes().startswith(b"\x89PNG")


def test_the_log_is_searched_and_exported(operator: Operator) -> None:
    page = operator.page
    operator.selects("MENU", "Menu")
    operator.confirms()
    operator.logs("Press Menu.*done", 10.0)
    page.fill("#log-search", "menu")
    operator.sees("#log-found", r"\d+ of \d+")
    shown = page.locator("#log tr:visible").all_inner_texts()
    assert shown and all("Menu" in row for row in shown)
    with page.expect_download() as saved:
        page.click("#log-export")
    rows = list(csv.DictReader(io.StringIO(Path(saved.value.path()).read_text())))
    assert any((row["action"], row["target"], row["status"]) == ("press", "Menu", "reached") for row in rows)
    assert len(rows) > len(shown) - 1
    page.fill("#log-search", "")


def test_engineers_read_what_the_programs_say(operator: Operator, instrument: Instrument) -> None:
    page = operator.page
    page.click("#tab-console")
    page.click("#stop")
    operator.sees("#console-lines", r"warn ui_bridge: stop")
    page.click("#reset")
    operator.sees("#chip-driver", "Idle")
    page.click("#tab-calibrate")
    operator.sees("#guide-machine", "✓")


def test_outlines_are_seen_on_any_picture(operator: Operator, tmp_path: Path) -> None:
    """WCAG 1.4.11 on pixels: along each outline bright and dark lie side by side, at least 3:1 on any ground."""
    import cv2
    import numpy as np

    page = operator.page
    operator.selects("RUN_STOP", "Run / Stop")
    box = page.locator("#stage").bounding_box()
    path = tmp_path / "stage.png"
    page.screenshot(path=str(path), clip=box)
    picture = cv2.imread(str(path)).astype(float)[:, :, ::-1] / 255
    linear = np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)
    light = linear @ [0.2126, 0.7152, 0.0722]
    boxes = page.evaluate(
        """() => [...document.querySelectorAll('#controls button')].map((b) => ['left', 'top', 'width', 'height']
            .map((k) => parseFloat(b.style[k]) / 100))"""
    )
    height, width = light.shape
    for left, top, w, _ in boxes:
        x, y = round((left + w / 2) * width), round(top * height)
        across = light[max(y - 5, 0) : y + 6, x]
        assert (across.max() + 0.05) / (across.min() + 0.05) > 3, (x, y)
