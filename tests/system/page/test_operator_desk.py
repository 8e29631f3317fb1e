"""The page's other tools in a real browser: languages, zoom, comparing, moving, plots, search, and WCAG by axe-core."""

from __future__ import annotations

import csv
import io
import json
import re
import signal
import subprocess
import time
import unicodedata
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from fluent.runtime import FluentBundle, FluentResource
from support.message_files import GRAPH, PAGE, constants, messages, values
from system.conftest import executable
from system.operator_browser import Operator
from system.page_instrument import Instrument
from system.page_rig import PERSON, axe, instrument, operator

from icu_common.core.reasons.catalogue import key_of
from icu_common.core.reasons.message import Message, joined, quoted, tree
from icu_common.core.reasons.state_text import because

__all__ = ["instrument", "operator"]  # fixtures
STARTS_S = 60.0  # on a loaded machine a program is long in starting, and in writing its last
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300), pytest.mark.long]


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
        for tab in ("machine", "move", "sequence", "calibrate", "plots", "teach", "console"):
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
    speaks_german_for_the_graph(operator)
    stranger = operator.context.browser.new_context(locale="de-DE")
    signs_in = stranger.new_page()
    signs_in.goto(page.url)
    operator.until(lambda: signs_in.title() == "Anmelden – Ferninstrument", 15.0, signs_in.title)
    stranger.close()
    wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wide <= 0
    page.reload()
    operator.sees("#lease-text", "Niemand bedient|Sie bedienen")
    page.click("#language")
    operator.sees("#chip-driver", "Machine")
    operator.until(lambda: not page.is_hidden("#lease-take"), 15.0, lambda: page.inner_text("#lease-text"))
    page.click("#lease-take")
    operator.sees("#lease-text", "You are in control")


def test_numbers_have_the_languages_decimal_sign_and_are_taken_with_either(
    operator: Operator, instrument: Instrument
) -> None:
    """A browser's own field of numbers makes 905 of 90,5 where its language has points."""
    page = operator.page
    instrument.tell("motion 0.3")
    page.click("#tab-move")
    page.click("#language")
    try:
        operator.sees("#position-x", r"^\d+,\d mm$")
        assert page.locator("#jog-step option").all_inner_texts() == ["0,1 mm", "1 mm", "5 mm", "10 mm"]
        for x, y in (("90,5", "40.2"), ("91.5", "41,2")):
            for field, typed in (("#go-x", x), ("#go-y", y)):
                page.fill(field, "")
                page.locator(field).press_sequentially(typed)
            page.press("#go-y", "Enter")
            place = f"({x}; {y})".replace(".", ",")
            operator.logs(rf"Fahren nach {re.escape(place)} mm.*erledigt", 15.0)
            operator.sees("#banner", "Bereit")
        page.focus("#go-x")
        page.keyboard.press("ArrowUp")
        assert page.input_value("#go-x") == "91,6"
        rows = page.locator("#log tr:not(.nothing)").count()
        for wrong in ("1000,5", "1.000,5", "9o", "-1"):
            page.fill("#go-x", wrong)
            page.press("#go-x", "Enter")
            said = page.eval_on_selector("#go-x", "(field) => field.validationMessage")
            assert said == "Bitte eine Zahl von 0 bis 1000."
        page.fill("#go-x", "90")
        assert page.eval_on_selector("#go-form", "(form) => form.checkValidity()")
        assert page.locator("#log tr:not(.nothing)").count() == rows, "nothing was sent"
        said = """async (text) => (await import("/page/language/said.js")).said(text)"""
        for text, german in (
            (tree(Message("wait.for_s", age_s=0.6)), "0,6 s"),
            ("press:0.120,0.080@base_link", "press:0.120,0.080@base_link"),
            ("at 10.0.0.5, GRBL 1.1h: $100=80.000", "at 10.0.0.5, GRBL 1.1h: $100=80.000"),
        ):
            assert german in page.evaluate(said, text)
    finally:
        page.click("#language")
    operator.sees("#position-x", r"^\d+\.\d mm$")


def test_what_is_shown_already_changes_its_language_too(operator: Operator, instrument: Instrument) -> None:
    page = operator.page
    instrument.tell("motion 0.3")
    operator.selects("MENU", "Menu")
    operator.confirms()
    operator.sees("#last", "done")
    page.click("#freeze")
    page.click("#stage", position={"x": 5, "y": 5})
    operator.sees("#refusal", "A kept picture")
    page.click("[data-call=home]")
    page.click("#tab-sequence")
    page.click("#language")
    operator.sees("#lease-text", "Sie bedienen")
    try:
        home = page.eval_on_selector("[data-call=home]", "(button) => ['armed' in button.dataset, button.textContent]")
        assert home in ([True, "Bestätigen: Fahrt"], [False, "Referenzfahrt"]), "it says what a click would do"
        assert page.title().endswith(" – Ferninstrument")
        operator.sees("#refusal", "Ein festgehaltenes Bild")
        operator.sees("#before-time", "davor ·")
        operator.sees("#last", "erledigt")
        assert page.inner_text("#sequence-choice option >> nth=0") == "– wie hier geschrieben –"
    finally:
        page.click("#language")
        page.click("#freeze")
        instrument.tell("motion 1.5")


_UNLIKE = [
    Message("sequence.unlike", check="lamp:RUN_STOP=red", instead=Message("panel.lamp", lamp="green")),
    Message("sequence.unlike", check="effect", instead=Message("effect.none_seen")),
]
# Messages of the controller, the driver and the others.
REASONS = {
    Message(
        "hold.driver_idle_needed", driver=quoted(because("stopped", Message("driver.stop_requested")))
    ): "der Treiber ist 'gestoppt: Stop verlangt', er muss ruhen",
    Message(
        "controller.machine_told_stop",
        cause=Message("inputs.lost_operator_no_heartbeat", age=Message("wait.for_s", age_s=0.62)),
    ): "Bediener verloren: seit 0,6 s kein Herzschlag; die Maschine soll anhalten",
    Message(
        "sequence.step_failed",
        number=2,
        steps=3,
        gesture="press:M",
        cause=Message("sequence.not_seen_time", missing=joined(_UNLIKE, "text.listed")),
    ): ("Schritt 2 von 3, press:M: nicht rechtzeitig zu sehen: lamp:RUN_STOP=red (Lampe grün), effect (keine gesehen)"),
    Message("board.lines_unanswered", reason="x", lost=1): "x; 1 Zeile unbeantwortet",
    Message("board.lines_unanswered", reason="x", lost=1200): "x; 1200 Zeilen unbeantwortet",
    "a text of a program that nobody knows: 3 of 4 (left)": "a text of a program that nobody knows: 3 of 4 (left)",
}


def german_sentences() -> dict[Message, str]:
    """Return a message for each code, and its German as Fluent's Python runtime writes it."""
    file = PAGE / "language" / "de.ftl"
    functions = {name: lambda value, **options: value for name in ("FIXED", "SHORT", "WORD")}
    bundle = FluentBundle(["de"], functions=functions, use_isolating=False)
    bundle.add_resource(FluentResource(file.read_text(encoding="utf-8")))
    graph = messages(GRAPH)
    codes = {text for text in constants() if key_of(text) in graph and "." in text}
    wanted = {}
    for code in codes:
        given = {name: f"<{name}>" for name in values(key_of(code), graph)}
        pattern = bundle.get_message(key_of(code)).value
        assert pattern is not None
        wanted[Message(code, **given)] = bundle.format_pattern(pattern, given)[0]
    return wanted


