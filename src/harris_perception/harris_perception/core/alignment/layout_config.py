"""Settings of the comparison between a panel and its layout."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class LayoutConfig(Config):
    """Settings of measuring controls against their layout, and of judging deviations."""

    controls_per_look: int = setting(
        2,
        "Number of controls measured in each image pair, once all have been measured; 0: no control is measured",
        minimum=0,
        maximum=100,
    )
    looks: int = setting(
        2, "Minimum number of measurements of a control before its deviation counts", minimum=1, maximum=50
    )
    window: int = setting(9, "Number of latest measurements of a control whose median counts", minimum=1, maximum=100)
    agreement_mm: float = setting(
        0.3,
        "Maximum difference between a control's shifts in both images, besides what its height may explain",
        minimum=0.01,
        maximum=5.0,
        unit="mm",
    )
    max_scatter_mm: float = setting(
        0.15,
        "Maximum scatter of a control's measurements; above it the control counts as not measured",
        minimum=0.01,
        maximum=5.0,
        unit="mm",
    )
    outline_sigma_mm: float = setting(
        0.06, "Standard deviation of an outline's position in one image", minimum=0.001, maximum=5.0, unit="mm"
    )
    shared_sigma_mm: float = setting(
        0.06,
        "Standard deviation of the error that both images share (bevels, shadows)",
        minimum=0.0,
        maximum=5.0,
        unit="mm",
    )
    max_misfit: float = setting(
        12.0,
        "Maximum sum of squared residuals, in standard deviations, of the fit of offset and height to both "
        "images and of the height itself; above it the control counts as not measured",
        minimum=1.0,
        maximum=1000.0,
    )
    significant_sigmas: float = setting(
        2.0, "Size, in standard deviations, from which a deviation is corrected", minimum=1.0, maximum=100.0
    )
    max_offset_mm: float = setting(
        1.0, "Maximum deviation of a control that may be touched", minimum=0.05, maximum=20.0, unit="mm"
    )
    min_controls: int = setting(
        5, "Minimum number of measured controls to estimate the panel's tolerance from", minimum=3, maximum=200
    )
