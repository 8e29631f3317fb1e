"""The calibration's file: comes back as it was saved, and is refused where it does not belong."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from harris_perception.core.hand_eye.calibration_file import (
    CalibrationFileError,
    StoredCalibration,
    check_fits,
    load,
    save,
)
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Transform


def camera(
    name: str = "left", focal: float = 1700.0, width: int = 1280, baseline: float = 0.0, **change: Any
) -> CameraModel:
    k = np.array([[focal, 0.0, 640.0], [0.0, focal, 360.0], [0.0, 0.0, 1.0]])
    p = np.column_stack([k, [-focal * baseline, 0.0, 0.0]])
    values = {"k": k, "d": np.array([-0.08, 0.02, 0.0, 0.0, 0.0]), "r": np.eye(3), "p": p, **change}
    return CameraModel(name=name, width=width, height=720, **values)


def stored(**change: Any) -> StoredCalibration:
    values: dict[str, Any] = {
        "camera_from_base": Transform.from_quaternion((0.9, 0.1, 0.02, 0.3), (-0.17, 0.09, 0.66)),
        "base_from_reading": np.array([[1.004, -0.003], [0.0, 0.997]]),
        "stylus_direction": np.array([0.001, 0.0, -1.0]),
        "left": camera(),
        "right": camera("right", baseline=0.12),
        "machine": "bench",
        "rms_m": 0.00005,
        "sigma_m": 0.00003,
        "held_out_m": 0.0001,
        "samples": 24,
        "made_at": "2026-03-04T05:06:07+00:00",
    }
    return StoredCalibration(**{**values, **change})


def test_round_trip_is_exact(tmp_path: Path) -> None:
    path = tmp_path / "new" / "hand_eye.yaml"
    before = stored()
    save(before, path)
    after = load(path)
    np.testing.assert_array_equal(after.camera_from_base.rotation, before.camera_from_base.rotation)
    np.testing.assert_array_equal(after.camera_from_base.translation, before.camera_from_base.translation)
    np.testing.assert_array_equal(after.base_from_reading, before.base_from_reading)
    np.testing.assert_array_equal(after.stylus_direction, before.stylus_direction)
    same = ("machine", "rms_m", "sigma_m", "held_out_m", "samples", "made_at")
    assert [getattr(after, n) for n in same] == [getattr(before, n) for n in same]
    check_fits(after, camera(), camera("right", baseline=0.12), "bench")
    assert [p.name for p in path.parent.iterdir()] == ["hand_eye.yaml"]
    assert "24 samples, rms 0.050 mm, held-out 0.10 mm, predicted 0.030 mm" in after.summary()


def test_unknown_right_camera_and_held_out_error_survive(tmp_path: Path) -> None:
    save(stored(right=None, held_out_m=math.nan), tmp_path / "c.yaml")
    after = load(tmp_path / "c.yaml")
    assert after.right is None and math.isnan(after.held_out_m)
    check_fits(after, camera(), camera("right", baseline=0.5), "bench")


@pytest.mark.parametrize(
    ("left", "right", "machine", "message"),
    [
        (camera(), camera(baseline=0.12), "other", "made for machine 'bench', this one is 'other'"),
        (camera(width=640), camera(baseline=0.12), "bench", "a left picture of 1280 x 720 px, now it has 640 x 720 px"),
        (camera(focal=1701.0), camera(baseline=0.12), "bench", r"left camera's calibration has changed by 1\.00 px"),
        (camera(d=np.array([-0.09, 0.02, 0, 0, 0])), None, "bench", r"left camera's calibration has changed by"),
        (camera(), camera(baseline=0.121), "bench", r"the right camera's calibration has changed by 1\.70 px"),
    ],
)
def test_other_cameras_and_machines_are_refused(
    left: CameraModel, right: CameraModel | None, machine: str, message: str
) -> None:
    with pytest.raises(CalibrationFileError, match=message):
        check_fits(stored(), left, right, machine)


@pytest.mark.parametrize("now", ["unknown", "$100=80=1", "$100"])
def test_settings_of_another_form_are_refused_as_other_settings(now: str) -> None:
    with pytest.raises(
        CalibrationFileError, match=r"the machine's settings have changed since this calibration: \$100 was"
    ):
        check_fits(stored(settings="$100=80.000"), camera(), None, "bench", now)
    with pytest.raises(CalibrationFileError, match="the machine's settings have changed"):
        check_fits(stored(settings=now), camera(), None, "bench", "$100=80.000")


@pytest.mark.parametrize("d", [(-1e6, 0.0, 0.0, 0.0, 0.0), (1e9, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, -1e12)])
def test_a_distortion_that_reaches_no_pixel_is_a_change(d: tuple[float, ...]) -> None:
    """Where no pixel has a ray with it, nothing was compared, and nothing had changed."""
    with pytest.raises(CalibrationFileError, match="left camera's calibration has changed by"):
        check_fits(stored(), camera(d=np.array(d)), None, "bench")


def test_a_camera_that_looks_the_other_way_is_another() -> None:
    with pytest.raises(CalibrationFileError, match="left camera's calibration has changed by"):
        check_fits(stored(), camera(r=np.diag([-1.0, 1.0, -1.0])), None, "bench")


def test_a_change_is_seen_in_a_picture_whose_corners_the_distortion_does_not_reach() -> None:
    wide = {"d": np.array([-0.2, 0.0, 0.0, 0.0, 0.0])}
    check_fits(stored(left=camera(focal=768.0, **wide)), camera(focal=768.0, **wide), None, "bench")
    with pytest.raises(CalibrationFileError, match="left camera's calibration has changed by"):
        check_fits(
            stored(left=camera(focal=768.0, **wide)),
            camera(focal=768.0, d=np.array([-0.21, 0, 0, 0, 0])),
            None,
            "bench",
        )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"format": 9}, "expected format 2"),
        (
            {"base_from_reading": [[1.0, 0.0]]},
            r"base_from_reading = \[\[1\.0, 0\.0\]\]: finite numbers of shape \(2, 2\)",
        ),
        ({"base_from_reading": [[1.0, 0.0], [0.0, 0.0]]}, "has no inverse"),
        ({"camera_from_base": {"rotation": np.eye(3).tolist()}}, "translation_m"),
        ({"camera_from_base": {"rotation": (2 * np.eye(3)).tolist(), "translation_m": [0, 0, 1]}}, "not a rotation"),
        ({"stylus_direction": [0, math.nan, -1]}, "finite numbers"),
        ({"rms_m": math.nan}, "rms_m = nan: finite numbers"),
        ({"predicted_sigma_m": math.inf}, "predicted_sigma_m = inf: finite numbers"),
        ({"rms_m": -0.001}, r"rms_m = -0\.001 is below 0"),
        ({"left_camera": {}}, r"left_camera: 'distortion_model' is missing"),
        (
            {"left_camera": {**camera().to_mapping(), "image_width": math.inf}},
            r"left_camera: image_width = inf; expected a whole number from 1 to 32767",
        ),
        (
            {"right_camera": {**camera().to_mapping(), "image_height": 720.5}},
            r"right_camera: image_height = 720\.5; expected a whole number from 1 to 32767",
        ),
        (
            {"right_camera": {**camera().to_mapping(), "camera_matrix": {"data": "abc"}}},
            r"right_camera: camera_matrix = 'abc'; expected 9 numbers",
        ),
        ({"left_camera": None}, r"left_camera = None; expected a mapping"),
        ({"camera_from_base": [1, 2]}, r"camera_from_base = \[1, 2\]; expected a mapping"),
        (
            {"camera_from_base": {"rotation": np.eye(3).tolist(), "translation_m": [-170.0, 90.0, 660.0]}},
            r"camera_from_base: translation_m = \[-170\.0, 90\.0, 660\.0\] (limit 20 m)",
        ),
        (
            {"base_from_panel": {"rotation": "x", "translation_m": [0, 0, 1]}},
            r"base_from_panel: rotation = 'x': finite",
        ),
        ({"stylus_direction": "down"}, r"stylus_direction = 'down': finite numbers of shape \(3,\)"),
        ({"backlash_sigma_m": [math.inf, 0.0]}, r"backlash_sigma_m = \[inf, 0\.0\]: finite numbers"),
        ({"held_out_max_m": -0.001}, r"held_out_max_m = -0\.001 is below 0"),
        ({"held_out_max_m": math.inf}, r"held_out_max_m = inf: finite numbers"),
        ({"samples": math.inf}, r"samples = inf; expected a whole number from 0"),
        ({"samples": 1.5}, r"samples = 1\.5; expected a whole number from 0"),
        ({"samples": -3}, r"samples = -3; expected a whole number from 0"),
    ],
)
def test_broken_files_are_refused_by_name(tmp_path: Path, spoil: dict[str, Any], message: str) -> None:
    path = tmp_path / "c.yaml"
    save(stored(), path)
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **spoil}))
    with pytest.raises(CalibrationFileError, match=message) as refusal:
        load(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize("text", ["", "just words", "a: [1", "- 1"])
def test_what_is_no_mapping_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(CalibrationFileError, match="not a hand-eye calibration"):
        load(tmp_path / "c.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [("format: " + 5000 * "[", "more than 24 open brackets"), ("#" + 1_000_001 * " ", "1000002 bytes")],
    ids=["deep", "long"],
)
def test_a_file_is_limited_before_it_is_parsed(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(CalibrationFileError, match=f"not a hand-eye calibration: .*{message}"):
        load(tmp_path / "c.yaml")


def test_old_file_stays_when_the_new_one_cannot_be_written(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    save(stored(), path)
    (tmp_path / "c.yaml.new").mkdir()
    with pytest.raises(OSError, match=r"c\.yaml\.new"):
        save(dataclasses.replace(stored(), samples=99), path)
    assert load(path).samples == 24
