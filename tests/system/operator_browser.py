"""A person at the operator page in a real browser, for tests and benchmarks.

Without a browser the tests are skipped with the reason; where ``CI`` is set they fail instead. Screenshots go to the
folder named by ``PAGE_SCREENSHOTS``; those of the whole story always to a folder.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
PROGRAMS = ("chromium-headless-shell", "chromium")
"""The first draws no window of its own around the page, and takes a quarter less time."""
PICTURE_MS = 60_000


def _unavailable(reason: str) -> None:
    if os.environ.get("CI"):
        pytest.fail(f"{reason} (CI is set, so the page must be tested)")
    pytest.skip(reason)


def browser_program() -> str | None:
    """Return the path of the browser, or None."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    program = browser_program()
    if program is None:
        _unavailable(f"no browser: neither {' nor '.join(PROGRAMS)} is installed")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _unavailable("no browser: the python package playwright is not installed")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        yield running
        running.close()


# How many answers the page has had, once it has had those to all that it has asked for.
_ANSWERS = """async () => {
    const { desk } = await import("/page/connection/desk.js");
    await desk.link.ask("jog", { dx: 0, dy: 0, step_mm: 1, ...desk.seen }); // lets go of what nobody holds
    if (!desk.answers) {
        desk.answers = [];
        const report = desk.report;
        desk.report = (answer) => {
            desk.answers.push(answer);
            return report.call(desk, answer);
        };
    }
    return desk.answers.length;
}"""


