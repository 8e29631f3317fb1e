"""Every layout in config/scopes: the bench draws it, and recognition finds in the picture what the layout says."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.parameter_files import parameters

from harris_perception.core.corners.harris import HarrisDetector
from harris_perception.core.recognition.panel_reader import PanelReader
from harris_perception.core.recognition.recognition import PanelRecogniser
from harris_perception.core.stylus.stylus import StylusTracker
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from icu_common.core.configuration.config import from_mapping
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core import instrument
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.renderer import Moment, Renderer, base_from_panel

FOLDER = Path(__file__).parents[4] / "config" / "scopes"
PINK = ("#e0409a",)
"""Of the ball's own colour: when lit, it hides the ball, which is measured off it then."""
LAYOUTS = sorted(path.stem for path in FOLDER.glob("*.yaml"))
PANEL_BY_PANEL = pytest.mark.parametrize("name", LAYOUTS, scope="module")
"""One after the other, as the bench keeps what it has drawn of the last panels."""


def test_there_are_several_makes_and_one_that_is_no_scope() -> None:
    assert len(LAYOUTS) >= 5 and "ventilator_v1" in LAYOUTS


@PANEL_BY_PANEL
def test_is_drawn_recognised_and_read(name: str) -> None:
    layout = load_layout(FOLDER / f"{name}.yaml")
    assert layout.model == name
    config = BenchConfig()
    panel_from = base_from_panel(config.panel)
    renderer = Renderer(layout, config, panel_from)
    state = instrument.InstrumentState(knobs=tuple((c.name, 25.0) for c in layout.controls if c.kind == "knob"))
    lamps = [c.name for c in layout.controls if c.lit_colour]
    for lamp in lamps:
        state = instrument.press(state, lamp, 0.0)
    picture, _ = renderer.render(Moment(tip=(0.0, -0.05, 0.0), state=state, now_s=1.0))
    gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    model = CameraModel.from_mapping(renderer.rig.calibration("left"))
    sighting = PanelRecogniser(layout).locate(gray, HarrisDetector().detect(gray).xy, model)
    assert sighting is not None
    truth = renderer.rig.rectified_left_from_base() @ panel_from
    tops = np.array([(*c.position_mm, c.height_mm) for c in layout.controls]) / 1000
    error = np.linalg.norm(sighting.camera_from_panel.apply(tops) - truth.apply(tops), axis=1).max()
    print(f"{name}: {1000 * error:.3f} mm, agreement {sighting.agreement:.2f}")
    assert error < 0.0003
    seen = PanelReader(layout).read(picture, sighting.camera_from_panel, model, 1, patches=sighting.patches)
    for control in layout.controls:
        found = seen.control(control.name)
        assert found is not None
        if control.kind == "knob" and not found.hidden_by:
            assert found.angle_deg == pytest.approx(25.0, abs=2.0), control.name
        if control.lit_colour and not found.hidden_by:
            dark = state.lamp(control.name, control.lit_colour) == ""
            assert (found.lamp == "off") is dark, (control.name, found.lamp)


@PANEL_BY_PANEL
def test_the_tip_is_measured_before_lamps_that_shine(name: str) -> None:
    """At contact, while looking before it, and between: lamps, their edges and printed bands are behind the ball."""
    layout, config = load_layout(FOLDER / f"{name}.yaml"), BenchConfig()
    panel_from = base_from_panel(config.panel)
    renderer = Renderer(layout, config, panel_from)
    stereo = StereoModel(
        **{side: CameraModel.from_mapping(renderer.rig.calibration(side)) for side in ("left", "right")}
    )
    tracker = StylusTracker(from_mapping(StylusSearchConfig, parameters("stylus_tracker")), stereo)
    base_from_camera = renderer.rig.rectified_left_from_base().inverse()
    lamps = [c for c in layout.controls if c.lit_colour and c.lit_colour not in PINK]
    state = instrument.InstrumentState(lit=tuple(c.name for c in lamps))
    for lamp in lamps:
        for above_mm in (0.0, 2.5, 5.0, 7.5, 10.0, 12.5):
            tip = panel_from.apply(np.array([*lamp.position_mm, lamp.height_mm + 2.0 + above_mm]) / 1000)
            looks = [
                tracker.find(*renderer.render(Moment(tip=tuple(tip), state=state, now_s=above_mm + n / 15)))
                for n in range(3)
            ]
            seen = [look.tip for look in looks if look.tip is not None]
            assert len(seen) >= 2, (lamp.name, above_mm, [look.reason for look in looks])
            error_mm = 1000 * float(np.linalg.norm((base_from_camera.apply(seen[0]) - tip)[:2]))
            print(f"{name} {lamp.name} {above_mm:4.1f} mm above: {error_mm:.3f} mm")
            assert error_mm < 0.2, (lamp.name, above_mm)
