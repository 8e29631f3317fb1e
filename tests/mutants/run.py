"""Mutation test of the guard's pure rooms: ``python -m mutants.run``.

Each mutant is one small change of a module. The module's tests run in a fork of a process that has collected them; a
mutant that no test detects survives. Each survivor needs a line with its reason in
``docs/decisions/guard-mutants.md``: the exit code is 1 if one has none, or if a line names no survivor.
"""

from __future__ import annotations

import argparse
import gc
import importlib.machinery
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest
from mutants.child import answer_of
from mutants.operators import Mutant, mutants

ROOT = Path(__file__).parents[2]
CORE = ROOT / "src/gantry_driver/gantry_driver/core"
TESTS = ROOT / "tests/unit/gantry_driver"
ROOMS = {
    "guard": ["guard"],
    "envelope": ["envelope", "configuration"],
}
"""Folder of ``core`` -> the tests that must detect each change of it."""
SOURCES = {"guard": ["guard/*.py"], "envelope": ["envelope/*.py", "configuration/envelope_config.py"]}
"""The same folder -> the modules that are changed."""
REASONS = ROOT / "docs/decisions/guard-mutants.md"
TEST_S, MUTANT_S = 20, 120.0
"""Maximum seconds of one test, and of all tests of a mutant."""
SLOW_S = 10.0
"""Seconds after which a detected mutant is judged again; all tests of a room take less."""
DETECTED, SURVIVED, SAME = "detected", "survived", "same code"
OPTIONS = ["-q", "-x", "-s", "--no-header", "--tb=line", "-p", "no:xdist", f"--timeout={TEST_S}"]


@dataclass(frozen=True)
class Change:
    """A mutant, the file of its module, and the folder whose tests must detect it."""

    mutant: Mutant
    path: Path
    room: str

    @property
    def name(self) -> str:
        return f"{self.path.relative_to(CORE).as_posix()} {self.mutant.name}"


@dataclass
class Results:
    """Result of each mutant."""

    total: int
    counts: Counter[str] = field(default_factory=Counter)
    survivors: list[str] = field(default_factory=list)

    def note(self, change: Change, answer: str) -> None:
        """Count a result; a child without an answer ended or took too long, which a person would have seen."""
        answer = answer or DETECTED
        self.counts[answer] += 1
        if answer == SURVIVED:
            self.survivors.append(change.name)
            print(f"survived  {change.name}", flush=True)
        if sum(self.counts.values()) % 100 == 0:
            print(f"{sum(self.counts.values())} of {self.total}", flush=True)


class Loop:
    """A plugin of pytest: it runs the collected tests once for each mutant, the fastest ones first."""

    def __init__(self, changes: Sequence[Change], results: Results) -> None:
        self._changes, self._results = changes, results

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        order = answer_of(lambda: _timed(session), 3.0 * MUTANT_S).split("\n")
        if len(order) != len(session.items):
            raise pytest.UsageError(f"a test fails without a mutant: {order[-1] or 'it took too long'}")
        session.items.sort(key=lambda item: order.index(item.nodeid))
        gc.unfreeze()  # conftest.py hides them
        functions = [f for f in gc.get_objects() if isinstance(f, FunctionType)]
        for change in self._changes:
            own = [f for f in functions if f.__code__.co_filename == str(change.path)]
            if not own:
                raise pytest.UsageError(f"no test has imported {change.path}")
            items = [item for item in session.items if any(item.path.is_relative_to(p) for p in _tests(change.room))]
            work = partial(_judged, session, items, own, change.mutant.code)
            self._results.note(change, confirmed(partial(answer_of, work, MUTANT_S)))
        return True


def confirmed(judge: Callable[[], str], clock: Callable[[], float] = time.monotonic) -> str:
    """Return a judgement; one that took long is made again, because on a computer that was held up any test fails."""
    begun = clock()
    answer = judge()
    return judge() if answer != SURVIVED and clock() - begun > SLOW_S else answer


