"""Values that each command passes to the machine: every value, none exchanged with another."""

from __future__ import annotations

from typing import Any

import pytest

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.guard.commands import COMMANDS
from gantry_driver.core.guard.messages import config_values, waypoint_values
from gantry_driver.core.machine.machine import Machine
from icu_common.core.goals.intent import Intent

NOW = 7.5
PLANE = PanelPlane(at_m=(0.1, 0.2, 0.03), slope=(0.01, 0.02), covariance=(1e-8, 0, 0, 0, 1e-6, 0, 0, 0, 1e-6))
CONFIG = DriverConfig(feed_m_s=0.01)
POINTS = [Waypoint(positions_m=(0.1, 0.2, 0.0), velocities_m_s=(0.01, 0.0, 0.0), time_s=0.5)]


class Recorder:
    """Writes down each call of a machine's methods and answers with their names."""

    def __init__(self, wall_s: float | None = None) -> None:
        self.wall_s = wall_s
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def __getattr__(self, name: str) -> Any:
        def call(*positional: Any, **named: Any) -> str:
            self.calls.append((name, positional, named))
            return f"the answer to {name}"

        return call


def called(name: str, wall_s: float | None = None, **values: Any) -> tuple[str, tuple[Any, ...], dict[str, Any]]:
    machine = Recorder(wall_s)
    answer = COMMANDS[name](machine, NOW, values)  # type: ignore[arg-type]
    assert answer in (None, f"the answer to {name}")
    (call,) = machine.calls
    return call


@pytest.mark.parametrize(
    ("name", "values", "passed"),
    [
        ("home", {}, (NOW,)),
        ("reset", {}, (NOW,)),
        ("accept_settings", {}, (NOW,)),
        ("write_settings", {}, (NOW,)),
        ("unrest", {}, ()),
        ("seen_clear", {"height_m": 0.02, "age_s": 0.5}, (0.02, 0.5)),
        ("panel", {"plane": PLANE.values(), "age_s": 0.5}, (PLANE, 0.5, NOW)),
        ("rivals", {"topic": "panel/pose", "text": "two programs"}, ("panel/pose", "two programs", NOW)),
        ("enable", {"on": True}, (True, NOW)),
        ("enable", {"on": False}, (False, NOW)),
        ("activate", {"on": True}, (True, NOW)),
        ("activate", {"on": False}, (False, NOW)),
        ("configure", {"config": config_values(CONFIG)}, (CONFIG, NOW)),
    ],
)
def test_a_command_passes_its_values_in_order(name: str, values: dict[str, Any], passed: tuple[Any, ...]) -> None:
    assert called(name, **values) == (name, passed, {})


@pytest.mark.parametrize(
    "name", ["home", "reset", "accept_settings", "write_settings", "seen_clear", "panel", "unrest", "enable"]
)
def test_the_machine_s_answer_is_the_command_s(name: str) -> None:
    values = {"height_m": 0.02, "age_s": 0.5, "plane": PLANE.values(), "on": True}
    assert COMMANDS[name](Recorder(), NOW, values) == f"the answer to {name}"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("extra", "distrust", "intent"),
    [
        ({}, "", Intent.PRESS),
        ({"distrust": "two programs", "intent": "turn"}, "two programs", Intent.TURN),
    ],
)
def test_a_trajectory_arrives_with_its_intent_and_why_it_is_not_trusted(
    extra: dict[str, str], distrust: str, intent: Intent
) -> None:
    values: dict[str, Any] = {
        "goal_id": "g",
        "names": ["x", "y", "z"],
        "points": waypoint_values(POINTS),
        "age_s": 0.25,
        **extra,
    }
    name, positional, named = called("run", **values)
    assert (name, positional) == ("run", ("g", ["x", "y", "z"], POINTS))
    assert named == {"age_s": 0.25, "now": NOW, "distrust": distrust, "intent": intent}


@pytest.mark.parametrize(("wall_s", "at_s"), [(None, NOW - 0.25), (100.0, 99.75)])
def test_a_heartbeat_was_given_before_now_by_its_age(wall_s: float | None, at_s: float) -> None:
    assert called("heartbeat", wall_s, age_s=0.25) == ("heartbeat", (at_s,), {})


def test_the_status_has_state_values_and_settings() -> None:
    machine = Machine(DriverConfig())
    status = COMMANDS["status"](machine, NOW, {})
    assert status == {
        "state": "disconnected: not opened yet",
        "codes": (),
        "values": machine.diagnostics(),
        "settings": machine.settings_text(),
    }


def test_the_commands_are_these() -> None:
    assert sorted(COMMANDS) == [
        *("accept_settings", "activate", "configure", "enable", "heartbeat", "home", "panel", "reset", "rivals", "run"),
        *("seen_clear", "status", "unrest", "write_settings"),
    ]
