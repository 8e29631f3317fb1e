"""Limits of the space at the panel."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvelopeConfig(Config):
    """Limits of the space at the panel; see docs/explanation/guard.md."""

    free_space_m: float = setting(
        0.016,
        "Maximum extension without a known panel: the deepest height of the hand-eye calibration, which runs "
        "before the panel is known",
        minimum=0.0,
        maximum=0.2,
        unit="m",
        guards="the stylus goes down there without a known panel",
    )
    crossing_m: float = setting(
        0.005,
        "Maximum extension at which the stylus may cross the panel: above the highest control",
        minimum=0.0,
        maximum=0.2,
        unit="m",
        guards="the stylus may hit a high control from the side",
    )
    side_height_m: float = setting(
        0.005,
        "Height above the panel's face below which only a drag or a turn may move sideways; less than the "
        "controller's hover_m",
        minimum=0.001,
        maximum=0.05,
        unit="m",
        guards="the stylus moves sideways close to the panel",
    )
    correction_m: float = setting(
        0.007,
        "Maximum sideways motion of a stylus extended beyond crossing_m, except in a drag or a turn: at least the "
        "sum of the controller's max_correction_m and 1.5 times its approach_m",
        minimum=0.0,
        maximum=0.05,
        unit="m",
        guards="the stylus moves farther sideways between the controls",
    )
    max_sigma_m: float = setting(
        0.0005,
        "Maximum standard deviation at which a plane counts as known; a path may go three standard deviations deeper",
        minimum=1e-5,
        maximum=0.001,
        unit="m",
        guards="paths go three times as far beyond the panel",
    )
    max_age_s: float = setting(
        60.0,
        "Maximum age of a plane that counts as known",
        minimum=1.0,
        maximum=600.0,
        unit="s",
        guards="the panel may have moved since",
    )
