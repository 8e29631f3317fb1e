"""Each test is in one tier: `make test`, or what `make test-all` adds. `make test-quick` is a part of `make test`."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest
from _pytest.mark.expression import Expression

ROOT = Path(__file__).resolve().parents[3]
MAKEFILE = (ROOT / "Makefile").read_text()
TESTS = ROOT / "tests"
FOLDERS = sorted({"/".join(path.relative_to(ROOT).parts[:2]) for path in TESTS.rglob("test_*.py")})
MARKERS = ("slow", "long", "alone")


def runs_of(target: str) -> list[tuple[str, Expression]]:
    """Return the folder and the choice of markers of each call of pytest in a target of the Makefile."""
    recipe = re.search(rf"^{target}:.*\n((?:\t.*\n)+)", MAKEFILE, re.MULTILINE)
    assert recipe, target
    found = re.findall(r'(?<=\s)(tests\S*) -m "([^"]+)"', recipe[1])
    assert found and len(found) == recipe[1].count(" -m "), recipe[1]
    return [(folder, Expression.compile(choice)) for folder, choice in found]


def times(target: str, folder: str, marks: tuple[str, ...]) -> int:
    """Return how often a target runs a test of a folder with these markers."""
    return sum(
        f"{folder}/".startswith(f"{root}/") and choice.evaluate(lambda name, **_: name in marks)
        for root, choice in runs_of(target)
    )


def kinds() -> list[tuple[str, tuple[str, ...]]]:
    """Return each folder of tests with each set of markers that its tests may have."""
    sets = [marks for size in range(len(MARKERS) + 1) for marks in itertools.combinations(MARKERS, size)]
    return [
        (folder, marks) for folder in FOLDERS for marks in sets if "alone" not in marks or _may_be_alone(folder, marks)
    ]


def _may_be_alone(folder: str, marks: tuple[str, ...]) -> bool:
    return folder == "tests/system" or (folder == "tests/nodes" and "long" in marks)


def files_with(marker: str) -> set[str]:
    return {
        "/".join(path.relative_to(ROOT).parts[:2])
        for path in TESTS.rglob("test_*.py")
        if re.search(rf"\bpytest\.mark\.{marker}\b(?!\")", path.read_text()) and path != Path(__file__)
    }


@pytest.mark.parametrize(
    ("folder", "marks"), kinds(), ids=lambda value: value if isinstance(value, str) else "+".join(value)
)
def test_each_test_is_in_one_tier(folder: str, marks: tuple[str, ...]) -> None:
    assert times("test", folder, marks) + times("test-long", folder, marks) == 1
    assert times("test-long", folder, marks) == ("long" in marks)


@pytest.mark.parametrize(
    ("folder", "marks"), kinds(), ids=lambda value: value if isinstance(value, str) else "+".join(value)
)
def test_quick_tests_are_unit_tests_of_the_second_tier(folder: str, marks: tuple[str, ...]) -> None:
    quick = folder == "tests/unit" and not {"slow", "long", "alone"} & {*marks}
    assert times("test-quick", folder, marks) == quick
    assert times("test", folder, marks) >= quick


def test_tests_of_the_system_and_long_ones_of_nodes_run_alone_and_only_unit_tests_are_slow() -> None:
    assert files_with("alone") == {"tests/nodes", "tests/system"}
    for path in (TESTS / "nodes").rglob("test_*.py"):
        marks = re.findall(r"pytest\.mark\.(alone|long)\b", path.read_text())
        assert "alone" not in marks or sorted(set(marks)) == ["alone", "long"], path
    assert files_with("slow") == {"tests/unit"}, "elsewhere the marker chooses nothing"


def test_all_is_test_and_the_rest_and_continuous_integration_runs_both() -> None:
    assert re.search(r"^test-all: test test-rest\b", MAKEFILE, re.MULTILINE)
    assert re.search(r"^test-rest: test-long\b", MAKEFILE, re.MULTILINE)
    assert re.findall(r"^tier (\S+)$", (ROOT / ".ci" / "run").read_text(), re.MULTILINE) == ["test", "test-long"]