def speaks_german_for_the_graph(operator: Operator) -> None:
    say = "async (texts) => { const { said } = await import('/page/language/said.js'); return texts.map(said); }"
    wanted = {**REASONS, **german_sentences()}
    assert len(wanted) > 600
    assert dict(zip(wanted, operator.page.evaluate(say, [tree(text) for text in wanted]))) == wanted
    made = Message(
        "calibration.samples_rms_predicted",
        samples=24,
        where="",
        rms_mm=0.085,
        held="",
        sigma_mm=0.047,
        made_at="2026-07-04T02:32:13+00:00",
    )
    local = datetime(2026, 7, 4, 2, 32, 13, tzinfo=timezone.utc).astimezone()
    (german,) = operator.page.evaluate(say, [tree(made)])
    assert german == f"24 Stellen, rms 0,085 mm, vorhergesagt 0,047 mm, {local:%d.%m.%Y, %H:%M}", (
        "the time of the reader's clock"
    )
    other = tree(Message("goal.move", x=0.1, y=0.2, z=0.0, base="base_link"))
    others = "async (action) => (await import('/page/reports/command_log.js')).actionText({ action })"
    said = operator.page.evaluate(others, other)
    assert said == "fahren nach (0,1; 0,2; 0) m in base_link", "where somebody else's goal goes"
    target = "async (entry) => (await import('/page/reports/command_log.js')).targetText(entry)"
    for name in ("lamp", "constructor"):  # a key of the page's sentences, and one of every object
        assert operator.page.evaluate(target, {"action": "teach", "target": name}) == name, "a name is no sentence"
    press = {"action": "press", "target": "Menu", "reason": "", "error_mm": 0.05, "effect": ""}
    spoken = "async (entry) => (await import('/page/reports/command_log.js')).spoken(entry)"
    for more, german in (
        (
            {"status": "reached", "effect": tree(Message("effect.lamp", lamp="green", lamp_2="red"))},
            "Wirkung: Lampe grün -> rot.",
        ),
        ({"status": "reached", "effect": tree(Message("effect.none_seen"))}, "Wirkung: keine gesehen."),
        ({"status": "aborted", "reason": tree(Message("controller.no_reason_given"))}, "Ohne Grund"),
    ):
        assert operator.page.evaluate(spoken, press | more).endswith(f"gemessener Fehler 0,05 mm. {german}")
    closed = operator.page.evaluate(target, {"action": "stop", "target": "stopped_page_gone"})
    assert closed == "der Bediener hat die Seite geschlossen oder neu geladen"


def test_nothing_is_taken_for_a_confirmation_that_was_none(operator: Operator, instrument: Instrument) -> None:
    """A held key and a double click are one press, an empty field is no zero, a held picture is not the live one."""
    page = operator.page
    rows = page.locator("#log tr").count()
    page.focus("[data-control=CH1_SCALE]")
    page.keyboard.down("Enter")
    operator.sees("#selection-name", "Channel 1 scale")
    focused = lambda: page.evaluate("document.activeElement.dataset.act ?? ''")  # noqa: E731
    operator.until(lambda: focused() == "turn", 15.0, lambda: f"focus on {focused()!r}, not on Turn")
    for _ in range(3):
        page.keyboard.down("Enter")  # repeats, as a keyboard does while the key stays down
    page.keyboard.up("Enter")
    page.dblclick("[data-call=home]")
    assert page.inner_text("[data-call=home]") == "Confirm: home"
    for field, gesture in (("#set-degrees", "set"), ("#click-count", "click")):
        page.fill(field, "")
        page.click(f"[data-act={gesture}] >> nth=0")
        operator.sees("#refusal", "Enter a number first")
    page.click("#freeze")
    page.click("[data-control=MENU]")
    operator.sees("#refusal", "lies over the live one")
    assert page.inner_text("#selection-name") == "Channel 1 scale"
    page.click("#freeze")
    assert page.locator("#log tr").count() == rows, page.inner_text("#log")
    # A refusal during a command is not shown any more after it, if that was a second ago.
    instrument.tell("motion 60")
    operator.selects("RUN_STOP", "Run / Stop")
    operator.confirms()
    page.click("[data-control=CH1_IN]", force=True)
    operator.sees("#refusal", "connector; the stylus never touches connectors")
    operator.sees("#selection-name", "Nothing selected")
    page.wait_for_timeout(1000)
    instrument.tell("motion 0.3")
    operator.sees("#last", "Press Run / Stop: done")
    operator.until(lambda: not page.inner_text("#refusal"), 15.0, lambda: page.inner_text("#refusal"))
    # A page that is closed or reloaded is not a hidden one; STOP, and nothing else, is hit while the help is open.
    operator.selects("MENU", "Menu")
    instrument.tell("motion 60")
    operator.confirms()
    operator.sees("#chip-driver", "Moving")
    page.reload()
    operator.logs("STOP.*the operator closed or reloaded the page", 20.0)
    instrument.tell("motion 1.5")
    operator.takes_control()
    page.keyboard.press("?")
    assert page.is_visible("#help")
    operator.shoots("help")
    box = page.locator("[data-call=enable]").bounding_box()
    page.mouse.click(box["x"] + 5, box["y"] + 5)
    assert "Enable" not in page.inner_text("#log"), "what is shaded is not operated"
    box = page.locator("#stop").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    operator.logs(r"STOP\s*✓done\s*Operator", 15.0)
    page.click("#reset")
    operator.sees("#chip-driver", "Idle")


def test_a_choice_that_is_refused_is_not_shown_as_chosen_and_can_be_made_again(operator: Operator) -> None:
    page = operator.page
    page.click("#freeze")
    page.select_option("#chooser", "MENU")
    operator.sees("#refusal", "A kept picture")
    assert page.inner_text("#selection-name") == "Nothing selected"
    chosen = lambda: page.input_value("#chooser")  # noqa: E731
    operator.until(lambda: chosen() == "", 15.0, lambda: f"{chosen()!r} is shown as chosen")
    page.click("#freeze")
    page.focus("#chooser")
    # Key by key: the letters of a name count as one only while none is a second after the other.
    down = lambda: operator.answer(lambda: page.keyboard.press("ArrowDown"))  # noqa: E731
    operator.until(lambda: down() and chosen() == "MENU", 60.0, lambda: f"{chosen()!r} is shown as chosen")
    operator.sees("#selection-name", "Menu")
    assert chosen() == "MENU"
    page.click("#lease-release")
    operator.sees("#selection-name", "Nothing selected")
    page.select_option("#chooser", "MENU")
    operator.sees("#refusal", "Take control first")
    operator.until(lambda: chosen() == "", 15.0, lambda: f"{chosen()!r} is shown as chosen")


def test_single_keys_are_typed_in_any_way_and_can_be_switched_off(operator: Operator) -> None:
    page = operator.page
    typed = "(keys) => document.body.dispatchEvent(new KeyboardEvent('keydown', {key: '[', bubbles: true, ...keys}))"
    altgr = {"ctrlKey": True, "altKey": True, "modifierAltGraph": True}
    turned = page.locator("#log tr", has_text="Turn")
    done = turned.filter(has_text="done")
    for keys, turns in (({}, True), (altgr, True), ({"altKey": True}, True), ({"ctrlKey": True}, False)):
        operator.selects("CH1_SCALE", "Channel 1 scale")
        operator.until(lambda: page.is_enabled("[data-act=turn]"), 15.0, lambda: page.inner_text("#refusal"))
        before = done.count()
        if not turns:
            page.evaluate(typed, keys)
            continue
        operator.insists(lambda keys=keys: page.evaluate(typed, keys))
        operator.until(lambda before=before: done.count() > before, 15.0, lambda: page.inner_text("#log"))
    assert turned.count() == done.count() == 3, "Ctrl is the browser's"
    page.click("#help-open")
    page.uncheck("#single-keys")
    page.click("#help-close")
    page.keyboard.press("+")
    page.keyboard.press("?")
    assert page.is_hidden("#help") and page.inner_text("#zoom-fit") == "100 %"
    page.reload()
    operator.takes_control()
    page.keyboard.press("?")
    assert page.is_hidden("#help"), "it is remembered"
    page.click("#help-open")
    page.check("#single-keys")
    page.click("#help-close")
    page.keyboard.press("?")
    assert page.is_visible("#help")
    page.click("#help-close")
    page.keyboard.press("Escape")
    operator.sees("#banner", "STOPPED", within_s=20.0)
    page.click("#reset")
    operator.sees("#chip-driver", "Idle")


def passing_on(routes: list[Any], hung: Callable[[], int]) -> Callable[[Any], None]:
    """Pass pictures on, but for the first connections: once these hang, they do so for ever."""

    def video(route: Any) -> None:
        routes.append(route)
        number, server = len(routes), route.connect_to_server()
        route.on_message(server.send)
        server.on_message(lambda m: route.send(m) if number > hung() else None)

    return video


