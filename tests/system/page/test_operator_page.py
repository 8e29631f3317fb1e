"""The operator page in a real browser with a synthetic instrument.

See operator_browser.py for the browser.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from system.conftest import PATIENT
from system.operator_browser import Operator
from system.page_instrument import Instrument

pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300), pytest.mark.long]


@pytest.fixture
def instrument(browser: Any, tmp_path: Path) -> Iterator[Instrument]:
    made = Instrument(tmp_path, PATIENT)
    made.tell("heartbeat_timeout 30")
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def strict_instrument(browser: Any, tmp_path: Path) -> Iterator[Instrument]:
    """With the product's own limits of pictures and recognition; an operator whose page is held up stays one."""
    made = Instrument(tmp_path, {"silence_stop_s": 2.0, "lease_timeout_s": 30.0})
    try:
        yield made
    finally:
        made.close()


# --- with the synthetic instrument ---


@pytest.mark.parametrize(
    ("topic", "english", "german"),
    [
        ("left/image_raw", "No picture has come from the camera yet", "Von der Kamera kam noch kein Bild"),
        ("left/camera_info", "A camera has no calibration", "Eine Kamera ist nicht kalibriert"),
        ("panel/pose", "The cameras do not recognise the panel: the left camera must", "Keine Front erkannt"),
    ],
)
def test_where_there_is_no_control_the_list_of_controls_says_why(
    browser: Any, tmp_path: Path, topic: str, english: str, german: str
) -> None:
    """It was an empty box, next to which the page asked for a click on a control."""
    instrument = Instrument(tmp_path, PATIENT, "--ros-args", "-r", f"{topic}:=elsewhere")
    try:
        operator = Operator(browser, instrument.address())
        listed = lambda: operator.page.locator("#chooser option").all_inner_texts()  # noqa: E731
        for name, why in (("No panel in view", english), ("Keine Front in Sicht", german)):
            operator.sees("#selection-detail", why)
            assert listed() == [name, operator.page.inner_text("#selection-detail")]
            assert operator.page.is_disabled("#chooser option >> nth=1"), "it is no control"
            operator.shoots(f"no_control_{topic.replace('/', '_')}_{name[:2]}")
            operator.page.click("#language")
        operator.leaves()
    finally:
        instrument.close()


def test_from_sign_in_to_the_measured_result(browser: Any, instrument: Instrument) -> None:
    operator = Operator(browser, instrument.address())
    page = operator.page
    operator.sees_controls()
    assert "token" not in page.url
    first = operator.picture_sum()
    operator.until(lambda: operator.picture_sum() != first, 15.0, lambda: "the picture changes")
    assert operator.lit()
    assert not page.is_enabled("[data-call=home]"), "viewers move nothing"
    operator.takes_control()
    operator.selects("RUN_STOP", "Run / Stop")
    assert page.get_attribute("[data-control=RUN_STOP]", "aria-pressed") == "true"
    operator.shoots("selected_light")
    instrument.tell("motion 60")  # a page on a loaded machine may not draw what lasts shorter
    operator.confirms()
    operator.sees("#chip-driver", "Moving")
    operator.logs(r"Press Run / Stop.*in progress", 15.0)
    instrument.tell("motion 1.5")
    row = operator.logs(r"Press Run / Stop.*done", 15.0)
    assert "0.42 mm" in row
    assert "Operator 1" in row
    operator.sees("#last", "measured error 0.42 mm")
    operator.until(lambda: not operator.lit(), 15.0, lambda: "RUN/STOP goes dark in the picture")
    operator.sees("#position-x", "^208.0 mm$")
    operator.leaves()


