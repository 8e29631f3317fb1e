"""Monitors the deviation of controls from their layout, and decides what to do about it.

Each call of ``look`` measures a few controls in both images. The median of a control's measurements counts once enough
of them agree. Its standard deviation combines their scatter, an error shared by all measurements, and the unknown
height.

The print gives the pose, and a print is seldom in register with the holes of a panel: all controls are shifted alike.
The median of the measured controls gives this shift, also for controls that cannot be measured. A control's own
deviation is weighted by its certainty relative to that of the other controls.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from harris_perception.core.alignment.control_outlines import Gray, TopShift, top_shift
from harris_perception.core.alignment.layout_config import LayoutConfig
from icu_common.core.alignment.layout import ControlDeviation, DeviationCode
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, PanelLayout

_MEDIAN_SQUARE = 0.455
"""Median of the square of a normal variable of variance 1."""
_HEIGHTS = 1.5
"""Ratio of height error to position error on a panel far beyond its tolerance: a drawing or an image gives positions,
but not heights."""
_OF_MEDIAN = 1.25
"""Standard deviation of a median, as a multiple of that of a mean."""
Shifts = tuple[TopShift, TopShift]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Panel:
    """Deviations of the panel's controls from its layout, in the plane of the face.

    Attributes
    ----------
    median_mm
        (2,) median of the measured deviations.
    shift_mm, shift_sigma_mm
        (2,) shift of all controls relative to the print, which gives the pose, and its standard deviation: the median
        less the part that bevels and shadows may explain.
    place_mm, height_mm
        Standard deviations of an unmeasured control's position and height.
    own_mm
        Standard deviation of the controls' own deviations, as far as the measurements show it.
    """

    median_mm: Array
    shift_mm: Array
    shift_sigma_mm: float
    place_mm: float
    height_mm: float
    own_mm: float = 0.0


class LayoutWatch:
    """Measures controls and stores their deviations.

    Parameters
    ----------
    config
        Limits.
    layout
        The designated panel.
    cameras
        Calibration without correction.
    """

    def __init__(self, config: LayoutConfig, layout: PanelLayout, cameras: StereoModel) -> None:
        self.config, self._layout, self._cameras = config, layout, cameras
        self._proud = [c for c in layout.controls if c.height_mm > 0]
        self._seen: dict[str, deque[Shifts | None]] = {c.name: deque(maxlen=config.window) for c in self._proud}
        self._next = 0

    def look(self, views: tuple[Gray, Gray], camera_from_panel: Transform, rotation_rad: Array) -> None:
        """Measure the next few controls.

        Parameters
        ----------
        views
            (H, W) uint8 rectified images of a pair.
        camera_from_panel
            Pose of the panel in the left rectified frame.
        rotation_rad
            (3,) rotation of the right camera relative to its calibration.
        """
        back = np.asarray(cv2.Rodrigues(-rotation_rad)[0], dtype=np.float64)
        shift = camera_from_panel.translation - np.array([self._cameras.baseline, 0.0, 0.0])
        poses = (camera_from_panel, Transform(back @ camera_from_panel.rotation, back @ shift))
        cameras = (self._cameras.left, self._cameras.right)
        count = min(self.config.controls_per_look, len(self._proud))
        if count and self._next < self.config.looks * len(self._proud):
            count = len(self._proud)  # measure all at first: the robot may start work soon
        for _ in range(count):
            control = self._proud[self._next % len(self._proud)]
            self._next += 1
            left, right = (top_shift(view, control, pose, camera) for view, pose, camera in zip(views, poses, cameras))
            seen = None if left is None or right is None or not self._agree(left, right) else (left, right)
            self._seen[control.name].append(seen)

    def _agree(self, left: TopShift, right: TopShift) -> bool:
        """Return whether both images may show the same outline: a height within the tolerance explains the rest.



        An outline with a large standard deviation in one image, because of other explanations, does not count as seen.
        """
        if max(left.sigma_mm.max(), right.sigma_mm.max()) > self.config.max_scatter_mm:
            return False
        apart = np.abs(left.shift_mm - right.shift_mm)
        height = self.config.max_offset_mm * np.abs(left.lean - right.lean)
        return bool((apart <= self.config.agreement_mm + height).all())

    def deviations(self) -> dict[str, ControlDeviation]:
        """Return the deviation of each control, by its name."""
        panel = self._panel()
        return {c.name: self._judge(c, panel) for c in self._layout.controls}

    def _panel(self) -> _Panel:
        """Return the findings of all measured controls about the panel."""
        tolerance_mm = self._layout.tolerance_mm / np.sqrt(3)
        first = list(filter(None, (self._estimate(c, tolerance_mm) for c in self._proud)))
        if len(first) < self.config.min_controls:
            still = np.zeros(2)
            return _Panel(
                median_mm=still, shift_mm=still, shift_sigma_mm=0.0, place_mm=tolerance_mm, height_mm=tolerance_mm
            )
        measured = np.array([offset for offset, _ in first])
        median = np.median(measured, axis=0)
        seen_mm = float(np.sqrt(np.median(np.square(measured - median)) / _MEDIAN_SQUARE))
        sigma_mm = float(np.hypot(_OF_MEDIAN * seen_mm / np.sqrt(len(measured)), self.config.shared_sigma_mm))
        # W. James, C. Stein, "Estimation with Quadratic Loss", 1961: a shift of the size of its error is none.
        share = max(0.0, 1.0 - 2.0 * sigma_mm**2 / max(float(median @ median), 1e-12))
        noise = float(np.median([np.diag(self._alone(covariance)) for _, covariance in first]))
        # If controls are farther from the layout than its declared tolerance, its heights are as inaccurate.
        height_mm = max(tolerance_mm, seen_mm * (_HEIGHTS if seen_mm > 2.0 * tolerance_mm else 1.0))
        return _Panel(
            median_mm=median,
            shift_mm=share * median,
            shift_sigma_mm=sigma_mm,
            place_mm=max(tolerance_mm, seen_mm),
            height_mm=height_mm,
            own_mm=float(np.sqrt(max(seen_mm**2 - noise, 0.0))),
        )

    def _estimate(self, control: Control, height_mm: float) -> tuple[Array, Array] | None:
        """Return offset (2,) mm and covariance (2, 2) of a control; None if too few measurements agree."""
        looks = self._seen.get(control.name, ())
        seen = [shifts for shifts in looks if shifts is not None]
        # An outline that is visible only sometimes is a lit lamp or an object on the panel.
        if len(seen) < self.config.looks or 2 * len(seen) <= len(looks):
            return None
        shifts = np.array([[left.shift_mm, right.shift_mm] for left, right in seen])
        middle = np.median(shifts, axis=0)
        scatter = float(1.4826 * np.median(np.abs(shifts - middle)))
        if scatter > self.config.max_scatter_mm:
            return None
        left, right = seen[-1]
        # Unknowns: the offset (2,) and the error of the control's height; each image gives two rows.
        rows = np.zeros((4, 3))
        rows[0:2, :2] = rows[2:4, :2] = np.eye(2)
        rows[0:2, 2], rows[2:4, 2] = left.lean, right.lean
        fit = np.median([[left.sigma_mm, right.sigma_mm] for left, right in seen], axis=0).reshape(4)
        sharp = self.config.outline_sigma_mm**2 + scatter**2 / len(seen)
        variance = sharp + fit**2
        higher = 1.0 / max(height_mm, 1e-3) ** 2
        covariance = np.linalg.inv(rows.T @ (rows / variance[:, None]) + np.diag([0.0, 0.0, higher]))
        found = covariance @ (rows.T @ (middle.reshape(4) / variance))
        # Offset and height must explain both images: a lit lamp has different edges in each. The fit's own uncertainty
        # does not count, because both images would have the same error.
        rest = middle.reshape(4) - rows @ found
        if float(rest @ rest / sharp + found[2] ** 2 * higher) > self.config.max_misfit:
            return None
        return np.asarray(found[:2]), np.asarray(covariance[:2, :2] + self.config.shared_sigma_mm**2 * np.eye(2))

    def _judge(self, control: Control, panel: _Panel) -> ControlDeviation:
        tolerance, limit = self._layout.tolerance_mm, self.config.max_offset_mm
        found = self._estimate(control, panel.height_mm)
        code, offset, sigma = DeviationCode.UNMEASURED, np.zeros(2), np.full(2, tolerance / np.sqrt(3))
        # A flat control is part of the print, from which the pose is measured.
        if found is None and control.height_mm > 0:
            offset, sigma = panel.shift_mm, np.full(2, np.hypot(panel.place_mm, panel.shift_sigma_mm))
        if found is not None:
            measured, covariance = found
            code = DeviationCode.AS_LAID_OUT
            if self._significant(measured, covariance):
                code = DeviationCode.CORRECTED if np.hypot(*measured) <= limit else DeviationCode.REFUSED
            offset, apart = measured, measured - panel.median_mm
            if not self._significant(apart, covariance):
                share = panel.own_mm**2 * np.linalg.inv(panel.own_mm**2 * np.eye(2) + self._alone(covariance))
                offset = panel.shift_mm + share @ apart
            # The deviation covers the measured position.
            sigma = np.sqrt(np.diag(covariance))
            sigma = np.minimum(np.hypot(sigma, measured - offset), np.maximum(tolerance / np.sqrt(3), sigma))
        return ControlDeviation(
            name=control.name,
            code=code,
            offset_mm=(float(offset[0]), float(offset[1])),
            sigma_mm=(float(sigma[0]), float(sigma[1])),
            limit_mm=limit,
        )

    def _alone(self, covariance: Array) -> Array:
        """Return a covariance without the error by bevels and shadows, which shifts all controls alike."""
        return np.asarray(covariance - self.config.shared_sigma_mm**2 * np.eye(2))

    def _significant(self, offset_mm: Array, covariance: Array) -> bool:
        return bool(offset_mm @ np.linalg.solve(covariance, offset_mm) > 2 * self.config.significant_sigmas**2)


def text_of(deviations: Mapping[str, ControlDeviation]) -> str:
    """Return the names of the controls that are not at their layout positions."""
    return " ".join(d.name for d in deviations.values() if d.code in (DeviationCode.CORRECTED, DeviationCode.REFUSED))