def test_connections_that_hang_and_places_that_are_taken(browser: Any, instrument: Instrument) -> None:
    person = Operator(browser, instrument.new_address())
    page = person.page
    full = {"type": "answer", "seq": None, "ok": False, "code": "too_many_viewers", "values": {"limit": 24}}
    whole, hung = False, 0

    def control(route: Any) -> None:
        if whole:
            route.connect_to_server()
            lines.append(route)
            return
        route.send(json.dumps(full))
        route.close()

    lines: list[Any] = []
    pictures: list[Any] = []
    page.route_web_socket(re.compile("/control$"), control)
    page.route_web_socket(re.compile("/video$"), passing_on(pictures, lambda: hung))
    page.reload()
    person.sees("#banner", "Other viewers have all 24 places")
    whole = True
    person.sees_controls()
    person.sees("#banner", "Viewing")
    numbers = {"rms_mm": "0.051", "held_out_max_mm": "nan", "predicted_sigma_mm": "0.030"}
    for facts, done in ({}, "no"), ({"calibration": {**numbers, "held_out_max_mm": "0.1"}}, "yes"):
        lines[-1].send(json.dumps({"type": "facts", "facts": facts}))
        person.until(
            lambda done=done: page.get_attribute("#guide-result", "data-done") == done, 15.0, lambda done=done: done
        )
    lines[-1].send(json.dumps({"type": "facts", "facts": {"calibration": numbers}}))
    person.until(lambda: "checked – mm" in (page.text_content("#guide-numbers") or ""), 15.0, lambda: "a dash")
    assert page.get_attribute("#guide-result", "data-done") == "no", "nobody knows how good it is"
    lamp = re.findall("lamp (green|off)", person.sees("#seen", "lamp (green|off)"))[0]  # as a test before has left it
    whole, hung = False, len(pictures)
    page.route("**/stop*", lambda route: route.abort())
    lines[-1].close()
    person.sees("#banner", "No link to the bridge. This page’s STOP may not arrive")
    for part in ("driver", "controller", "calibration", "recognition"):
        person.sees(f"#chip-{part}", "unknown")
        assert page.get_attribute(f"#chip-{part}", "data-look") == "none", "what was last heard may hold no more"
    assert page.inner_text("#position-x") == page.inner_text("#position-stylus") == "–"
    label = lambda: str(page.get_attribute("[data-control=RUN_STOP]", "aria-label"))  # noqa: E731
    assert (page.inner_text("#seen"), label()) == ("", "Run / Stop, Button"), "nor is a lamp lit that was lit then"
    assert page.inner_text("#seen-none") == "There is no link to the bridge."
    page.click("#tab-plots")
    person.sees("#plot-position .values", "X – · Y – · Stylus down – mm")
    page.click("#tab-machine")
    page.click("#stop")
    person.sees("#banner", "STOP has not got through. Use the wired emergency stop")
    page.unroute("**/stop*")
    page.click("#stop")
    whole = True
    person.sees("#banner", "STOPPED", within_s=30.0)
    person.until(lambda: len(pictures) > hung, 60.0, lambda: "the picture is asked for anew")
    before = person.picture_sum()
    person.until(lambda: person.picture_sum() != before, 20.0, lambda: "the picture is live again")
    person.sees("#seen", f"lamp {lamp}")
    assert label() == f"Run / Stop, Button, lamp {lamp}"
    page.click("#lease-take")
    person.until(lambda: page.is_enabled("#reset"), 15.0, lambda: page.inner_text("#lease-text"))
    page.click("#reset")
    person.sees("#chip-driver", "Idle")
    person.leaves()


def test_a_calibration_that_has_drifted_is_not_shown_as_good(browser: Any, instrument: Instrument) -> None:
    summary = Message(
        "calibration.samples_rms_predicted",
        samples=24,
        where="",
        rms_mm=0.08,
        held="",
        sigma_mm=0.05,
        made_at="2026-07-04T02:32:13+00:00",
    )
    drift = Message(
        "text.more",
        first=Message("drift.tip_seen_calibrated_place", tip_mm=3.1),
        second=Message("drift.camera_machine_moved_calibrate_again"),
    )
    drifted = Message("calibration.drifted", summary=summary, drift=drift)
    reasons = {"good": tree(summary), "waiting": tree(drifted)}
    words = {"en": {"good": "Calibrated", "waiting": "Drifted"}, "de": {"good": "Kalibriert", "waiting": "Verschoben"}}
    numbers = {"rms_mm": "0.051", "held_out_max_mm": "0.1", "predicted_sigma_mm": "0.030"}
    person = Operator(browser, instrument.new_address())
    page = person.page
    told: dict[str, Any] = {"calibration": {"state": "calibrated", "reason": reasons["good"]}}
    person.hears("state", told)
    page.reload()
    person.sees_controls()
    set_facts = "async (calibration) => (await import('/page/reports/guide.js')).setFacts({ calibration })"
    page.evaluate(set_facts, numbers)
    try:
        for language in words:
            for look, word in words[language].items():
                told["calibration"] = {"state": "calibrated", "reason": reasons[look]}
                person.sees("#chip-calibration dd", rf"{word}$")
                assert page.get_attribute("#chip-calibration", "data-look") == look
                whole = f"{word}: {page.evaluate(_SAID, reasons[look])}"
                assert page.get_attribute("#chip-calibration", "title") == whole
                done = {"good": "yes", "waiting": "no"}[look]
                person.until(lambda done=done: _done(page, "result") == done, 15.0, lambda: _done(page, "result"))
                assert _done(page, "run") == "yes", "it was made all the same"
                text = str(page.text_content("#calibration-text"))
                assert word in text
                assert page.evaluate(_SAID, reasons[look]) in text
            page.click("#language")
    finally:
        page.evaluate("localStorage.clear()")
    person.leaves()


_SAID = "async (text) => (await import('/page/language/said.js')).said(text)"


def _done(page: Any, step: str) -> str:
    return str(page.get_attribute(f"#guide-{step}", "data-done"))


def test_a_page_that_was_held_up_itself_looks_at_what_came_before_it_judges(
    browser: Any, instrument: Instrument
) -> None:
    """A frame begins 4 s late; whether messages or the frame come first then is else a matter of chance."""
    person = Operator(browser, instrument.new_address())
    page = person.page
    page.add_init_script("""{
        const draw = window.requestAnimationFrame.bind(window);
        window.requestAnimationFrame = (drawn) => draw(() => {
            const until = performance.now() + (window.heldUpMs ?? 0);
            if (window.heldUpMs) window.heldUps = (window.heldUps ?? 0) + 1;
            window.heldUpMs = 0;
            while (performance.now() < until);
            drawn(performance.now());
        });
    }""")
    page.reload()
    person.takes_control()
    connections: list[Any] = []
    page.on("websocket", lambda socket: connections.append(socket))
    page.evaluate("document.querySelector('[data-control=MENU]').click(); window.heldUpMs = 4000;")
    person.until(lambda: page.evaluate("window.heldUps"), 20.0, lambda: "a frame that takes long")
    person.sees("#selection-name", "Menu")
    person.sees("#banner", "Ready")
    assert page.inner_text("#refusal") == "", "the answer had come"
    assert "You are in control" in page.inner_text("#lease-text")
    assert connections == [], "the ones that there were live"
    person.leaves()


def test_what_was_pressed_while_the_page_was_held_up_is_not_done(operator: Operator) -> None:
    """No user expects it any more; the button may have another meaning than at the press."""
    page = operator.page
    rows = page.locator("#log tr:not(.nothing)")
    before = rows.count()
    page.evaluate("""() => { window.late = (kind, selector, ms = 5200, more = {}) => {
        const kinds = { click: MouseEvent, pointerdown: PointerEvent, keydown: KeyboardEvent };
        const event = new kinds[kind](kind, { bubbles: true, cancelable: true, detail: 1, ...more });
        Object.defineProperty(event, 'timeStamp', { value: performance.now() - ms });
        document.querySelector(selector).dispatchEvent(event);
    }; }""")
    presses = {
        "arrow": "late('keydown', 'body', 5200, { key: 'ArrowRight', shiftKey: true })",
        "control": "late('click', '[data-control=MENU]')",
        "enable": "late('click', '[data-call=enable]')",
    }
    for name, press in presses.items():
        page.evaluate("async () => { (await import('/page/connection/desk.js')).desk.refuse({ code: 'no_number' }); }")
        page.evaluate(press)
        said = operator.sees("#refusal", r"pressed 5\d\d\d ms ago, while the page was busy")
        assert "at most 4000 ms" in said, name
    assert page.inner_text("#selection-name") == "Nothing selected"
    # A second press from before the page has asked for it, though not long ago, is no answer to the question.
    page.evaluate("document.querySelector('[data-call=home]').click(); late('click', '[data-call=home]', 300)")
    assert page.inner_text("[data-call=home]") == "Confirm: home"
    page.keyboard.press("?")
    page.keyboard.press("Escape")
    operator.logs("STOP", 15.0)
    page.evaluate("late('click', '#lease-release')")
    operator.sees("#lease-text", "No operator has control")
    page.click("#lease-take")
    operator.sees("#lease-text", "You are in control")
    page.click("#reset")
    operator.sees("#chip-driver", "Idle")
    assert rows.count() == before + 2, f"STOP and reset alone; {page.inner_text('#log')}"


