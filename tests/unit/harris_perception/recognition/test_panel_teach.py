"""Teaching a panel from a tilted picture: the layout has the controls' places, and recognition finds the panel."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shlex
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from unit.harris_perception import panel_scene as scene

from harris_perception.adapters.panel_files import how_to_start, write_panel
from harris_perception.cli.panel_teach import main
from harris_perception.core.corners.harris import HarrisDetector
from harris_perception.core.recognition.panel_teaching import Lesson, Pointed, TeachingError, parse_request, teach
from harris_perception.core.recognition.panel_template import draw_panel
from harris_perception.core.recognition.recognition import PanelRecogniser
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.panel.panel_layout import load_layout

pytestmark = pytest.mark.slow

LAYOUT = scene.bench_layout()
CAMERA = scene.camera(k1=0.0)
NAMES = ("SCREEN", "RUN_STOP", "CH1", "TIME_SCALE", "CH1_IN")


def photo(folder: Path) -> tuple[Path, list[str], list[str]]:
    """Write an image; return it with the corners and controls as a person would point at them."""
    truth = scene.pose(LAYOUT, distance_m=0.5, below_deg=8.0)
    path = folder / "photo.png"
    cv2.imwrite(str(path), scene.picture(LAYOUT, CAMERA, truth, scene.Look(arm_x_mm=None, noise=1.0), 3))
    width, height = LAYOUT.size_mm
    face = np.array([(0, 0, 0), (width, 0, 0), (width, height, 0), (0, height, 0)]) / 1000
    corners = [f"{u:.1f},{v:.1f}" for u, v in CAMERA.project(truth.apply(face))]
    pointed = []
    for name in NAMES:
        control = LAYOUT.control(name)
        u, v = CAMERA.project(truth.apply(np.array([*control.position_mm, 0.0]) / 1000))[0]
        w, h = control.size_mm
        pointed += ["--control", f"{name}:{control.kind}:{u:.1f},{v:.1f}:{w:g}x{h:g}:{control.height_mm:g}"]
    return path, corners, pointed


def test_a_panel_taught_from_a_picture_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, corners, pointed = photo(tmp_path)
    arguments = ["picture", str(path), "--model", "taught", "--size-mm", "320", "150", "--corners", *corners]
    assert main([*arguments, *pointed, "-o", str(tmp_path)]) == 0
    assert "taught: 320 x 150 mm" in capsys.readouterr().out
    layout = load_layout(tmp_path / "taught.yaml")
    for name in NAMES:
        apart = np.subtract(layout.control(name).position_mm, LAYOUT.control(name).position_mm)
        # The test camera's tangential distortion stays in the picture.
        assert np.abs(apart).max() < 1.0, name
    template = cv2.imread(str(tmp_path / "taught.png"), cv2.IMREAD_GRAYSCALE)
    assert template is not None and template.shape == (600, 1280)
    recogniser = PanelRecogniser(layout, picture=template, picture_px_per_mm=4.0)
    truth = scene.pose(LAYOUT, below_deg=20.0)
    seen = scene.picture(LAYOUT, CAMERA, truth, scene.Look(), 4)
    sighting = recogniser.locate(seen, HarrisDetector().detect(seen).xy, CAMERA)
    assert sighting is not None
    points = scene.control_points_m(LAYOUT)
    error = np.linalg.norm(sighting.camera_from_panel.apply(points) - truth.apply(points), axis=1).max()
    print(f"{1000 * error:.2f} mm")
    assert error < 0.003
    assert main([*arguments, *pointed, "-o", str(tmp_path)]) == 1
    assert "is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("corners", ["1,1", "2,2", "3,3", "4,4"], "do not go round the face"),
        ("corners", ["1,1", "2,2", "3,3", "a,4"], "expected pixels u,v"),
        ("control", ["--control", "START:lever:3,4:5x6"], "kind 'lever' is none of"),
        ("control", ["--control", "START:button:3:5x6"], "NAME:kind:u,v:WIDTHxHEIGHT"),
    ],
)
def test_what_does_not_make_a_panel_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: list[str], words: str
) -> None:
    path, corners, pointed = photo(tmp_path)
    corners, pointed = (new, pointed) if old == "corners" else (corners, new)
    code = main(["picture", str(path), "--model", "m", "--size-mm", "320", "150", "--corners", *corners, *pointed])
    assert code == 1 and words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["--model", "../elsewhere"], "model '../elsewhere': a letter, then up to 40"),
        (["--size-mm", "inf", "150"], "inf x 600 px at 4 px/mm (limits 48 to 8192 px"),
        (["--size-mm", "320", "nan"], "1280 x nan px at 4 px/mm (limits 48 to 8192 px"),
        (["--px-per-mm", "inf"], "inf x inf px at inf px/mm (limits 48 to 8192 px"),
        (["--corners", "1,2,3", "2,2", "3,3", "4,4"], "--corners 1,2,3 2,2 3,3 4,4; expected pixels u,v"),
        (["missing.png"], "missing.png does not exist"),
    ],
)
def test_what_is_out_of_bounds_ends_with_one_line_and_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: list[str], words: str
) -> None:
    path, corners, pointed = photo(tmp_path)
    out = tmp_path / "scopes"
    given = ["--model", "m", "--size-mm", "320", "150", "--corners", *corners, *pointed, "-o", str(out)]
    source = [] if changes == ["missing.png"] else [str(path)]
    assert main(["picture", *source, *given, *changes]) == 1
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert not out.exists() and [p.name for p in tmp_path.iterdir()] == ["photo.png"]


def test_a_drawing_of_an_unknown_kind_ends_with_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(scene.LAYOUT), "--drawing", str(tmp_path / "face.xyz")]) == 1
    error = capsys.readouterr().err
    assert "cannot write face.xyz" in error and error.count("\n") == 1


def test_a_drawing_that_does_not_fit_on_the_disk_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "face.png").symlink_to("/dev/full")
    assert main(["check", str(scene.LAYOUT), "--drawing", str(tmp_path / "face.png")]) == 1
    error = capsys.readouterr().err
    assert "No space left on device" in error and error.count("\n") == 1


def request(folder: Path, **changes: object) -> dict[str, object]:
    """Return what the page would send for the same picture."""
    _, corners, pointed = photo(folder)
    controls = []
    for text in pointed[1::2]:
        name, kind, pixel, size, proud = text.split(":")
        controls.append([name, kind, *map(float, pixel.split(",")), *map(float, size.split("x")), float(proud)])
    places = [[float(n) for n in corner.split(",")] for corner in corners]
    said = {"id": "service-1", "stamp": "7", "model": "taught", "title": "", "size_mm": [320, 150], "corners": places}
    return {**said, "controls": controls, **changes}


def test_with_its_calibration_the_cameras_distortion_does_not_stay_in_the_layout(tmp_path: Path) -> None:
    found = parse_request(json.dumps(request(tmp_path)))
    assert (found.goal_id, found.stamp_ns, found.lesson.title) == ("service-1", 7, "taught")
    picture = cv2.imread(str(tmp_path / "photo.png"))
    taught = teach(np.asarray(picture, np.uint8), found.lesson, CAMERA)
    apart = [
        float(np.abs(np.subtract(taught.layout.control(n).position_mm, LAYOUT.control(n).position_mm)).max())
        for n in NAMES
    ]
    assert max(apart) < 0.06, "the places were rounded to a tenth of a pixel"
    layout, template = write_panel(taught, tmp_path / "new", "a test")
    assert load_layout(layout) == taught.layout and cv2.imread(str(template)).shape == (600, 1280, 3)
    assert f"--scope taught --set recognition.template={template}" in how_to_start(taught, template)
    spaced = shlex.split(how_to_start(taught, tmp_path / "my panels" / "taught.png"))
    assert f"recognition.template={tmp_path}/my panels/taught.png" in spaced, "it is pasted into a shell"
    before = layout.read_text()
    with pytest.raises(TeachingError, match="is there already"):
        write_panel(taught, tmp_path / "new", "a test")
    assert layout.read_text() == before and sorted(p.name for p in layout.parent.iterdir()) == [
        "taught.png",
        "taught.yaml",
    ]


def wide_lesson(skew: float = 0.0) -> tuple[Any, CameraModel, Lesson]:
    """Return a picture by a wide lens, and the panel in it pointed at exactly."""
    camera = scene.camera(focal=750.0, k1=-0.27)
    camera = dataclasses.replace(camera, k=camera.k + np.array([[0.0, skew, 0.0], [0.0] * 3, [0.0] * 3]))
    truth = scene.pose(LAYOUT, distance_m=0.18, below_deg=3.0)
    width, height = LAYOUT.size_mm
    face = np.array([(0, 0, 0), (width, 0, 0), (width, height, 0), (0, height, 0)]) / 1000
    controls = []
    for control in map(LAYOUT.control, NAMES):
        u, v = camera.project(truth.apply(np.array([*control.position_mm, 0.0]) / 1000))[0]
        controls.append(Pointed(name=control.name, kind=control.kind, pixel=(u, v), size_mm=control.size_mm))
    lesson = Lesson(
        model="wide",
        title="wide",
        size_mm=LAYOUT.size_mm,
        corners_px=camera.project(truth.apply(face)),
        controls=tuple(controls),
    )
    return scene.picture(LAYOUT, camera, truth, scene.Look(arm_x_mm=None, noise=1.0), 3), camera, lesson


@pytest.mark.parametrize("skew", [0.0, 40.0])
def test_a_wide_lens_does_not_move_what_is_near_the_pictures_edge(skew: float) -> None:
    picture, camera, lesson = wide_lesson(skew)
    taught = teach(picture, lesson, camera)
    for name in NAMES:
        apart = np.subtract(taught.layout.control(name).position_mm, LAYOUT.control(name).position_mm)
        assert np.abs(apart).max() < 0.01, name
    drawn = cv2.resize(draw_panel(LAYOUT, 8.0), taught.template.shape[1::-1], interpolation=cv2.INTER_AREA)
    drawn = cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY).astype(np.float32)
    apart, _ = cv2.phaseCorrelate(drawn, taught.template.astype(np.float32))
    assert np.abs(apart).max() < 0.3, "with a skew that was left out it was 14 px"


def test_a_place_that_the_cameras_calibration_does_not_reach_is_refused() -> None:
    picture, camera, lesson = wide_lesson()
    bent = dataclasses.replace(camera, d=np.array([-0.7, 0.0, 0.0, 0.0, 0.0]))
    u, v = lesson.corners_px[0]
    with pytest.raises(ValueError, match=rf"pixel {u:.0f}, {v:.0f} is beyond what the camera's calibration reaches"):
        teach(picture, lesson, bent)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"model": "../taught"}, "model '../taught'"),
        ({"controls": [["A", "lever", 1, 2, 3, 4, 5]]}, "kind 'lever' is none of"),
        ({"controls": [["A", "button", 1, 2]]}, "cannot read the request"),
        ({"size_mm": "big"}, "cannot read the request"),
        ({"stamp": float("inf")}, "cannot read the request"),
        ({"size_mm": [10**400, 150]}, "cannot read the request"),
    ],
)
def test_a_request_that_makes_no_panel_is_refused(tmp_path: Path, changes: dict[str, object], words: str) -> None:
    with pytest.raises(TeachingError, match=re.escape(words)) as refused:
        parse_request(json.dumps(request(tmp_path, **changes)))
    assert refused.value.goal_id == "service-1"


@pytest.mark.parametrize(
    "text", ["[1", "[" * 100_000, "{}", '{"id": "\\ud800"}'], ids=["cut off", "deep", "without", "half a character"]
)
def test_a_request_whose_id_cannot_be_read_is_refused(text: str) -> None:
    with pytest.raises(TeachingError, match="cannot read the request") as refused:
        parse_request(text)
    assert refused.value.goal_id == ""


def test_a_drawing_is_written_though_nobody_reads_what_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1) as unread:
        monkeypatch.setattr("sys.stdout", unread)
        main(["check", str(scene.LAYOUT), "--drawing", str(tmp_path / "face.png")])
    assert cv2.imread(str(tmp_path / "face.png")).shape[2] == 3


def test_check_of_a_layout_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(scene.LAYOUT), "--drawing", str(tmp_path / "face.png")]) == 0
    assert "7 knob" in capsys.readouterr().out and (tmp_path / "face.png").stat().st_size > 1000
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("model: m\nsize_mm: [100, 50]\ncontrols:\n  - {name: A, kind: lever}\n")
    assert main(["check", str(wrong)]) == 1
    assert "wrong.yaml:4: " in capsys.readouterr().err
