"""Images of the bench with known state, and a reader of panels that looks at them."""

from __future__ import annotations

import copy
import functools
from pathlib import Path
from typing import Any

import numpy as np

from harris_perception.core.recognition.face_patches import Patches
from harris_perception.core.recognition.panel_reader import PanelReader
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Transform
from icu_common.core.panel.panel_layout import PanelLayout, load_layout
from icu_common.core.panel.panel_state import PanelSeen
from icu_simulator.core.configuration import BenchConfig, LightConfig
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.renderer import Moment, Renderer, base_from_panel

SCOPES = Path(__file__).parents[3] / "config" / "scopes"
LAYOUT = load_layout(SCOPES / "dso_bench_4.yaml")
AWAY = (0.01, 0.01, 0.0)
PERIOD_NS = 200_000_000


@functools.lru_cache(maxsize=2)
def drawn(layout: PanelLayout) -> Renderer:
    """Draw a panel as no test has changed it; it takes half a second, a copy a twentieth."""
    return Renderer(layout, BenchConfig(), base_from_panel(BenchConfig().panel))


class Scene:
    """A renderer of its own, the true pose, and a reader that looks at picture after picture, five a second."""

    def __init__(self, layout: PanelLayout = LAYOUT, **light: Any) -> None:
        self.config = BenchConfig(light=LightConfig(**light))
        self.panel_from = base_from_panel(self.config.panel)
        self.renderer = copy.deepcopy(drawn(layout))
        if light:
            self.renderer.relight(self.config.light)
        rig = self.renderer.rig
        self.camera_from_base = rig.rectified_left_from_base()
        self.camera = CameraModel.from_mapping(rig.calibration("left"))
        self.reader = PanelReader(layout)
        self.count = 0
        self.exposure = 1.0

    def look(
        self, state: InstrumentState, tip: Any = AWAY, patches: Patches | None = None, *, tip_seen: bool = True
    ) -> PanelSeen:
        self.count += 1
        left, _ = self.renderer.render(Moment(tip=tuple(float(v) for v in tip), state=state, now_s=0.2 * self.count))
        left = np.clip(np.rint(left * self.exposure), 0, 255).astype(np.uint8)
        pose: Transform = self.camera_from_base @ self.panel_from
        seen_tip = self.in_camera(tip) if tip_seen else None
        stamp_ns = PERIOD_NS * self.count
        return self.reader.read(left, pose, self.camera, stamp_ns, patches=patches, tip=seen_tip)

    def in_camera(self, tip: Any) -> Any:
        return self.camera_from_base.apply(np.array(tip))
