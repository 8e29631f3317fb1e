"""Each class of ``src`` has a name of its own, so that a search, a log or a traceback leads to one class."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

SRC = Path(__file__).parents[3] / "src"


def classes_below(folder: Path) -> dict[str, list[str]]:
    """Return the positions of all classes by name, also of private and of nested ones."""
    found = defaultdict(list)
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                found[node.name].append(f"{path.relative_to(folder)}:{node.lineno}")
    return found


def shared(classes: dict[str, list[str]]) -> dict[str, list[str]]:
    return {name: places for name, places in classes.items() if len(places) > 1}


def test_no_two_classes_share_a_name() -> None:
    classes = classes_below(SRC)
    assert len(classes) > 500
    assert shared(classes) == {}, "name each by what it is a part of, such as MockMachine or StatusReport"


def test_a_shared_name_is_found(tmp_path: Path) -> None:
    (tmp_path / "package").mkdir()
    (tmp_path / "board.py").write_text("class Board:\n    class _Row:\n        pass\n")
    (tmp_path / "package" / "board.py").write_text("class Board:\n    pass\n\n\nclass _Row:\n    pass\n")
    assert shared(classes_below(tmp_path)) == {
        "Board": ["board.py:1", "package/board.py:1"],
        "_Row": ["board.py:2", "package/board.py:5"],
    }
