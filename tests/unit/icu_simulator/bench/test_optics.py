"""The bench's cameras against closed forms, against OpenCV, and against the calibration files that belong to them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.cli import write_calibration
from icu_simulator.core.configuration import BenchCameraConfig, BenchConfig, PanelConfig
from icu_simulator.core.optics import stereo_rig, turn
from icu_simulator.core.renderer import base_from_panel

ROOT = Path(__file__).parents[4]
RIG = stereo_rig(BenchConfig().camera)
POINTS = np.random.default_rng(5).uniform((0.0, 0.0, -0.05), (0.359, 0.219, 0.0), (300, 3))


def test_a_plain_camera_projects_as_a_pinhole() -> None:
    plain = BenchCameraConfig(distortion=(0.0,) * 10, toe_in_deg=0.0, elevation_deg=0.0, azimuth_deg=0.0, roll_deg=0.0)
    camera = stereo_rig(plain).left
    x, y, z = plain.aim_m
    # Straight down from 0.665 m, half the baseline to the left: x to the right, y of the base upwards.
    expected = [646.3 + 1700 * (0.06 + 0.02) / 0.665, 354.8 - 1700 * 0.01 / 0.665]
    assert camera.project((x + 0.02, y + 0.01, z))[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("camera", [RIG.left, RIG.right], ids=["left", "right"])
def test_projection_agrees_with_opencv(camera) -> None:
    pose = camera.camera_from_base
    matrix = np.array([[1700.0, 0, camera.centre_px[0]], [0, 1700.0, camera.centre_px[1]], [0, 0, 1]])
    rotation, _ = cv2.Rodrigues(pose.rotation)
    expected, _ = cv2.projectPoints(POINTS, rotation, pose.translation, matrix, np.array(camera.distortion))
    assert np.abs(camera.project(POINTS) - expected[:, 0]).max() < 1e-9


@pytest.mark.parametrize("camera", [RIG.left, RIG.right], ids=["left", "right"])
def test_rays_invert_the_projection(camera) -> None:
    u, v = np.meshgrid(np.linspace(0, 1279, 17), np.linspace(0, 719, 11))
    a, b = camera.slopes(u, v)
    in_camera = np.column_stack([a.ravel(), b.ravel(), np.ones(a.size)]) * 0.7
    again = camera.project(camera.camera_from_base.inverse().apply(in_camera))
    assert np.abs(again - np.column_stack([u.ravel(), v.ravel()])).max() < 1e-9


def test_calibration_files_are_those_of_the_bench() -> None:
    pair = [CameraModel.load(ROOT / f"config/cameras/bench_{side}.yaml") for side in ("left", "right")]
    stereo = StereoModel(left=pair[0], right=pair[1])
    seen = RIG.rectified_left_from_base().apply(POINTS)
    assert np.abs(pair[0].project(seen) - RIG.left.project(POINTS)).max() < 1e-9
    assert np.abs(stereo.project_right(seen) - RIG.right.project(POINTS)).max() < 1e-9
    left, right = (model.rectify(camera.project(POINTS)) for model, camera in zip(pair, (RIG.left, RIG.right)))
    assert np.abs(left[:, 1] - right[:, 1]).max() < 1e-9, "rows of the rectified pair must agree"
    assert np.abs(stereo.triangulate(left, right) - seen).max() < 1e-9


def test_the_command_writes_the_committed_files(tmp_path: Path) -> None:
    assert write_calibration.main([str(tmp_path)]) == 0
    for name in ("bench_left.yaml", "bench_right.yaml"):
        written, kept = (yaml.safe_load((folder / name).read_text()) for folder in (tmp_path, ROOT / "config/cameras"))
        for key in ("camera_matrix", "distortion_coefficients", "rectification_matrix", "projection_matrix"):
            assert written[key]["data"] == pytest.approx(kept[key]["data"], abs=1e-9)
            # The rest is rounding, which differs from processor to processor.
            assert written[key]["data"] == [round(value, 13) for value in written[key]["data"]] == kept[key]["data"]
        assert (written["image_width"], written["image_height"]) == (kept["image_width"], kept["image_height"])


def test_the_command_writes_the_cameras_of_a_changed_bench(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "config/params/bench.yaml").read_text(encoding="utf-8")
    assert "focal_px: 1700.0" in text and "baseline_m: 0.12\n" in text
    (tmp_path / "params").mkdir()
    changed, folder = tmp_path / "params" / "bench.yaml", tmp_path / "cameras"
    changed.write_text(
        text.replace("focal_px: 1700.0", "focal_px: 1500.0").replace("baseline_m: 0.12", "baseline_m: 0.1")
    )
    assert write_calibration.main([str(folder)]) == 2
    assert str(folder) in capsys.readouterr().err
    folder.mkdir()
    assert write_calibration.main([str(folder)]) == 0
    assert str(changed) in capsys.readouterr().out
    pair = [CameraModel.load(folder / f"bench_{side}.yaml") for side in ("left", "right")]
    assert [model.k[0, 0] for model in pair] == [1500.0, 1500.0]
    assert -pair[1].p[0, 3] / pair[1].p[0, 0] == pytest.approx(0.1, abs=1e-9)
    changed.write_text("/**: {ros__parameters: {camera: {focal_px: wide}}}")
    assert write_calibration.main([str(folder)]) == 2
    assert "focal_px = 'wide'" in capsys.readouterr().err


def test_panel_and_workspace_are_in_both_pictures() -> None:
    layout = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")
    width, height = (side / 1000 for side in layout.size_mm)
    corners = [(x, y, z) for x in (0, width) for y in (0, height) for z in (0, 0.015)]
    panel = base_from_panel(PanelConfig()).apply(corners)
    workspace = np.array([(x, y, z) for x in (0, 0.359) for y in (0, 0.219) for z in (-0.059, 0)])
    for camera in (RIG.left, RIG.right):
        for points, margin in ((panel, 120), (workspace, 40)):
            pixels = camera.project(points)
            assert pixels.min() > margin
            assert pixels[:, 0].max() < 1280 - margin
            assert pixels[:, 1].max() < 720 - margin


def test_rotation_is_counter_clockwise() -> None:
    assert turn(2, 90.0) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert turn(0, 90.0) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert turn(1, 90.0) @ [0, 0, 1] == pytest.approx([1, 0, 0])


def test_wrong_lengths_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"distortion = \(0.1,\) has 1 values; expected 10"):
        dataclasses.replace(BenchCameraConfig(), distortion=(0.1,))