def test_an_arrow_that_was_let_go_while_the_page_was_held_up_begins_nothing_more(operator: Operator) -> None:
    """It is else a matter of chance whether the page first asks again or processes the key release when it
    continues."""
    page = operator.page
    page.click("#tab-move")
    operator.until(lambda: page.is_enabled("[data-jog='1,0']"), 15.0, lambda: page.inner_text("#move-why"))
    sent = page.evaluate("""async () => {
        const { desk } = await import('/page/connection/desk.js');
        const { ask } = desk.link;
        const asked = [];
        desk.link.ask = (type, fields) => asked.push(fields.dx) && ask.call(desk.link, type, fields);
        const key = (kind) => document.body.dispatchEvent(
            new KeyboardEvent(kind, { key: 'ArrowRight', shiftKey: true, bubbles: true }));
        key('keydown');
        const until = performance.now() + 500;
        while (performance.now() < until);
        return new Promise((resolve) => setTimeout(() => { // comes after what was due first
            key('keyup');
            desk.link.ask = ask;
            resolve(asked);
        }, 10));
    }""")
    assert sent == [1, 0], "asked for once, and let go"
    operator.logs(r"Move \+x.*done", 15.0)
    operator.sees("#banner", "Ready")


def test_answers_that_come_late_take_no_focus_and_an_end_that_was_missed_is_told(
    browser: Any, instrument: Instrument
) -> None:
    person = Operator(browser, instrument.new_address())
    page = person.page
    ends: list[Any] = []  # of each connection, the bridge's and the page's
    kept: list[str] = []
    keeps = False

    def control(route: Any) -> None:
        server = route.connect_to_server()
        ends.extend([server, route])
        route.on_message(server.send)
        late = lambda text: keeps and json.loads(text)["type"] == "answer"  # noqa: E731
        server.on_message(lambda text: kept.append(text) if late(text) else route.send(text))

    page.route_web_socket(re.compile("/control$"), control)
    page.reload()
    person.takes_control()
    person.sees("#banner", "Ready")
    keeps = True
    page.focus("[data-control=MENU]")
    page.keyboard.press("Enter")
    person.sees("#selection-name", "Menu")
    page.focus("#log-search")
    person.until(lambda: kept, 15.0, lambda: "the answer to the choice")
    keeps = False
    ends[-1].send(kept[-1])
    page.keyboard.press("Enter")
    page.evaluate("new Promise((resolve) => requestAnimationFrame(resolve))")
    assert page.evaluate("document.activeElement.id") == "log-search", "it has gone on to something else meanwhile"
    instrument.tell("motion 60")
    person.confirms()
    person.sees("#last", "Press Menu: in progress")
    for end in ends[-2:]:
        end.close()
    person.logs("Press Menu.*(aborted|stopped)", 20.0)
    person.sees("#last", "Press Menu: aborted")
    instrument.tell("motion 1.5")
    page.click("#lease-take")
    page.click("#reset")
    person.sees("#chip-driver", "Idle")
    person.leaves()


def test_the_picture_that_was_held_last_is_pointed_at_whichever_comes_last(operator: Operator) -> None:
    page = operator.page
    asked: list[Any] = []

    def picture(route: Any) -> None:
        asked.append(route)
        for width, late in zip((48, 32), reversed(asked)) if len(asked) == 2 else ():
            jpeg = cv2.imencode(".jpg", np.zeros((24, width, 3), np.uint8))[1].tobytes()
            late.fulfill(body=jpeg, content_type="image/jpeg")

    page.route("**/held.jpg*", picture)
    hold = """async (stamps) => {
        const { setHeld } = await import('/page/orders/teach.js');
        await Promise.all(stamps.map(([stamp, width]) => setHeld({ stamp, width, height: 24 })));
        return document.getElementById('held').width;
    }"""
    page.click("#tab-teach")
    assert page.evaluate(hold, [["1", 32], ["2", 48]]) == 48
    page.route("**/held.jpg*", lambda route: route.abort())
    assert page.evaluate(hold, [["3", 64]]) == 48
    operator.sees("#teach-said", "no longer held")


def test_a_picture_that_hangs_alone_stops_the_motion_and_comes_back(browser: Any, instrument: Instrument) -> None:
    person = Operator(browser, instrument.new_address())
    page = person.page
    connections: list[Any] = []
    hung = 0

    page.route_web_socket(re.compile("/video$"), passing_on(connections, lambda: hung))
    page.reload()
    person.takes_control()
    instrument.tell("motion 60")
    person.selects("MENU", "Menu")
    person.confirms()
    person.sees("#banner", "Moving")
    hung = 1000
    person.sees("#banner", "STOPPED", within_s=30.0)
    person.logs(r"STOP.*no new picture.*Watchdog", 15.0)
    person.sees("#lease-text", "You are in control")
    hung = len(connections)
    person.until(lambda: len(connections) > hung, 60.0, lambda: "the picture is asked for anew")
    before = person.picture_sum()
    person.until(lambda: person.picture_sum() != before, 20.0, lambda: "the picture is live again")
    instrument.tell("motion 1.5")
    page.click("#reset")
    person.sees("#chip-driver", "Idle")
    person.leaves()


SLOW_TO_DRAW = """
window.came = { left: 0, right: 0 };
window.atWork = 0;
let gate = Promise.resolve();
window.hold = () => {
  gate = new Promise((go) => (window.go = go));
};
const draw = createImageBitmap;
window.createImageBitmap = async (...picture) => {
  atWork += 1;
  await gate;
  atWork -= 1;
  return draw(...picture);
};
window.WebSocket = class extends WebSocket {
  constructor(address) {
    super(address);
    this.addEventListener("message", ({ data }) => {
      if (typeof data === "string") return;
      const about = new Uint8Array(data, 4, new DataView(data).getUint32(0));
      came[JSON.parse(new TextDecoder().decode(about)).camera] += 1;
    });
  }
};
"""


def test_the_outlines_are_those_of_the_camera_that_is_shown_also_when_pictures_are_passed_over(
    operator: Operator,
) -> None:
    page = operator.page
    page.add_init_script(SLOW_TO_DRAW)
    page.reload()
    operator.sees_controls()
    place = lambda: page.evaluate("document.querySelector('[data-control=RUN_STOP]').style.left")  # noqa: E731
    places = [place()]
    for camera in ("right", "left", "right", "left"):
        page.evaluate("hold()")
        operator.until(lambda: page.evaluate("atWork"), 20.0, lambda: "a picture is drawn")
        page.evaluate(f"came.{camera} = 0")
        page.click(f"[data-camera={camera}]")
        come = lambda camera=camera: page.evaluate(f"came.{camera}")  # noqa: E731
        operator.until(lambda come=come: come() > 1, 20.0, lambda: "two pictures, the first of which is passed over")
        page.evaluate("go()")
        operator.until(lambda: place() != places[-1], 20.0, lambda: f"the outlines are where they were: {places}")
        places.append(place())
    assert places[0] == places[2] == places[4] and places[1] == places[3]


def test_a_picture_that_was_long_on_its_way_is_shown_as_old_as_it_is(browser: Any, instrument: Instrument) -> None:
    """The connection of the images alone is slow, so that round trips on the other one do not show it."""
    person = Operator(browser, instrument.new_address())
    page = person.page
    on_their_way: list[tuple[float, Any, Any]] = []
    slow_s = 0.0

    def video(route: Any) -> None:
        server = route.connect_to_server()
        route.on_message(server.send)
        server.on_message(lambda m: on_their_way.append((time.monotonic() + slow_s, route, m)))

    def arrive() -> None:
        while on_their_way and on_their_way[0][0] <= time.monotonic():
            _, route, message = on_their_way.pop(0)
            route.send(message)

    def age_ms() -> int:
        arrive()
        shown = re.search(r"(\d+) ms", page.inner_text("#chip-video"))
        return int(shown[1]) if shown else -1

    page.route_web_socket(re.compile("/video$"), video)
    page.reload()
    person.until(lambda: 0 <= age_ms() < 700, 20.0, lambda: page.inner_text("#chip-video"))
    slow_s = 1.5
    person.until(lambda: age_ms() >= 1500, 20.0, lambda: page.inner_text("#chip-video"))
    end = time.monotonic() + 3.0
    ages: list[int] = []
    while time.monotonic() < end:
        ages.append(age_ms())
        page.wait_for_timeout(20)  # allows the browser's events
    assert min(ages) >= 1450, ages
    person.leaves()


