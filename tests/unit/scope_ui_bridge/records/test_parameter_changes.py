"""The command log of every page and the audit file show changed parameters, and count the rest of a flood."""

from __future__ import annotations

from scope_ui_bridge.core.effects import Broadcast, Now, Record
from scope_ui_bridge.core.records import CommandLog, ParameterChanges
from scope_ui_bridge.core.records.parameter_changes import MOST, WITHIN_S


def at(seconds: float) -> Now:
    return Now(mono_s=seconds, ros_ns=0, wall_s=1000.0 + seconds)


def test_change_is_shown_and_recorded() -> None:
    log = CommandLog()
    changes = ParameterChanges(log)
    effects = changes.changed("/gantry/serial_driver", "lift_on_stop", "false", at(1.0))
    assert effects[0] == Record(
        record={
            "wall_s": 1001.0,
            "who": "/gantry/serial_driver",
            "command": "parameter",
            "target": "lift_on_stop = false",
            "result": "done",
        }
    )
    assert isinstance(effects[1], Broadcast) and effects[1].message["entry"]["target"] == "lift_on_stop = false"
    assert [entry["status"] for entry in log.messages()] == ["done"] and not log.waiting


def test_flood_is_counted() -> None:
    changes = ParameterChanges(CommandLog())
    shown = [changes.changed("/a", "x", str(i), at(1.0 + i / 1000)) for i in range(500)]
    assert [bool(effects) for effects in shown] == [True] * MOST + [False] * (500 - MOST)
    (line, _) = changes.changed("/a", "x", "last", at(1.1 + WITHIN_S))
    assert isinstance(line, Record) and line.record["omitted"] == 500 - MOST
    (line, _) = changes.changed("/a", "x", "more", at(1.2 + WITHIN_S))
    assert isinstance(line, Record) and "omitted" not in line.record