def test_a_knob_a_point_and_the_touch_screen(browser: Any, instrument: Instrument) -> None:
    operator = Operator(browser, instrument.address())
    page = operator.page
    operator.takes_control()
    operator.selects("CH1_SCALE", "Channel 1 scale")
    page.select_option("#turn-degrees", "30")
    operator.confirms("turn")
    operator.logs(r"Turn ↺ 30° Channel 1 scale.*done", 20.0)
    area = page.locator("#controls [data-control=SCREEN]").bounding_box()
    page.mouse.click(area["x"] + area["width"] / 4, area["y"] + area["height"] / 2)
    operator.sees("#selection-name", "Point on the panel")
    # a quarter of the screen (15 to 185 mm wide, centre at 82.5 mm up), seen in perspective
    x, y = map(float, re.findall(r"([\d.]+)", operator.sees("#selection-detail", "Point"))[:2])
    assert abs(x - 57.5) < 8
    assert abs(y - 82.5) < 6
    operator.confirms()
    operator.logs(r"Press \([\d.]+, [\d.]+\) mm.*done", 20.0)
    page.click("[data-control=CH1_IN]", force=True)  # aria-disabled, and still answered
    operator.sees("#refusal", "connector; the stylus never touches connectors")
    page.mouse.click(area["x"] - 60, area["y"] - 90)
    operator.sees("#refusal", "off the panel")
    page.select_option("#chooser", "MENU")
    operator.sees("#selection-name", "Menu")
    operator.leaves()


def test_everything_by_keyboard_and_escape_stops_a_motion(browser: Any, instrument: Instrument) -> None:
    operator = Operator(browser, instrument.address(), color_scheme="dark")
    page = operator.page
    operator.sees_controls()
    operator.sees("#lease-text", "No operator has control")
    page.keyboard.press("l")
    operator.sees("#lease-text", "You are in control")
    focused = lambda: page.evaluate("document.activeElement.dataset.control ?? ''")  # noqa: E731
    for _ in range(30):
        page.keyboard.press("Tab")
        if focused():
            break
    assert focused(), "Tab reaches the controls"
    page.focus("[data-control=SINGLE]")
    page.keyboard.press("?")
    operator.until(lambda: page.is_visible("#help"), 15.0, lambda: "the help")
    page.keyboard.press("Shift+ArrowUp")  # only STOP works under the help; the log is looked at in the end
    page.keyboard.press("Enter")
    operator.until(lambda: focused() == "SINGLE", 15.0, lambda: "the help gives the focus back to where it was")
    page.keyboard.press("ArrowLeft")
    assert focused() == "RUN_STOP"
    page.keyboard.press("ArrowDown")
    assert focused() == "CH1_SCALE"
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Enter")
    operator.sees("#selection-name", "Run / Stop")
    operator.until(
        lambda: page.evaluate("document.activeElement.dataset.act ?? ''") == "press", 15.0, lambda: "focus on Press"
    )
    instrument.tell("motion 60")
    page.keyboard.press("Enter")
    operator.sees("#chip-driver", "Moving")
    page.keyboard.press("Escape")
    operator.sees("#banner", "STOPPED")
    instrument.tell("motion 1.5")
    operator.logs("aborted stopped: operator", 15.0)
    operator.logs("STOP", 15.0)
    assert operator.lit(), "the motion did not end in a touch"
    operator.shoots("stopped_dark")
    assert not page.is_enabled("[data-act=press]")
    operator.sees("#refusal", "Press “Reset after stop” first.")
    page.click("[data-call=reset]")
    operator.sees("#chip-driver", "Idle")
    operator.sees("#banner", "Ready")
    assert "Move" not in page.inner_text("#log")
    operator.leaves()


