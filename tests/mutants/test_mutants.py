"""The changes that the mutation test makes, and the process in which it judges them."""

from __future__ import annotations

import os
import signal
import time

import pytest
from mutants.child import answer_of
from mutants.operators import mutants
from mutants.run import DETECTED, REASONS, SLOW_S, SURVIVED, changes, confirmed, reasons

SOURCE = '''"""A module."""
from __future__ import annotations
LIMIT: float = 0.5
@dataclass(frozen=True, slots=True)
class Box:
    """A box."""
    size: int | None = 0
    def larger(self, other: Box) -> bool:
        """Compare."""
        if not other:
            return False
        return self.size < other.size and self.size >= 2
'''


def test_each_change_is_made_once_and_text_and_annotations_are_left_alone() -> None:
    found = list(mutants(SOURCE, "box.py"))
    assert [m.name for m in found if not m.inside] == [
        "module: LIMIT: float = 0.5 -> LIMIT: float = 1.0",
        "module: LIMIT: float = 0.5 -> LIMIT: float = 0.25",
        "Box: size: int | None = 0 -> size: int | None = 1",
        "Box: size: int | None = 0 -> size: int | None = -1",
        "Box: dataclass(frozen=True, slots=True) -> dataclass(frozen=False, slots=True)",
    ]
    compared = "self.size < other.size and self.size >= 2"
    assert [m.name.removeprefix("Box.larger: ") for m in found if m.inside] == [
        "if not other -> if other",
        "return False -> return None",
        "return False -> return True",
        f"return {compared} -> return None",
        f"return {compared} -> return self.size < other.size or self.size >= 2",
        f"return {compared} -> return self.size >= 2",
        f"return {compared} -> return self.size < other.size",
        f"{compared} -> self.size <= other.size and self.size >= 2",
        f"{compared} -> self.size >= other.size and self.size >= 2",
        f"{compared} -> self.size < other.size and self.size > 2",
        f"{compared} -> self.size < other.size and self.size < 2",
        f"{compared} -> self.size < other.size and self.size >= 3",
        f"{compared} -> self.size < other.size and self.size >= 1",
    ]


def test_every_reason_belongs_to_a_change_and_says_something() -> None:
    listed = reasons()
    assert REASONS.exists() and set(listed) <= {change.name for change in changes(lambda name: True)}
    assert all(len(reason.split()) >= 2 for reason in listed.values())


def test_a_child_answers_and_what_it_changes_is_gone() -> None:
    values: list[int] = []

    def work() -> str:
        values.append(1)
        return f"{len(values)} in {os.getpid()}"

    answer = answer_of(work, 30.0)
    assert answer.startswith("1 in ") and answer != f"1 in {os.getpid()}" and values == []


def test_a_child_that_ends_or_hangs_answers_nothing() -> None:
    def ends() -> str:
        os.kill(os.getpid(), signal.SIGKILL)
        return "never"

    def fails() -> str:
        raise ValueError

    def hangs() -> str:
        signal.pause()
        return "never"

    begun = time.monotonic()
    assert [answer_of(work, 0.2) for work in (ends, fails, hangs)] == ["", "", ""]
    assert time.monotonic() - begun < 30.0


@pytest.mark.parametrize(
    ("answers", "took_s", "result"),
    [
        ([DETECTED], SLOW_S, DETECTED),
        ([DETECTED, SURVIVED], SLOW_S + 1.0, SURVIVED),
        (["", DETECTED], SLOW_S + 1.0, DETECTED),
        ([SURVIVED], SLOW_S + 1.0, SURVIVED),
    ],
)
def test_a_detection_that_took_long_is_made_again(answers: list[str], took_s: float, result: str) -> None:
    times, given = iter([0.0, took_s]), iter(answers)
    assert confirmed(lambda: next(given), lambda: next(times)) == result
    assert list(given) == [], "no more often than that"
