"""Settings of the solver: minimum quality of the samples, and limits of a plausible machine."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class HandEyeConfig(Config):
    """Minimum quality of the samples, and limits of a plausible machine."""

    min_samples: int = setting(6, "Minimum number of samples that fit", minimum=4, maximum=1000)
    min_span_m: float = setting(
        0.06, "Minimum extent of the readings along each of two directions", minimum=0.001, maximum=5.0, unit="m"
    )
    min_stylus_span_m: float = setting(
        0.004,
        "Minimum extent of the stylus readings from which the stylus's direction is also fitted",
        minimum=0.0001,
        maximum=1.0,
        unit="m",
    )
    tip_sigma_px: float = setting(
        0.02,
        "Lower limit of a sample's standard deviation in each image; the sightings of a sample share their background",
        minimum=0.0001,
        maximum=5.0,
        unit="px",
    )
    common_error: float = setting(
        1.15,
        "Error shared by all samples (the ball's shading), which more samples do not reduce, as a fraction of "
        "one sample's error",
        minimum=0.0,
        maximum=5.0,
    )
    place_error: float = setting(
        1.0,
        "Error shared by samples from one position in the image (background of the ball), as a fraction of "
        "one sample's error",
        minimum=0.0,
        maximum=5.0,
    )
    panel_sigma_m: float = setting(
        0.000022,
        "Error of the panel's position across the line of sight, shared by all its sightings",
        minimum=0.0,
        maximum=0.01,
        unit="m",
    )
    panel_depth_sigma_m: float = setting(
        0.00016,
        "Error of the panel's distance as measured by one camera, shared by all its sightings",
        minimum=0.0,
        maximum=0.05,
        unit="m",
    )
    contact_sigma_m: float = setting(
        0.0003, "Standard deviation of a touched point", minimum=1e-6, maximum=0.01, unit="m"
    )
    outlier_sigmas: float = setting(
        4.5, "Deviation, in standard deviations, above which a sample is removed", minimum=2.0, maximum=100.0
    )
    max_outliers: float = setting(0.3, "Maximum fraction of samples that may be removed", minimum=0.0, maximum=0.49)
    max_rms_m: float = setting(0.0007, "Maximum accepted rms misfit", minimum=1e-6, maximum=0.1, unit="m")
    max_scale_error: float = setting(
        0.05, "Maximum relative error of an axis's scale against its readings", minimum=0.001, maximum=0.5
    )
    max_skew: float = setting(
        0.05,
        "Maximum deviation from 90 degrees of the angle between the axes, and between the stylus and both axes",
        minimum=0.001,
        maximum=0.5,
        unit="rad",
    )