def test_the_stop_button_of_a_viewer_and_of_a_page_without_script(browser: Any, instrument: Instrument) -> None:
    instrument.tell("motion 300")
    operator = Operator(browser, instrument.address())
    operator.takes_control()
    viewer = Operator(browser, instrument.new_address())
    viewer.sees("#lease-text", "Operator 1 is in control")
    operator.selects("MENU", "Menu")
    instrument.tell("deaf 1")
    operator.confirms()
    viewer.sees("#chip-driver", "Moving")
    viewer.page.click("#stop")
    viewer.sees("#banner", "STOP has not got through. Use the wired emergency stop")
    assert "Moving" in viewer.page.inner_text("#chip-driver"), "the bridge has heard it, but the driver has not"
    send = "({ desk }) => desk.link.dispatchEvent(new CustomEvent('log', { detail }))"
    tell = f"import('/page/connection/desk.js').then({send})"
    stop = {"entry": 99, "wall_ms": 0, "who": "Operator 2", "action": "stop", "target": "", "status": "no_answer"}
    operator.page.evaluate(f"detail => {tell}", {"entry": {**stop, "reason": "", "error_mm": None, "duration_s": None}})
    operator.sees("#banner", "STOP has not got through. Use the wired emergency stop")
    instrument.tell("driver unhomed")  # it was restarted, at rest
    viewer.sees("#banner", "Moving")
    instrument.tell("deaf 0")
    viewer.page.click("#stop")
    viewer.sees("#chip-driver", "Stopped")
    viewer.sees("#banner", "STOPPED")
    operator.logs("STOP.*Operator 2", 15.0)
    operator.page.click("[data-call=reset]")
    operator.sees("#chip-driver", "Idle")
    bare = Operator(browser, instrument.new_address(), java_script_enabled=False)
    bare.page.click("#stop-form button")
    operator.sees("#chip-driver", "Stopped")
    operator.logs("STOP.*Operator 3", 15.0)
    bare.context.close()
    viewer.leaves()
    operator.leaves()


def test_a_stop_is_pressed_by_whatever_clicks_and_each_press_is_one(browser: Any, instrument: Instrument) -> None:
    """Screen readers in some browsers click a button without any pointer, and the click still counts as a mouse's."""
    operator = Operator(browser, instrument.address(), has_touch=True)
    page = operator.page
    operator.sees_controls()
    new_stops = operator.counts_stops()

    def clicks(detail: int) -> None:
        click = "new MouseEvent('click', { detail, bubbles: true, cancelable: true })"
        page.evaluate(f"(detail) => document.getElementById('stop').dispatchEvent({click})", detail)

    clicks(1)
    assert new_stops() == 1, "a click alone"
    page.click("#stop")
    assert new_stops() == 1, "the mouse"
    clicks(1)
    assert new_stops() == 1, "a click alone, right after the mouse's"
    page.tap("#stop")
    assert new_stops() == 1, "a finger"
    page.focus("#stop")
    page.keyboard.press("Enter")
    assert new_stops() == 1, "a key"
    box = page.locator("#stop").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    assert new_stops() == 1, "on press, not on release"
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 300)
    page.mouse.up()
    assert new_stops() == 0, "a pointer that has slid off"
    operator.until(lambda: clicks(1) or new_stops() == 1, 15.0, lambda: "a click alone is heard after that, too")
    operator.leaves()


def test_control_is_handed_over(browser: Any, instrument: Instrument) -> None:
    first = Operator(browser, instrument.address())
    first.takes_control()
    second = Operator(browser, instrument.new_address())
    second.sees_controls()
    second.page.click("[data-control=MENU]")
    second.sees("#refusal", "Ask for control first")  # there is no "Take control" that could be pressed
    places = [second.page.locator(part).bounding_box() for part in ("#selection-card", "#lease-request")]
    second.page.dblclick("#lease-request")
    first.sees("#lease-text", "Operator 2 asks for control")
    waits = "You have asked for control: wait until the operator hands it over"
    for part in ("#refusal", "#banner"):
        second.sees(part, waits)
    assert second.page.is_disabled("#lease-request"), "it is asked for already"
    now = [second.page.locator(part).bounding_box() for part in ("#selection-card", "#lease-request")]
    assert now == places, "nothing moves under a hand"
    second.page.click("#lease-withdraw")
    first.sees("#lease-text", "You are in control")
    second.sees("#refusal", "Ask for control first")
    second.page.click("#lease-request")
    first.sees("#lease-text", "Operator 2 asks for control")
    first.page.click("#lease-decline")
    second.sees("#lease-text", "Operator 1 keeps control")
    second.page.click("#lease-request")
    first.sees("#lease-text", "Operator 2 asks for control")
    third = Operator(browser, instrument.new_address())
    third.page.click("#lease-request")
    second.sees("#lease-text", "Operator 3 has asked for control after you")
    first.sees("#lease-text", "Operator 3 asks for control")
    third.leaves()
    second.sees("#lease-text", "Operator 1 is in control")
    second.page.click("#lease-request")
    first.sees("#lease-text", "Operator 2 asks for control")
    first.page.click("#lease-grant")
    second.sees("#lease-text", "You are in control")
    first.sees("#lease-text", "Operator 2 is in control")
    assert not first.page.is_enabled("[data-call=home]")
    second.page.click("[data-call=home]")
    assert second.page.inner_text("[data-call=home]") == "Confirm: home"
    second.page.click("[data-call=home]")
    second.logs("Home.*done homing", 15.0)
    first.sees("#banner", "Viewing. Ask for control to operate")
    second.selects("MENU", "Menu")
    instrument.tell("motion 60")
    second.confirms()
    first.sees("#banner", "Moving. STOP or Esc stops it")
    instrument.tell("motion 0.3")
    second.logs("Press Menu.*done", 15.0)
    second.sees("#banner", "Ready")  # what still moves would be stopped
    second.page.click("#lease-release")
    second.sees("#banner", "You have lost control: you released it, or this page was hidden")
    first.sees("#banner", "Viewing. Take control to operate")
    first.leaves()
    second.leaves()


