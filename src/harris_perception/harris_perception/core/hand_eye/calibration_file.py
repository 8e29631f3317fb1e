"""Hand-eye calibration as a YAML file, which is valid only for the cameras and the machine it was made with."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from harris_perception.core.hand_eye.carriage_camera import shifted
from harris_perception.core.hand_eye.machine_axes import axes_skew
from icu_common.core.configuration.yaml_text import UNREADABLE, Loader
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.reasons.message import Message, joined, quoted

FORMAT = 2
_FARTHEST_M = 20.0
"""Maximum distance of a camera of a bench; a pose beyond it was written in other units."""
_ALIKE_PX = 0.05
"""Maximum difference of projection, over the whole image, between cameras that count as the same."""


class CalibrationFileError(ValueError):
    """The file is no calibration, or is for other cameras or another machine; the message names the difference."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StoredCalibration:
    """The stored values.

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
    settings
        Settings of the board that affect the readings, as reported by the driver; empty: unknown.
    mounting
        Mounting of the cameras: ``fixed`` or ``carriage``. For the latter, ``camera_from_base`` is the pose at readings
        zero.
    backlash_m, backlash_sigma_m
        (2,) of x and y, and their standard deviations (NaN: not measured).
    base_from_panel
        Pose of the panel at the calibration; None: unknown.
    contact_offset_m
        (3,) in base_link, touched minus seen position of the tip (NaN: nothing was touched).
    rms_m, sigma_m, held_out_m
        Misfit of the samples, predicted error, and largest error at held-out positions (NaN: not measured).
    samples
        Number of samples used.
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
    settings: str = ""
    mounting: str = "fixed"
    backlash_m: Array = field(default_factory=lambda: np.full(2, np.nan))
    backlash_sigma_m: Array = field(default_factory=lambda: np.full(2, np.nan))
    base_from_panel: Transform | None = None
    contact_offset_m: Array = field(default_factory=lambda: np.full(3, np.nan))

    @property
    def on_carriage(self) -> bool:
        """Whether the cameras move with the carriage."""
        return self.mounting == "carriage"

    def camera_from_base_at(self, reading: Array) -> Transform:
        """Return camera_from_base for one reading (3,) m."""
        if not self.on_carriage:
            return self.camera_from_base
        return shifted(self.camera_from_base, self.base_from_reading, reading)

    def tip_in_camera(self, reading: Array) -> Array:
        """Return (3,) m: the tip's position in the camera's frame for one reading (3,) m."""
        base = np.array([*(self.base_from_reading @ reading[:2]), 0.0]) + reading[2] * self.stylus_direction
        return self.camera_from_base_at(reading).apply(base)

    def summary(self) -> str:
        """Return one line for people."""
        held = (
            "" if np.isnan(self.held_out_m) else Message("calibration.held_out", held_out_mm=self.held_out_m * 1000.0)
        )
        where = Message("calibration.cameras_carriage") if self.on_carriage else ""
        return Message(
            "calibration.samples_rms_predicted",
            samples=self.samples,
            where=where,
            rms_mm=self.rms_m * 1000.0,
            held=held,
            sigma_mm=self.sigma_m * 1000.0,
            made_at=self.made_at,
        )

    def values(self) -> list[tuple[str, str]]:
        """Return the values for the diagnostics."""
        axes = self.base_from_reading
        return [
            ("rms_mm", f"{self.rms_m * 1e3:.4f}"),
            ("predicted_sigma_mm", f"{self.sigma_m * 1e3:.4f}"),
            ("held_out_max_mm", f"{self.held_out_m * 1e3:.4f}"),
            ("mounting", self.mounting),
            ("scale_x", f"{axes_scale(axes)[0]:.6f}"),
            ("scale_y", f"{axes_scale(axes)[1]:.6f}"),
            ("skew_mrad", f"{axes_skew(axes) * 1e3:.3f}"),
            ("right_angle_deg", f"{90.0 - float(np.degrees(axes_skew(axes))):.4f}"),
            ("backlash_x_mm", _measured(self.backlash_m[0], self.backlash_sigma_m[0])),
            ("backlash_y_mm", _measured(self.backlash_m[1], self.backlash_sigma_m[1])),
            ("contact_offset_mm", ", ".join(f"{v * 1e3:.3f}" for v in self.contact_offset_m)),
            ("stylus_tilt_mrad", _tilt(self.stylus_direction)),
            ("made_at", self.made_at),
        ]


def save(calibration: StoredCalibration, path: Path) -> None:
    """Write the file atomically.

    Raises
    ------
    OSError
        If it cannot be written; an existing file stays unchanged.
    """
    document = {
        "format": FORMAT,
        "made_at": calibration.made_at,
        "machine": calibration.machine,
        "settings": calibration.settings,
        "mounting": calibration.mounting,
        "camera_from_base": _pose(calibration.camera_from_base),
        "base_from_reading": [[float(v) for v in row] for row in calibration.base_from_reading],
        "stylus_direction": [float(v) for v in calibration.stylus_direction],
        "scale_xy": axes_scale(calibration.base_from_reading).tolist(),
        "skew_rad": axes_skew(calibration.base_from_reading),
        "backlash_m": calibration.backlash_m.tolist(),
        "backlash_sigma_m": calibration.backlash_sigma_m.tolist(),
        "base_from_panel": None if calibration.base_from_panel is None else _pose(calibration.base_from_panel),
        "contact_offset_m": calibration.contact_offset_m.tolist(),
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
        document: Any = yaml.load(path.read_text(encoding="utf-8"), Loader)
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise CalibrationFileError(Message("calibration.format_needed", format=FORMAT))
        axes = _numbers(document, "base_from_reading", (2, 2))
        if not np.linalg.det(axes) > 0:
            raise CalibrationFileError(Message("calibration.base_reading_cannot_inverted", axes=axes.tolist()))
        panel, right = (document[key] is not None for key in ("base_from_panel", "right_camera"))
        return StoredCalibration(
            camera_from_base=_part(document, "camera_from_base", _pose_of),
            base_from_reading=axes,
            stylus_direction=_numbers(document, "stylus_direction", (3,)),
            left=_part(document, "left_camera", CameraModel.from_mapping),
            right=_part(document, "right_camera", CameraModel.from_mapping) if right else None,
            machine=str(document["machine"]),
            rms_m=_error(document, "rms_m"),
            sigma_m=_error(document, "predicted_sigma_m"),
            held_out_m=_error(document, "held_out_max_m", known=False),
            samples=_count(document, "samples"),
            made_at=str(document["made_at"]),
            settings=str(document["settings"]),
            mounting=_mounting(document),
            backlash_m=_numbers(document, "backlash_m", (2,), known=False),
            backlash_sigma_m=_numbers(document, "backlash_sigma_m", (2,), known=False),
            base_from_panel=_part(document, "base_from_panel", _pose_of) if panel else None,
            contact_offset_m=_numbers(document, "contact_offset_m", (3,), known=False),
        )
    except (KeyError, TypeError, ValueError, OverflowError, *UNREADABLE) as error:
        raise CalibrationFileError(Message("calibration.not_hand_eye_calibration", path=path, error=error)) from error


def check_fits(
    calibration: StoredCalibration,
    left: CameraModel,
    right: CameraModel | None,
    machine: str,
    settings: str = "",
    mounting: str = "",
) -> None:
    """Reject a calibration of other cameras, another resolution, mounting, machine, or other settings of the machine.

    Parameters
    ----------
    calibration
        The loaded calibration.
    left, right
        The cameras in use; ``right`` may be unknown.
    machine
        Name of the machine's configuration in use.
    settings, mounting
        Settings and mounting in use; empty: unknown.

    Raises
    ------
    CalibrationFileError
        If something differs; the message names the difference.
    """
    if machine != calibration.machine:
        raise CalibrationFileError(
            Message("calibration.made_machine_one", machine=quoted(calibration.machine), machine_2=quoted(machine))
        )
    if settings and calibration.settings and settings != calibration.settings:
        old_values, new_values = (
            {name: value for name, _, value in (part.partition("=") for part in text.split())}
            for text in (calibration.settings, settings)
        )
        changed = [k for k in sorted({*old_values, *new_values}) if old_values.get(k) != new_values.get(k)]
        texts = [
            Message(
                "calibration.now", k=k, old_values=old_values.get(k, "unknown"), new_values=new_values.get(k, "unknown")
            )
            for k in changed
        ]
        raise CalibrationFileError(Message("calibration.machine_settings_changed_since_made", texts=joined(texts)))
    if mounting and mounting != calibration.mounting:
        raise CalibrationFileError(
            Message(
                "calibration.made_cameras_mounted_now",
                mounting=quoted(calibration.mounting),
                mounting_2=quoted(mounting),
            )
        )
    for name, old, new in (("left", calibration.left, left), ("right", calibration.right, right)):
        if old is None or new is None:
            continue
        if old.size != new.size:
            raise CalibrationFileError(
                Message(
                    "calibration.made_picture_now",
                    name=name,
                    width=old.width,
                    height_px=old.height,
                    width_2=new.width,
                    height_2_px=new.height,
                )
            )
        change = _difference_px(old, new)
        if not change <= _ALIKE_PX:
            raise CalibrationFileError(
                Message("calibration.camera_calibration_changed_since_made", name=name, change_px=change)
            )


def _difference_px(old: CameraModel, new: CameraModel) -> float:
    u, v = np.meshgrid(np.linspace(0, old.width - 1, 9), np.linspace(0, old.height - 1, 7))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    rays = old.rays(pixels)
    off = np.abs(old.project(rays) - new.project(rays))
    turned = float(off.max(where=np.isfinite(rays[:, :2]), initial=0.0))  # a lens may not reach the corners
    # The fourth column of P is focal length times baseline, the shift in pixels at a distance of one metre.
    return max(turned, float(np.abs(old.p - new.p).max()))


def axes_scale(base_from_reading: Array) -> Array:
    """Return (2,) metres that the x and the y axis move per metre of reading."""
    return np.asarray(np.linalg.norm(base_from_reading, axis=0))


def _measured(value_m: float, sigma_m: float) -> str:
    return f"{value_m * 1e3:.3f} +- {sigma_m * 1e3:.3f}"


def _tilt(direction: Array) -> str:
    x, y, _ = direction * 1e3 / -direction[2]
    return f"x {x:.2f}, y {y:.2f}"


def _pose(transform: Transform) -> dict[str, Any]:
    return {"rotation": transform.rotation.tolist(), "translation_m": transform.translation.tolist()}


_T = TypeVar("_T")


def _part(document: Any, key: str, build: Callable[[Any], _T]) -> _T:
    """Return the object built from a key's mapping; errors name the key."""
    part = document[key]
    if not isinstance(part, dict):
        raise CalibrationFileError(Message("calibration.mapping_needed", key=key, part=quoted(part)))
    try:
        return build(part)
    except KeyError as error:
        raise CalibrationFileError(Message("calibration.missing", key=key, error=error)) from error
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationFileError(f"{key}: {error}") from error


