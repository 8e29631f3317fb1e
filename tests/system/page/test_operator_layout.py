"""Where things are on the page: nothing moves under a hand, a telephone shows all at once, Esc stops from anywhere."""

from __future__ import annotations

import signal
from typing import Any

import pytest
from system.operator_browser import Operator
from system.page_instrument import Instrument
from system.page_rig import instrument, operator

from scope_ui_bridge.adapters.web.front_door import PAGE

__all__ = ["instrument", "operator"]  # fixtures
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300), pytest.mark.long]

SIZES = {
    "desktop": (1280, 800),
    "tablet": (820, 1180),
    "telephone": (390, 844),
    "small telephone": (360, 740),
    "desktop zoomed to 200 %": (640, 400),
    "desktop with larger letters": (1280, 800),
}

# Positions of everything that can be clicked, by a name and number of each, while the page is given a state: no message
# of the bridge comes between.
_PLACES = """async (what) => {
  const { desk } = await import('/page/connection/desk.js');
  const before = desk.state;
  const told = (state) => desk.link.dispatchEvent(new CustomEvent('state', { detail: { ...before, ...state } }));
  const hide = (object, name, value) => Object.defineProperty(object, name, { get: () => value, configurable: true });
  const stopped = { state: 'stopped', reason: 'stop requested' };
  const stop = { driver: stopped, controller: stopped, refusal: { code: 'not_ready', values: stopped } };
  const cause = { code: 'stopped_page_blind', who: 'Watchdog', silence_s: 1.2 };
  const other = (state, reason) => told({ ...stop, driver: { state, reason } });
  const changes = {
    'nothing': () => {},
    'stop': () => told({ ...stop, stop_cause: { code: 'stopped_by_person', who: 'Ada', silence_s: 0 } }),
    'the longest reason': () => told({ ...stop, stop_cause: cause }),
    'alarm': () => other('alarm', 'the limit switch of x was hit'),
    'wrong settings': () => other('mismatch', '$100=250, wanted 80; $101=250, wanted 80'),
    'motion': () => told({ ...stop, moving: true, driver: { state: 'moving', reason: '' } }),
    'stop failed': () => { desk.unstopped = true; },
    'no link': () => hide(desk.link, 'silent', true),
    'old picture': () => hide(desk.video, 'ageMs', 5000),
    'sign-in ends': () => hide(desk.link, 'signInEndsMs', 250000),
    'request': () => told({ lease: { ...before.lease, requester: 'v99', requester_name: 'Grace' } }),
  };
  changes[what]();
  desk.changed();
  window.numbers ??= new Map();
  const places = {};
  for (const e of document.querySelectorAll('button, input, select, textarea, summary, a, #stage, #dial')) {
    const { x, y, width, height } = e.getBoundingClientRect();
    if (!e.checkVisibility({ visibilityProperty: true }) || !width || e.closest('#stay')) continue;
    if (!numbers.has(e)) numbers.set(e, `${e.id || e.textContent.trim() || JSON.stringify(e.dataset)} ${numbers.size}`);
    places[numbers.get(e)] = [x, y, width, height].map(Math.round);
  }
  delete desk.link.silent;
  delete desk.video.ageMs;
  delete desk.link.signInEndsMs;
  desk.unstopped = false;
  told({});
  return places;
}"""
# The focused element, if the head lies over all of it.
_UNDER_HEAD = """() => {
  const { bottom } = document.activeElement.getBoundingClientRect();
  const under = bottom <= document.querySelector('.top').getBoundingClientRect().bottom;
  return under && !document.activeElement.closest('.head') ? document.activeElement.outerHTML.slice(0, 60) : '';
}"""
# Whether anything can be clicked at one of these points.
_HIT = (
    "(points) => points.some(([x, y]) => document.elementFromPoint(x, y)?.closest('button, input, select, a, #stage'))"
)
CAUSES = ["stop", "the longest reason", "alarm", "wrong settings", "motion", "stop failed", "no link", "old picture"]
CAUSES += ["sign-in ends", "request"]


def points(place: list[float]) -> list[list[float]]:
    """Return the middle and the corners of a place: left, top, width, height."""
    x, y, width, height = place
    return [[x + width / 2, y + height / 2], *([x + u, y + v] for u in (3, width - 3) for v in (3, height - 3))]


