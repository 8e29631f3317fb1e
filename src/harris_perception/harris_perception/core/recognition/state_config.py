"""Settings of reading lamps, knobs and screens."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.configuration.config import Config, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class StateConfig(Config):
    """Settings of reading lamps, knobs and screens."""

    lit_chroma: float = setting(
        80.0, "Minimum chroma of a coloured lamp that is lit", minimum=5.0, maximum=255.0, unit="grey levels"
    )
    lit_gain: float = setting(
        1.3,
        "Minimum ratio of a lit white lamp's brightness to its surroundings, and of a lit lamp's on bright or "
        "coloured paint to the paint",
        minimum=1.0,
        maximum=20.0,
    )
    marker_contrast: float = setting(
        12.0,
        "Minimum difference between a knob's marker and the knob's top",
        minimum=1.0,
        maximum=255.0,
        unit="grey levels",
    )
    marker_unity: float = setting(
        0.95,
        "Minimum length of the mean direction of the marker's pixels; 1 is a single line",
        minimum=0.1,
        maximum=1.0,
    )
    cell_mm: float = setting(3.4, "Side of a screen cell", minimum=0.5, maximum=50.0, unit="mm")
    cell_change: float = setting(
        14.0,
        "Minimum difference of a cell at rest that counts as a change",
        minimum=1.0,
        maximum=255.0,
        unit="grey levels",
    )
    changed_cells: int = setting(
        5, "Minimum number of changed cells that count as a change of the screen", minimum=1, maximum=10000
    )
    cell_rest_s: float = setting(
        6.0,
        "Minimum time at rest before a screen cell counts; must exceed the period of periodic screen content",
        minimum=0.2,
        maximum=60.0,
        unit="s",
    )
    stylus_radius_m: float = setting(
        0.006, "Half width of the area that the shaft hides", minimum=1e-4, maximum=0.1, unit="m"
    )
    arm_half_width_m: float = setting(
        0.013, "Half width of the area that the arm hides", minimum=1e-4, maximum=0.2, unit="m"
    )
    arm_height_m: float = setting(
        0.070, "Height of the arm's underside above the panel's face", minimum=0.0, maximum=1.0, unit="m"
    )
    arm_top_m: float = setting(
        0.150, "Height of the top of shaft and arm above the panel's face", minimum=0.0, maximum=1.0, unit="m"
    )
    print_margin_mm: float = setting(
        9.0,
        "Width of the print around a control that shows whether the control is hidden",
        minimum=0.0,
        maximum=100.0,
        unit="mm",
    )
    odd_colour: float = setting(
        45.0,
        "Minimum difference from a control's usual colour for the control to count as hidden",
        minimum=1.0,
        maximum=255.0,
        unit="levels",
    )
    print_share: float = setting(
        0.5, "Minimum fraction of the print around a control that must match the template", minimum=0.0, maximum=1.0
    )
