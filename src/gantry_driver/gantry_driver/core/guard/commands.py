"""Commands of the node to the machine, by name; the guard and a node without a guard use the same table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from gantry_driver.core.envelope.plane import plane_of
from gantry_driver.core.guard.messages import config_of, waypoints_of
from gantry_driver.core.machine.machine import Machine
from icu_common.core.goals.intent import Intent

Values = Mapping[str, Any]


def _run(machine: Machine, now: float, values: Values) -> None:
    points = waypoints_of(values["points"])
    machine.run(
        values["goal_id"],
        values["names"],
        points,
        age_s=values["age_s"],
        now=now,
        distrust=values.get("distrust", ""),
        intent=Intent(values.get("intent", Intent.PRESS)),
    )


def _status(machine: Machine, now: float, values: Values) -> dict[str, Any]:
    return {
        "state": machine.state_text,
        "codes": machine.codes(),
        "values": machine.diagnostics(),
        "settings": machine.settings_text(),
    }


def _heartbeat(machine: Machine, now: float, values: Values) -> None:
    machine.heartbeat((now if machine.wall_s is None else machine.wall_s) - values["age_s"])


COMMANDS: dict[str, Callable[[Machine, float, Values], Any]] = {
    "run": _run,
    "heartbeat": _heartbeat,
    "status": _status,
    "home": lambda machine, now, values: machine.home(now),
    "reset": lambda machine, now, values: machine.reset(now),
    "accept_settings": lambda machine, now, values: machine.accept_settings(now),
    "write_settings": lambda machine, now, values: machine.write_settings(now),
    "seen_clear": lambda machine, now, values: machine.seen_clear(values["height_m"], values["age_s"]),
    "panel": lambda machine, now, values: machine.panel(plane_of(values["plane"]), values["age_s"], now),
    "rivals": lambda machine, now, values: machine.rivals(values["topic"], values["text"], now),
    "unrest": lambda machine, now, values: machine.unrest(),
    "enable": lambda machine, now, values: machine.enable(bool(values["on"]), now),
    "activate": lambda machine, now, values: machine.activate(bool(values["on"]), now),
    "configure": lambda machine, now, values: machine.configure(config_of(values["config"]), now),
}
"""Name -> function of the machine, the time and the values; it returns JSON values."""