def test_an_old_picture_is_shown_as_such_and_moves_nothing(browser: Any, strict_instrument: Instrument) -> None:
    instrument = strict_instrument
    operator = Operator(browser, instrument.address())
    page = operator.page
    operator.takes_control()
    operator.selects("MENU", "Menu")
    instrument.tell("stall")
    operator.until(lambda: page.get_attribute("#stage", "data-age") == "stale", 15.0, lambda: "the picture is stale")
    operator.sees("#stale", r"STALE · [1-9]")
    operator.shoots("stale_light")
    assert not page.is_enabled("[data-act=press]")
    operator.sees("#refusal", r"The picture is \d+ ms old \(limit 500 ms")
    page.keyboard.press("Enter")
    assert "Press" not in page.inner_text("#log")
    operator.sees("#banner", "picture is old")
    # None has come to the bridge for a second, even if the last one was late: else it stops a motion that begins.
    operator.sees("#stale", r"STALE · ([3-9]|\d\d)")
    instrument.tell("driver homing")  # which needs no picture
    operator.sees("#banner", "Moving, and the live picture is old. STOP or Esc stops it")
    instrument.tell("driver idle")
    operator.sees("#banner", "picture is old. You cannot select or move anything")
    spoken = page.evaluate("""async () => {
        const said = [];
        const heard = new MutationObserver(() => said.push(document.getElementById("refusal").textContent));
        heard.observe(document.getElementById("refusal"), { childList: true, subtree: true, characterData: true });
        await new Promise((resolve) => setTimeout(resolve, 2000));
        heard.disconnect();
        return said;
    }""")
    ages = [text for text in spoken if "ms old" in text]
    assert len(ages) <= 2, f"a screen reader would speak of each: {spoken}"
    others = {text for text in spoken if text not in ages}
    assert others <= {"There is no link to the bridge."}, "which is so for a moment where the bridge is held up"
    instrument.tell("resume")
    operator.until(lambda: page.is_hidden("#stale"), 15.0, lambda: "the picture is live again")
    focused = lambda: page.evaluate("document.activeElement.dataset.control")  # noqa: E731
    operator.until(lambda: focused() == "MENU", 15.0, lambda: "the focus comes back to the control that was clicked")
    operator.sees("#chip-recognition", "97 %")
    instrument.tell("mute 1")
    operator.sees("#chip-recognition", "unknown")
    operator.sees("#refusal", r"The recognition has been silent for \d\.?\d* s")
    instrument.tell("mute 0")
    instrument.tell("confidence 0.2")
    operator.sees("#refusal", "recognised with 0.2; at least 0.5")
    assert not page.is_enabled("[data-act=press]")
    instrument.tell("shift 0.01")
    instrument.tell("confidence 0.97")
    operator.insists(lambda: operator.hits("[data-act=press]"), "panel_moved")
    operator.sees("#refusal", "The panel has moved by 10 mm since the selection")
    operator.leaves()


