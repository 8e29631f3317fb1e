"""Configurations validate themselves and say what is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from icu_common.core.configuration.config import (
    Config,
    ConfigError,
    from_mapping,
    nested,
    setting,
    settings_of,
    to_mapping,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Part(Config):
    gain: float = setting(1.0, "gain", minimum=0.0, maximum=2.0, unit="V")


@dataclass(frozen=True, slots=True, kw_only=True)
class Whole(Config):
    count: int = setting(3, "count", minimum=1)
    names: tuple[str, ...] = setting(("a",), "names")
    part: Part = nested(Part)


def test_mapping_round_trip() -> None:
    config = from_mapping(Whole, {"count": 5, "part.gain": 2, "names": ["x", "y"]})
    assert config == Whole(count=5, names=("x", "y"), part=Part(gain=2.0))
    assert from_mapping(Whole, to_mapping(config)) == config
    assert [item.name for item in settings_of(Whole)] == ["count", "names", "part.gain"]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"count": 0}, "count = 0 is below its minimum 1"),
        ({"part.gain": 2.5}, "gain = 2.5 is above its maximum 2 V"),
        ({"part.gain": float("inf")}, "not finite"),
        pytest.param({"part.gain": 10**400}, "gain = 10+ is not finite", id="beyond a float"),
        pytest.param({"part.gain": -(10**400)}, "gain = -10+ is not finite", id="below a float"),
        ({"count": 2**63}, f"count = {2**63} does not fit into 64 bits"),
        pytest.param({"count": 10**400}, "count = 10+ does not fit into 64 bits", id="beyond an integer"),
        ({"count": True}, "expected int"),
        ({"count": 1.5}, "expected int"),
        ({"names": [1]}, "expected str"),
        ({"names": 3}, "names = 3; expected a tuple of str"),
        ({"names": None}, "names = None; expected a tuple of str"),
        ({"cuont": 1}, "no setting cuont; it has count, names, part.gain"),
    ],
)
def test_refusals_name_value_and_bound(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        from_mapping(Whole, values)
