"""Deviations of the manufactured panel from its layout file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from icu_common.core.configuration.config import Config, nested, setting
from icu_simulator.imaging.effect import BenchEffect


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintConfig(Config):
    """Print of the face: its registration, and its font, which differs from the font that recognition draws."""

    offset_mm: float = setting(
        0.25,
        "Maximum offset of the print in x and y; screen printing registers to some tenths of a millimetre",
        minimum=0.0,
        maximum=3.0,
        unit="mm",
    )
    font_weight: float = setting(1.35, "Stroke thickness of letters relative to the layout", minimum=0.3, maximum=3.0)
    font_width: float = setting(0.94, "Width of words relative to the layout", minimum=0.5, maximum=1.5)
    font_height: float = setting(0.97, "Height of letters relative to the layout", minimum=0.5, maximum=1.5)
    font_slant: float = setting(0.0, "Slant of letters: sideways shift per height", minimum=-0.5, maximum=0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class AgeConfig(Config):
    """Wear, dust and screws of the face."""

    wear: float = setting(0.06, "Share of the print that is worn off in spots", minimum=0.0, maximum=0.9)
    dust_per_dm2: float = setting(
        8.0, "Number of specks of dust and paint per square decimetre", minimum=0.0, maximum=500.0
    )
    screws: bool = setting(True, "Draw screws in the corners of the face, which the layout does not show")


@dataclass(frozen=True, slots=True, kw_only=True)
class ManufactureConfig(BenchEffect):
    """Deviations of the manufactured panel from its layout file, drawn from the seed of the bench."""

    SOURCE: ClassVar[str] = (
        "ISO 2768-1 class m: 0.1 mm for lengths up to 6 mm, 0.2 mm up to 30 mm, 0.3 mm up to 120 mm; print: estimates"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("position_mm", "height_mm", "colour_levels")

    position_mm: float = setting(0.2, "Maximum offset of each control in x and y", minimum=0.0, maximum=5.0, unit="mm")
    height_mm: float = setting(
        0.2, "Maximum height deviation of each protruding control", minimum=0.0, maximum=5.0, unit="mm"
    )
    colour_levels: float = setting(
        6.0, "Maximum colour deviation in grey levels, as between batches of paint", minimum=0.0, maximum=80.0
    )
    print: PrintConfig = nested(PrintConfig)
    age: AgeConfig = nested(AgeConfig)
