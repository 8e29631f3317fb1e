"""Settings of a contact: its evidence, and the travel of a press."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, ConfigError, nested, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightConfig(Config):
    """Expected errors of heights before they are measured."""

    image_sigma_m: float = setting(
        0.00008,
        "Standard deviation of the ball's height in one image pair, until the images of a descent give their own",
        minimum=1e-6,
        maximum=0.005,
        unit="m",
    )
    place_sigma_m: float = setting(
        0.00006,
        "Standard deviation of the difference of two heights of the ball at one control that repetition does not "
        "show: other distance from the cameras",
        minimum=0.0,
        maximum=0.005,
        unit="m",
    )
    look_sigma_m: float = setting(
        0.00006,
        "Standard deviation of the ball's height above one control, which repetition does not show, relative to its "
        "readings: another background than that of the other controls",
        minimum=0.0,
        maximum=0.005,
        unit="m",
    )
    start_sigma_m: float = setting(
        0.00018,
        "Standard deviation of the stylus's height relative to its readings after a calibration",
        minimum=1e-5,
        maximum=0.01,
        unit="m",
    )
    panel_sigma_m: float = setting(
        0.00015,
        "Standard deviation of a recognised panel's height between images",
        minimum=1e-6,
        maximum=0.005,
        unit="m",
    )
    drift_sigma_m: float = setting(
        0.00005, "Standard deviation of a height's drift between two touches", minimum=0.0, maximum=0.005, unit="m"
    )
    max_offset_m: float = setting(
        0.0015,
        "Maximum difference between the stylus's height and its readings that is corrected",
        minimum=0.0,
        maximum=0.01,
        unit="m",
        guards="lost steps of z are corrected instead of reported",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactConfig(Config):
    """Recognition of a contact, and travel of a press."""

    key_travel_m: float = setting(
        0.0023,
        "First travel of a press of a key, from its top; the stylus's spring limits its force",
        minimum=0.0,
        maximum=0.01,
        unit="m",
    )
    max_travel_m: float = setting(
        0.0035,
        "Maximum travel of a press, from the surface; the driver's envelope limits it as well",
        minimum=0.0,
        maximum=0.01,
        unit="m",
        guards="a press that meets nothing goes deeper",
    )
    step_m: float = setting(
        0.001, "Additional travel per step while nothing has stopped the ball", minimum=0.0001, maximum=0.005, unit="m"
    )
    lag_m: float = setting(
        0.0003,
        "Compression of the stylus's spring at which the ball counts as stopped: the end of a key's stroke",
        minimum=0.00005,
        maximum=0.005,
        unit="m",
        guards="a smaller scatter of the measured height counts as a contact",
    )
    sigmas: float = setting(
        4.0,
        "Lag at which the ball counts as stopped, in standard deviations of the measured lag",
        minimum=2.0,
        maximum=20.0,
    )
    height: HeightConfig = nested(HeightConfig)

    def __post_init__(self) -> None:
        super(ContactConfig, self).__post_init__()
        if self.max_travel_m < self.key_travel_m:
            raise ConfigError(
                f"max_travel_m = {self.max_travel_m:g}: expected at least key_travel_m = {self.key_travel_m:g}"
            )