@pytest.mark.parametrize("size", SIZES)
def test_no_banner_moves_what_can_be_clicked(browser: Any, instrument: Instrument, size: str) -> None:
    """A second click would hit another control than the one that was meant."""
    width, height = SIZES[size]
    operator = Operator(browser, instrument.new_address(), viewport={"width": width, "height": height})
    page = operator.page
    try:
        operator.takes_control()
        if size == "tablet":
            operator.insists(lambda: page.click("[data-control=SCREEN]"))  # what a line can be drawn on
        else:
            operator.selects("CH1_SCALE", "Channel 1 scale")
        if size == "desktop":
            for view in ((1280, 800), (1024, 768), (820, 1180), (768, 1024)):
                page.set_viewport_size({"width": view[0], "height": view[1]})
                page.evaluate("scrollTo(0, 0)")
                assert page.evaluate(_OUT_OF_SIGHT, ["#stop", "#stage", "#verdict"]) == [], f"at {view}"
            page.set_viewport_size({"width": width, "height": height})
            # A user who scrolled down to calibrate, then selects in the picture, sees the selection and its result.
            page.evaluate("document.querySelector('.desk').scrollTop = 1e4")
            needed = ["#selection-name", "#verdict", "[data-act=press]"]
            assert len(page.evaluate(_OUT_OF_SIGHT, needed)) == len(needed)
            operator.selects("RUN_STOP", "Run / Stop")
            operator.until(lambda: page.evaluate(_OUT_OF_SIGHT, needed) == [], 15.0, lambda: "the selection's card")
            operator.selects("CH1_SCALE", "Channel 1 scale")
            page.evaluate("document.querySelector('.desk').scrollTop = 0")
        if "letters" in size:
            page.evaluate("document.documentElement.style.fontSize = '22px'")
        moved: list[str] = []
        for tab, language in (("machine", "de"), ("move", "en"), ("sequence", "de"), ("calibrate", "en")):
            operator.reads(language)
            page.click(f"#tab-{tab}")
            page.evaluate("scrollTo(0, 0)")
            before = page.evaluate(_PLACES, "nothing")
            for cause in CAUSES:
                now = page.evaluate(_PLACES, cause)
                where = f"{tab}, {language}, {cause}: "
                moved += [f"{where}{n} from {at} to {now[n]}" for n, at in before.items() if now.get(n, at) != at]
                new = [name for name in now if name not in before]
                assert new or cause not in ("stop", "wrong settings", "request"), "the button that is needed is there"
                moved += [f"{where}{n} lies over another" for n in new if page.evaluate(_HIT, points(now[n]))]
        assert moved == []
        if "zoomed" in size:
            page.focus("#log-export")
            for _ in range(45):
                page.keyboard.press("Shift+Tab")
                assert page.evaluate(_UNDER_HEAD) == "", "who goes back by keyboard sees where (WCAG 2.4.11)"
        assert operator.complaints == []
    finally:
        operator.context.close()


@pytest.mark.parametrize("width", [360, 390])
def test_a_telephone_shows_every_cause_of_a_stop_as_a_whole(browser: Any, instrument: Instrument, width: int) -> None:
    operator = Operator(browser, instrument.new_address(), viewport={"width": width, "height": 740})
    page = operator.page
    operator.takes_control()
    cut: list[str] = []
    for language in ("en", "de"):
        operator.reads(language)
        cut += page.evaluate(
            """async () => {
              const { desk } = await import('/page/connection/desk.js');
              const sentences = await (await fetch('/page/language/en.ftl')).text();
              const causes = [...sentences.matchAll(/^(stopped_\\w+) = /gm)].map(([, code]) => code);
              const stopped = { state: 'stopped', reason: 'stop requested' };
              return causes.filter((code) => {
                const stop_cause = { code, who: 'Watchdog', silence_s: 1.2 };
                const detail = { ...desk.state, driver: stopped, stop_cause };
                desk.link.dispatchEvent(new CustomEvent('state', { detail }));
                desk.changed();
                const said = document.querySelector('#banner p');
                return said.scrollHeight > said.clientHeight;
              });
            }"""
        )
    assert cut == []
    operator.leaves()