def test_a_click_before_the_page_has_drawn_that_it_cannot_be_done_gets_the_reason(
    browser: Any, strict_instrument: Instrument
) -> None:
    """The buttons are drawn every 100 ms; what was clicked in between was swallowed without a word."""
    operator = Operator(browser, strict_instrument.address())
    page = operator.page
    operator.takes_control()
    operator.selects("MENU", "Menu")

    busy = """button => {
        if (button.disabled) return false; // the picture happened to be late before
        const end = performance.now() + 600;
        while (performance.now() < end);
        button.click();
        return true;
    }"""

    def click_when_it_is_late() -> None:
        operator.until(lambda: page.eval_on_selector("[data-act=press]", busy), 20.0, lambda: "the button")

    operator.insists(click_when_it_is_late, "picture_late")
    operator.sees("#refusal", r"The picture is \d{3,} ms old \(limit 500 ms")
    for key in (">", "Shift+ArrowLeft"):
        operator.until(lambda: page.is_enabled("[data-act=press]"), 20.0, lambda: "ready again")
        operator.insists(lambda: page.click("[data-control=RUN_STOP]"))
        page.click("#freeze")
        operator.insists(lambda key=key: page.keyboard.press(key), "frozen_no_action")
        operator.sees("#refusal", "A kept picture lies over the live one")
        page.click("#freeze")
    operator.insists(lambda: page.keyboard.press(">"), "wrong_gesture")
    operator.sees("#refusal", "That cannot be done with this control")
    assert "Press" not in page.inner_text("#log")
    operator.leaves()


def test_words_can_be_read_and_buttons_can_be_hit(browser: Any, instrument: Instrument) -> None:
    """WCAG 2.2 AA: contrast of text at least 4.5 (3 for large text), targets of the desk at least 44 px."""
    for number, (scheme, size) in enumerate([("light", (1280, 800)), ("dark", (820, 1180)), ("light", (390, 844))]):
        address = instrument.address() if number == 0 else instrument.new_address()
        operator = Operator(browser, address, color_scheme=scheme, viewport=dict(zip(("width", "height"), size)))
        operator.takes_control()
        assert operator.page.evaluate(_HIT_BY_OTHERS) == []
        operator.selects("CH1_SCALE", "Channel 1 scale")
        operator.page.click("#stop")
        operator.sees("#banner", "STOPPED")
        operator.page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
        for part in ("#stop", "#banner", "#reset"):
            box = operator.page.locator(part).bounding_box()
            assert 0 <= box["y"] <= size[1] - box["height"], f"{part} is seen wherever one has scrolled to"
        operator.page.click("[data-call=reset]")
        operator.sees("#chip-driver", "Idle")
        operator.shoots(f"page_{scheme}_{size[0]}")
        poor = operator.page.evaluate(_CONTRAST)
        assert poor == []
        small = operator.page.evaluate(
            """() => [...document.querySelectorAll('button, select')]
                .filter((e) => e.offsetParent && !e.closest('#controls') && !e.classList.contains('link'))
                .map((e) => [e.id || e.textContent, e.getBoundingClientRect()])
                .filter(([, r]) => r.width < 44 || r.height < 44).map(([n, r]) => `${n} ${r.width} x ${r.height}`)"""
        )
        assert small == []
        wide = operator.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0, "nothing to scroll sideways"
        log = "e => { e.querySelector('.number').textContent = '0.42 mm'; return e.scrollWidth - e.clientWidth; }"
        assert operator.page.eval_on_selector(".log-rows", log) <= 0, "0.42 mm that is cut reads 0.42 m"
        assert operator.page.evaluate(_CUT_NAMES) == []
        assert operator.page.evaluate(_BROKEN_RESULT) == [1, 0], "one line for its word, nothing cut"
        assert operator.page.evaluate(_WIDE_NAME) <= 0, "a long name breaks, and STOP stays in sight"
        assert operator.page.evaluate(_LONG_USER) == [0], "nor does a person's name take the room of the states"
        operator.leaves()


# The element under the middle of each control is that control, however small the picture is.
_HIT_BY_OTHERS = """() => {
  document.getElementById('stage').scrollIntoView({ block: 'center' });
  return [...document.querySelectorAll('#controls [data-kind=button], #controls [data-kind=knob]')].map((button) => {
    const r = button.getBoundingClientRect();
    const hit = document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2);
    return hit === button ? '' : `${button.dataset.control}: ${hit?.dataset.control ?? hit?.outerHTML.slice(0, 60)}`;
  }).filter(Boolean);
}"""

