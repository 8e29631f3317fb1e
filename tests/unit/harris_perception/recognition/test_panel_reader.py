"""Lamps, knob markers, screens and what hides them, read from pictures of the bench with known state."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest
from unit.harris_perception.bench_scene import AWAY, LAYOUT, PERIOD_NS, SCOPES, Scene

from harris_perception.core.corners.harris import HarrisDetector
from harris_perception.core.image.gray import gray_of
from harris_perception.core.recognition.face_patches import Patches
from harris_perception.core.recognition.own_shadow import own_shadow
from harris_perception.core.recognition.panel_reader import HUES
from harris_perception.core.recognition.recognition import PanelRecogniser
from icu_common.core.geometry.geometry import Transform
from icu_common.core.panel.panel_layout import load_layout
from icu_common.core.panel.panel_state import LAMPS, PanelSeen
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.renderer import Moment

pytestmark = pytest.mark.slow

KNOBS = [c.name for c in LAYOUT.controls if c.kind == "knob"]
RESTED = 34
"""Images until cells that do not change count."""


def lamps(seen: PanelSeen) -> dict[str, str]:
    return {c.name: c.lamp for c in seen.controls if c.lamp}


@pytest.mark.parametrize("level", [1.0, 0.25])
def test_lamps_in_bright_and_dim_light(level: float) -> None:
    scene = Scene(level=level)
    assert lamps(scene.look(InstrumentState())) == {"RUN_STOP": "green", "CH1": "yellow", "CH2": "cyan"}
    stopped = InstrumentState(running=False, channels=(False, True))
    assert lamps(scene.look(stopped)) == {"RUN_STOP": "red", "CH1": "off", "CH2": "cyan"}


@pytest.mark.parametrize(("level", "limit"), [(1.0, 1.0), (0.35, 1.5)])
def test_knob_markers_to_a_degree(level: float, limit: float) -> None:
    scene, rng = Scene(level=level), np.random.default_rng(7)
    errors = []
    for _ in range(4):
        truth = {name: float(rng.uniform(-180, 180)) for name in KNOBS}
        seen = scene.look(InstrumentState(knobs=tuple(sorted(truth.items()))))
        for name, angle in truth.items():
            control = seen.control(name)
            assert control is not None
            errors.append(abs((control.angle_deg - angle + 180) % 360 - 180))
    print(f"light {level}: mean {np.mean(errors):.2f}, greatest {max(errors):.2f} degrees")
    assert max(errors) < limit


@pytest.mark.parametrize("level", [0.25, 1.0, 1.6])
def test_coloured_paint_is_no_lamp(level: float) -> None:
    scene = Scene(load_layout(SCOPES / "crt_classic_2.yaml"), level=level)
    assert lamps(scene.look(InstrumentState()))["POWER"] == "off"
    lit = scene.look(InstrumentState(lit=("POWER", "AUTO")))
    assert lamps(lit) == {"POWER": "red", "AUTO": "green", "NORM": "off", "RUN_STOP": "green"}


def test_light_paint_on_a_dark_face_is_no_white_lamp() -> None:
    dark = load_layout(SCOPES / "mso_dark_6.yaml")
    controls = tuple(dataclasses.replace(c, lit_colour="#f4f4f0") if c.name == "CH3" else c for c in dark.controls)
    scene = Scene(dataclasses.replace(dark, controls=controls))
    for level in (0.3, 1.0):
        scene.renderer.relight(dataclasses.replace(scene.config.light, level=level))
        assert [lamps(scene.look(InstrumentState(lit=lit)))["CH3"] for lit in ((), ("CH3",))] == ["off", "white"]


def test_no_angle_is_told_where_bright_light_takes_the_marker() -> None:
    layout = load_layout(SCOPES / "mso_dark_6.yaml")
    scene, rng = Scene(layout), np.random.default_rng(1)
    truth = {c.name: float(rng.uniform(-180, 180)) for c in layout.controls if c.kind == "knob"}
    for level, least in ((1.0, 7), (2.0, 0), (2.5, 0)):
        scene.renderer.relight(dataclasses.replace(scene.config.light, level=level))
        seen = scene.look(InstrumentState(knobs=tuple(sorted(truth.items()))))
        told = {name: c.angle_deg for name in truth if (c := seen.control(name)) and not np.isnan(c.angle_deg)}
        wrong = {name: angle for name, angle in told.items() if abs((angle - truth[name] + 180) % 360 - 180) > 3}
        assert not wrong and len(told) >= least, (level, wrong, told)


def test_a_sequence_may_wait_for_every_colour_that_is_told() -> None:
    assert {name for _, name in HUES} | {"off", "white"} == set(LAMPS)


def test_a_running_trace_is_no_change_of_the_screen_but_its_stop_is() -> None:
    scene, running = Scene(), InstrumentState()
    assert [scene.look(running).changed_ns() for _ in range(RESTED)][-1] == 0
    stopped = dataclasses.replace(running, running=False, phase_s=2.8)
    seen = [scene.look(stopped).changed_ns() for _ in range(3)]
    assert seen == [0, 0, (RESTED + 1) * PERIOD_NS], "the first image with the new look, once it lasts"
    menu = dataclasses.replace(stopped, menu="MENU")
    assert [scene.look(menu).changed_ns() for _ in range(3)][-1] == (RESTED + 4) * PERIOD_NS


@pytest.mark.parametrize(("model", "exposure"), [("dso_bench_4", 0.85), ("dso_bench_4", 1.5), ("ventilator_v1", 0.6)])
def test_an_exposure_or_a_lamp_in_the_room_is_no_change_of_the_screen(model: str, exposure: float) -> None:
    scene, still = Scene(load_layout(SCOPES / f"{model}.yaml")), InstrumentState(running=False, phase_s=2.8)
    for _ in range(RESTED):
        scene.look(still)
    scene.renderer.relight(dataclasses.replace(scene.config.light, level=exposure))
    assert [scene.look(still).changed_ns() for _ in range(3)][-1] == 0, "the room's light"
    scene.exposure = exposure
    assert [scene.look(still).changed_ns() for _ in range(3)][-1] == 0
    scene.exposure = 1.0
    menu = dataclasses.replace(still, menu="MENU")
    changed = [scene.look(menu).changed_ns() for _ in range(3)]
    assert changed[-1] == (RESTED + 7) * PERIOD_NS, "what changes with the exposure is seen"


def test_the_arm_over_the_screen_is_no_change_of_it() -> None:
    scene = Scene()
    still = InstrumentState(running=False)
    for _ in range(RESTED):
        scene.look(still)
    for x in np.linspace(0.03, 0.17, 8):
        tip = scene.panel_from.apply([x, 0.06, 0.035])
        assert scene.look(still, tip).changed_ns() == 0, x


def test_what_the_stylus_hides_is_not_read() -> None:
    scene = Scene()
    for name, height in (("RUN_STOP", 0.005), ("CH1_SCALE", 0.017)):
        control = LAYOUT.control(name)
        tip = scene.panel_from.apply([*(np.array(control.position_mm) / 1000), height])
        seen = scene.look(InstrumentState(), tip).control(name)
        assert seen is not None and seen.hidden_by == "stylus" and seen.lamp == "" and np.isnan(seen.angle_deg)


def test_an_arm_that_passes_the_camera_hides_all_up_to_the_pictures_edge() -> None:
    scene = Scene()
    width, height = (v * 1e-3 for v in LAYOUT.size_mm)
    # A camera 0.3 m from the panel that looks down on it by 30 degrees: the arm, which comes from above, passes it.
    turn = np.radians(30.0)
    down = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    rotation = down @ np.diag([1.0, -1.0, -1.0])
    pose = Transform(rotation, np.array([0.0, 0.0, 0.3]) - rotation @ np.array([width / 2, height / 2, 0.0]))
    tip = np.array([width / 2, 0.8 * height, 0.01])
    arm = np.array([(tip[0] + i * 0.013, tip[1] + up, 0.08) for i in (-1, 0, 1) for up in np.linspace(0.0, 0.5, 400)])
    pixels = scene.camera.project(pose.apply(arm))
    seen = pixels[((pixels >= 0) & (pixels <= (1279, 719))).all(axis=1)].round().astype(int)
    assert not np.isfinite(pixels).all() and len(seen) > 20

    before = time.process_time()
    shadow = own_shadow(pose, scene.camera, pose.apply(tip), scene.reader.config)
    assert time.process_time() - before < 2.0
    assert shadow[seen[:, 1], seen[:, 0]].all()
    beside = pixels[np.isfinite(pixels).all(axis=1)] + (160.0, 0.0)
    beside = beside[((beside >= 0) & (beside <= (1279, 300))).all(axis=1)].round().astype(int)
    assert len(beside) and not shadow[beside[:, 1], beside[:, 0] + 100].any()
    assert not own_shadow(pose, scene.camera, np.full(3, np.nan), scene.reader.config).any()


def test_a_hand_hides_what_it_lies_on_and_nothing_else() -> None:
    scene = Scene()
    width, height = LAYOUT.size_mm
    places = np.array([(x, y) for x in np.arange(3, width, 6) for y in np.arange(3, height, 6)])
    free = Patches(centres_mm=places, agreeing=np.ones(len(places), bool))
    for _ in range(2):
        assert all(c.hidden_by == "" for c in scene.look(InstrumentState(), patches=free).controls)
    scene.renderer.hide((195.0, 80.0, 60.0, 60.0))
    inside = (np.abs(places - (225, 122)) < 30).all(axis=1)
    none = Patches(centres_mm=places[:0], agreeing=np.ones(0, bool))
    seen = scene.look(InstrumentState(), patches=none).controls
    assert "something" not in {c.hidden_by for c in seen if c.kind == "touch_area"}, "no print to be seen tells nothing"
    covered = Patches(centres_mm=places, agreeing=~inside)
    hidden = {c.name for c in scene.look(InstrumentState(), patches=covered).controls if c.hidden_by == "something"}
    assert {"RUN_STOP", "SINGLE", "CH1_SCALE", "CH2_SCALE"} <= hidden
    assert not hidden & {"MENU", "CH1", "CH1_POSITION", "TRIG_LEVEL", "MATH", "CH1_IN", "SCREEN"}, hidden
    scene.renderer.hide(None)
    assert all(c.hidden_by == "" for c in scene.look(InstrumentState(), patches=free).controls)


def test_what_is_not_in_the_picture_is_hidden_by_its_edge() -> None:
    scene = Scene()
    left, _ = scene.renderer.render(Moment(tip=AWAY, state=InstrumentState(), now_s=0.2))
    pose = scene.camera_from_base @ scene.panel_from
    u = float(scene.camera.project(pose.apply([np.array([*LAYOUT.control("MENU").position_mm, 0.0]) * 1e-3]))[0, 0])
    # The same picture without its right part: as by cameras that ride and stand farther to the left.
    narrow = dataclasses.replace(scene.camera, width=int(u))
    seen = scene.reader.read(left[:, : int(u)].copy(), pose, narrow, 1)
    menu, knob, run = (seen.control(name) for name in ("MENU", "TRIG_LEVEL", "RUN_STOP"))
    assert menu is not None and menu.hidden_by == "edge" and menu.text() == "not in the picture"
    assert knob is not None and knob.hidden_by == "edge" and np.isnan(knob.angle_deg)
    assert run is not None and run.lamp == "green" and not run.hidden_by


@pytest.mark.parametrize("model", sorted(path.stem for path in SCOPES.glob("*.yaml")))
def test_no_shadow_hides_a_control(model: str) -> None:
    layout = load_layout(SCOPES / f"{model}.yaml")
    scene, detector = Scene(layout), HarrisDetector()
    recogniser, found = PanelRecogniser(layout), {}
    buttons = [c for c in layout.controls if c.kind == "button"]
    places = {"away": np.array(AWAY)}
    for control in (buttons[0], *buttons[-2:]):
        places[control.name] = scene.panel_from.apply(np.array([*control.position_mm, 0.0]) * 1e-3) * (1, 1, 0)
    for place, tip in places.items():
        left, _ = scene.renderer.render(Moment(tip=tuple(float(v) for v in tip), state=InstrumentState(), now_s=0.2))
        gray = gray_of(left, "bgr8")
        sighting = recogniser.locate(gray, detector.detect(gray).xy, scene.camera)
        assert sighting is not None, place
        seen = scene.reader.read(
            left, sighting.camera_from_panel, scene.camera, 1, patches=sighting.patches, tip=scene.in_camera(tip)
        )
        found[place] = [c.name for c in seen.controls if c.hidden_by == "something"]
    assert not any(found.values()), found


def test_dimmed_light_hides_nothing() -> None:
    scene = Scene()
    scene.look(InstrumentState())
    scene.renderer.relight(dataclasses.replace(scene.config.light, level=0.4))
    assert all(c.hidden_by == "" for c in scene.look(InstrumentState()).controls)