# Which states lie under the banner, by their values' places, once the page has drawn the stop.
_COVERED = """async (cause) => {
  const { desk } = await import('/page/connection/desk.js');
  const stopped = { state: 'stopped', reason: 'stop requested' };
  const detail = { ...desk.state, driver: stopped, controller: stopped, stop_cause: cause };
  desk.link.dispatchEvent(new CustomEvent('state', { detail }));
  desk.changed();
  const top = document.getElementById('banner').getBoundingClientRect().top;
  const values = [...document.querySelectorAll('.chip:not([hidden]) dd')];
  const below = (value) => value.getBoundingClientRect().bottom - 3 > top; // letters end above their line's end
  return [values.length, values.filter(below).map((value) => value.parentElement.id)];
}"""


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_telephones_banner_of_a_stop_covers_nothing_that_it_does_not_tell(
    browser: Any, instrument: Instrument, language: str
) -> None:
    """How old the picture is, and whether there is a link, lay under it."""
    operator = Operator(browser, instrument.new_address(), viewport={"width": 360, "height": 740})
    page = operator.page
    operator.takes_control()
    operator.reads(language)
    button = page.locator("#reset")
    told = {"stopped_by_person": [], "stopped_page_blind": ["chip-driver", "chip-controller", "chip-calibration"]}
    for code, allowed in told.items():
        count, covered = page.evaluate(_COVERED, {"code": code, "who": "Operator 12", "silence_s": 1.2})
        operator.shoots(f"{code}_{language}")
        assert count == 6 and set(covered) <= set(allowed), (code, covered)
        assert button.bounding_box()["height"] >= 44, "for a thumb"
    spoken = "Nothing moves before" if language == "en" else "Nichts bewegt sich vor"
    assert spoken in page.inner_text("#banner p"), "for who cannot see the button beside it"
    operator.leaves()


@pytest.mark.parametrize("width", [1000, 1280, 1600])
def test_letters_of_twice_the_size_leave_all_of_the_head_in_reach(
    browser: Any, instrument: Instrument, width: int
) -> None:
    """The states lay over the way out, the language and the help (WCAG 1.4.4)."""
    operator = Operator(browser, instrument.new_address(), viewport={"width": width, "height": 900})
    page = operator.page
    operator.takes_control()
    page.evaluate("document.documentElement.style.fontSize = '30px'")
    for language in ("de", "en"):
        operator.reads(language)
        assert page.evaluate(_OUT_OF_SIGHT, [".brand button", "#stop", ".chip"]) == []
    operator.leaves()


# Excess length of the words next to the buttons over their place.
_CUT = "(({ scrollHeight, clientHeight }) => scrollHeight - clientHeight)(document.getElementById('verdict'))"
_LONG_RESULT = """async () => {
  const { desk } = await import('/page/connection/desk.js');
  const own = { entry: 9001, action: 'press', target: 'Menu', status: 'aborted', reason: 'look; '.repeat(60) };
  const entry = { ...own, wall_ms: Date.now(), who: 'Ada', error_mm: null, duration_s: null, effect: '' };
  desk.link.dispatchEvent(new CustomEvent('log', { detail: { entry } }));
}"""

# Those of them that are not wholly in the window, or lie under another element in their middle.
_OUT_OF_SIGHT = """(selectors) => selectors.flatMap((s) => [...document.querySelectorAll(s)])
  .filter((e) => e.checkVisibility())
  .filter((e) => {
    const { x, y, width, height } = e.getBoundingClientRect();
    const at = document.elementFromPoint(x + width / 2, y + height / 2);
    return x < 0 || y < 0 || x + width > innerWidth || y + height > innerHeight || !(e.contains(at) || at?.contains(e));
  }).map((e) => e.id || e.dataset.act || e.tagName)"""


