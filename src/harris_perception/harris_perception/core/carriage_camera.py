"""Hand-eye calibration of cameras that ride on the carriage: the panel stands still, and the pictures move.

The carriage does not turn, so all sightings of the panel share one rotation, and its origin is seen at
``t = a - N q``: a linear regression gives ``N = R M`` (rotation of base_link into the camera, scale and skew), as for
fixed cameras. Motion does not tell where the stylus is; that is seen when the cameras see the tip, or touched: the tip
at a contact is where the panel's point is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye import (
    DegenerateError,
    Fit,
    HandEye,
    HandEyeConfig,
    Sample,
    checked,
    extension_design,
    least_covariance,
    robust_fit,
    split_axes,
)
from icu_common.core.geometry import Array, Transform, nearest_rotation

MAX_CONTACTS = 5
_PANEL_NOISE = 3.0
"""A recognised panel scatters by so many times what the tip does, before its residuals tell better."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PanelSample:
    """The panel seen while the machine stood still: readings (3,) m, and its pose in the camera's rectified frame."""

    reading: Array
    camera_from_panel: Transform


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Contact:
    """The stylus touched a known point.

    Attributes
    ----------
    reading
        (3,) m at the moment of contact.
    in_panel
        (3,) m in panel_link, the centre of the ball: the touched point raised by the ball's radius.
    """

    reading: Array
    in_panel: Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StylusOffset:
    """Where touching puts the tip, against where the calibration has it.

    Attributes
    ----------
    offset
        (3,) m in base_link, touched minus calibrated.
    sigma
        (3,) m, standard deviation of ``offset``; of one contact it is ``contact_sigma_m``.
    contacts
        How many were averaged.
    """

    offset: Array
    sigma: Array
    contacts: int


def calibrate_on_carriage(
    panels: Sequence[PanelSample],
    tips: Sequence[Sample],
    contacts: Sequence[Contact] = (),
    config: HandEyeConfig | None = None,
) -> HandEye:
    """Solve the calibration of cameras on the carriage.

    Parameters
    ----------
    panels
        The panel from spread places.
    tips
        The tip as the cameras see it; may be empty when there are contacts.
    contacts
        One to five touches of known points of the panel; they win over what is seen.
    config
        Limits.

    Raises
    ------
    DegenerateError
        As :func:`harris_perception.core.hand_eye.calibrate`, and when nothing tells where the stylus is.
    """
    config = config if config is not None else HandEyeConfig()
    rotation = mean_rotation(panels) if panels else np.eye(3)
    readings, points = checked([_origin(p, rotation) for p in panels], "the panel", config)
    design = np.column_stack([readings[:, :2], np.ones(len(readings))])
    shape = _PANEL_NOISE**2 * least_covariance(points, config)
    fit = robust_fit(design, points, shape, config)
    # Again without the panels that did not fit, whose rotation was in the mean.
    rotation = mean_rotation([p for p, used in zip(panels, fit.used) if used])
    points = np.array([_origin(p, rotation).tip for p in panels])
    fit = robust_fit(design, points, shape, config)
    ray = points.mean(axis=0) / np.linalg.norm(points.mean(axis=0))
    along = np.outer(ray, ray)
    common = config.panel_sigma_m**2 * (np.eye(3) - along) + config.panel_depth_sigma_m**2 * along
    fit = dataclasses.replace(fit, common=fit.common + common)
    camera_from_axes, axes = split_axes(-fit.regression[0], -fit.regression[1], config)
    if contacts:
        if len(contacts) > MAX_CONTACTS:
            raise DegenerateError(f"{len(contacts)} contacts, at most {MAX_CONTACTS} are used: start anew")
        tips = [_touched(c, rotation, fit, config) for c in contacts]
    elif not tips:
        raise DegenerateError(
            "nothing tells where the stylus is: let the cameras see its tip, or touch one to five known points"
        )
    tip_fit, origin, direction = _stylus(tips, camera_from_axes, config)
    return HandEye(
        camera_from_base=Transform(camera_from_axes, origin),
        base_from_reading=axes,
        stylus_direction=direction,
        fit=fit,
        tip_fit=tip_fit,
    )


def mean_rotation(panels: Sequence[PanelSample]) -> Array:
    """Return the (3, 3) rotation camera_from_panel that all sightings share."""
    return nearest_rotation(np.mean([p.camera_from_panel.rotation for p in panels], axis=0))


def panel_origin(panel: PanelSample, rotation: Array) -> Array:
    """Return (3,) m: the panel's origin in the camera's frame, with the rotation that all sightings share.

    A single pose is best where the panel is seen, in the middle of the picture; its own small error of rotation would
    move a far origin. So the point on the optical axis is taken as measured, and the way from it to the origin from
    the mean rotation.
    """
    own = panel.camera_from_panel
    normal = own.rotation[:, 2]
    ahead = float(normal @ own.translation) / normal[2] if abs(normal[2]) > 0.1 else float(own.translation[2])
    in_camera = np.array([0.0, 0.0, ahead])
    return np.asarray(in_camera - rotation @ own.inverse().apply(in_camera))


