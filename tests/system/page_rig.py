"""A bridge with a synthetic instrument, an operator in control of its page, and axe-core."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import axe_playwright_python
import pytest
from system.conftest import PATIENT
from system.operator_browser import Operator
from system.page_instrument import Instrument

from scope_ui_bridge.adapters.secret_files import write_secret
from scope_ui_bridge.core.access import new_user

AXE = Path(axe_playwright_python.__file__).parent / "axe.min.js"
WCAG = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
PERSON = ("Jürgen Groß", "operator", "correct horse")


@pytest.fixture(scope="module")
def instrument(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instrument]:
    folder = tmp_path_factory.mktemp("instrument")
    write_secret(folder / "passwords", new_user(*PERSON, b"a" * 16).line())
    made = Instrument(folder, PATIENT | {"token_role": "engineer", "passwords_file": folder / "passwords"})
    made.tell("heartbeat_timeout 30")
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
        # A page that goes while something moves stops it. The answer that something has ended comes before its state.
        person.page.wait_for_selector("#stage:not(.moving)", state="attached")
        assert person.complaints == []
    finally:
        person.context.close()  # its page goes away, and with it the control


def axe(operator: Operator) -> list[str]:
    """Return what axe-core finds wrong: rule, and where."""
    # Through the debugger, which the page's own security policy does not hinder.
    operator.page.evaluate(AXE.read_text() + "; null")
    found = operator.page.evaluate("(t) => axe.run(document, {runOnly: t, resultTypes: ['violations']})", WCAG)
    return [f"{v['id']}: {[node['target'] for node in v['nodes']][:3]}" for v in found["violations"]]
