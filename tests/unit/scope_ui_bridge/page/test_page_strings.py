"""The page's sentences: every key that is used exists, and no text of the graph is left without a code."""

from __future__ import annotations

import ast
import hashlib
import re

from support.message_files import PAGE, language, messages, templates, values

from scope_ui_bridge.core.wire import LEASE_STEPS, SERVICES

EXPLAINED = {"state", "reason", "what", "step", "role", "field"}
"""Values that the page itself gives to each refusal."""


def test_no_sentence_is_left_in_english() -> None:
    english, german = (messages(PAGE / "language" / f"{name}.ftl") for name in ("en", "de"))
    text = {name: (PAGE / "language" / f"{name}.ftl").read_text() for name in ("en", "de")}
    lines = {name: dict(re.findall(r"^(\w+) = (.{7,})$", text[name], re.MULTILINE)) for name in text}
    same = {key for key, line in lines["en"].items() if lines["de"].get(key) == line and "{" not in line}
    assert english.keys() <= german.keys() and same <= {"position"}


def test_every_key_that_is_used_exists() -> None:
    english = language("en")
    pages = "".join((PAGE / name).read_text() for name in ("index.html", "sign_in.html"))
    used = set(re.findall(r'data-(?:text|label|title|placeholder)="(\w+)"', pages))
    for script in PAGE.rglob("*.js"):
        used |= set(re.findall(r'\bt\("(\w+)"', script.read_text()))
    used |= {f"call_{name}" for name in SERVICES} | {f"action_{name}" for name in SERVICES}
    used |= {f"lease_{name}" for name in LEASE_STEPS} - {"lease_decline"}
    package = PAGE.parent
    for source in (*package.glob("core/**/*.py"), *package.glob("adapters/**/*.py")):
        used |= set(re.findall(r'Refusal\(\s*"(\w+)"', source.read_text()))
        used |= set(re.findall(r'"(stopped_\w+)"', source.read_text()))
    assert len(used) > 300 and used - english.keys() == set()


def test_each_refusal_has_the_values_of_its_sentence() -> None:
    english = language("en")
    wrong = []
    for source in PAGE.parent.rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            if (
                isinstance(node, ast.Call)
                and ast.unparse(node.func) == "Refusal"
                and isinstance(node.args[0], ast.Constant)
            ):
                named = {keyword.arg for keyword in node.keywords}
                key = str(node.args[0].value)
                if None not in named and (missing := values(key, english) - named - EXPLAINED):
                    wrong.append(f"{source.name}:{node.lineno}: {key} lacks {sorted(missing)}")
    assert wrong == []


def test_the_vendored_library_is_as_published() -> None:
    folder = PAGE / "vendor" / "fluent"
    sums = dict(line.split("  ")[::-1] for line in (folder / "SHA256SUMS").read_text().splitlines())
    found = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in folder.glob("*.js")}
    assert found == sums
    assert "Apache License" in (folder / "LICENSE").read_text()


# Collected with the sentences, but never visible on the page, or the same in every language.
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
        *("the operator's page", "{} +- {} mm", "{} to {}"),
    ),
    "lines of the audit file": (
        *("take control", "hand over control", "release control", "lose control", "the bridge"),
        *("its time was over", "{} others have signed in since", "{} newer ones of the same user"),
    ),
    "compared with what the board says": ("reset to continue",),
    "answers to who changes a parameter": ("the stylus is extended by {} mm", "the {} is {}"),
    "status lines and plain pages of the web server; terminals": (
        *("not signed in", "engineers only", "no picture is held", "sign in first"),
        *("too many connections", "more than {} a second", "more than {}: the oldest ends", "more than {} are open"),
        *("ended: kept sending after rate_limited", "too many viewers"),
        *("the desk knows which picture is held", "Operator page: {}?token={}"),
        "tls_certificate = {}, tls_key = {}: {}",
        "{}: rms {} px, residuals x{}, red: above three times the rms",
        "bring_up --scope {} --set recognition.template={} --set recognition.template_px_per_mm={}",
    ),
    "the log": (
        *("{}: message of {} bytes dropped (limit {} bytes)", "{}: message of {} bytes dropped: {}"),
        "serial_driver: {}; under load a stop may take longer, see docs/how-to/hardware.md",
        "ui_bridge: {}; under load a motion may be stopped, see docs/how-to/hardware.md",
        *("encoding {} is none of bgr8, mono8, {}", "OpenCV could not encode the picture"),
        "encoding {} is none of {}, nor one of these with 16 bits",
        *("a standard deviation of {} m: 0 to {} m are believed", "the panel's plane faces away from the stylus"),
        "the panel's plane counts as unknown: its standard deviation is {} mm (limit {} mm)",
        "the panel's plane has moved by up to {} mm within the travel",
        *("a plane has 3 readings, 2 slopes and 9 covariances", "a variance is below zero: {}"),
        *("the plane at {} m is not finite", "the plane at {} m with slopes {} is no panel's (limits {} m and {})"),
    ),
}


def test_all_that_the_graph_can_say_has_a_code() -> None:
    unsaid = {text for texts in UNSAID.values() for text in texts}
    missing = [f"{text!r} in {file}" for text, file in templates().items() if text not in unsaid]
    assert missing == [], "make it a Message with a sentence in each language's file, or tell where it is not shown"
