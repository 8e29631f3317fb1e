"""The command: files written and read again by CameraModel, and one line of advice for each wrong input."""

from __future__ import annotations

import json
import os
import re
import struct
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from unit.harris_perception.drawn_board import camera, picture, poses

from harris_perception.adapters.camera_sources import CameraNodeConfig, open_source
from harris_perception.cli.calibrate import main
from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.view_collection import ViewCollection
from icu_common.core.geometry.camera_model import CameraModel

pytestmark = pytest.mark.slow

BOARD = CalibrationBoard(columns=9, rows=6, square_m=0.025)
SMALL = ["--chessboard", "9x6", "--square-mm", "25"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of six rendered views, left0.png to left5.png."""
    place = tmp_path_factory.mktemp("views")
    rng = np.random.default_rng(21)
    for number, pose in enumerate(poses(rng, BOARD, 6)):
        assert cv2.imwrite(str(place / f"left{number}.png"), picture(BOARD, pose, rng))
    return place


def test_one_camera_is_calibrated_and_its_file_loads(folder: Path, tmp_path: Path, capsys: Any) -> None:
    assert main(["mono", str(folder), *SMALL, "--name", "bench_left", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "left3.png" in said and "+-" in said and "coverage" in said
    model = CameraModel.load(tmp_path / "bench_left.yaml")
    assert model.name == "bench_left" and model.size == (960, 720)
    assert model.k[0, 0] == pytest.approx(camera().k[0, 0], abs=3)
    # Contents that camera_info_manager reads (camera_calibration_parsers), no more and no less.
    document = yaml.safe_load((tmp_path / "bench_left.yaml").read_text())
    assert set(document) == {
        "image_width",
        "image_height",
        "camera_name",
        "camera_matrix",
        "distortion_model",
        "distortion_coefficients",
        "rectification_matrix",
        "projection_matrix",
    }
    report = json.loads((tmp_path / "calibration.json").read_text())
    assert len(report["views"]) == 6 and report["rms_px"] < 0.1 and report["sigma"]["fx_px"] > 0
    assert set(report["coverage"]) == {"x", "y", "size", "skew"}
    assert cv2.imread(str(tmp_path / "bench_left_residuals.png")).shape == (1000, 1280, 3)


def held(png: Path, orientation: int) -> bytes:
    """Return a picture as a JPEG of a camera that notes how it was held (EXIF), 1 = upright."""
    jpeg = cv2.imencode(".jpg", cv2.imread(str(png)), [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    tag = struct.pack("<2sHIHHHIHHI", b"II", 42, 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    return jpeg[:2] + struct.pack(">2sH6s", b"\xff\xe1", len(tag) + 8, b"Exif\0\0") + tag + jpeg[2:]


def test_pictures_are_taken_as_the_sensor_has_them_however_it_was_held(folder: Path, tmp_path: Path) -> None:
    """Turned upright, the same camera would have its centre elsewhere in each of them."""
    for number, orientation in enumerate((1, 3, 3, 6, 8, 3)):
        (tmp_path / f"photo{number}.jpg").write_bytes(held(folder / f"left{number}.png", orientation))
    assert main(["mono", str(tmp_path / "*.jpg"), *SMALL, "-o", str(tmp_path)]) == 0
    model = CameraModel.load(tmp_path / "camera.yaml")
    assert model.size == (960, 720)
    assert model.k == pytest.approx(camera().k, abs=3)
    camera_node = CameraNodeConfig(source="images", left_path=str(tmp_path / "*.jpg"), rate_hz=240.0)
    source = open_source(camera_node, now_ns=lambda: 7, stop=threading.Event())
    assert {source.read(1.0).pictures[0].shape for _ in range(6)} == {(720, 960, 3)}


def test_board_files_are_written(tmp_path: Path) -> None:
    files = [str(tmp_path / "b.svg"), str(tmp_path / "b.pdf")]
    assert main(["board", *files, "--charuco", "9x6", "--square-mm", "24", "--paper", "a4"]) == 0
    assert "<svg" in Path(files[0]).read_text()
    assert Path(files[1]).read_bytes().startswith(b"%PDF-")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["mono", "{folder}/left[01].png", "--chessboard", "10x7"],
            "left0.png shows 9x6 inner corners: try --chessboard 9x6",
        ),
        (["mono", "{folder}/left[0-2].png", *SMALL], "found in 3 pictures; expected at least 5"),
        (["mono", "{folder}/nothing*.png"], "no pictures"),
        (["mono", "{folder}", "--charuco", "9x6"], "check the dictionary"),
        (["stereo", "{folder}/left[0-2].png", "{folder}/left[3-5].png"], "no left picture has a right one"),
        (
            ["stereo", "{folder}", "{folder}", *SMALL, "--names", "cam", "cam"],
            "--names cam cam; expected two different names",
        ),
        (["mono", "{folder}", "--alpha", "2"], "alpha = 2.0 is above its maximum 1"),
        (["board", "{folder}/board.txt"], "must end in .svg or .pdf"),
        (["board", "{new}.svg", "{new}.txt"], "new.txt: the name must end in .svg or .pdf"),
        (["mono", "--live", "{folder}"], "is not empty"),
        (["mono", "--live", "{new}", "--within", "nan"], "--within nan; expected 0 or more"),
        (["mono", "--live", "{new}", "--within", "-1"], "--within -1; expected 0 or more"),
        (["mono", "--live", "{new}", "--views", "0"], "--views 0; expected 1 or more"),
        (["mono", "--live", "{new}", "--topic", "a b"], "topic 'a b': Invalid topic name: topic name must not contain"),
        (["stereo", "--live", "{new}", "{new}_2", "--namespace", "/a/"], "topic '/a//left/image_raw': Invalid topic"),
    ],
)
def test_wrong_input_gets_one_line_of_advice(
    arguments: list[str], message: str, folder: Path, tmp_path: Path, capsys: Any
) -> None:
    places = {"{folder}": str(folder), "{new}": str(tmp_path / "new")}
    given = [re.sub(r"{\w+}", lambda name: places[name[0]], argument) for argument in arguments]
    output = [] if given[0] == "board" else ["-o", str(tmp_path)]
    assert main([*given, *output]) == 2
    lines = capsys.readouterr().err.strip().split("\n")
    assert lines[-1].startswith("error: ") and message in lines[-1]
    assert not list(tmp_path.iterdir())


def test_a_place_for_the_results_is_needed_before_a_board_is_shown(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "file").touch()
    given = ["mono", "--live", str(tmp_path / "new"), "--within", "0", "-o", str(tmp_path / "file")]
    assert main(given) == 2
    shown = capsys.readouterr()
    assert "File exists" in shown.err and "listening" not in shown.out
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_residuals_of_the_last_time_beside_the_pictures_do_not_mix_the_pairs_up(tmp_path: Path, capsys: Any) -> None:
    for name in ("left1", "left2", "left_residuals", "right2", "right3", "right_residuals"):
        assert cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((72, 96), 90, np.uint8))
    assert main(["stereo", f"{tmp_path}/left*.png", f"{tmp_path}/right*.png", *SMALL, "-o", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "without a partner: left1.png, left_residuals.png, right3.png, right_residuals.png\n" in said.out
    assert "in any of 1 pictures" in said.err, "left2.png with right2.png"


def test_results_are_written_though_nobody_reads_what_is_told(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As behind ``| head -n 1``: it has gone before the calibration is done."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1) as unread:
        monkeypatch.setattr("sys.stdout", unread)
        main(["mono", str(folder), *SMALL, "-o", str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["calibration.json", "camera.yaml", "camera_residuals.png"]


def test_views_are_collected_though_nobody_reads_what_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    def collected(board: CalibrationBoard, *_: Any, say: Any, **__: Any) -> ViewCollection:
        for line in ("0/20 views; show the board", "1/20 views"):
            say(line)
        return ViewCollection(board, 20)

    monkeypatch.setattr("harris_perception.nodes.calibration_capture.capture", collected)
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as unread:
        monkeypatch.setattr("sys.stdout", unread)
        assert main(["mono", "--live", str(tmp_path / "views")]) == 2
    assert capsys.readouterr().err.startswith("error: no view of the chessboard")


def test_what_the_views_cover_is_told_before_the_error_in_a_log(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "log"
    with log.open("a") as output, log.open("a", buffering=1) as errors:
        monkeypatch.setattr("sys.stdout", output)
        monkeypatch.setattr("sys.stderr", errors)
        assert main(["mono", f"{folder}/left[0-2].png", *SMALL, "-o", str(tmp_path)]) == 2
    first, *_, skew, error = log.read_text().splitlines()
    assert first.startswith("coverage") and skew.startswith("  skew") and error.startswith("error: the board was found")


def test_pictures_without_the_board_are_named(folder: Path, tmp_path: Path, capsys: Any) -> None:
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    assert cv2.imwrite(str(tmp_path / "left9.png"), np.full((720, 960), 90, np.uint8))
    assert main(["mono", str(tmp_path), *SMALL, "-o", str(tmp_path / "out")]) == 0
    assert "board not found in 1 of 7: left9.png" in capsys.readouterr().out
