"""Every parameter of every node: numbers have bounds, all have a description, and safety parameters are listed."""

from __future__ import annotations

import ast
import importlib
import math
import pkgutil
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.contact.config import ContactConfig, HeightConfig
from gantry_driver.core.job.controller_config import ControllerConfig
from icu_common.core.configuration.config import Config, ConfigError, ConfigItem, from_mapping, settings_of
from scope_ui_bridge.core.config import BridgeConfig

PACKAGES = ("icu_common", "harris_perception", "gantry_driver", "scope_ui_bridge", "icu_simulator", "icu_bringup")
ENVELOPE = {"free_space_m", "crossing_m", "side_height_m", "correction_m", "max_sigma_m", "max_age_s"}
GUARDS = {
    EnvelopeConfig: ENVELOPE,
    ContactConfig: {"max_travel_m", "lag_m", "height.max_offset_m"},
    HeightConfig: {"max_offset_m"},
    DriverConfig: {
        *("heartbeat_timeout_s", "moving_status_rate_hz", "touch_status_rate_hz", "status_timeout_s"),
        *("hold_timeout_s", "homing_timeout_s", "goal_max_age_s", "max_rest_extended_s", "lift_on_stop"),
        *("attendance_timeout_s", "node_silence_s"),
        *(f"envelope.{name}" for name in ENVELOPE),
    },
    ControllerConfig: {
        *("max_error_m", "max_correction_m", "max_depth_error_m", "require_servo", "state_max_age_s"),
        *("hidden_after_s", "motion_timeout_s", "goal_max_age_s", "heartbeat_timeout_s", "joints_timeout_s"),
        *("camera_timeout_s", "slow_limit_max_s", "min_confidence", "panel_max_age_s", "panel_moved_m"),
        *("pair_max_age_s", "pair_max_turn_px", "max_uncertainty_m"),
        *("seen_clear_m", "contact.max_travel_m", "contact.lag_m", "contact.height.max_offset_m"),
    },
    BridgeConfig: {
        *("frame_max_age_s", "min_confidence", "recognition_max_age_s", "panel_moved_limit_m", "keepalive_fresh_s"),
        *("silence_stop_s", "picture_stop_s", "jog_hold_s", "jog_step_max_m", "lease_timeout_s"),
    },
}
"""Safety settings, listed by hand: a test fails if one loses its mark."""


def _subclasses(of: type[Config]) -> Iterator[type[Config]]:
    for one in of.__subclasses__():
        yield one
        yield from _subclasses(one)


def configurations() -> Iterator[type[Config]]:
    """Iterate over every configuration class of the project."""
    for package in PACKAGES:
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if ".core." in module.name or ".nodes." in module.name:
                importlib.import_module(module.name)
    found = list(_subclasses(Config))
    yield from (c for c in found if c.__module__.partition(".")[0] in PACKAGES)


ITEMS = {f"{c.__name__}.{i.name}": (c, i) for c in configurations() for i in settings_of(c, deep=False)}


def kind_of(item: ConfigItem) -> Any:
    return typing.get_args(item.kind)[0] if typing.get_origin(item.kind) is tuple else item.kind


def test_parameters_were_found() -> None:
    assert len(ITEMS) > 300
    assert {"DriverConfig.lift_on_stop", "BridgeConfig.silence_stop_s", "StylusConfig.kind"} <= set(ITEMS)


@pytest.mark.parametrize("name", ITEMS)
def test_parameter_has_bounds_and_a_reason(name: str) -> None:
    _, item = ITEMS[name]
    info = item.setting
    assert len(info.description.split()) >= 2 or info.description.startswith("$"), "what it is for"
    if kind_of(item) in (int, float):
        assert info.minimum is not None and info.maximum is not None
        assert math.isfinite(info.minimum) and math.isfinite(info.maximum) and info.minimum < info.maximum
        values = item.default if isinstance(item.default, tuple) else (item.default,)
        assert all(info.minimum <= value <= info.maximum for value in values)


@pytest.mark.parametrize("config_class", GUARDS)
def test_safety_settings_are_marked_with_their_reason(config_class: type[Config]) -> None:
    marked = {i.name: i.setting.guards for i in settings_of(config_class) if i.setting.guards}
    assert set(marked) == GUARDS[config_class]
    assert all(len(reason.split()) >= 4 for reason in marked.values())


def test_only_these_configurations_have_safety_settings() -> None:
    assert {c for c, item in ITEMS.values() if item.setting.guards} == set(GUARDS)


@pytest.mark.parametrize(
    ("config_class", "name", "most"),
    [
        (BridgeConfig, "keepalive_fresh_s", 1.0),
        (BridgeConfig, "silence_stop_s", 2.0),
        (BridgeConfig, "picture_stop_s", 2.0),
        (BridgeConfig, "jog_hold_s", 1.0),
        (BridgeConfig, "lease_timeout_s", 30.0),
        (DriverConfig, "heartbeat_timeout_s", 2.0),
        (ControllerConfig, "heartbeat_timeout_s", 2.0),
    ],
)
@pytest.mark.parametrize("value", [1e9, 400.0])
def test_time_limit_of_a_safety_setting_has_a_maximum_near_its_purpose(
    config_class: type[Config], name: str, most: float, value: float
) -> None:
    with pytest.raises(ConfigError, match=f"{name} = .* is above its maximum {most:g} s"):
        from_mapping(config_class, {name: value})


MOST_TIMES = 20
"""Maximum ratio of the maximum of a safety setting in seconds to its default."""


@pytest.mark.parametrize("config_class", GUARDS)
def test_no_time_limit_of_a_safety_setting_can_be_set_far_from_its_purpose(config_class: type[Config]) -> None:
    times = [i for i in settings_of(config_class) if i.setting.guards and i.setting.unit == "s"]
    far = {
        i.name: (i.default, i.setting.maximum)
        for i in times
        if float(i.setting.maximum or 0.0) > MOST_TIMES * i.default
    }
    assert far == {}


def sources() -> Iterator[tuple[Path, ast.Module]]:
    """Iterate over the modules of the graph and their syntax trees."""
    for package in PACKAGES:
        folder = Path(importlib.import_module(package).__path__[0])
        yield from ((path, ast.parse(path.read_text(encoding="utf-8"))) for path in folder.rglob("*.py"))


def test_every_parameter_of_a_node_was_looked_at() -> None:
    """A node has the parameters of its configuration and declares none by itself."""
    seen = {config_class.__name__ for config_class in configurations()}
    used, declared = set(), set()
    for path, tree in sources():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            if isinstance(node.func, ast.Name) and node.func.id == "LiveParameters":
                used.add(ast.unparse(node.args[1]))
            elif isinstance(node.func, ast.Attribute) and node.func.attr.startswith("declare_parameter"):
                declared.add(path.name)
    assert declared == {"parameters.py"}
    assert len(used) >= 13 and used <= seen
