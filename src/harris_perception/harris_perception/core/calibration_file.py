"""The hand-eye calibration as a YAML file, which is only used with the cameras and the machine it was made with."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from icu_common.core.camera_model import CameraModel
from icu_common.core.geometry import Array, Transform

FORMAT = 1


class CalibrationFileError(ValueError):
    """The file is no calibration, or one of other cameras or another machine; the message names the difference."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StoredCalibration:
    """What is kept.

    Attributes
    ----------
    camera_from_base
        Pose of base_link in the left camera's rectified frame.
    base_from_reading
        (2, 2) axes' scale and skew.
    stylus_direction
        (3,) in base_link, motion of the tip per metre of extension.
    left, right
        The cameras; ``right`` may be unknown.
    machine
        Name of the machine's configuration.
    rms_m, sigma_m, held_out_m
        Misfit of the samples, predicted error, and greatest error at held-out positions (NaN: not measured).
    samples
        How many were used.
    made_at
        Date and time, for people.
    """

    camera_from_base: Transform
    base_from_reading: Array
    stylus_direction: Array
    left: CameraModel
    right: CameraModel | None
    machine: str
    rms_m: float
    sigma_m: float
    held_out_m: float
    samples: int
    made_at: str

    def summary(self) -> str:
        """Return one line for people."""
        held = "" if np.isnan(self.held_out_m) else f", held-out {self.held_out_m * 1e3:.2f} mm"
        return (
            f"{self.samples} samples, rms {self.rms_m * 1e3:.3f} mm{held}, predicted {self.sigma_m * 1e3:.3f} mm, "
            f"{self.made_at}"
        )


def save(calibration: StoredCalibration, path: Path) -> None:
    """Write the file, whole or not at all.

    Raises
    ------
    OSError
        If it cannot be written; an old file stays.
    """
    document = {
        "format": FORMAT,
        "made_at": calibration.made_at,
        "machine": calibration.machine,
        "camera_from_base": {
            "rotation": [[float(v) for v in row] for row in calibration.camera_from_base.rotation],
            "translation_m": [float(v) for v in calibration.camera_from_base.translation],
        },
        "base_from_reading": [[float(v) for v in row] for row in calibration.base_from_reading],
        "stylus_direction": [float(v) for v in calibration.stylus_direction],
        "samples": calibration.samples,
        "rms_m": calibration.rms_m,
        "predicted_sigma_m": calibration.sigma_m,
        "held_out_max_m": calibration.held_out_m,
        "left_camera": calibration.left.to_mapping(),
        "right_camera": None if calibration.right is None else calibration.right.to_mapping(),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    with fresh.open("w", encoding="utf-8") as file:
        yaml.safe_dump(document, file, sort_keys=False, default_flow_style=None)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)


def load(path: Path) -> StoredCalibration:
    """Read a file.

    Raises
    ------
    CalibrationFileError
        If it is no calibration of this format; the message names file and reason.
    OSError
        If it cannot be read.
    """
    try:
        document: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise CalibrationFileError(f"format {FORMAT} is needed")
        pose = document["camera_from_base"]
        axes = _numbers(document, "base_from_reading", (2, 2))
        if not np.linalg.det(axes) > 0:
            raise CalibrationFileError(f"base_from_reading {axes.tolist()} cannot be inverted")
        right = document["right_camera"]
        return StoredCalibration(
            camera_from_base=Transform(_numbers(pose, "rotation", (3, 3)), _numbers(pose, "translation_m", (3,))),
            base_from_reading=axes,
            stylus_direction=_numbers(document, "stylus_direction", (3,)),
            left=CameraModel.from_mapping(document["left_camera"]),
            right=None if right is None else CameraModel.from_mapping(right),
            machine=str(document["machine"]),
            rms_m=float(document["rms_m"]),
            sigma_m=float(document["predicted_sigma_m"]),
            held_out_m=float(document["held_out_max_m"]),
            samples=int(document["samples"]),
            made_at=str(document["made_at"]),
        )
    except (KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        raise CalibrationFileError(f"{path}: not a hand-eye calibration: {error}") from error


def check_fits(
    calibration: StoredCalibration, left: CameraModel, right: CameraModel | None, machine: str, limit_px: float = 0.05
) -> None:
    """Refuse a calibration made with other cameras, another resolution or another machine.

    Parameters
    ----------
    calibration
        As loaded.
    left, right
        The cameras in use; ``right`` may be unknown.
    machine
        Name of the machine's configuration in use.
    limit_px
        Cameras are the same while they project alike to this, over the whole picture.

    Raises
    ------
    CalibrationFileError
        With the difference.
    """
    if machine != calibration.machine:
        raise CalibrationFileError(f"it was made for machine {calibration.machine!r}, this one is {machine!r}")
    for name, old, new in (("left", calibration.left, left), ("right", calibration.right, right)):
        if old is None or new is None:
            continue
        if old.size != new.size:
            raise CalibrationFileError(
                f"it was made with a {name} picture of {old.width} x {old.height} px, now it has "
                f"{new.width} x {new.height} px"
            )
        change = _difference_px(old, new)
        if change > limit_px:
            raise CalibrationFileError(
                f"the {name} camera's calibration has changed by {change:.2f} px since it was made"
            )


def _difference_px(old: CameraModel, new: CameraModel) -> float:
    u, v = np.meshgrid(np.linspace(0, old.width - 1, 9), np.linspace(0, old.height - 1, 7))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    turned = float(np.abs(old.rectify(pixels) - new.rectify(pixels)).max())
    # The fourth column of P is focal length times baseline: what it moves at one metre.
    return max(turned, float(np.abs(old.p - new.p).max()))


def _numbers(document: Any, key: str, shape: tuple[int, ...]) -> Array:
    value = np.array(document[key], dtype=np.float64)
    if value.shape != shape or not np.isfinite(value).all():
        raise CalibrationFileError(f"{key} = {document[key]!r}: finite numbers of shape {shape} are needed")
    return value