def held_out_on_carriage(calibration: HandEye, fitted: Sequence[PanelSample], checks: Sequence[PanelSample]) -> Array:
    """Return (N,) m: how far the panel was seen from where the calibration expects it, at other places."""
    rotation = mean_rotation(fitted)
    design = np.array([(*p.reading[:2], 1.0) for p in checks])
    seen = np.array([panel_origin(p, rotation) for p in checks])
    return np.asarray(np.linalg.norm(seen - design @ calibration.fit.regression, axis=1))


def stylus_offset(
    calibration: HandEye, camera_from_panel: Transform, contacts: Sequence[Contact], config: HandEyeConfig
) -> StylusOffset:
    """Compare touches with a calibration that was made by sight.

    Parameters
    ----------
    calibration
        Of either mounting.
    camera_from_panel
        Pose of the panel; for cameras on the carriage at readings zero.
    contacts
        One to five.
    config
        ``contact_sigma_m`` is used.

    Raises
    ------
    DegenerateError
        Without contacts, or with too many.
    """
    if not 1 <= len(contacts) <= MAX_CONTACTS:
        raise DegenerateError(f"{len(contacts)} contacts, 1 to {MAX_CONTACTS} are needed")
    base_from_panel = calibration.camera_from_base.inverse() @ camera_from_panel
    touched = base_from_panel.apply(np.array([c.in_panel for c in contacts]))
    expected = calibration.tip_in_base(np.array([c.reading for c in contacts]))
    count = len(contacts)
    scatter = np.var(touched - expected, axis=0, ddof=1) if count > 1 else np.zeros(3)
    variance = np.maximum(scatter, config.contact_sigma_m**2) / count
    return StylusOffset(offset=(touched - expected).mean(axis=0), sigma=np.sqrt(variance), contacts=count)


def _origin(panel: PanelSample, rotation: Array) -> Sample:
    return Sample(reading=panel.reading, tip=panel_origin(panel, rotation), covariance=np.zeros((3, 3)))


def _touched(contact: Contact, rotation: Array, fit: Fit, config: HandEyeConfig) -> Sample:
    """Return the tip in the camera's frame at a contact: where the panel's point is for those readings."""
    origin = np.array([*contact.reading[:2], 1.0]) @ fit.regression
    covariance = config.contact_sigma_m**2 * np.eye(3)
    return Sample(reading=contact.reading, tip=origin + rotation @ contact.in_panel, covariance=covariance)


def _stylus(tips: Sequence[Sample], rotation: Array, config: HandEyeConfig) -> tuple[Fit, Array, Array]:
    """Return the fit of the tip on the extension, the retracted tip (3,) m, and its direction (3,) in base_link."""
    readings = np.array([s.reading for s in tips])
    points = np.array([s.tip for s in tips])
    shape = np.mean([s.covariance for s in tips], axis=0) + least_covariance(points, config)
    if len(tips) <= MAX_CONTACTS:
        # Too few for a direction and a scatter of their own: a mean along the panel's normal.
        points = points + readings[:, 2:] * rotation[:, 2]
        mean = points.mean(axis=0)
        count = len(tips)
        rms = float(np.sqrt(np.mean(np.sum((points - mean) ** 2, axis=1))))
        if rms > 4 * config.contact_sigma_m:
            raise DegenerateError(
                f"the contacts miss one another by {rms * 1e3:.2f} mm rms, {4e3 * config.contact_sigma_m:.2f} mm are "
                "accepted: check which points were touched"
            )
        used = np.ones(count, dtype=bool)
        fit = Fit(
            regression=mean[np.newaxis],
            spread=np.array([[1 / count]]),
            noise=shape,
            common=np.zeros((3, 3)),
            variance_factor=1.0,
            rms_m=rms,
            used=used,
        )
        return fit, mean, np.array([0.0, 0.0, -1.0])
    with_stylus = bool(np.ptp(readings[:, 2]) >= config.min_stylus_span_m)
    if not with_stylus:
        points = points + readings[:, 2:] * rotation[:, 2]
        readings = readings * (1.0, 1.0, 0.0)
    fit = robust_fit(extension_design(readings, with_stylus), points, shape, config)
    direction = rotation.T @ fit.regression[0] if with_stylus else np.array([0.0, 0.0, -1.0])
    return fit, fit.regression[-1], direction


def shifted(camera_from_base: Transform, base_from_reading: Array, reading: Array) -> Transform:
    """Return camera_from_base of a camera on the carriage for readings (3,) m; given is that at readings zero."""
    moved = np.array([*(base_from_reading @ reading[:2]), 0.0])
    return dataclasses.replace(
        camera_from_base, translation=camera_from_base.translation - camera_from_base.rotation @ moved
    )
