"""The page's sentences: both languages have the same keys and values, and every key that is used exists."""

from __future__ import annotations

import re

from scope_ui_bridge.adapters.front_door import PAGE
from scope_ui_bridge.core.wire import LEASE_STEPS, SERVICES


def table(name: str) -> dict[str, str]:
    pairs = re.findall(r'^  (\w+): "(.*)",$', (PAGE / f"strings_{name}.js").read_text(), re.MULTILINE)
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
    for script in PAGE.glob("*.js"):
        if not script.name.startswith("strings"):
            used |= set(re.findall(r'\bt\("(\w+)"', script.read_text()))
    used |= {f"call_{name}" for name in SERVICES} | {f"action_{name}" for name in SERVICES}
    used |= {f"lease_{name}" for name in LEASE_STEPS} - {"lease_decline"}
    package = PAGE.parent
    for source in (*package.glob("core/*.py"), *package.glob("adapters/*.py")):
        used |= set(re.findall(r'Refusal\("(\w+)"', source.read_text()))
        used |= set(re.findall(r'"(stopped_\w+)"', source.read_text()))
    assert used - english.keys() == set()
