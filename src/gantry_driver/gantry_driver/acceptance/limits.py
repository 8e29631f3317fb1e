"""Limits of the acceptance test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from icu_common.core.configuration.config import Config, ConfigError, setting, settings_of


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptanceLimits(Config):
    """Largest values, or smallest where the name says so, with which a machine passes."""

    position_error_m: float = setting(
        0.0002, "Maximum distance of a reading from the ordered one at rest", minimum=0.0, maximum=0.01, unit="m"
    )
    direction_deg: float = setting(
        10.0, "Maximum angle between an axis and that of the panel", minimum=0.0, maximum=45.0, unit="deg"
    )
    scale_error: float = setting(
        0.01, "Maximum relative difference of a way by the board's counts from the seen way", minimum=0.0, maximum=0.2
    )
    squareness_deg: float = setting(
        0.5, "Maximum deviation of the angle between the axes from 90 degrees", minimum=0.0, maximum=10.0, unit="deg"
    )
    tilt_deg: float = setting(
        3.0, "Maximum angle between the plane of the axes and the panel", minimum=0.0, maximum=20.0, unit="deg"
    )
    backlash_m: float = setting(0.0006, "Maximum backlash of an axis", minimum=0.0, maximum=0.01, unit="m")
    straightness_m: float = setting(
        0.0003, "Maximum rms distance of a seen tip from the straight axes", minimum=0.0, maximum=0.01, unit="m"
    )
    blur_px: float = setting(
        1.6, "Maximum blur (standard deviation) of the panel's edges", minimum=0.0, maximum=20.0, unit="px"
    )
    panel_share_min: float = setting(
        1.0, "Minimum share of the panel's outline in each image", minimum=0.0, maximum=1.0
    )
    seen_share_min: float = setting(0.7, "Minimum share of stops at which the tip was seen", minimum=0.0, maximum=1.0)
    touch_error_m: float = setting(0.0005, "Maximum measured error of a touch", minimum=0.0, maximum=0.01, unit="m")


def limits_of(texts: Sequence[str]) -> AcceptanceLimits:
    """Return the limits with the values of texts such as ``squareness_deg=0.3``.

    Raises
    ------
    ConfigError
        If a name is unknown, or a value is no number or out of its bounds.
    """
    names = [item.name for item in settings_of(AcceptanceLimits)]
    values: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in names:
            raise ConfigError(f"limit {name!r} is none of {', '.join(names)}")
        try:
            values[name] = float(value)
        except ValueError as error:
            raise ConfigError(f"limit {name}: expected a number, got {value!r}") from error
    return AcceptanceLimits(**values)