@pytest.mark.parametrize(("width", "height"), [(390, 844), (360, 740)])
def test_a_telephone_shows_picture_gestures_result_and_stop_at_once(
    browser: Any, instrument: Instrument, width: int, height: int
) -> None:
    view = {"width": width, "height": height}
    operator = Operator(browser, instrument.new_address(), viewport=view, has_touch=True, is_mobile=True)
    page = operator.page
    needed = [
        "#stop",
        "#stage",
        "#selection-name",
        "[data-act]",
        "#clear",
        "#last",
        "#verdict",
        "#confirm select",
        "#dial",
    ]
    try:
        operator.takes_control()
        page.evaluate("scrollTo(0, 0)")
        instrument.tell("motion 0.3")
        for language, done in (("en", "done"), ("de", "erledigt")):
            if page.get_attribute("html", "lang") != language:
                page.tap("#language")
            for control, gesture in (("MENU", "press"), ("CH1_SCALE", "turn"), ("SCREEN", "press")):
                operator.insists(lambda control=control: page.tap(f"[data-control={control}]"))
                operator.confirms(gesture)
                operator.sees("#last", done)
                assert page.evaluate(_OUT_OF_SIGHT, needed) == []
                assert page.evaluate("scrollY") == 0, "nobody had to scroll"
                top = page.locator("#confirm").bounding_box()["y"]
                operator.insists(lambda: page.tap("#controls [data-control=CH1_IN]", force=True), "not_operable")
                operator.sees("#refusal", "Channel 1 input")
                assert page.evaluate(_CUT) == 0, "a refusal and a result are read together"
                assert page.locator("#confirm").bounding_box()["y"] == top
        sign = "getComputedStyle(document.getElementById('verdict'), '::after').content"
        assert page.evaluate(sign) == "none"
        page.evaluate(_LONG_RESULT)
        operator.until(lambda: "▼" in page.evaluate(sign), 15.0, lambda: "a sign that there is more to read")
        page.evaluate("document.getElementById('verdict').scrollTop = 1e4")
        operator.until(lambda: page.evaluate(sign) == "none", 15.0, lambda: "all is read")
        for part in ("#stop", "#stage"):
            assert page.evaluate(_OUT_OF_SIGHT, [part]) == []
        wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 0
        operator.shoots(f"one_screen_{width}")
        assert operator.complaints == []
    finally:
        instrument.tell("motion 1.5")
        operator.context.close()


