"""Settings of the stylus tracker."""

from __future__ import annotations

from dataclasses import dataclass

from harris_perception.core.alignment.layout_config import LayoutConfig
from harris_perception.core.alignment.pair_config import PairConfig
from harris_perception.core.stereo.depth_range import DepthRange
from icu_common.core.configuration.config import nested, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class StylusSearchConfig(DepthRange):
    """Settings of the stylus tracker."""

    ball_diameter_m: float = setting(
        0.004, "Diameter of the ball at the stylus's end", minimum=0.0005, maximum=0.05, unit="m"
    )
    min_depth_m: float = setting(0.2, "Minimum depth of the ball", minimum=0.02, maximum=10.0, unit="m")
    max_depth_m: float = setting(1.5, "Maximum depth of the ball", minimum=0.03, maximum=20.0, unit="m")
    min_chroma: float = setting(
        30.0,
        "Minimum difference between the ball's min(red, blue) - green and that of its surroundings",
        minimum=5.0,
        maximum=200.0,
        unit="grey levels",
    )
    row_tolerance_px: float = setting(
        0.7,
        "Maximum difference between the rectified rows of the centres in both images",
        minimum=0.05,
        maximum=10.0,
        unit="px",
    )
    max_fit_error: float = setting(
        0.1, "Maximum rms difference from a shaded disc, as a fraction of the ball's chroma", minimum=0.01, maximum=1.0
    )
    max_size_error: float = setting(
        0.12,
        "Maximum relative difference between the circle's radius and the expected radius",
        minimum=0.01,
        maximum=0.5,
    )
    min_arc_deg: float = setting(90.0, "Minimum angle of the visible outline", minimum=30.0, maximum=360.0, unit="deg")
    search_margin_px: int = setting(
        60, "Distance around the ball's last position that is searched first", minimum=10, maximum=2000, unit="px"
    )
    unchanged_pairs: int = setting(
        3,
        "Maximum number of successive pairs that reuse the last tip without measuring, while the stylus rests "
        "and its surroundings do not change; 0: each pair is measured",
        minimum=0,
        maximum=15,
    )
    pair_tolerance_s: float = setting(
        0.004, "Maximum difference between the left and right stamps of one instant", minimum=0.0, maximum=0.1, unit="s"
    )
    free_running: bool = setting(
        True,
        "Cameras have no common trigger: pair images that are farther apart, and interpolate the right "
        "camera's view to the left image's instant",
    )
    layout: str = setting(
        "", "Layout file of the designated panel; empty: the cameras are not compared", read_only=True
    )
    template: str = setting("", "Image of the panel's face, straight on; empty: drawn from the layout", read_only=True)
    template_px_per_mm: float = setting(
        4.0, "Scale of the template image", minimum=0.1, maximum=100.0, unit="px/mm", read_only=True
    )
    pair: PairConfig = nested(PairConfig)
    controls: LayoutConfig = nested(LayoutConfig)
