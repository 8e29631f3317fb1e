"""A further language is one file: a pseudo-language with accented letters renders the whole page."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from fluent.syntax import FluentParser, FluentSerializer
from fluent.syntax import ast as ftl
from fluent.syntax.visitor import Transformer
from support.message_files import GRAPH, PAGE
from system.operator_browser import Operator
from system.page_instrument import ROOT, Instrument
from system.page_rig import PERSON, instrument

from icu_common.core.panel.panel_layout import load_layout
from icu_common.core.reasons.message import Message, joined, tree

__all__ = ["instrument"]  # a fixture
pytestmark = [pytest.mark.browser, pytest.mark.system, pytest.mark.timeout(300), pytest.mark.long]

PSEUDO = "en-XA"
PLAIN = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
ACCENTED = "ȧƀƈḓḗƒɠħīĵķŀḿƞǿƥɋřşŧŭṽẇẋẏẑȦƁƇḒḖƑƓĦĪĴĶĿḾȠǾƤɊŘŞŦŬṼẆẊẎẐ"
TABS = ("machine", "move", "sequence", "calibrate", "plots", "teach", "console")
WORD = re.compile(r"[A-Za-z]{3,}")
KEYS = {"Esc", "Tab", "Enter", "Ctrl", "Alt", "Shift", "Escape", "Space"}
"""Names of keys on the keyboard."""
GRAMMAR = {"screen", "effect", "press"}
"""Words of the sequences' grammar, which is the same in every language."""
MONTHS = {"Jul"}
"""A month as the browser writes it, which knows no pseudo-language."""

# The page's texts for eyes and ears. The log lines of programs are left out, because they are in English. Text that is
# marked as another language is left out too: the name of the next one.
SHOWN = """() => {
  const lines = document.querySelector('#console');
  const texts = [];
  for (const element of document.querySelectorAll('body *')) {
    if (lines?.contains(element) || element.lang || !element.checkVisibility()) continue;
    for (const node of element.childNodes) if (node.nodeType === Node.TEXT_NODE) texts.push(node.data);
    for (const name of ['aria-label', 'title', 'placeholder']) texts.push(element.getAttribute(name) ?? '');
  }
  return [document.title, ...texts].map((text) => text.trim()).filter(Boolean);
}"""


class _Accents(Transformer):
    def visit_TextElement(self, node: ftl.TextElement) -> ftl.TextElement:
        node.value = node.value.translate(str.maketrans(PLAIN, ACCENTED))
        return node


def pseudo_language() -> str:
    """Return the file of the pseudo-language, made of the English sentences."""
    text = "\n".join(file.read_text(encoding="utf-8") for file in (PAGE / "language" / "en.ftl", GRAPH))
    made = _Accents().visit(FluentParser().parse(text))
    words = (PAGE / "language" / "de.ftl").read_text(encoding="utf-8")
    accents = str.maketrans(PLAIN, ACCENTED)
    found = [f"word-{word} = {word.translate(accents)}" for word in re.findall(r"^word-(\w+) =", words, re.MULTILINE)]
    serialized = FluentSerializer().serialize(made)
    # Words that are values of sentences are translated in this language too.
    graph = re.sub(r"\{ \$(side|lamp|lamp_2|kind|hidden_by|what|state|needed) \}", r"{ WORD($\1) }", serialized)
    return graph + "\n".join(found) + "\n"


def left_in_english(shown: list[str], names: set[str]) -> list[str]:
    return [text for text in shown if set(WORD.findall(text)) - names]


def shown_title(page: Any) -> str:
    """Return what the page shows of the calibration; its program reports code and values each second."""
    return str(page.get_attribute("#chip-calibration", "title"))


def test_a_pseudo_language_leaves_no_english_on_the_page(browser: Any, instrument: Instrument) -> None:
    layout = load_layout(ROOT / "config" / "scopes" / "dso_bench_4.yaml")
    named = [layout.title, layout.model, PERSON[0], "Operator", "robot", "pump_2", *(c.name for c in layout.controls)]
    named += [control.label for control in layout.controls] + [mark for c in layout.controls for mark, _ in c.marks]
    names = {word for text in named for word in WORD.findall(text)} | KEYS | GRAMMAR | MONTHS
    person = Operator(browser, instrument.address().partition("?")[0])
    page = person.page
    page.route("**/languages", lambda route: route.fulfill(json=["en", "de", PSEUDO]))
    page.route(f"**/{PSEUDO}.ftl", lambda route: route.fulfill(body=pseudo_language(), content_type="text/plain"))
    page.evaluate(f"localStorage.setItem('language', '{PSEUDO}')")
    page.reload()
    person.until(lambda: page.get_attribute("html", "lang") == PSEUDO, 15.0, lambda: "the language")
    assert left_in_english(page.evaluate(SHOWN), names) == []
    told: dict[str, Any] = {}
    person.hears("state", told)
    page.goto(instrument.new_address())
    person.sees_controls()
    page.click("#lease-take")
    person.until(lambda: page.is_visible("#lease-release"), 15.0, lambda: page.inner_text("#lease-text"))
    person.insists(lambda: page.click("[data-control=RUN_STOP]"))
    person.confirms()
    person.until(lambda: "✓" in page.inner_text("#log"), 30.0, lambda: page.inner_text("#log"))
    person.until(lambda: "12 \u015f" in shown_title(page), 15.0, lambda: shown_title(page))
    found = {}
    for tab in TABS:
        page.click(f"#tab-{tab}")
        found[tab] = left_in_english(page.evaluate(SHOWN), names)
    page.click("#help-open")
    found["help"] = left_in_english(page.evaluate(SHOWN), names)
    page.click("#help-close")
    for state, reason in REASONS.items():
        part, _, name = state.partition(" ")
        told.clear()
        told.update({part: {"state": name, "reason": tree(reason)}, "stop_cause": None})
        person.until(lambda part=part: page.get_attribute(f"#chip-{part}", "title"), 15.0, lambda: "a state")
        accent = reason.translate(str.maketrans(PLAIN, ACCENTED))[:9]
        person.until(
            lambda a=accent: a in json.dumps(page.evaluate(SHOWN), ensure_ascii=False), 15.0, lambda a=accent: a
        )
        found[state] = left_in_english(page.evaluate(SHOWN), names)
    assert {place: texts for place, texts in found.items() if texts} == {}
    assert person.complaints == []
    person.leaves()


REASONS = {
    "driver stopped": joined([Message("driver.stop_requested"), Message("stylus.stylus_not_lifted_may_still")]),
    "driver alarm": Message("grbl.alarm", code=1, texts=Message("grbl.hard_limit_switch_position_lost")),
    "controller waiting": Message("hold.not_homed"),
    "calibration failed": Message(
        "calibration.held_out_place_off_accepted", what="tip", max_mm=0.4, max_held_out_mm=0.2
    ),
    "calibration calibrating": Message("calibration.part", done=3, total=12, remaining_s=9.0),
}
"""Part and state -> a reason, whose sentence the page makes."""
