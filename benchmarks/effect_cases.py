"""Cases for measurements, made from the declarations of the simulated bench's effects.

An effect is a nested configuration of the class :class:`icu_simulator.imaging.effect.BenchEffect`: its values are its
ordinary size, ``SCALED`` names the fields that are doubled, ``SOURCE`` is the source of the sizes. The kinds of keys
are effects as well, and so are some settings whose default is no error.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from icu_common.core.configuration.config import Config, settings_of, to_mapping
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.imaging.effect import BenchEffect

NOMINAL, TWICE = "nominal", "twice"
PARTS = ("stylus.switch",)
"""Parts of the machine that can be switched on but are no effects."""
SINGLE = {
    "mechanics.z_offset_mm": (0.8, "lost steps or a bumped stylus: a quarter turn of a lead screw with 3 mm of lead"),
    "mechanics.missed_mm": ((0.2, 0.0), "one full step of a motor with 20 teeth of 2 mm"),
}
"""Settings whose default is no error, with an ordinary size and its source; they apply after the calibration."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One effect at one size: settings, whether they apply only after the calibration, and source of the size."""

    effect: str
    size: str
    values: dict[str, Any]
    later: bool
    source: str


def cases() -> list[Case]:
    """Return all cases; the first one is the bench without effects."""
    none = Case(effect="none", size=NOMINAL, values={}, later=False, source="the bench of the room")
    return [none, *_switched(BenchConfig(), ""), *_kinds_of_keys(), *_single()]


def _switched(config: Any, prefix: str) -> Iterator[Case]:
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), prefix + field.name
        if isinstance(value, BenchEffect):
            yield from _sizes(value, name)
        elif isinstance(value, Config):
            yield from _switched(value, name + ".")


def _sizes(effect: BenchEffect, name: str) -> Iterator[Case]:
    for size, factor in ((NOMINAL, 1), (TWICE, 2)):
        scaled = effect.scaled(factor)
        if size == NOMINAL or scaled != effect.scaled(1):
            values = to_mapping(scaled, name + ".")
            yield Case(effect=name, size=size, values=values, later=effect.LATER, source=effect.SOURCE)


def _times(value: Any, factor: float) -> Any:
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor


def _kinds_of_keys() -> Iterator[Case]:
    items = {item.name: item for item in settings_of(BenchConfig)}
    kinds = items["keys.kind"].setting.choices if "keys.kind" in items else ()
    keys = getattr(BenchConfig(), "keys", None)
    for kind in kinds:
        if kind != items["keys.kind"].default:
            source = " ".join((type(getattr(keys, kind)).__doc__ or "").split())
            yield Case(effect=f"keys.kind {kind}", size=NOMINAL, values={"keys.kind": kind}, later=False, source=source)


def _single() -> Iterator[Case]:
    known = {item.name for item in settings_of(BenchConfig)}
    for name, (value, source) in SINGLE.items():
        if name in known:
            for size, factor in ((NOMINAL, 1), (TWICE, 2)):
                yield Case(effect=name, size=size, values={name: _times(value, factor)}, later=True, source=source)
