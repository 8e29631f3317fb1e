"""Sub-packages: each has a map of its modules, few enough to read, and the operator page's meet by public names.

The folders of tests are small enough to read, too, no test module imports from another one, and what tests of several
folders share is in tests/support.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SRC = Path(__file__).parents[3] / "src"
TESTS = Path(__file__).parents[2]
SUPPORT = TESTS / "support"
CORES = [SRC / package / package / "core" for package in ("harris_perception", "scope_ui_bridge")]
BRIDGE = SRC / "scope_ui_bridge" / "scope_ui_bridge"
ROOMS = sorted(path.parent for folder in [*CORES, BRIDGE / "adapters"] for path in folder.glob("*/__init__.py"))
MAX_MODULES = 15


def modules_of(folder: Path) -> set[str]:
    return {path.stem for path in folder.glob("*.py")} - {"__init__"}


def map_of(folder: Path) -> str:
    return ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""


def bridge_imports() -> list[tuple[Path, str, list[str]]]:
    """Return each import in the operator page's package: file, module and names."""
    return [
        (path, node.module, [alias.name for alias in node.names])
        for path in sorted(BRIDGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module
    ]


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: f"{room.parts[-3]}-{room.name}")
def test_map_names_every_module_of_its_room(room: Path) -> None:
    missing = {name for name in modules_of(room) if f"``{name}``" not in map_of(room)}
    assert not missing, f"name them in {room / '__init__.py'}, in the sentence of what they do"


@pytest.mark.parametrize("folder", ["core", "adapters", "nodes"])
def test_map_names_every_room_and_module(folder: str) -> None:
    whole = BRIDGE / folder
    rooms = {path.parent.name for path in whole.glob("*/__init__.py")} | modules_of(whole)
    assert {name for name in rooms if f"``{name}``" not in map_of(whole)} == set()


def test_no_folder_of_the_operator_page_has_more_files_than_can_be_read() -> None:
    for folder in {path.parent for path in BRIDGE.rglob("*") if path.suffix in (".py", ".js")}:
        found = [path for path in folder.iterdir() if path.is_file() and path.name != "__init__.py"]
        assert len(found) <= MAX_MODULES, f"{folder}: {len(found)} files"


def test_room_says_what_enters_and_what_leaves() -> None:
    for room in (BRIDGE / "core").glob("*/__init__.py"):
        assert "Enters: " in map_of(room.parent) and "Leaves: " in map_of(room.parent), room


def test_rooms_of_the_operator_page_are_imported_by_their_public_names() -> None:
    rooms = {
        f"scope_ui_bridge.core.{path.parent.name}": path.parent for path in (BRIDGE / "core").glob("*/__init__.py")
    }
    past_the_door = [
        f"{path.relative_to(BRIDGE)}: {module}"
        for path, module, names in bridge_imports()
        for room, folder in rooms.items()
        if folder not in path.parents
        and (module.startswith(f"{room}.") or (module == room and set(names) & modules_of(folder)))
    ]
    assert past_the_door == []


def test_no_folder_of_tests_has_more_files_than_can_be_read() -> None:
    modules = sorted(TESTS.rglob("*.py"))
    assert modules
    for folder in {path.parent for path in modules}:
        found = [path for path in folder.iterdir() if path.is_file()]
        assert len(found) <= MAX_MODULES, f"{folder}: {len(found)} files"


def test_no_test_module_imports_from_another() -> None:
    """Code that several tests share is in a module of its own, which can be read and moved without those tests."""
    imported = [
        (path, name)
        for path in sorted(TESTS.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for name in [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
    ]
    assert imported
    test_modules = {path.stem for path in TESTS.rglob("test_*.py")}
    found = [f"{path.relative_to(TESTS)}: {name}" for path, name in imported if name.rpartition(".")[2] in test_modules]
    assert found == []


def test_shared_helpers_are_in_one_package() -> None:
    """Pytest's own file is the only one above the folders of tests."""
    assert {path.name for path in TESTS.glob("*.py")} == {"conftest.py"}
    assert {name for name in modules_of(SUPPORT) if f"``{name}``" not in map_of(SUPPORT)} == set()
    assert {path.name for path in SUPPORT.glob("test_*.py")} == set()


def test_shared_helpers_have_docstrings() -> None:
    without = [
        f"{path.name}:{node.lineno} {node.name}"
        for path in sorted(SUPPORT.glob("*.py"))
        for owner in ast.walk(ast.parse(path.read_text()))
        if isinstance(owner, (ast.Module, ast.ClassDef))
        for node in owner.body
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef))
        and not node.name.startswith("_")
        and not ast.get_docstring(node)
    ]
    assert without == []


def test_shared_helper_is_not_used_by_one_folder_only() -> None:
    """A helper of one folder is next to its tests."""
    users: dict[str, set[str]] = {name: set() for name in modules_of(SUPPORT)}
    for path in [*TESTS.rglob("*.py"), *(TESTS.parent / "benchmarks").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                package, _, module = node.module.partition(".")
                for name in [module] if module else [alias.name for alias in node.names]:
                    if package == "support" and name in users:
                        users[name].add(str(path.parent.relative_to(TESTS.parent)))
    assert {name: found for name, found in users.items() if len(found) < 2} == {}