def test_a_picture_from_before_the_computer_slept_is_not_shown_as_new(browser: Any, instrument: Instrument) -> None:
    """The page's clock is stopped then: to the page the bridge's clock jumps ahead at once."""
    person = Operator(browser, instrument.new_address())
    page = person.page
    slept_s, hangs, answers, at_most = 0.0, False, 0, 1e9

    def control(route: Any) -> None:
        def told(text: str) -> None:
            nonlocal answers
            message = json.loads(text)
            if message["type"] == "alive":
                if answers >= at_most:
                    return
                answers += 1
                message["bridge_ms"] += 1e3 * slept_s
            route.send(json.dumps(message))

        server = route.connect_to_server()
        route.on_message(server.send)
        server.on_message(told)

    def video(route: Any) -> None:
        server = route.connect_to_server()
        route.on_message(server.send)
        server.on_message(lambda message: None if hangs else route.send(message))

    page.route_web_socket(re.compile("/control$"), control)
    page.route_web_socket(re.compile("/video$"), video)
    page.reload()
    person.takes_control()
    person.sees("#banner", "Ready")
    person.until(lambda: answers >= 10, 15.0, lambda: "what the bridge's clock shows is known well")
    # Two seconds' answers must do: the clocks are known from those of the last five.
    hangs, slept_s, at_most = True, 60.0, answers + 10
    person.sees("#stale", r"6\d\.\d s")
    hangs, slept_s, at_most = False, 0.0, answers + 10
    person.sees("#banner", "Ready")
    person.leaves()


def test_a_sign_in_that_ends_is_told_and_put_off_while_something_moves(browser: Any, instrument: Instrument) -> None:
    person = Operator(browser, instrument.address().partition("?")[0])
    page = person.page
    name, _, password = PERSON
    page.fill("#name", unicodedata.normalize("NFD", name))  # as some keyboards write it
    page.fill("#password", password)
    ends: dict[str, float] = {}
    person.hears("alive", ends)  # that the end is near; the bridge itself has hours left
    page.click(".by-password button")
    person.takes_control()
    person.sees("#you", f"^{name} · 1 viewing")
    assert page.is_hidden("#stay")
    beside = "async (name) => (await import('/page/language/strings.js')).t('you', { name, count: 2 })"
    assert page.evaluate(beside, "דנה") == "\u2068דנה\u2069 · 2 viewing", "else 2 would stand to the left of it"
    ends["sign_in_ends_s"] = 250.0
    try:
        person.sees(
            "#stay-text",
            "Your sign-in ends within 5 min. Then the machine stops, the stylus lifts, and you lose control",
        )
        assert (page.inner_text("#stay-label"), page.get_attribute("#stay-secret", "type")) == ("Password", "password")
        assert "ends within 5 min" in page.inner_text("#say")
        assert axe(person) == []
        person.shoots("sign_in_ends")
        page.set_viewport_size({"width": 390, "height": 844})
        wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0
        person.shoots("sign_in_ends_telephone")
        page.set_viewport_size({"width": 1280, "height": 800})
        page.click("#tab-sequence")
        page.fill("#sequence-text", "press:MENU")
        instrument.tell("motion 60")
        person.selects("MENU", "Menu")
        person.confirms()
        newest = page.locator("#log tr").first.inner_text
        person.until(lambda: re.search("Press Menu.*in progress", newest()), 10.0, newest)
        page.fill("#stay-secret", "wrong horse")
        page.press("#stay-secret", "Enter")
        person.sees("#stay-problem", "Name or password is wrong")
        assert page.input_value("#stay-secret") == ""
        while True:  # after a wrong one the next is looked at half a second later
            page.fill("#stay-secret", password)
            with page.expect_response("**/renew") as renewed:
                page.press("#stay-secret", "Enter")
            if renewed.value.status != 429:
                break
            # Its answer empties the field, also what was typed already.
            person.until(lambda: page.input_value("#stay-secret") == "", 15.0, lambda: "the answer")
            person.sees("#stay-problem", "Too many failed attempts")
        assert renewed.value.status == 200
        ends.clear()
        person.until(lambda: page.is_hidden("#stay"), 15.0, lambda: page.inner_text("#stay"))
        person.sees("#lease-text", "You are in control")
        focus = page.evaluate("document.activeElement.id")
        assert focus == "desk", "where a second Enter does nothing"
        assert page.input_value("#sequence-text") == "press:MENU", "the page is as it was"
        instrument.tell("motion 0.3")
        person.until(lambda: re.search("Press Menu.*done", newest()), 15.0, newest)
        person.sees("#banner", "Ready")  # what still moves would be stopped
        assert person.complaints == []
    finally:
        instrument.tell("motion 1.5")
        person.context.close()


def test_who_only_watches_sees_that_a_recording_runs_whoever_started_it(
    browser: Any, operator: Operator, instrument: Instrument, tmp_path: Path
) -> None:
    watcher = Operator(browser, instrument.new_address())
    page = watcher.page
    watcher.sees("#lease-text", "is in control")
    assert page.is_hidden("#chip-recording") and page.is_hidden("#recordings")
    can = lambda call: operator.page.is_enabled(f"[data-call={call}]")  # noqa: E731
    operator.until(lambda: can("record"), 15.0, lambda: "recording can be begun")
    assert not can("end_record"), "nothing is recorded"
    operator.page.click("[data-call=record]")
    name = operator.page.inner_text("#you").partition(" ·")[0]
    for person in (watcher, operator):
        person.until(lambda person=person: person.page.is_visible("#chip-recording"), STARTS_S, lambda: "a recording")
        person.sees("#chip-recording", r"Recording\s*●\s*\d:\d\d$")
        person.sees("#recordings", rf"^Recording for \d:\d\d, begun by {name}\.$")
    operator.until(lambda: can("end_record") and not can("record"), 15.0, lambda: "it can be ended")
    said = watcher.page.inner_text("#recordings")
    watcher.until(lambda: page.inner_text("#recordings") != said, 15.0, lambda: f"more than {said!r}")
    page.click("#language")
    watcher.sees("#recordings", rf"^Aufzeichnung seit \d:\d\d, begonnen von {name}\.$")
    page.click("#language")
    for size in ((390, 844), (820, 1180), (1280, 800)):
        page.set_viewport_size(dict(zip(("width", "height"), size)))
        watcher.shoots(f"recording_{size[0]}")
        cut = "(dd) => dd.scrollWidth - dd.clientWidth"
        assert page.eval_on_selector("#chip-recording dd", cut) <= 0
    assert axe(watcher) == []
    # One that was started in a terminal, too.
    program = [executable("icu_bringup", "bag_record"), "-o", str(tmp_path / "bag"), "/gantry/state"]
    recorder = subprocess.Popen(program, env=instrument.environment, stdout=subprocess.DEVNULL)
    try:
        watcher.sees("#recordings", r"\nRecording for \d:\d\d, by the program /bag_recorder\.$", within_s=STARTS_S)
        operator.page.click("[data-call=end_record]")
        watcher.sees("#recordings", r"^Recording for \d:\d\d, by the program /bag_recorder\.$", within_s=STARTS_S)
        operator.until(lambda: can("record") and not can("end_record"), 15.0, lambda: "another program's is not ended")
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.wait(STARTS_S)
    watcher.until(lambda: page.is_hidden("#chip-recording"), STARTS_S, lambda: page.inner_text("#recordings"))
    assert page.is_hidden("#recordings")
    watcher.leaves()


def test_a_beginner_is_told_what_to_do_next(browser: Any, instrument: Instrument) -> None:
    """And not that something is wrong, where nothing is."""
    first = Operator(browser, instrument.new_address(), viewport={"width": 360, "height": 740})
    second = Operator(browser, instrument.new_address())
    page = first.page
    try:
        second.sees_controls()
        second.sees("#refusal", "^Take control first.$")
        first.takes_control()
        second.sees("#refusal", "^Ask for control first.$")
        name = str(second.page.inner_text("#you")).partition(" ·")[0]
        page.evaluate("scrollTo(0, 0)")
        second.page.click("#lease-request")
        first.sees("#banner", f"{name} asks for control", within_s=10.0)
        second.page.context.close()
        first.sees("#banner", "Ready. Select a control")
        instrument.tell("motion 60")
        first.selects("RUN_STOP", "Run / Stop")
        first.confirms()
        first.sees("#chip-controller", "Moving")
        first.sees("#refusal", "^Not while something moves.$")
        page.click("#stop")
        first.sees("#chip-driver", "Stopped")
        first.sees("#refusal", "^Press “Reset after stop” first.$")
        instrument.tell("motion 1.5")
        first.hits("#reset")
        first.sees("#chip-driver", "Idle")
        first.selects("CH1_SCALE", "Channel 1 scale")
        signs = page.locator("[data-act=turn], [data-act=click]").all_inner_texts()
        told = "{ action: 'record', target: '', status: 'sent', reason: '', error_mm: null }"
        said = page.evaluate(f"import('/page/reports/command_log.js').then(({{ spoken }}) => spoken({told}))")
        assert said.startswith("Record: starting, no recording yet."), "its program takes seconds to begin"
        assert signs == ["↺ Turn", "Turn ↻", "↺ Click", "Click ↻"], "counter-clockwise is + in the angle beside it"
    finally:
        first.context.close()
        second.context.close()


