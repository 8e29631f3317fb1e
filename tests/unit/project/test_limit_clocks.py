"""Which clock measures which limit: the declarations of all nodes; docs/reference/parameters.md shows them."""

from __future__ import annotations

import re

from unit.icu_bringup.graph_programs import config_class, programs

from icu_common.core.configuration.config import GRAPH_TIME, WALL_TIME, settings_of

GUARDS = {
    "camera.retry_max_s",
    "camera.retry_min_s",
    "gantry_controller.heartbeat_timeout_s",
    "serial_driver.heartbeat_timeout_s",
    "serial_driver.node_silence_s",
    "ui_bridge.jog_hold_s",
    "ui_bridge.keepalive_fresh_s",
    "ui_bridge.lease_timeout_s",
    "ui_bridge.session_lifetime_s",
    "ui_bridge.sign_in_warning_s",
    "ui_bridge.silence_stop_s",
}
"""All that the wall clock measures: they guard people, or wait for a device."""


def limits() -> dict[str, tuple[str, str]]:
    """Return node.parameter -> default and clock of every duration of the graph."""
    found = {}
    for program in programs("bench"):
        if program.is_node:
            for item in settings_of(config_class(program)):
                if item.setting.unit == "s":
                    name = re.sub(r"_(left|right)$", "", program.name)
                    found[f"{name}.{item.name}"] = (f"{item.default:g}", item.setting.clock)
    return dict(sorted(found.items()))


def test_every_duration_has_a_clock_and_only_guards_have_the_wall_s() -> None:
    clocks = {name: clock for name, (_, clock) in limits().items()}
    assert len(clocks) > 50
    assert set(clocks.values()) == {GRAPH_TIME, WALL_TIME}
    assert {name for name, clock in clocks.items() if clock == WALL_TIME} == GUARDS
