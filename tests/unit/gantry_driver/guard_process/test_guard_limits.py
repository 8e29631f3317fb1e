"""Limits of the guard as a program: its size, and the silence that it allows its node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from unit.gantry_driver.guard_rig import Rig

import gantry_driver
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.messages import config_values, frame

MOST_LINES = 1500
"""Maximum number of lines of the guard's own modules, so that one person can read them in a day."""
OWN = ("core/guard/*.py", "adapters/guard/*.py", "cli/gantry_guard.py")


def test_the_guard_is_small_enough_to_be_read() -> None:
    package = Path(gantry_driver.__file__).parent
    files = [path for pattern in OWN for path in package.glob(pattern)]
    assert len(files) >= 10
    lines = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert sum(lines.values()) <= MOST_LINES, lines


@pytest.mark.parametrize("limit_s", [0.05, 0.2])
def test_a_changed_limit_of_silence_counts_at_once(make: Callable[..., Rig], limit_s: float) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    rig.hello(node)
    config = DriverConfig(port=str(rig.folder / "none"))
    assert rig.guard._watch.limit_s == config.node_silence_s == 0.1
    node.sendall(frame({"do": "configure", "config": config_values(replace(config, node_silence_s=limit_s))}))
    rig.turn()
    assert rig.guard._watch.limit_s == limit_s