def test_two_tabs_of_one_person_are_told_apart(operator: Operator) -> None:
    page, other = operator.page, operator.context.new_page()
    name = operator.sees("#you", "Operator").partition(" ·")[0]
    other.goto(page.url)
    reads = lambda tab, text: operator.until(  # noqa: E731
        lambda: tab.inner_text("#lease-text") == text, 20.0, lambda: f"{tab.inner_text('#lease-text')!r}, not {text!r}"
    )
    reads(other, f"{name} (another page) is in control. You are viewing.")
    other.click("#lease-request")
    reads(other, f"You have asked {name} (another page) for control.")
    page.bring_to_front()
    reads(page, f"{name} (another page) asks for control.")
    page.click("#lease-decline")
    reads(page, "You are in control.")
    other.bring_to_front()
    reads(other, f"{name} (another page) keeps control.")
    other.close()
    page.bring_to_front()


def test_a_screen_reader_hears_of_requests_and_results_and_not_of_each_millimetre(
    browser: Any, operator: Operator, instrument: Instrument
) -> None:
    page = operator.page
    instrument.tell("motion 0.3")
    page.evaluate(_HEAR)
    for control, label in (("MENU", "Menu"), ("SINGLE", "Single")):
        operator.selects(control, label)
        operator.confirms()
        operator.sees("#last", f"Press {label}: done")
    assert page.get_by_role("group", name="Selected Single").count() == 1, "what the buttons in it are for is said"
    other = Operator(browser, instrument.new_address())
    other.page.click("#lease-request")
    name = re.search(r"Operator \d+", operator.sees("#lease-text", "asks for control"))[0]
    heard = page.evaluate("heard")
    assert f"{name} asks for control." in heard
    assert "Press Single: done, measured error 0.42 mm." in heard
    assert [text for text in heard if re.fullmatch(r"[\d.]+ mm", text)] == [], "it would be at them all the way"
    other.leaves()
    said = page.evaluate(_TWO_ENDS)
    assert "look at the panel" in said and said.endswith("STOP: done."), "the one is not cut off by the other"


# Texts that appear at once when a stop ends a press: the bridge reports both ends in one go.
_TWO_ENDS = """async () => {
  const { desk } = await import('/page/connection/desk.js');
  const common = { wall_ms: Date.now(), who: 'Ada', error_mm: null, duration_s: null, effect: '' };
  for (const [entry, own] of [
    [9001, { action: 'press', target: 'Menu', status: 'aborted', reason: 'it broke off: look at the panel' }],
    [9002, { action: 'stop', target: '', status: 'done', reason: '' }],
  ]) desk.link.dispatchEvent(new CustomEvent('log', { detail: { entry: { ...common, entry, ...own } } }));
  return document.getElementById('say-now').textContent.trim();
}"""
# Texts of live regions whenever they change, into `heard`.
_HEAR = """() => {
  window.heard = [];
  const live = '[aria-live=polite], [aria-live=assertive], [role=status], [role=alert], output:not([aria-live=off])';
  new MutationObserver((changes) => {
    for (const { target } of changes) {
      const region = (target.nodeType === 1 ? target : target.parentElement)?.closest(live);
      if (region) heard.push(region.textContent.trim());
    }
  }).observe(document.body, { subtree: true, childList: true, characterData: true });
}"""


def test_the_focus_stays_where_a_second_enter_does_nothing(operator: Operator, instrument: Instrument) -> None:
    page, keyboard = operator.page, operator.page.keyboard
    instrument.tell("motion 0.3")
    focus = lambda: page.evaluate("(({ id, dataset }) => id || dataset.act || dataset.jog)(document.activeElement)")  # noqa: E731
    lands_on = lambda place: operator.until(lambda: focus() == place, 15.0, lambda: f"{focus()} has the focus")  # noqa: E731

    def goes_to(selector: str, place: str) -> None:
        """Focus what is switched off only for a moment."""
        operator.until(lambda: page.focus(selector) or focus() == place, 15.0, lambda: f"{focus()} has the focus")

    page.focus("#lease-release")
    keyboard.press("Enter")
    lands_on("lease-card")
    keyboard.press("Tab")
    lands_on("lease-take")
    keyboard.press("Enter")
    lands_on("lease-card")
    keyboard.press("Enter")
    operator.sees("#lease-text", "You are in control")
    operator.sees("#banner", "Ready")
    page.focus("[data-control=MENU]")
    keyboard.press("Enter")
    lands_on("press")
    rows = page.locator("#log tr:not(.nothing)")
    before = rows.count()
    instrument.tell("motion 60")  # the page must see that it moves
    keyboard.press("Enter")
    lands_on("selection-card")
    instrument.tell("motion 0.3")
    operator.sees("#last", "Press Menu: done")
    keyboard.press("Enter")
    keyboard.press("Escape")
    operator.until(lambda: page.is_visible("#reset"), 15.0, lambda: page.inner_text("#banner"))
    assert rows.count() == before + 2, "one press and the stop"
    operator.logs("STOP.*done", 15.0)
    goes_to("#reset", "reset")
    keyboard.press("Enter")
    lands_on("desk")
    operator.sees("#banner", "Ready")
    page.click("#tab-move")
    goes_to("[data-jog='0,1']", "0,1")
    keyboard.press("Enter")
    operator.logs(r"Move \+y.*done", 15.0)
    lands_on("0,1")
    page.fill("#go-x", "90")
    page.fill("#go-y", "40")
    goes_to("#go", "go")
    instrument.tell("motion 60")
    keyboard.press("Enter")
    lands_on("panel-move")
    instrument.tell("motion 0.3")
    operator.logs(r"Go to \(90.0, 40.0\) mm.*done", 15.0)
    operator.sees("#banner", "Ready")  # the page's end would stop what still moves


def test_the_chosen_sequence_stays_chosen_when_the_link_comes_back(operator: Operator) -> None:
    page = operator.page
    again = """async (names) => {
        const last = { name: "", who: "", steps: [], number: 0, status: "", reason: "", state: "" };
        const stored = names.map((name) => ({ name, title: "", steps: [`press:${name}`] }));
        (await import('/page/orders/sequence.js')).setSequences(stored, last);
    }"""
    page.evaluate(again, ["SAVE", "MENU"])
    page.click("#tab-sequence")
    page.select_option("#sequence-choice", "MENU")
    page.evaluate(again, ["MENU", "SAVE"])
    assert page.input_value("#sequence-choice") == "MENU"
    operator.sees("#sequence-steps", "press:MENU")
    page.evaluate(again, ["SAVE"])
    assert page.locator("#sequence-choice").evaluate("(choice) => choice.selectedIndex") == 0, "as written here"


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
    page.focus("[data-control=MENU]")
    page.keyboard.press("Enter")  # a key was never dragged
    operator.sees("#selection-name", "Menu", within_s=15.0)
    operator.selects("RUN_STOP", "Run / Stop")
    page.keyboard.press("0")
    operator.sees("#zoom-fit", "100 %")


