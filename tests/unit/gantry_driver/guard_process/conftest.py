"""Fixtures of the tests of the guard's process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from unit.gantry_driver.guard_rig import Rig


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Callable[..., Rig]]:
    made: list[Rig] = []

    def start(**values: Any) -> Rig:
        made.append(Rig(tmp_path, **values))
        return made[-1]

    yield start
    for rig in made:
        rig.close()