# Controls are distinguished by their whole names, even where only a part of the control is seen.
_CUT_NAMES = """async () => {
  const { setPanel, renderPanel } = await import('/page/picture/panel_seen.js');
  const shown = [1, 2].map((n) => ({ name: `CH${n}_POSITION`, label: `Channel ${n} position` }));
  setPanel(shown.map(({ name }) => ({ name, hidden_by: 'stylus', marks: {}, angle_deg: null, changed_ms: 0 })));
  renderPanel(shown);
  const names = [...document.querySelectorAll('#seen dt')];
  if (names.length !== 2) return [`${names.length} names`];
  return names.filter((e) => !e.textContent.startsWith('Channel') || e.scrollWidth > e.clientWidth)
    .map((e) => `${e.textContent}: ${e.scrollWidth} in ${e.clientWidth} px`);
}"""

# Number of lines of a result's word next to a long name, and the excess width of the log.
_BROKEN_RESULT = """() => {
  const row = document.querySelector('#log tr'), log = document.querySelector('.log-rows');
  if (innerWidth < 620) log.style.width = '298px'; // as on a telephone of 360 px
  row.querySelector('.number').textContent = '0.42 mm';
  row.cells[1].textContent = 'Drücken Beatmungsdruckbegrenzungsventileinstellknopf';
  row.querySelector('strong').textContent = 'erledigt';
  return [row.querySelector('strong').getClientRects().length, Math.max(0, log.scrollWidth - log.clientWidth)];
}"""

# How much wider than the window the page is with a long German word as a control's name.
_WIDE_NAME = """() => {
  for (const id of ['selection-name', 'last']) {
    document.getElementById(id).hidden = false;
    document.getElementById(id).textContent = 'Beatmungsdruckbegrenzungsventileinstellknopf';
  }
  return document.documentElement.scrollWidth - document.documentElement.clientWidth;
}"""

# How much wider than the window the page is with the longest name of a person, and which states are cut.
_LONG_USER = """() => {
  const name = 'Maximiliane.Hohenstauffen-Weber1';
  document.querySelector('#banner p').textContent = `GESTOPPT – ${name.toUpperCase()} hat STOP gedrückt`;
  document.getElementById('you').textContent = `${name} · 3 dabei`;
  const states = ['driver', 'controller'].map((part) => document.querySelector(`#chip-${part} dd`));
  for (const state of states) state.textContent = 'Gestoppt';
  const cut = states.filter((state) => state.scrollWidth > state.clientWidth).map((state) => state.parentElement.id);
  return [Math.max(0, document.documentElement.scrollWidth - document.documentElement.clientWidth), ...cut];
}"""

_CONTRAST = """() => {
  const parse = (c) => { const v = c.match(/[\\d.]+/g).map(Number); return v.length > 3 ? v : [...v, 1]; };
  const light = (c) => c.slice(0, 3).map((v) => v / 255)
    .map((v) => (v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4))
    .reduce((s, v, i) => s + v * [.2126, .7152, .0722][i], 0);
  const ground = (e) => {
    for (let n = e; n; n = n.parentElement) {
      const c = parse(getComputedStyle(n).backgroundColor);
      if (c[3] > .7) return c;
    }
    return [255, 255, 255, 1];
  };
  const poor = [];
  for (const e of document.querySelectorAll('body *')) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    if (!own || !e.offsetParent || e.closest('.unseen, #stage, option') || e.disabled) continue;
    const style = getComputedStyle(e), size = parseFloat(style.fontSize), bold = Number(style.fontWeight) >= 700;
    const [a, b] = [light(parse(style.color)), light(ground(e))].sort((x, y) => y - x);
    const ratio = (a + .05) / (b + .05), needed = size >= 24 || (bold && size >= 18.7) ? 3 : 4.5;
    if (ratio < needed) poor.push(`${e.textContent.trim().slice(0, 30)}: ${ratio.toFixed(2)}`);
  }
  return poor;
}"""
