"""Which clock measures which limit: the declarations of all nodes against the table in docs/decisions."""

from __future__ import annotations

import os
import re
from pathlib import Path

from unit.scope_bench.graph_programs import config_class, programs

from icu_common.core.configuration.config import GRAPH_TIME, WALL_TIME, settings_of

PAGE = Path(__file__).parents[3] / "docs/decisions/simulated-time.md"
GUARDS = {
    "camera.retry_max_s",
    "camera.retry_min_s",
    "gantry_controller.heartbeat_timeout_s",
    "serial_driver.heartbeat_timeout_s",
    "serial_driver.node_silence_s",
    "ui_bridge.jog_hold_s",
    "ui_bridge.keepalive_fresh_s",
    "ui_bridge.lease_timeout_s",
    "ui_bridge.session_lifetime_s",
    "ui_bridge.sign_in_warning_s",
    "ui_bridge.silence_stop_s",
}
"""All that the wall clock measures: they guard people, or wait for a device."""


def limits() -> dict[str, tuple[str, str]]:
    """Return node.parameter -> default and clock of every duration of the graph."""
    found = {}
    for program in programs("bench"):
        if program.is_node:
            for item in settings_of(config_class(program)):
                if item.setting.unit == "s":
                    name = re.sub(r"_(left|right)$", "", program.name)
                    found[f"{name}.{item.name}"] = (f"{item.default:g}", item.setting.clock)
    return dict(sorted(found.items()))


def table() -> str:
    rows = [f"| `{name}` | {default} | {clock} |" for name, (default, clock) in limits().items()]
    return "\n".join(["| parameter | default, s | clock |", "|---|---|---|", *rows])


def test_every_duration_has_a_clock_and_only_guards_have_the_wall_s() -> None:
    clocks = {name: clock for name, (_, clock) in limits().items()}
    assert len(clocks) > 50
    assert set(clocks.values()) == {GRAPH_TIME, WALL_TIME}
    assert {name for name, clock in clocks.items() if clock == WALL_TIME} == GUARDS


def test_page_lists_every_limit_with_its_clock() -> None:
    text = PAGE.read_text(encoding="utf-8")
    begin, end = "<!-- limits: begin -->\n", "<!-- limits: end -->"
    before, _, rest = text.partition(begin)
    shown, _, after = rest.partition(end)
    if os.environ.get("WRITE_DOCS"):
        PAGE.write_text(f"{before}{begin}{table()}\n{end}{after}", encoding="utf-8")
        return
    assert shown.strip() == table(), "renew it: WRITE_DOCS=1 .venv/bin/pytest tests/unit/project/test_limit_clocks.py"