def test_the_picture_before_is_compared_and_nothing_moves_meanwhile(operator: Operator, instrument: Instrument) -> None:
    page = operator.page
    assert not page.is_enabled("#compare")
    operator.selects("RUN_STOP", "Run / Stop")
    lit = operator.lit()
    operator.confirms()
    operator.sees("#last", "Press Run / Stop: done")
    operator.until(lambda: operator.lit() != lit, 15.0, lambda: "the button changes")
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
    operator.until(lambda: page.is_enabled("[data-act=press]"), 15.0, lambda: page.inner_text("#refusal"))
    page.click("#freeze")
    operator.until(lambda: not page.is_enabled("[data-act=press]"), 15.0, lambda: "nothing moves from a held picture")
    assert page.is_visible("#before") and page.get_attribute("#freeze", "aria-pressed") == "true"
    instrument.tell("running 1")
    held = "() => document.getElementById('before').toDataURL()"
    still, live = page.evaluate(held), operator.picture_sum()
    operator.until(lambda: operator.picture_sum() != live, 15.0, lambda: "the live picture goes on below")
    assert page.evaluate(held) == still
    page.click("[data-camera=right]")  # whose outlines are not those of a picture of the left one
    assert not page.is_visible("#before") and page.get_attribute("#freeze", "aria-pressed") == "false"
    page.click("[data-camera=left]")
    operator.until(lambda: page.is_enabled("[data-act=press]"), 15.0, lambda: page.inner_text("#refusal"))
    with page.expect_download() as saved:
        page.click("#snapshot")
    assert re.fullmatch(r"picture_[\d_-]+\.png", saved.value.suggested_filename)
    assert Path(saved.value.path()).read_bytes().startswith(b"\x89PNG")


def test_moving_while_held_and_to_a_point(operator: Operator, instrument: Instrument) -> None:
    page = operator.page
    instrument.tell("motion 0.3")
    page.click("#tab-move")
    page.select_option("#jog-step", "5")
    operator.until(lambda: page.is_enabled("[data-jog='1,0']"), 15.0, lambda: page.inner_text("#move-why"))
    # A position that no program has reported for a second is not shown.
    at = lambda: float(re.match(r"-?[\d.]+", operator.sees("#position-x", r"\d"))[0])  # noqa: E731
    start = at()
    named = lambda text: [row for row in page.locator("#log tr").all_inner_texts() if text in row]  # noqa: E731
    before = {text: len(named(text)) for text in ("Move +x", "Move -x", "Go to (80.0, 60.5) mm")}

    def ends(text: str, within_s: float) -> None:
        """Wait until what was begun here has ended; the newest row is the first."""
        ended = lambda: len(named(text)) > before[text] and "done" in named(text)[0]  # noqa: E731
        operator.until(ended, within_s, lambda: page.inner_text("#log"))

    page.hover("[data-jog='1,0']")
    page.mouse.down()
    x = lambda: at() - start  # noqa: E731
    operator.until(lambda: x() >= 15, 20.0, lambda: f"moved by {x()} mm; {page.inner_text('#log')}")
    page.mouse.up()
    ends("Move +x", 15.0)
    end = x()
    assert abs(end / 5 - round(end / 5)) < 0.01
    assert len(named("Move +x")) == before["Move +x"] + 1
    page.keyboard.down("Shift")
    page.keyboard.down("ArrowLeft")
    operator.until(lambda: x() <= end - 10, 20.0, lambda: f"moved to {x()} mm; {page.inner_text('#log')}")
    page.click("#freeze")  # what is not seen any more does not go on, though the key is still down
    operator.sees("#refusal", "A kept picture lies over the live one")
    ends("Move -x", 15.0)
    page.keyboard.up("ArrowLeft")
    page.keyboard.up("Shift")
    page.click("#freeze")
    instrument.tell("motion 60")
    page.fill("#go-x", "80")
    page.fill("#go-y", "60.5")
    page.click("#go")
    operator.sees("#chip-driver", "Moving")
    page.keyboard.press("Shift+ArrowLeft")
    answered = """async () => {
        const { desk } = await import('/page/connection/desk.js');
        return (await desk.link.ask("jog", { dx: 0, dy: 0, step_mm: 1, ...desk.seen })).ok;
    }"""
    assert page.evaluate(answered), "and so has been what the key asked for, and that it was let go"
    assert page.inner_text("#refusal") == "The last command is still running."
    instrument.tell("motion 0.3")
    ends("Go to (80.0, 60.5) mm", 15.0)
    operator.sees("#position-x", "^80.0 mm$")
    page.click("#tab-plots")
    operator.sees("#plot-position .values", r"X 80.0 · Y 60.5")
    assert page.get_attribute("#plot-position path", "d")
    instrument.tell("motion 1.5")


def test_an_arrow_that_is_held_at_a_limit_orders_one_step_and_says_why(
    operator: Operator, instrument: Instrument
) -> None:
    page = operator.page
    page.click("#tab-move")
    operator.until(lambda: page.is_enabled("[data-jog='1,0']"), 15.0, lambda: page.inner_text("#move-why"))
    operator.sees("#position-x", r"\d")
    numbers = """async () => {
        const { desk } = await import('/page/connection/desk.js');
        await desk.link.ask("select", {});
        return document.querySelectorAll("#log tr:not(.nothing)").length;
    }"""
    before = page.evaluate(numbers)
    instrument.tell("reach_m 0.0")
    try:
        page.hover("[data-jog='1,0']")
        page.mouse.down()
        operator.sees("#refusal", "That step was not done: x is beyond 0.0 m. Press the arrow again to try once more.")
        for _ in range(5):  # still held
            assert page.evaluate(numbers) == before + 1, page.inner_text("#log")
        page.mouse.up()
        page.hover("[data-jog='1,0']")  # the sentence has moved it
        page.mouse.down()
        operator.until(lambda: page.evaluate(numbers) == before + 2, 15.0, lambda: page.inner_text("#log"))
        page.mouse.up()
    finally:
        instrument.tell("reach_m inf")


# A computer whose clock is a day and an hour ahead.
_AHEAD = """{ const True = Date, ahead = 90_000_000; globalThis.Date = class extends True {
  constructor(...given) { super(...(given.length ? given : [True.now() + ahead])); }
  static now() { return True.now() + ahead; }
}; }"""


def test_times_are_the_bridges_and_those_of_another_day_have_their_date(browser: Any, instrument: Instrument) -> None:
    operator = Operator(browser, instrument.new_address())
    page = operator.page
    operator.context.add_init_script(_AHEAD)
    page.reload()
    operator.sees_controls()
    operator.sees("#chip-link", r"\d ms")
    begun = time.time()
    page.click("#freeze")
    shown = operator.sees("#before-time", "before").removeprefix("before · ")
    with page.expect_download() as saved:
        page.click("#snapshot")
    moments = [datetime.fromtimestamp(begun + seconds) for seconds in range(-1, 20)]
    assert shown in [f"{at:%H:%M:%S}" for at in moments]
    assert saved.value.suggested_filename in [f"picture_{at:%Y-%m-%d_%H-%M-%S}.png" for at in moments]
    entry = {"entry": 999, "who": "Operator 1", "action": "home", "target": "", "status": "done", "reason": ""}
    at = datetime(2026, 3, 29, 23, 50, 7)
    page.evaluate(
        """async (entry) => {
            const { desk } = await import('/page/connection/desk.js');
            desk.link.alive = () => {}; // the bridge tells the time no more
            desk.link.dispatchEvent(new CustomEvent('log', { detail: { entry } }));
        }""",
        {**entry, "error_mm": None, "wall_ms": at.timestamp() * 1e3},
    )

    def time_of(days: int) -> str:
        # Each time again: an answer in transit sets the clock once more.
        shown_ms = (at.timestamp() + days * 86_400) * 1e3
        page.evaluate("async ms => (await import('/page/connection/clock.js')).setClock(ms)", shown_ms)
        return str(page.inner_text("#log tr >> nth=0 >> td >> nth=0").replace("\xa0", " "))

    for days, expected in ((0, "23:50:07"), (1, "Mar 29 23:50:07")):
        operator.until(lambda d=days, text=expected: time_of(d) == text, 15.0, lambda d=days: time_of(d))
    page.click("#language")
    operator.until(lambda: time_of(1) == "29. März 23:50:07", 15.0, lambda: time_of(1))
    operator.leaves()


def test_the_log_is_searched_and_exported(operator: Operator) -> None:
    page = operator.page
    operator.selects("MENU", "Menu")
    operator.confirms()
    operator.sees("#last", "Press Menu: done")
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
    page.emulate_media(media="print")
    for width in (1280, 794):  # in a wide window, and on paper
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate(_PRINTED) == 0, "a printed log lacks nothing"
    page.emulate_media(media="screen")


# How much of a long log, px, is not on the page that is printed.
_PRINTED = """async () => {
  const { desk } = await import('/page/connection/desk.js');
  const entry = { wall_ms: Date.now(), who: 'Ada', action: 'press', target: 'Menu', status: 'done', reason: '' };
  const more = { error_mm: null, duration_s: null, effect: '' };
  for (let number = 9001; number < 9061; number += 1) {
    const detail = { entry: { ...entry, ...more, entry: number } };
    desk.link.dispatchEvent(new CustomEvent('log', { detail }));
  }
  const bottom = document.querySelector('#log tr:last-child').getBoundingClientRect().bottom;
  const boxes = ['.log-rows', '.log', 'main'].map((part) => document.querySelector(part).getBoundingClientRect());
  return Math.round(Math.max(0, ...boxes.map((box) => bottom - box.bottom)));
}"""