# A running sequence and the report of a calibration, as the bridge would send them.
_AT_WORK = """async () => {
  const { desk } = await import('/page/connection/desk.js');
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
    operator.sees("#sequence-said", "Step 2 of 3 is running. STOP ends the sequence")
    assert signs("#sequence-steps") == ["✓", "▶", "○"]
    page.click("#tab-calibrate")
    operator.sees("#calibration-text", "Calibrated – 12 samples, rms 0.080 mm")
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
    operator.sees("#calibration-text", "Calibrated – 12 samples, rms 0.080 mm")
    operator.until(lambda: signs("#panel-calibrate")[0] == "✓", 20.0, lambda: page.inner_text("#panel-calibrate"))


def test_escape_stops_at_once_from_everywhere(operator: Operator) -> None:
    page, keyboard = operator.page, operator.page.keyboard
    new_stops = operator.counts_stops()

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
    # A browser that draws the list itself treats the press as the list's end, and reports only its release to the page.
    release = "new KeyboardEvent('keyup', { key: 'Escape', bubbles: true })"
    up = f"(id) => document.getElementById(id).dispatchEvent({release})"
    page.evaluate(up, "chooser")
    assert new_stops() == 1
    page.evaluate(up, "desk")
    assert new_stops() == 0, "a press that was meant for the browser, as for its search, is released anywhere"
    operator.hits("#reset")
    operator.sees("#chip-driver", "Idle")


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_telephone_cuts_no_word_of_a_button_and_none_of_the_log_in_pieces(
    browser: Any, instrument: Instrument, language: str
) -> None:
    operator = Operator(browser, instrument.new_address(), viewport={"width": 360, "height": 740})
    page = operator.page
    operator.takes_control()
    operator.reads(language)
    cut: list[str] = []

    def look() -> None:
        too_wide = "all => all.filter((b) => b.scrollWidth > b.clientWidth).map((b) => b.id || b.innerText)"
        cut.extend(page.eval_on_selector_all("main button:not([data-control])", too_wide))

    for tab in page.locator("[role=tab]:visible").all():
        tab.click()
        look()
    for control, label in (("RUN_STOP", "Run / Stop"), ("CH1_SCALE", "Channel 1 scale")):
        operator.selects(control, label)
        look()
        widths = page.eval_on_selector_all(
            "[data-act=press], [data-act=double]", "all => all.map((b) => b.offsetWidth)"
        )
        assert widths[0] >= 0.9 * widths[1], "what is done most is no smaller than what is done less"
    assert cut == []
    widest = page.evaluate(
        """async () => {
          const { desk } = await import('/page/connection/desk.js');
          const place = '/home/somebody/.local/state/icu_gantry/sessions/2026-11-27_00-54-42-714746';
          const what = { entry: 9999, wall_ms: Date.now(), who: 'Ada', action: 'end_record', target: '' };
          const entry = { ...what, status: 'done', reason: `recorded to ${place}: 991 messages`, error_mm: 0.4 };
          desk.link.dispatchEvent(new CustomEvent('log', { detail: { entry } }));
          const [cell] = [...document.querySelectorAll('#log tr')].map((row) => row.cells[1]);
          const word = document.createElement('span');
          word.style.cssText = 'position: absolute; white-space: nowrap';
          word.textContent = cell.textContent.split(' ').reduce((a, b) => (a.length > b.length ? a : b));
          cell.append(word);
          const found = [word.offsetWidth, cell.clientWidth];
          word.remove();
          return found;
        }"""
    )
    operator.shoots(f"telephone_log_{language}")
    assert widest[0] <= widest[1], "its longest word is in one piece"
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    assert page.evaluate(_CUT_TAGS) == [], "controls whose names differ at their end are told apart in the picture"
    operator.leaves()


# Which controls' names do not fit into the picture, where a panel has long ones, all around.
_CUT_TAGS = """async () => {
  const { desk } = await import('/page/connection/desk.js');
  const label = 'Infusion pump channel A: bolus volume, upper alarm limit, increase';
  const places = [5, 300, 420, 640, 850, 950, 1255].flatMap((x) => [5, 180, 350, 380, 690].map((y) => [x, y, 20, 20]));
  const controls = places.map((box) => ({ kind: 'button', label, box, outline: [], name: `AT_${box}` }));
  const panel = { outline: [], controls, missing: '' };
  const drawn = { width: 1280, height: 720, panel, tip: null, target: null, path: [], planned: false };
  desk.video.dispatchEvent(new CustomEvent('frame', { detail: drawn }));
  const stage = document.getElementById('stage').getBoundingClientRect();
  const buttons = [...document.querySelectorAll('#controls button')];
  const cut = buttons.filter((button) => {
    const [at, tag] = [button.getBoundingClientRect(), getComputedStyle(button, '::before')];
    const [left, top, width, height] = ['left', 'top', 'width', 'height'].map((side) => parseFloat(tag[side]));
    const [x, y] = [at.left + left + new DOMMatrix(tag.transform).e, at.top + top];
    const [right, bottom] = [x + width + 18, y + height + 6]; // with what is around the letters
    return x < stage.left || y < stage.top || right > stage.right || bottom > stage.bottom;
  });
  return buttons.length === places.length ? cut.map((button) => button.dataset.control) : ['other buttons'];
}"""
_NO_DRAWN_LISTS = "CSS.supports = (...what) => !what.join().includes('base-select') && true"


def test_escape_stops_at_once_beside_an_open_list_also_where_the_browser_cannot_let_the_page_draw_it(
    browser: Any, instrument: Instrument
) -> None:
    operator = Operator(browser, instrument.new_address())
    page, keyboard = operator.page, operator.page.keyboard
    page.add_init_script(_NO_DRAWN_LISTS)
    style = (PAGE / "style.css").read_text().replace("(appearance: base-select)", "(appearance: nothing-known)")
    page.route("**/style.css", lambda route: route.fulfill(body=style, content_type="text/css"))
    page.reload()
    operator.takes_control()
    new_stops = operator.counts_stops()
    options = page.locator(".choices option")
    for way in ("mouse", "Space", "Enter", "Alt+ArrowDown"):
        page.focus("#chooser")
        page.click("#chooser") if way == "mouse" else keyboard.press(way)
        assert options.count() == page.locator("#chooser option").count() > 5, way
        operator.shoots("own_list")
        keyboard.press("End")
        keyboard.down("Escape")
        assert new_stops() == 1, f"{way}: when the key goes down"
        keyboard.up("Escape")
        assert new_stops() == 0, f"{way}: one press is one stop"
        assert (options.count(), page.input_value("#chooser")) == (0, ""), "nothing is chosen"
        assert page.evaluate("document.activeElement.id") == "chooser"
        operator.hits("#reset")
        operator.sees("#chip-driver", "Idle")
    page.click("#chooser")
    options.filter(has_text="Run / Stop").click()
    operator.sees("#selection-name", "Run / Stop")
    assert (options.count(), page.input_value("#chooser")) == (0, "RUN_STOP")
    page.click("#tab-move")
    page.focus("#jog-step")
    for key in ("Enter", "ArrowDown", "Enter"):
        keyboard.press(key)
    assert page.input_value("#jog-step") == "5", "one further than 1"
    page.click("#jog-step")
    page.click("#jog-step")
    assert options.count() == 0, "a second click shuts it"
    page.click("#jog-step")
    page.click("#stop")
    assert (new_stops(), options.count()) == (1, 0), "STOP beside it is no click that only shuts it"
    operator.hits("#reset")
    operator.sees("#chip-driver", "Idle")
    operator.leaves()
