"""Relates the gantry's readings to the camera's coordinates, for a machine that only translates.

A carriage that never rotates makes AX = XB degenerate, so the observable part is solved directly: the stylus tip in the
fixed stereo camera at readings q is ``X = N q + b``. This is a linear regression in closed form, without wrong
detections, then refined by the pixels of both images. Its columns are split as ``N = R M``: R rotates base_link into
the camera's frame, M (upper triangular, close to identity) has the axes' scale and skew.

Cameras that ride on the carriage are solved in :mod:`harris_perception.core.hand_eye.carriage_camera`.

base_link: origin at the tip for readings zero, x along the x rail, y in the plane of both rails, z their normal towards
the viewer; metric and orthogonal. ``base_xy = M q_xy``, ``base_z = -stylus``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.degeneracy import check_extensions, check_motion, checked
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.machine_axes import check_side, check_stylus, split_axes
from harris_perception.core.hand_eye.robust_regression import Fit
from harris_perception.core.hand_eye.tip_regression import fit_tip
from harris_perception.core.hand_eye.tip_samples import Place, Sample, extension_design, reading_design
from harris_perception.core.pose.reprojection import pair_pixels
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.reasons.message import Message


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HandEye:
    """A calibration.

    Attributes
    ----------
    camera_from_base
        Pose of base_link in the camera's rectified frame; for a camera on the carriage, that at readings zero.
    base_from_reading
        (2, 2) upper triangular M.
    stylus_direction
        (3,) in base_link: motion of the tip per metre of extension; (0, 0, -1) if it was not fitted.
    fit
        The regression on the readings: of the tip, or, for a camera on the carriage, of the panel's origin.
    tip_fit
        For a camera on the carriage, the regression of the tip on the extension; else None.
    panel_rotation
        For a camera on the carriage, the (3, 3) rotation camera_from_panel; else None.
    """

    camera_from_base: Transform
    base_from_reading: Array
    stylus_direction: Array
    fit: Fit
    tip_fit: Fit | None = None
    panel_rotation: Array | None = None

    @property
    def camera_from_panel(self) -> Transform | None:
        """Pose of the panel for readings zero, of a camera on the carriage."""
        return None if self.panel_rotation is None else Transform(self.panel_rotation, self.fit.regression[-1])

    @property
    def on_carriage(self) -> bool:
        """Whether the camera moves with the carriage."""
        return self.tip_fit is not None

    def tip_in_base(self, readings: Array) -> Array:
        """Return (N, 3) m in base_link for readings (N, 3) m, as the rest of the graph computes it."""
        rows = np.atleast_2d(readings)
        return np.column_stack([rows[:, :2] @ self.base_from_reading.T, -rows[:, 2]])

    def tip_in_camera(self, readings: Array) -> Array:
        """Return (N, 3) m in the camera's frame for readings (N, 3) m."""
        tips = self.tip_in_base(readings)
        return self.camera_from_base.apply(tips * (0.0, 0.0, 1.0) if self.on_carriage else tips)

    def covariance(self, readings: Array) -> Array:
        """Return (N, 3, 3) m^2, in the camera's frame, for readings (N, 3).

        It is the covariance of the fitted tip or, for a camera on the carriage, of the tip's position relative to the
        panel.
        """
        rows = np.atleast_2d(readings)
        own = self.fit.covariance(reading_design(rows, len(self.fit.regression) == 4))
        if self.tip_fit is None:
            return own
        return own + self.tip_fit.covariance(extension_design(rows[:, 2], len(self.tip_fit.regression) == 2))

    def sigma_m(self, readings: Array) -> float:
        """Return the predicted rms distance, m, between fitted and true tip over readings (N, 3)."""
        return _rms(self.covariance(readings))

    def own_sigma_m(self, readings: Array) -> float:
        """Return the same without the error that all samples share: the part that more samples reduce."""
        rows = np.atleast_2d(readings)
        own = self.fit.own_covariance(reading_design(rows, len(self.fit.regression) == 4))
        if self.tip_fit is not None:
            own = own + self.tip_fit.own_covariance(extension_design(rows[:, 2], len(self.tip_fit.regression) == 2))
        return _rms(own)


def _rms(covariances: Array) -> float:
    return float(np.sqrt(np.mean(np.trace(covariances, axis1=1, axis2=2))))


def calibrate(samples: Sequence[Sample], cameras: StereoModel, config: HandEyeConfig | None = None) -> HandEye:
    """Solve the calibration of fixed cameras; wrong detections are excluded.

    Parameters
    ----------
    samples
        Sightings of the tip from different positions.
    cameras
        The pair that measured it.
    config
        Limits.

    Raises
    ------
    DegenerateError
        For too few, motionless, crowded or collinear samples (with the motion that would help), too many that do not
        fit, and implausible axes or stylus.
    """
    config = config if config is not None else HandEyeConfig()
    readings, tips = checked(samples, Message("calibration.tip"), config)
    with_stylus = bool(np.ptp(readings[:, 2]) >= config.min_stylus_span_m)
    if with_stylus:
        check_extensions(readings, config)
    places = len(np.unique(np.round(readings[:, :2], 4), axis=0))
    fit = fit_tip(reading_design(readings, with_stylus), samples, places, cameras, config)
    check_motion(readings[fit.used], tips[fit.used], Message("calibration.tip"), config)
    rotation, axes = split_axes(fit.regression[0], fit.regression[1], config)
    stylus, origin = np.array([0.0, 0.0, -1.0]), fit.regression[-1]
    if with_stylus:
        stylus = rotation.T @ fit.regression[2]
        check_stylus(stylus, config)
    else:
        check_side(rotation, tips[fit.used].mean(axis=0))
        origin = origin + rotation[:, 2] * readings[fit.used, 2].mean()  # all samples were taken at this extension
    return HandEye(
        camera_from_base=Transform(rotation, origin), base_from_reading=axes, stylus_direction=stylus, fit=fit
    )


def tip_place(calibration: HandEye, sample: Sample, cameras: StereoModel, variance: float = 1.0) -> Place:
    """Return a sample's tip position, with ``variance`` times the covariance from all samples' residuals."""
    by_point = pair_pixels(sample.tip[np.newaxis], cameras)[1][0]
    per_pixel = np.asarray(np.linalg.inv(by_point.T @ by_point))
    return Place(
        reading=sample.reading,
        point=sample.tip,
        per_pixel=per_pixel,
        covariance=variance * calibration.fit.sigma_px**2 * per_pixel,
    )
