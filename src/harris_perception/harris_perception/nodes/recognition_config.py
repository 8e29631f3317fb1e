"""Settings of the recognition node."""

from __future__ import annotations

from dataclasses import dataclass

from harris_perception.core.corners.harris import HarrisConfig
from harris_perception.core.recognition.recognition import RecognitionConfig
from harris_perception.core.recognition.state_config import StateConfig
from icu_common.core.configuration.config import Config, nested, setting
from icu_common.nodes.on_demand import on_demand_setting


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognitionNodeConfig(Config):
    """Settings of the recognition node."""

    layout: str = setting("", "Layout file of the designated panel", read_only=True)
    template: str = setting("", "Image of the panel's face, straight on; empty: drawn from the layout", read_only=True)
    template_px_per_mm: float = setting(
        4.0, "Scale of the template image", minimum=0.1, maximum=100.0, unit="px/mm", read_only=True
    )
    teach_folder: str = setting(
        "", "Folder for the layouts of panels that are taught by messages; empty: none", read_only=True
    )
    rate_hz: float = setting(5.0, "Maximum rate of processed images", minimum=0.1, maximum=60.0, unit="Hz")
    corners_wait_s: float = setting(
        0.1, "Maximum time that an image waits for its published corners", minimum=0.0, maximum=2.0, unit="s"
    )
    silence_s: float = setting(
        1.0, "Time without images after which the panel counts as lost", minimum=0.1, maximum=60.0, unit="s"
    )
    tip_wait_s: float = setting(
        1.0,
        "Time without messages from the stylus tracker after which lamps, knobs and screens are read without "
        "it; otherwise an image waits until the tracker has processed it",
        minimum=0.0,
        maximum=60.0,
        unit="s",
    )
    tip_max_age_s: float = setting(
        0.3,
        "Maximum time between an image without a certain tip and the nearest sighting of the tip, before or "
        "after; beyond it the stylus counts as out of view",
        minimum=0.0,
        maximum=5.0,
        unit="s",
    )
    tip_speed_m_s: float = setting(
        0.2,
        "Maximum speed of the stylus; the tip may hide lamps within this speed times the time to its nearest sighting",
        minimum=0.0,
        maximum=2.0,
        unit="m/s",
    )
    plane_max_age_s: float = setting(
        0.0,
        "Maximum time between an image and a stereo plane that improves its pose; 0: none does, and stereo "
        "need not run",
        minimum=0.0,
        maximum=5.0,
        unit="s",
        read_only=True,
    )
    marker_bound_mm: float = setting(
        2.0,
        "Maximum difference between the panel's poses by its markers and by its print",
        minimum=0.1,
        maximum=100.0,
        unit="mm",
    )
    stereo_bound_mm: float = setting(
        2.0,
        "Maximum difference in depth between the panel by both cameras and by its print, if stereo runs; 0: "
        "not compared",
        minimum=0.0,
        maximum=100.0,
        unit="mm",
        read_only=True,
    )
    on_demand: bool = on_demand_setting(
        "Subscribe to corners only while the panel is searched, and measure it once a second while it looks the same"
    )
    recognition: RecognitionConfig = nested(RecognitionConfig)
    state: StateConfig = nested(StateConfig)
    harris: HarrisConfig = nested(HarrisConfig)
