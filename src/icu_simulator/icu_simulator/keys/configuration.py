"""Travel and force of the keys by kind, and the kind of each control.

The forces follow the usual letters of a key's force-travel curve: F1 is the peak at S1, F2 the force at the contact
travel S2, and the snap ratio is (F1 - F2) / F1. The real key's contact travel is ``actuation_mm`` here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from icu_common.core.configuration.config import Config, ConfigError, nested, setting

_OVERRIDE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)=([a-z]+)(?::([0-9.]+)/([0-9.]+))?")


def _travel(default: float) -> float:
    value: float = setting(default, "Stroke at which the key reaches its stop", minimum=0.05, maximum=10.0, unit="mm")
    return value


def _actuation(default: float) -> float:
    value: float = setting(default, "Stroke at which the key acts (S2)", minimum=0.02, maximum=10.0, unit="mm")
    return value


def _release(default: float) -> float:
    value: float = setting(default, "Stroke below which the key releases", minimum=0.0, maximum=10.0, unit="mm")
    return value


def _force(default: float, where: str) -> float:
    value: float = setting(default, f"Force of the key {where}", minimum=0.0, maximum=30.0, unit="N")
    return value


def _peak_travel(default: float) -> float:
    value: float = setting(default, "Stroke at the peak force (S1)", minimum=0.0, maximum=10.0, unit="mm")
    return value


def _return_share(default: float) -> float:
    value: float = setting(default, "Release force as a share of the press force", minimum=0.0, maximum=1.0)
    return value


_START, _PEAK, _CONTACT, _END = "before it moves", "at its peak (F1)", "where it acts (F2)", "at its stop"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyConfig(Config):
    """A key; these values describe the ideal key, which follows the ball without force."""

    travel_mm: float = _travel(1.5)
    actuation_mm: float = _actuation(0.7)
    release_mm: float = _release(0.35)
    start_n: float = _force(0.0, _START)
    peak_mm: float = _peak_travel(0.0)
    peak_n: float = _force(0.0, _PEAK)
    contact_n: float = _force(0.0, _CONTACT)
    end_n: float = _force(0.0, _END)
    return_share: float = _return_share(1.0)

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if not self.peak_mm <= self.actuation_mm <= self.travel_mm:
            raise ConfigError(
                f"peak_mm = {self.peak_mm:g}, actuation_mm = {self.actuation_mm:g}, travel_mm = {self.travel_mm:g}: "
                "expected ascending values"
            )
        if not self.release_mm < self.actuation_mm:
            raise ConfigError(
                f"release_mm = {self.release_mm:g}: expected less than actuation_mm {self.actuation_mm:g}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class DomeKeyConfig(KeyConfig):
    """A metal dome or tact switch under a cap.

    Omron's B3F and B3S act at 0.25 + 0.2 - 0.1 mm and need 0.98, 1.47 or 2.55 N (datasheets).
    """

    travel_mm: float = _travel(0.35)
    actuation_mm: float = _actuation(0.25)
    release_mm: float = _release(0.15)
    start_n: float = _force(0.2, _START)
    peak_mm: float = _peak_travel(0.15)
    peak_n: float = _force(1.5, _PEAK)
    contact_n: float = _force(0.9, _CONTACT)
    end_n: float = _force(4.0, _END)
    return_share: float = _return_share(0.7)


@dataclass(frozen=True, slots=True, kw_only=True)
class SiliconeKeyConfig(KeyConfig):
    """A silicone rubber key with a web; 125 to 150 gf at a snap ratio of 40 to 60 % (Diamond HMI, design guide)."""

    travel_mm: float = _travel(1.5)
    actuation_mm: float = _actuation(1.3)
    release_mm: float = _release(1.0)
    start_n: float = _force(0.1, _START)
    peak_mm: float = _peak_travel(0.7)
    peak_n: float = _force(1.35, _PEAK)
    contact_n: float = _force(0.68, _CONTACT)
    end_n: float = _force(3.0, _END)
    return_share: float = _return_share(0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class MembraneKeyConfig(KeyConfig):
    """A flat membrane switch without a dome: short travel and no snap, so the force only increases."""

    travel_mm: float = _travel(0.5)
    actuation_mm: float = _actuation(0.3)
    release_mm: float = _release(0.2)
    start_n: float = _force(0.3, _START)
    peak_mm: float = _peak_travel(0.15)
    peak_n: float = _force(1.0, _PEAK)
    contact_n: float = _force(2.0, _CONTACT)
    end_n: float = _force(5.0, _END)
    return_share: float = _return_share(0.8)


@dataclass(frozen=True, slots=True, kw_only=True)
class RockerKeyConfig(KeyConfig):
    """One side of a spring-return rocker: long and stiff, with a snap after the middle of its stroke."""

    travel_mm: float = _travel(2.8)
    actuation_mm: float = _actuation(2.0)
    release_mm: float = _release(1.2)
    start_n: float = _force(0.5, _START)
    peak_mm: float = _peak_travel(1.4)
    peak_n: float = _force(3.0, _PEAK)
    contact_n: float = _force(1.8, _CONTACT)
    end_n: float = _force(6.0, _END)
    return_share: float = _return_share(0.6)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeysConfig(Config):
    """The keys of the panel: one kind for all of them, and exceptions by control."""

    kind: str = setting("plain", "Kind of all keys", choices=("plain", "dome", "silicone", "membrane", "rocker"))
    controls: str = setting("", "Exceptions as NAME=kind or NAME=kind:TRAVEL/ACTUATION in mm, separated by spaces")
    plain: KeyConfig = nested(KeyConfig)
    dome: DomeKeyConfig = nested(DomeKeyConfig)
    silicone: SiliconeKeyConfig = nested(SiliconeKeyConfig)
    membrane: MembraneKeyConfig = nested(MembraneKeyConfig)
    rocker: RockerKeyConfig = nested(RockerKeyConfig)

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        self.exceptions()

    def of_kind(self, kind: str) -> KeyConfig:
        """Return the key of a kind.

        Raises
        ------
        ConfigError
            For an unknown kind.
        """
        kinds: dict[str, KeyConfig] = {
            "plain": self.plain,
            "dome": self.dome,
            "silicone": self.silicone,
            "membrane": self.membrane,
            "rocker": self.rocker,
        }
        if kind not in kinds:
            raise ConfigError(f"key kind {kind!r}: expected one of {', '.join(kinds)}")
        return kinds[kind]

    def exceptions(self) -> dict[str, KeyConfig]:
        """Return the keys of the controls that ``controls`` names.

        Raises
        ------
        ConfigError
            If an entry has another form, an unknown kind, or an unsuitable travel.
        """
        found: dict[str, KeyConfig] = {}
        for entry in self.controls.split():
            match = _OVERRIDE.fullmatch(entry)
            if match is None:
                raise ConfigError(f"controls entry {entry!r}: expected NAME=kind or NAME=kind:TRAVEL/ACTUATION")
            name, kind, travel, actuation = match.groups()
            key = self.of_kind(kind)
            found[name] = key if travel is None else _stretched(key, entry, travel, actuation)
        return found

    def key_of(self, control: str) -> KeyConfig:
        """Return the key of a control."""
        return self.exceptions().get(control) or self.of_kind(self.kind)


def _stretched(key: KeyConfig, entry: str, travel: str, actuation: str) -> KeyConfig:
    """Return the key with another travel and actuation point; peak and release keep their ratio to the latter."""
    try:
        travel_mm, actuation_mm = float(travel), float(actuation)
    except ValueError as error:
        raise ConfigError(f"controls entry {entry!r}: {travel} and {actuation} must be numbers of mm") from error
    share = actuation_mm / key.actuation_mm
    return KeyConfig(
        travel_mm=travel_mm,
        actuation_mm=actuation_mm,
        release_mm=key.release_mm * share,
        start_n=key.start_n,
        peak_mm=key.peak_mm * share,
        peak_n=key.peak_n,
        contact_n=key.contact_n,
        end_n=key.end_n,
        return_share=key.return_share,
    )
