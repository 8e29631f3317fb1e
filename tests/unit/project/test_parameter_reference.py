"""docs/reference/parameters.md has every parameter of every node, as its declaration gives it."""

from __future__ import annotations

import os
import re
import typing
from pathlib import Path
from typing import Any

from unit.icu_bringup.graph_programs import config_class, programs

from icu_common.core.configuration.config import ConfigItem, settings_of

PAGE = Path(__file__).parents[3] / "docs/reference/parameters.md"
BEGIN, END = "<!-- parameters: begin -->\n", "<!-- parameters: end -->"
RENEW = "renew it: WRITE_DOCS=1 .venv/bin/pytest tests/unit/project/test_parameter_reference.py"


def nodes() -> dict[str, Any]:
    """Return the nodes of the graph and their configuration classes; those of both cameras once, without the side."""
    return {
        re.sub(r"_(left|right)$", "", program.name): config_class(program)
        for program in programs("bench")
        if program.is_node
    }


def text_of(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(text_of, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value) or '""'


def kind_of(item: ConfigItem) -> str:
    if typing.get_origin(item.kind) is tuple:
        return f"{typing.get_args(item.kind)[0].__name__}[]"
    return str(item.kind.__name__)


def limits_of(item: ConfigItem) -> str:
    info = item.setting
    if info.choices:
        return ", ".join(choice or '""' for choice in info.choices)
    if info.minimum is None or info.maximum is None:
        return ""
    return f"{info.minimum:g} to {info.maximum:g}"


def row(item: ConfigItem) -> str:
    info = item.setting
    given = {f"{info.clock} clock": info.clock, "read only": info.read_only, "safety": info.guards}
    marks = [mark for mark, holds in given.items() if holds]
    cells = [
        f"`{item.name}`",
        kind_of(item),
        text_of(item.default),
        limits_of(item),
        info.unit,
        ", ".join(marks),
    ]
    return " | ".join(["", *(cell.replace("|", r"\|") for cell in [*cells, info.description]), ""]).strip()


def tables() -> str:
    """Return a heading and a table for each node."""
    parts = []
    for name, config in sorted(nodes().items()):
        rows = [row(item) for item in sorted(settings_of(config), key=lambda item: item.name)]
        head = ["| parameter | type | default | range | unit | notes | meaning |", "|---|---|---|---|---|---|---|"]
        parts.append("\n".join([f"## {name}", "", *head, *rows]))
    return "\n\n".join(parts)


def test_page_lists_every_parameter_as_it_is_declared() -> None:
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    shown, _, after = rest.partition(END)
    if os.environ.get("WRITE_DOCS"):
        PAGE.write_text(f"{before}{BEGIN}{tables()}\n{END}{after}", encoding="utf-8")
        return
    assert shown.strip() == tables(), RENEW


def test_a_row_has_default_range_unit_and_notes() -> None:
    items = {item.name: item for item in settings_of(nodes()["ui_bridge"])}
    assert row(items["silence_stop_s"]) == (
        "| `silence_stop_s` | float | 0.6 | 0.1 to 2 | s | wall clock, safety | "
        "Silence of the operator's page after which the bridge stops a motion |"
    )
    assert row(items["token_role"]).startswith(
        "| `token_role` | str | operator | viewer, operator, engineer |  | read only |"
    )
