"""The pair as a camera would deliver it: noise from the seed, light, the live screen, a hand, a moved panel."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.cli import render
from icu_simulator.core.configuration import BenchCameraConfig, BenchConfig, LightConfig
from icu_simulator.core.instrument import InstrumentState, press
from icu_simulator.core.renderer import Moment, Renderer, base_from_panel, control_pixels

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[4]
LAYOUT = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")
CAMERA = BenchCameraConfig(width_px=640, height_px=360, focal_px=850.0, centre_px=(321.2, 177.4, 316.3, 181.9))
NOISY = BenchConfig(camera=CAMERA)
QUIET = BenchConfig(camera=CAMERA, light=LightConfig(noise=0.0))
AWAY = (0.34, 0.21, 0.0)


def moment(state: InstrumentState | None = None, now_s: float = 3.0) -> Moment:
    return Moment(tip=AWAY, state=state or InstrumentState(), now_s=now_s)


@pytest.fixture
def renderer() -> Renderer:
    return Renderer(LAYOUT, QUIET, base_from_panel(QUIET.panel))


def screen_part(renderer: Renderer, picture: np.ndarray) -> np.ndarray:
    rows, columns = renderer.views[0].window_of_panel([(25, 45, 0), (175, 45, 0), (175, 120, 0), (25, 120, 0)], 0)
    return picture[rows, columns].astype(int)


def test_the_seed_decides() -> None:
    panel = base_from_panel(NOISY.panel)
    first, again = (Renderer(LAYOUT, NOISY, panel).render(moment()) for _ in range(2))
    other = Renderer(LAYOUT, dataclasses.replace(NOISY, seed=2), panel).render(moment())
    for side in (0, 1):
        assert first[side].shape == (360, 640, 3)
        assert first[side].dtype == np.uint8
        assert np.array_equal(first[side], again[side])
        assert not np.array_equal(first[side], other[side])


def test_an_image_does_not_depend_on_those_before_it() -> None:
    """A slow computer renders the same image of a moment, whatever it has left out."""
    panel = base_from_panel(NOISY.panel)
    often, once = (Renderer(LAYOUT, NOISY, panel) for _ in range(2))
    before = [often.render(moment(now_s=n / 15))[0] for n in range(4)]
    assert len({image.tobytes() for image in before}) == 4, "noise of its own for each"
    for side in (0, 1):
        assert np.array_equal(often.render(moment(now_s=1.0))[side], once.render(moment(now_s=1.0))[side])


def test_noise_has_the_asked_strength() -> None:
    config = dataclasses.replace(NOISY, light=LightConfig(noise=3.0))
    noisy = Renderer(LAYOUT, config, base_from_panel(config.panel))
    stopped = press(InstrumentState(), "RUN_STOP", 1.0)
    pictures = [noisy.render(moment(stopped, now_s))[0].astype(float) for now_s in (3.0, 3.1)]
    spread = (pictures[0] - pictures[1])[20:80, 20:200].std() / np.sqrt(2)
    # Rounding to whole grey levels adds a twelfth.
    assert spread == pytest.approx(np.sqrt(9 + 1 / 12), rel=0.03)


def test_the_screen_moves_only_while_running(renderer: Renderer) -> None:
    def change(state: InstrumentState) -> float:
        parts = [screen_part(renderer, renderer.render(moment(state, now))[0]) for now in (3.0, 3.4)]
        return float(np.abs(parts[0] - parts[1]).mean())

    assert change(InstrumentState()) > 3
    assert change(press(InstrumentState(), "RUN_STOP", 2.0)) == 0


def test_run_stop_changes_its_lamp_in_both_pictures(renderer: Renderer) -> None:
    running = renderer.render(moment())
    stopped = renderer.render(moment(press(InstrumentState(), "RUN_STOP", 2.0)))
    for side, view in enumerate(renderer.views):
        u, v = np.round(view.pixel_of_panel((208, 127, 3))[0]).astype(int)
        blue, green, red = running[side][v, u].astype(int)
        assert green > red + 80, (blue, green, red)
        blue, green, red = stopped[side][v, u].astype(int)
        assert red > green + 80, (blue, green, red)


def test_light_and_hand(renderer: Renderer) -> None:
    bright = renderer.render(moment())[0]
    renderer.relight(LightConfig(noise=0.0, level=0.5))
    dark = renderer.render(moment())[0]
    u, v = np.round(renderer.views[0].pixel_of_panel((120, 25, 0))[0]).astype(int)
    assert dark[v, u].astype(float) == pytest.approx(bright[v, u] * 0.5, abs=2.0)
    screens = [screen_part(renderer, picture) for picture in (bright, dark)]
    assert np.percentile(screens[1], 99) > 0.8 * np.percentile(screens[0], 99), "the screen shines by itself"
    renderer.hide((190.0, 60.0, 60.0, 80.0))
    hidden = renderer.render(moment())[0]
    u, v = np.round(renderer.views[0].pixel_of_panel((215, 100, 25))[0]).astype(int)
    blue, _, red = hidden[v, u].astype(int)
    assert blue > red + 15, "a blue glove"
    renderer.hide(None)
    after = renderer.render(moment())[0]
    assert np.array_equal(after[v - 5 : v + 5, u - 5 : u + 5], dark[v - 5 : v + 5, u - 5 : u + 5])


def test_the_stylus_throws_a_shadow_to_the_right_and_down(renderer: Renderer) -> None:
    stopped = press(InstrumentState(), "RUN_STOP", 1.0)
    without = renderer.render(dataclasses.replace(moment(stopped), tip=(0.33, 0.21, 0.0)))[0].astype(float)
    # Above the bare face left of the inputs; the shaft is 75 mm higher at its arm.
    panel_point = np.array([0.100, 0.018, 0.030])
    tip = base_from_panel(QUIET.panel).apply(panel_point)
    above = renderer.render(dataclasses.replace(moment(stopped), tip=tuple(tip)))[0].astype(float)
    fall = 46 * 0.45  # where the stem becomes the shaft
    u, v = np.round(renderer.views[0].pixel_of_panel((100 + fall * 0.5, 18 - fall * 0.866 + 3, 0))[0]).astype(int)
    lit, shaded = (picture[v - 1 : v + 2, u - 1 : u + 2].mean() for picture in (without, above))
    assert 0.6 * lit < shaded < 0.93 * lit


def test_a_moved_panel_is_seen_where_it_is(renderer: Renderer) -> None:
    before = renderer.render(moment())[0]
    was = renderer.views[0].pixel_of_panel((208, 127, 3))[0]
    renderer.move_panel(base_from_panel(QUIET.panel, (0.012, -0.004, 0.0)))
    after = renderer.render(moment())[0]
    now = renderer.views[0].pixel_of_panel((208, 127, 3))[0]
    assert np.linalg.norm(now - was) > 12
    u, v = np.round(now).astype(int)
    du, dv = np.round(was).astype(int)
    template = before[dv - 14 : dv + 15, du - 22 : du + 23]
    found = cv2.matchTemplate(after, template, cv2.TM_CCOEFF_NORMED)
    _, score, _, (left, top) = cv2.minMaxLoc(found)
    assert score > 0.9
    assert np.hypot(left + 22 - u, top + 14 - v) < 1.6


def test_control_pixels_agree_with_the_camera(renderer: Renderer) -> None:
    pixels = control_pixels(renderer.views[1], LAYOUT)
    assert set(pixels) == {c.name for c in LAYOUT.controls}
    point = base_from_panel(QUIET.panel).apply(np.array([0.211, 0.092, 0.015]))
    assert pixels["CH1_SCALE"]["centre"] == pytest.approx(renderer.rig.right.project(point)[0], abs=1e-9)
    assert len(pixels["SCREEN"]["outline"]) == 4


def test_the_command_writes_picture_and_truth(tmp_path: Path) -> None:
    out = tmp_path / "right.png"
    arguments = ["--layout", str(ROOT / "config/scopes/dso_bench_4.yaml"), "--out", str(out), "--side", "right"]
    small = ["camera.width_px=640", "camera.height_px=360", "camera.focal_px=850", "light.noise=0"]
    small.append("camera.centre_px=[321.2, 177.4, 316.3, 181.9]")
    for item in small:
        arguments += ["--set", item]
    assert render.main([*arguments, "--tip", "0.1", "0.1", "-0.02", "--press", "RUN_STOP"]) == 0
    picture = cv2.imread(str(out))
    truth = json.loads(out.with_suffix(".json").read_text())
    assert picture.shape == (360, 640, 3)
    u, v = np.round(truth["tip_px"]).astype(int)
    blue, green, red = picture[v + 1, u].astype(int)
    assert min(red, blue) > green + 40, "the magenta ball is where the truth says"
    with pytest.raises(SystemExit):
        render.main([*arguments, "--set", "light.noise=-1"])


def test_the_panel_of_the_configuration_is_drawn_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was looked for in config/ of the folder that one is in."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ICU_CONFIG", str(ROOT / "config"))
    assert render.main(["--out", "bench.png"]) == 0
    assert set(json.loads(Path("bench.json").read_text())["controls_px"]) == {c.name for c in LAYOUT.controls}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--set", "light.noise"], "'light.noise': expected KEY=VALUE"),
        (["--set", "light.noise=2026-13-45"], "'light.noise=2026-13-45': cannot read the value"),
        (["--set", "light.noise=[1"], "'light.noise=[1': cannot read the value"),
        (["--turn", "CH1_SCALE"], "--turn CH1_SCALE; expected NAME=DEGREES"),
        (["--turn", "CH1_SCALE=far"], "--turn CH1_SCALE=far; expected NAME=DEGREES"),
        (["--turn", "CH1_SCALE=nan"], "--turn CH1_SCALE=nan; expected NAME=DEGREES"),
        (["--turn", "RUN_STOP=3"], "--turn RUN_STOP=3: RUN_STOP is a button; expected a knob"),
        (["--hide", "0", "0", "-1", "5"], "--hide 0 0 -1 5; expected W and H above 0"),
        (["--turn", "NOPE=3"], "no control 'NOPE'"),
        (["--press", "NOPE"], "no control 'NOPE'"),
        (["--tip", "nan", "0", "0"], "argument --tip: nan is not finite"),
        (["--tip", "0.3", "0.2", "2"], "--tip 0.3 0.2 2: it is behind the left camera"),
        (["--tip", "0", "-0.4", "0.7", "--side", "right"], "--tip 0 -0.4 0.7: it is behind the right camera"),
        (["--tip", "1e300", "0", "0"], "--tip 1e+300 0 0: at most 10 m from base_link's origin are drawn"),
        (["--time", "inf"], "argument --time: inf is not finite"),
        (["--hide", "0", "0", "nan", "1"], "argument --hide: nan is not finite"),
        (["--out", "picture.nothing"], "cannot write picture.nothing"),
        (["--out", "nowhere/picture.png"], "nowhere/picture.png"),
        (["--truth", "nowhere/truth.json"], "nowhere/truth.json"),
        (["--truth", "picture.png"], "--truth picture.png: the picture is written there"),
        (["--layout", "own.yaml", "--truth", "own.yaml"], "--truth own.yaml: the layout is read from there"),
        (["--layout", "own.yaml", "--out", "own.yaml"], "--out own.yaml: the layout is read from there"),
    ],
)
def test_mistakes_on_the_command_line_end_with_one_sentence(
    given: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = ROOT / "config/scopes/dso_bench_4.yaml"
    Path("own.yaml").write_bytes(shipped.read_bytes())
    with pytest.raises(SystemExit) as ended:
        render.main(["--layout", str(shipped), "--out", "picture.png", *given])
    assert Path("own.yaml").read_bytes() == shipped.read_bytes()
    error = capsys.readouterr().err.splitlines()[-1]
    assert ended.value.code == 2 and error.startswith("bench_render: error: ") and said in error
