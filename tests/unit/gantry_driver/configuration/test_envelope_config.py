"""Limits of the space at the panel: a change of a default or a bound must change this test too."""

from __future__ import annotations

import dataclasses

import pytest

from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from icu_common.core.configuration.config import ConfigError, settings_of

LIMITS = {
    "free_space_m": (0.016, 0.0, 0.2, "m"),
    "crossing_m": (0.005, 0.0, 0.2, "m"),
    "side_height_m": (0.005, 0.001, 0.05, "m"),
    "correction_m": (0.007, 0.0, 0.05, "m"),
    "max_sigma_m": (0.0005, 1e-5, 0.001, "m"),
    "max_age_s": (60.0, 1.0, 600.0, "s"),
}
"""Name -> default, minimum, maximum and unit; docs/explanation/guard.md has the reasons."""


def test_each_limit_has_its_value_and_its_bounds() -> None:
    found = {
        i.name: (i.default, i.setting.minimum, i.setting.maximum, i.setting.unit) for i in settings_of(EnvelopeConfig)
    }
    assert found == LIMITS


@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_takes_the_ends_of_its_range_and_nothing_outside(name: str) -> None:
    _, minimum, maximum, _ = LIMITS[name]
    for value in (minimum, maximum):
        assert getattr(EnvelopeConfig(**{name: value}), name) == value
    for value in (minimum - 1e-9, maximum + 1e-9):
        with pytest.raises(ConfigError, match=f"^{name} = "):
            EnvelopeConfig(**{name: value})


def test_the_limits_of_a_driver_cannot_change_in_place() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        EnvelopeConfig().max_age_s = 1.0  # type: ignore[misc]


def test_each_limit_guards_for_a_reason_of_its_own() -> None:
    reasons = [item.setting.guards for item in settings_of(EnvelopeConfig)]
    assert all(len(reason.split()) >= 4 for reason in reasons) and len(set(reasons)) == len(LIMITS)