def _pose_of(document: Any) -> Transform:
    shift = _numbers(document, "translation_m", (3,))
    if not np.linalg.norm(shift) <= _FARTHEST_M:
        raise CalibrationFileError(
            Message("calibration.translation_most_possible", shift=shift.tolist(), farthest_m=_FARTHEST_M)
        )
    return Transform(_numbers(document, "rotation", (3, 3)), shift)


def _mounting(document: Any) -> str:
    mounting = str(document["mounting"])
    if mounting not in ("fixed", "carriage"):
        raise CalibrationFileError(Message("calibration.mounting_fixed_carriage_needed", mounting=quoted(mounting)))
    return mounting


def _error(document: Any, key: str, *, known: bool = True) -> float:
    value = float(_numbers(document, key, (), known=known))
    if value < 0.0:
        raise CalibrationFileError(Message("calibration.below_0", key=key, document=quoted(document[key])))
    return value


def _count(document: Any, key: str) -> int:
    value = document[key]
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise CalibrationFileError(Message("calibration.whole_number_0_needed", key=key, value=quoted(value)))
    return value


def _numbers(document: Any, key: str, shape: tuple[int, ...], *, known: bool = True) -> Array:
    """Return (shape) float64; unless ``known``, NaN stands for a value that was not measured."""
    given = document[key]
    try:
        value = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        value = None
    if value is None or value.shape != shape or np.isinf(value).any() or (known and np.isnan(value).any()):
        raise CalibrationFileError(
            Message("calibration.finite_numbers_shape_needed", key=key, given=quoted(given), shape=shape)
        )
    return value