class Operator:
    """A person at the page: what they see and do, by the words on the screen."""

    def __init__(self, browser: Any, address: str, **context: Any) -> None:
        self.context = browser.new_context(**{"viewport": {"width": 1280, "height": 800}, **context})
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.rows_before: set[str] | None = None
        """Rows of the log from before this person took control, others' among them."""
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda m: self.complaints.append(m.text) if "Security" in m.text else None)
        self.page.goto(address)

    def hears(self, kind: str, told: dict[str, Any]) -> None:
        """Put what is in ``told`` at the time into all messages of a kind that the page gets, from its next load on."""

        def control(route: Any) -> None:
            server = route.connect_to_server()

            def passed_on(text: str) -> None:
                message = json.loads(text)
                route.send(json.dumps(message | told) if message["type"] == kind else text)

            route.on_message(server.send)
            server.on_message(passed_on)

        self.page.route_web_socket(re.compile("/control$"), control)

    def sees(self, selector: str, text: str | re.Pattern[str], within_s: float = 20.0) -> str:
        """Wait until the element's text contains ``text``, and return it as it was then: it may change at any time."""
        shown = ""

        def found() -> Any:
            nonlocal shown
            shown = str(self.page.inner_text(selector))
            return re.search(text, shown)

        self.until(found, within_s, lambda: f"{selector} shows {shown!r}, {text!r} is awaited")
        return shown

    def until(self, condition: Callable[[], Any], within_s: float, what: Callable[[], str]) -> Any:
        deadline = time.monotonic() + within_s
        while True:
            late = time.monotonic() > deadline  # who was held up looks once more
            if value := condition():
                return value
            if late:
                pytest.fail(f"not within {within_s:g} s: {what()}")
            self.page.wait_for_timeout(20)  # allows the browser's events

    def sees_controls(self) -> None:
        self.page.wait_for_selector("[data-control=RUN_STOP]", timeout=PICTURE_MS)

    def reads(self, language: str) -> None:
        """Have the page in a language."""
        if self.page.get_attribute("html", "lang") != language:
            self.page.click("#language", timeout=5000)

    def takes_control(self) -> None:
        self.sees_controls()
        self.page.click("#lease-take")
        self.sees("#lease-text", "You are in control")
        if self.rows_before is None:
            self.rows_before = set(self.page.locator("#log tr").all_inner_texts())

    def answer(self, act: Callable[[], object]) -> dict[str, Any] | None:
        """Do what asks the page or the bridge for something; return the answer to that: ``ok``, ``code``, ``values``.

        The page's text may be the answer to an earlier action, and disappears after a second. Such an answer may even
        be in transit still, because its result is sent before it: the bridge answers one after the other. None is
        returned where nothing was asked for, as by a click on a button that was switched off at that very moment.
        """
        before = self.page.evaluate(_ANSWERS)
        act()
        if self.page.evaluate(_ANSWERS) == before:
            return None
        newest = f"({{ desk }}) => desk.answers[{before}]"
        return dict(self.page.evaluate(f"import('/page/connection/desk.js').then({newest})"))

    def insists(self, act: Callable[[], object], wanted: str = "") -> None:
        """Do it again until its answer has the code ``wanted``, or is no refusal.

        A picture, or the bridge, that happened to be late is refused as well, for as long as it is. An order that must
        be rejected must not be carried out once.
        """
        answer: dict[str, Any] | None = None

        def answered() -> bool:
            nonlocal answer
            if answer is not None:
                self.page.wait_for_timeout(100)
            answer = self.answer(act)
            if wanted and answer is not None and answer["ok"]:
                pytest.fail(f"{wanted} is awaited, and it was done")
            return answer is not None and str(answer.get("code", "")) == wanted

        self.until(answered, 20.0, lambda: f"{wanted or 'no refusal'} is awaited, not {answer}")

    def selects(self, control: str, label: str) -> None:
        """Click the control; again when the picture happened to be late."""
        self.insists(lambda: self.page.click(f"[data-control={control}]"))
        self.sees("#selection-name", label)

    def hits(self, button: str) -> None:
        """Click a button once it is on."""
        why = lambda: f"off: {self.page.inner_text('#selection-card')!r}"  # noqa: E731
        self.until(lambda: self.page.is_enabled(button), 20.0, why)
        self.page.click(button)

    def confirms(self, gesture: str = "press") -> None:
        """Press the button; again when the picture happened to be late."""
        rows = self.page.locator("#log tr:not(.nothing)")
        before = rows.count()
        self.insists(lambda: self.hits(f"[data-act={gesture}] >> nth=0"))
        self.until(lambda: rows.count() > before, 15.0, lambda: "a row of the log")

    def logs(self, text: str, within_s: float) -> str:
        """Wait for a row of the log that matches, and is not from before this person took control; return it."""

        def row() -> str:
            rows = (r for r in self.page.locator("#log tr").all_inner_texts() if r not in (self.rows_before or ()))
            return next((r for r in rows if re.search(text, r)), "")

        return str(self.until(row, within_s, lambda: f"log row {text!r}; there are {self.page.inner_text('#log')!r}"))

    def colour_of(self, control: str) -> tuple[float, float, float]:
        """Return mean red, green, blue of the control in the live picture."""
        mean = self.page.evaluate(
            """(name) => {
                const canvas = document.getElementById('picture');
                const button = document.querySelector(`[data-control=${name}]`);
                const [x, y, w, h] = ['left', 'top', 'width', 'height'].map((k, i) =>
                    parseFloat(button.style[k]) / 100 * (i % 2 ? canvas.height : canvas.width));
                const data = canvas.getContext('2d').getImageData(x + w / 4, y + h / 4, w / 2, h / 2).data;
                const sum = [0, 0, 0];
                for (let i = 0; i < data.length; i += 1) if (i % 4 < 3) sum[i % 4] += data[i];
                return sum.map((s) => s / (data.length / 4));
            }""",
            control,
        )
        return (mean[0], mean[1], mean[2])

    def lit(self) -> bool:
        """Return whether RUN/STOP is green."""
        red, green, blue = self.colour_of("RUN_STOP")
        return green > 1.3 * max(red, blue)

    def picture_sum(self) -> int:
        """Return a checksum of the live picture's pixels."""
        return int(
            self.page.evaluate(
                """() => { const c = document.getElementById('picture');
                    const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
                    let s = 0; for (let i = 0; i < d.length; i += 1) s = (s * 31 + d[i]) | 0; return s; }"""
            )
        )

    def shoots(self, name: str, folder: Path | None = None) -> None:
        folder = folder or os.environ.get("PAGE_SCREENSHOTS")
        if folder:
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=str(Path(folder) / f"{name}.png"))

    def counts_stops(self) -> Callable[[], int]:
        """Return a function for the number of stops since its last call, once the page has received all earlier
        ones."""
        page, stops = self.page, list[str]()
        page.on("request", lambda request: stops.append(request.url) if "/stop?" in request.url else None)

        def new_stops() -> int:
            with page.expect_response("**/session"):
                page.evaluate("async () => { await fetch('/session'); }")
            found = len(stops)
            stops.clear()
            return found

        return new_stops

    def leaves(self) -> None:
        assert self.complaints == []
        self.context.close()