def _tests(room: str) -> list[Path]:
    return [TESTS / name for name in ROOMS[room]]


def _timed(session: pytest.Session) -> str:
    seconds: dict[str, float] = {}
    for item, begun in _run(session, session.items):
        seconds[item.nodeid] = time.monotonic() - begun
        if session.testsfailed:
            return item.nodeid
    return "\n".join(sorted(seconds, key=lambda name: seconds[name]))


def _judged(session: pytest.Session, items: list[pytest.Item], functions: list[FunctionType], module: CodeType) -> str:
    codes = {(code.co_name, code.co_firstlineno): code for code in _codes(module)}
    changed = False
    for function in functions:
        code = codes.get((function.__code__.co_name, function.__code__.co_firstlineno))
        if code is not None and code != function.__code__:
            function.__code__, changed = code, True
    if not changed:
        return SAME
    for _ in _run(session, items):
        if session.testsfailed:
            return DETECTED
    return SURVIVED


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for value in code.co_consts:
        if isinstance(value, CodeType):
            yield from _codes(value)


def _run(session: pytest.Session, items: Sequence[pytest.Item]) -> Iterator[tuple[pytest.Item, float]]:
    """Run the tests one by one; yield each after its end, and the time at which it began."""
    for item, after in zip(items, [*items[1:], None]):
        begun = time.monotonic()
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
        yield item, begun


def _imported(change: Change) -> str:
    """Run the tests with a change that takes effect when the module is imported."""
    code_of = importlib.machinery.SourceFileLoader.get_code

    def get_code(loader: Any, name: str) -> CodeType | None:
        return change.mutant.code if loader.path == str(change.path) else code_of(loader, name)

    importlib.machinery.SourceFileLoader.get_code = get_code  # type: ignore[assignment,method-assign]
    return SURVIVED if pytest.main([*OPTIONS, *map(str, _tests(change.room))]) == 0 else DETECTED


def changes(wanted: Callable[[str], bool]) -> Iterator[Change]:
    """Yield the mutants of all rooms whose names are wanted."""
    for room in ROOMS:
        for path in (path for pattern in SOURCES[room] for path in sorted(CORE.glob(pattern))):
            for mutant in mutants(path.read_text(), str(path)):
                if wanted((change := Change(mutant, path, room)).name):
                    yield change


def reasons() -> dict[str, str]:
    """Return the reason of each survivor that the page lists: two columns of a table, the first one in code marks."""
    rows = [line.strip("|\n").split(" | ", 1) for line in REASONS.read_text().splitlines() if line.startswith("| `")]
    return {place.strip(" `").replace("\\|", "|"): reason.strip() for place, reason in rows}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="mutants.run", description=__doc__)
    parser.add_argument("--only", default="", metavar="TEXT", help="only mutants whose name has this text")
    options = parser.parse_args(arguments)
    chosen = list(changes(lambda name: options.only in name))
    results, begun = Results(len(chosen)), time.monotonic()
    for change in chosen:
        if not change.mutant.inside:
            results.note(change, answer_of(lambda c=change: _imported(c), MUTANT_S))  # type: ignore[misc]
    inside = [change for change in chosen if change.mutant.inside]
    if inside:
        paths = [str(path) for room in sorted({c.room for c in inside}) for path in _tests(room)]
        if (code := pytest.main([*OPTIONS, *paths], plugins=[Loop(inside, results)])) != 0:
            print(f"error: pytest ended with {code}", file=sys.stderr)
            return 1
    listed = reasons()
    unlisted = [name for name in results.survivors if not listed.get(name)]
    gone = [name for name in listed if options.only in name and name not in results.survivors]
    print(f"{dict(results.counts)} in {time.monotonic() - begun:.0f} s")
    for text, names in (("survivor without a reason", unlisted), ("no survivor, but listed", gone)):
        for name in names:
            print(f"{text}: {name}")
    return 1 if unlisted or gone else 0


if __name__ == "__main__":
    raise SystemExit(main())
