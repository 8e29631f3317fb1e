"""The page's sentences: both languages have the same keys and values, and every key that is used exists."""

from __future__ import annotations

import re

from graph_texts import german_phrases, templates

from scope_ui_bridge.adapters.web.front_door import PAGE
from scope_ui_bridge.core.wire import LEASE_STEPS, SERVICES


def table(name: str) -> dict[str, str]:
    pairs = re.findall(r'^  (\w+): "(.*)",$', (PAGE / "language" / f"strings_{name}.js").read_text(), re.MULTILINE)
    assert len(pairs) == len(dict(pairs)), "no key stands twice"
    return dict(pairs)


def test_both_languages_have_the_same_keys_and_values() -> None:
    english, german = table("en"), table("de")
    assert english.keys() == german.keys()
    for key, sentence in english.items():
        values = set(re.findall(r"\{(\w+)\}", sentence))
        assert set(re.findall(r"\{(\w+)\}", german[key])) == values, key
    same = {key for key in english if english[key] == german[key] and len(english[key]) > 6 and "{" not in english[key]}
    assert same <= {"position"}, "left in English"


def test_every_key_that_is_used_exists() -> None:
    english = table("en")
    pages = "".join((PAGE / name).read_text() for name in ("index.html", "sign_in.html"))
    used = set(re.findall(r'data-(?:text|label|title|placeholder)="(\w+)"', pages))
    for script in PAGE.rglob("*.js"):
        if not script.name.startswith("strings"):
            used |= set(re.findall(r'\bt\("(\w+)"', script.read_text()))
    used |= {f"call_{name}" for name in SERVICES} | {f"action_{name}" for name in SERVICES}
    used |= {f"lease_{name}" for name in LEASE_STEPS} - {"lease_decline"}
    package = PAGE.parent
    for source in (*package.glob("core/**/*.py"), *package.glob("adapters/**/*.py")):
        used |= set(re.findall(r'Refusal\("(\w+)"', source.read_text()))
        used |= set(re.findall(r'"(stopped_\w+)"', source.read_text()))
    assert used - english.keys() == set()


# Collected with the sentences, but never visible on the page, or the same in both languages.
UNSAID = {
    "names of things and goals": (
        *("gantry controller", "{}: board", "facts {}", "message {}"),
        *(
            "sequence {}",
            "teach {}",
            "move {}",
            "jog ({}, {}) mm",
            "({}, {}) mm",
            "{} mm",
            "{} id={}.{}",
            "Operator {}",
        ),
        *("the operator's page", "{} +- {} mm", "calibrating {}/{}, {} s left{}", "{} to {}"),
    ),
    "lines of the audit file": (
        *("take control", "hand over control", "release control", "lose control", "the bridge"),
        *("its time was over", "{} others have signed in since", "{} newer ones of the same user"),
    ),
    "parts of a sentence that is in the table as a whole": ("to {}", "; drift: {}"),
    "answers to who changes a parameter": (
        *("; the stylus is down", "the stylus is extended by {} mm", "the {} is {}"),
    ),
    "compared with what the board says": ("reset to continue",),
    "status lines and plain pages of the web server; terminals": (
        *("not signed in", "engineers only", "no picture is held", "sign in first"),
        *("too many connections", "more than {} a second", "more than {}: the oldest ends", "more than {} are open"),
        *("ended: kept sending after rate_limited", "too many viewers"),
        *("the desk knows which picture is held", "Operator page: {}?token={}"),
        "tls_certificate = {}, tls_key = {}: {}",
        "{}: rms {} px, residuals x{}, red: above three times the rms",
        *("bring_up --scope {} --set recognition.template={} --set recognition.template_px_per_mm={}",),
    ),
    "the log": (
        *("{}: message of {} bytes dropped (limit {} bytes)", "{}: message of {} bytes dropped: {}"),
        *("serial_driver: {}; under load a stop may take longer, see docs/how-to/hardware.md",),
        *("ui_bridge: {}; under load a motion may be stopped, see docs/how-to/hardware.md",),
        *("encoding {} is none of bgr8, mono8, {}", "OpenCV could not encode the picture"),
        *("encoding {} is none of {}, nor one of these with 16 bits",),
        *("a standard deviation of {} m: 0 to {} m are believed", "the panel's plane faces away from the stylus"),
        "the panel's plane counts as unknown: its standard deviation is {} mm (limit {} mm)",
        "the panel's plane has moved by up to {} mm within the travel",
        *("a plane has 3 readings, 2 slopes and 9 covariances", "a variance is below zero: {}"),
        *("the plane at {} m is not finite", "the plane at {} m with slopes {} is no panel's (limits {} m and {})"),
    ),
}
STATES = ("stopped: ", "waiting: ", "disconnected: ", "calibrated: ", "failed: ", "uncalibrated: ")


def test_all_that_the_graph_can_say_is_known_in_german() -> None:
    german = german_phrases()
    unsaid = {text for texts in UNSAID.values() for text in texts}

    def is_known(text: str) -> bool:
        for state in STATES:
            text = text.removeprefix(state)
        return text in ("", "{}") or text in german or f"{text} {{}}" in german or text in unsaid

    missing = [f"{text!r} in {file}" for text, file in templates().items() if not is_known(text)]
    assert missing == [], "give them a line in phrases_de.js, or their file one in graph_texts.ONLY_ELSEWHERE"


def test_what_ended_a_gesture_is_not_left_in_english_by_a_phrase_that_takes_half_of_it() -> None:
    # As the page does: of the phrases that match, the one with the most letters.
    phrases = sorted(german_phrases(), key=lambda phrase: -len(phrase.replace("{}", "")))
    patterns = {phrase: re.compile(re.escape(phrase).replace(r"\{\}", "(.+)")) for phrase in phrases}
    end = "; the stylus is up"
    for phrase in phrases:
        if "are allowed" in phrase and not phrase.endswith(end):
            said = phrase.replace("{}", "7") + end
            assert next(p for p in phrases if patterns[p].fullmatch(said)) == f"{{}}{end}", said


def test_german_phrases_keep_every_value() -> None:
    for english, sentence in german_phrases().items():
        holes = re.findall(r"\{(\d*)\}", sentence)
        numbers = [int(hole) if hole else place for place, hole in enumerate(holes)]
        assert sorted(numbers) == list(range(english.count("{}"))), english
