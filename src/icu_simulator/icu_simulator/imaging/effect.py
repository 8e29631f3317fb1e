"""Base of an effect: a switch, sizes with defaults of ordinary cameras, and the source of the sizes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from icu_common.core.configuration.config import Config, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchEffect(Config):
    """One effect of the bench; its default values are its ordinary size.

    Attributes
    ----------
    SOURCE
        Source of the sizes: a datasheet, paper or public report.
    SCALED
        Fields that are doubled for an effect of twice the ordinary size.
    LATER
        Whether the effect begins after the calibration of the machine instead of at the start.
    """

    SOURCE: ClassVar[str] = ""
    SCALED: ClassVar[tuple[str, ...]] = ()
    LATER: ClassVar[bool] = False

    enabled: bool = setting(False, "Simulate this effect")

    def scaled(self, factor: float) -> BenchEffect:
        """Return the enabled effect with its sizes multiplied by ``factor``."""
        changed: dict[str, Any] = {}
        for name in self.SCALED:
            value = getattr(self, name)
            changed[name] = tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor
        return dataclasses.replace(self, enabled=True, **changed)


def effects_of(config: Any, prefix: str = "") -> Iterator[tuple[str, BenchEffect]]:
    """Iterate over the effects in a configuration, with their dotted names."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if isinstance(value, BenchEffect):
            yield prefix + field.name, value
        elif isinstance(value, Config):
            yield from effects_of(value, f"{prefix}{field.name}.")