def test_engineers_read_what_the_programs_say(operator: Operator, instrument: Instrument) -> None:
    page = operator.page
    page.click("#tab-console")
    page.click("#stop")
    operator.sees("#console-lines", r"warn ui_bridge: stop")
    page.reload()
    operator.sees("#console-lines", r"warn ui_bridge: stop")  # also what was said before one came
    operator.takes_control()
    show = "async (counts) => (await import('/page/reports/console.js')).showCounts(counts)"
    page.evaluate(show, {"bytes_sent": "12"})
    assert page.locator("#driver-facts > div > *").all_inner_texts() == ["bytes sent", "12"]
    page.click("#reset")
    operator.sees("#chip-driver", "Idle")
    page.click("#tab-calibrate")
    operator.sees("#guide-machine", "✓")
    plotted = """async (places) => {
        const { desk } = await import('/page/connection/desk.js');
        const { sampleGuide } = await import('/page/reports/guide.js');
        const { state } = desk;
        places.forEach((position_mm, at) => {
            const reason = { values: { done: at + 1, total: 12 } };
            desk.state = { ...state, position_mm, calibration: { state: "calibrating", reason } };
            sampleGuide();
        });
        desk.state = state;
        const numbers = (node, ...names) => names.map((name) => Number(node.getAttribute(name)));
        const plot = document.getElementById("coverage");
        const shown = plot.getAttribute("viewBox").split(" ").map(Number);
        return [shown, [...plot.children].map((place) => numbers(place, "cx", "cy"))];
    }"""
    assert page.evaluate(plotted, [[30, 40, 0], [580, 410, 0]]) == [[0, 0, 580, 410], [[30, 370], [580, 0]]]


# Elements that are rewritten with the same text, while ten images are drawn.
_REWRITTEN = """async () => {
  const { desk } = await import("/page/connection/desk.js");
  const shown = (nodes) => [...nodes].map((node) => node.outerHTML ?? node.data).join("");
  const rewritten = [];
  const note = (changes) => {
    for (const { target, removedNodes, addedNodes } of changes) {
      const same = removedNodes.length && shown(removedNodes) === shown(addedNodes);
      if (same) rewritten.push(target.id || target.outerHTML);
    }
  };
  const observer = new MutationObserver(note);
  observer.observe(document, { subtree: true, childList: true });
  let pictures = 0;
  await new Promise((resolve) => desk.video.addEventListener("frame", () => (pictures += 1) === 10 && resolve()));
  note(observer.takeRecords());
  observer.disconnect();
  return [...new Set(rewritten)];
}"""


def test_nothing_is_written_or_drawn_anew_that_shows_the_same(operator: Operator, instrument: Instrument) -> None:
    """The stylus's tip and its way were drawn with every picture, a hint was written ten times a second."""
    page = operator.page
    instrument.tell("motion 0.3")
    operator.selects("SINGLE", "Single")
    operator.confirms()  # so that there is a target
    page.wait_for_selector(".layer-target .over", state="attached")
    operator.sees("#last", "Press Single: done")
    instrument.tell("motion 1.5")
    tabs = page.locator("#tabs [role=tab]:visible")
    for tab in tabs.all():
        tab.click()
        assert page.evaluate(_REWRITTEN) == [], tab.inner_text()


# Places along each line, in pixels of the stage, with its colour; corners are dots, lines without length.
_DRAWN = """() => { const stage = document.getElementById('stage').getBoundingClientRect();
  return [...document.querySelectorAll('#overlay .over')].filter((p) => getComputedStyle(p.parentElement)
    .display !== 'none').map((path) => { const length = path.getTotalLength(), m = path.getScreenCTM();
      const parts = path.parentElement.classList.contains('layer-edges') ? 60 : 5;
      const dots = [...path.getAttribute('d').matchAll(/M(\\S+) (\\S+)h0/g)];
      const at = (dots.length ? dots.map(([, x, y]) => new DOMPoint(x, y))
        : Array.from({ length: parts }, (_, i) => path.getPointAtLength(((i + 0.5) / parts) * length)))
        .map((p) => p.matrixTransform(m)).map((p) => [p.x - stage.x, p.y - stage.y]);
      return [path.parentElement.classList[0], at, getComputedStyle(path).stroke.match(/\\d+/g)
        .map((v) => v / 255)]; }); }"""


def test_outlines_edges_and_the_way_are_seen_on_any_picture(
    operator: Operator, instrument: Instrument, tmp_path: Path
) -> None:
    """WCAG 1.4.11 on pixels: along each line its bright colour is next to dark, at least 3:1, whatever is below."""
    import cv2
    import numpy as np

    page = operator.page
    for layer in ("edges", "corners"):
        page.click(f"[data-layer={layer}]")
    operator.selects("RUN_STOP", "Run / Stop")
    for layer in ("edges", "corners", "path"):
        page.wait_for_selector(f".layer-{layer} .over", state="attached")
    box = page.locator("#stage").bounding_box()
    path = tmp_path / "stage.png"
    layers = {"layer-edges", "layer-corners", "layer-path", "layer-outline", "layer-controls", "layer-tip"}

    def drawn() -> dict[tuple[str, float, float], list[float]]:
        return {(layer, *place): colour for layer, places, colour in page.evaluate(_DRAWN) for place in places}

    def shoot() -> dict[tuple[str, float, float], list[float]]:
        """Return what was drawn before and after the screenshot alike; each new picture brings its own."""
        before = drawn()
        page.screenshot(path=str(path), clip=box)
        after = drawn()
        kept = {place: colour for place, colour in before.items() if place in after}
        return kept if {layer for layer, _, _ in kept} >= layers else {}

    lines = operator.until(shoot, 30.0, lambda: "all layers before and after a screenshot")
    operator.shoots("layers")
    picture = cv2.imread(str(path)).astype(float)[:, :, ::-1] / 255
    linear = np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)
    light = linear @ [0.2126, 0.7152, 0.0722]
    seen: dict[str, list[float]] = {}
    for (layer, x, y), colour in lines.items():
        inside = 6 <= x < light.shape[1] - 6 and 6 <= y < light.shape[0] - 6
        if not inside:
            continue
        part = np.s_[round(y) - 6 : round(y) + 7, round(x) - 6 : round(x) + 7]
        off = np.abs(picture[part] - colour[:3]).max(axis=2)
        bright = light[part].ravel()[off.argmin()]
        if off.min() < 0.25:  # between the dashes, or under a line that lies above it, there is none
            seen.setdefault(layer, []).append((bright + 0.05) / (light[part].min() + 0.05))
    assert seen.keys() >= layers
    print({layer: (len(found), round(min(found), 1)) for layer, found in seen.items()})
    assert {layer: min(found) for layer, found in seen.items() if min(found) < 3} == {}
    assert len(seen["layer-controls"]) > 20 and len(seen["layer-path"]) >= 2 and len(seen["layer-corners"]) > 50
    # An image in transit when the layer was switched off does not show it again.
    page.evaluate(
        """async () => { const counts = window.counts = { edges: 0, pictures: 0 };
            const { desk } = await import('/page/connection/desk.js');
            const added = (changes) => changes.reduce((sum, change) => sum + change.addedNodes.length, 0);
            const edges = new MutationObserver((changes) => { counts.edges += added(changes); });
            document.querySelector('[data-layer=edges]').addEventListener('click', () => {
              edges.observe(document.querySelector('.layer-edges'), { childList: true });
              desk.video.addEventListener('frame', () => { counts.pictures += 1; }); }); }"""
    )
    for layer in ("edges", "corners"):
        page.click(f"[data-layer={layer}]")
    page.click("[data-layer=path]")
    operator.until(lambda: page.evaluate("counts.pictures") >= 10, 30.0, lambda: "ten more pictures")
    assert page.evaluate("counts.edges") == page.locator(".layer-edges .over").count() == 0
    assert not page.is_visible(".layer-path")
    page.click("[data-layer=path]")
    instrument.tell("motion 60")  # a page on a loaded machine may not draw what lasts shorter
    operator.confirms()
    page.wait_for_selector(".layer-path .over:not(.planned)", state="attached")
    instrument.tell("motion 1.5")
    operator.sees("#last", "Press Run / Stop: done")
