"""Conditions under which samples and a calibration are valid: cameras, settings of the machine, and readings."""

from __future__ import annotations

from harris_perception.core.hand_eye.calibration_file import CalibrationFileError, StoredCalibration, check_fits
from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.hand_eye.machine_axes import check_axes, check_stylus
from harris_perception.core.hand_eye_procedure.calibrator_config import CalibratorConfig
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message


class CalibrationRefused(ValueError):
    """A request is rejected; the text gives the reason."""


class Conditions:
    """Present cameras by side, settings of the board, and readings (3,) m; None: none have arrived."""

    def __init__(self) -> None:
        self.cameras: dict[str, CameraModel] = {}
        self.settings = ""
        self.reading: Array | None = None

    def pair(self) -> StereoModel:
        """Return the pair of cameras.

        Raises
        ------
        CalibrationRefused
            If a camera is missing, or the two are no pair.
        """
        for side in ("left", "right"):
            if side not in self.cameras:
                raise CalibrationRefused(Message("calibration.no_camera_info_camera_arrived", side=side))
        try:
            return StereoModel(left=self.cameras["left"], right=self.cameras["right"])
        except ValueError as error:
            raise CalibrationRefused(Message("calibration.camera_info", error=error)) from error

    def check_fit(self, calibration: StoredCalibration, config: CalibratorConfig) -> None:
        """Reject a calibration that was made under other conditions.

        Raises
        ------
        CalibrationFileError
            With the difference.
        """
        mounting = config.run.mounting
        left, right = self.cameras["left"], self.cameras.get("right")
        check_fits(calibration, left, right, config.machine, self.settings, mounting)
        try:
            check_axes(calibration.base_from_reading, config.solver)
            check_stylus(calibration.stylus_direction, config.solver)
        except DegenerateError as error:
            raise CalibrationFileError(str(error)) from error
