"""Hand-eye calibration of cameras that ride on the carriage: the panel is at rest, and the images move.

The carriage does not rotate, so all sightings of the panel share one rotation, and its origin is at ``t = a - N q``. A
linear regression gives ``N = R M`` (rotation of base_link into the camera, scale and skew), as for fixed cameras. It is
the start of a joint refinement of rotation, N and a by all measured points of the panel in all images. Motion does not
determine the stylus's position. It is seen if the cameras see the tip, or touched: at a contact the tip is at the
panel's point.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.degeneracy import DegenerateError, checked
from harris_perception.core.hand_eye.hand_eye import HandEye
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.machine_axes import check_side, check_stylus, split_axes
from harris_perception.core.hand_eye.robust_regression import Fit, misfit_rms, robust_fit
from harris_perception.core.hand_eye.tip_regression import fit_tip
from harris_perception.core.hand_eye.tip_samples import Place, Sample, extension_design
from harris_perception.core.pose.planar_pose import FacePoints
from harris_perception.core.pose.reprojection import RayError, panel_origin, refine_panel
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array, Transform, nearest_rotation
from icu_common.core.reasons.message import Message

MAX_CONTACTS = 5
_PANEL_NOISE = 0.00004, 0.0002
"""Scatter of a recognised panel in m, across and along the line of sight, until its residuals give a better value."""
_MIN_POINTS = 12


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PanelSample:
    """A sighting of the panel while the machine was at rest.

    Attributes
    ----------
    reading
        (3,) m.
    camera_from_panel
        Pose of the panel in the left camera's rectified frame.
    points
        The points measured for that pose; not needed to check the panel's position.
    """

    reading: Array
    camera_from_panel: Transform
    points: FacePoints


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
    """Difference between the tip by contacts and the tip by calibration.

    Attributes
    ----------
    offset
        (3,) m in base_link, touched minus calibrated.
    sigma
        (3,) m, standard deviation of ``offset``; for one contact it is ``contact_sigma_m``.
    contacts
        Number of averaged contacts.
    """

    offset: Array
    sigma: Array
    contacts: int


def calibrate_on_carriage(
    panels: Sequence[PanelSample],
    tips: Sequence[Sample],
    cameras: StereoModel,
    contacts: Sequence[Contact] = (),
    config: HandEyeConfig | None = None,
) -> HandEye:
    """Solve the calibration of cameras on the carriage.

    Parameters
    ----------
    panels
        Sightings of the panel from different positions.
    tips
        Sightings of the tip; may be empty if there are contacts.
    cameras
        The pair.
    contacts
        One to five contacts with known points of the panel; they take precedence over ``tips``.
    config
        Limits.

    Raises
    ------
    DegenerateError
        Like :func:`harris_perception.core.hand_eye.hand_eye.calibrate`, and if nothing gives the stylus's position.
    """
    config = config if config is not None else HandEyeConfig()
    rotation = _mean_rotation(panels) if panels else np.eye(3)
    readings, points = checked([_origin(p, rotation) for p in panels], Message("carriage.panel"), config)
    for p in panels:
        if len(p.points.pixels) < _MIN_POINTS:
            raise DegenerateError(
                Message(
                    "carriage.only_points_panel_measured_needed",
                    pixels=len(p.points.pixels),
                    reading=p.reading[0] * 1000.0,
                    reading_mm=p.reading[1] * 1000.0,
                    min_points=_MIN_POINTS,
                )
            )
    design = np.column_stack([readings[:, :2], np.ones(len(readings))])
    across, along = _PANEL_NOISE
    shape = RayError(eye=np.zeros(3), across_m=across, along_m=along).covariance(points.mean(axis=0, keepdims=True))[0]
    fit = robust_fit(design, points, shape, config)
    # Repeat without the panels that did not fit, whose rotations were part of the mean.
    rotation = _mean_rotation([p for p, used in zip(panels, fit.used) if used])
    points = np.array([_origin(p, rotation).tip for p in panels])
    fit = robust_fit(design, points, shape, config)
    views = [p.points for p, used in zip(panels, fit.used) if used]
    rotation, regression, spread = refine_panel(views, design[fit.used], rotation, fit.regression, cameras.left)
    points = np.array([_origin(p, rotation).tip for p in panels])
    fit = dataclasses.replace(
        fit,
        regression=regression,
        spread=spread,
        rms_m=misfit_rms(design[fit.used], points[fit.used], regression),
        # The panel is seen in the middle of the image, wherever its origin is.
        common=RayError(eye=None, across_m=config.panel_sigma_m, along_m=config.panel_depth_sigma_m),
    )
    camera_from_axes, axes = split_axes(-fit.regression[0], -fit.regression[1], config)
    if contacts:
        if len(contacts) > MAX_CONTACTS:
            raise DegenerateError(
                Message("carriage.contacts_most_used_start_anew", contacts=len(contacts), max_contacts=MAX_CONTACTS)
            )
        tip, origin, direction = _touched(contacts, rotation, camera_from_axes, fit, config)
    elif tips:
        tip, origin, direction = _seen(tips, camera_from_axes, cameras, config)
    else:
        raise DegenerateError(Message("carriage.nothing_tells_where_stylus_let"))
    if len(tip.regression) == 1:
        check_side(camera_from_axes, points[fit.used].mean(axis=0))
    return HandEye(
        camera_from_base=Transform(camera_from_axes, origin),
        base_from_reading=axes,
        stylus_direction=direction,
        fit=fit,
        tip_fit=tip,
        panel_rotation=rotation,
    )


def origin_place(calibration: HandEye, panel: PanelSample, camera: CameraModel) -> Place:
    """Return the position of the panel's origin in a sample, with the rotation of the calibration."""
    rotation = calibration.panel_rotation
    assert rotation is not None
    start = _origin(panel, rotation).tip
    origin, per_pixel, covariance = panel_origin(panel.points, rotation, start, camera)
    return Place(reading=panel.reading, point=origin, per_pixel=per_pixel, covariance=covariance)


def held_out_on_carriage(calibration: HandEye, checks: Sequence[PanelSample], camera: CameraModel) -> Array:
    """Return (N,) m: distances between measured and expected panel at held-out positions."""
    design = np.array([(*p.reading[:2], 1.0) for p in checks])
    seen = np.array([origin_place(calibration, p, camera).point for p in checks])
    return np.asarray(np.linalg.norm(seen - design @ calibration.fit.regression, axis=1))


def stylus_offset(
    calibration: HandEye, camera_from_panel: Transform, contacts: Sequence[Contact], config: HandEyeConfig
) -> StylusOffset:
    """Compare contacts with a calibration made by the cameras.

    Parameters
    ----------
    calibration
        Of either mounting.
    camera_from_panel
        Pose of the panel; for cameras on the carriage, the pose at readings zero.
    contacts
        One to five.
    config
        Only ``contact_sigma_m`` is used.

    Raises
    ------
    DegenerateError
        Without contacts, or with too many.
    """
    if not 1 <= len(contacts) <= MAX_CONTACTS:
        raise DegenerateError(Message("carriage.contacts_1_needed", contacts=len(contacts), max_contacts=MAX_CONTACTS))
    base_from_panel = calibration.camera_from_base.inverse() @ camera_from_panel
    touched = base_from_panel.apply(np.array([c.in_panel for c in contacts]))
    expected = calibration.tip_in_base(np.array([c.reading for c in contacts]))
    count = len(contacts)
    scatter = np.var(touched - expected, axis=0, ddof=1) if count > 1 else np.zeros(3)
    variance = np.maximum(scatter, config.contact_sigma_m**2) / count
    return StylusOffset(offset=(touched - expected).mean(axis=0), sigma=np.sqrt(variance), contacts=count)


def _mean_rotation(panels: Sequence[PanelSample]) -> Array:
    """Return the (3, 3) rotation camera_from_panel that all sightings share."""
    return nearest_rotation(np.mean([p.camera_from_panel.rotation for p in panels], axis=0))


def _origin(panel: PanelSample, rotation: Array) -> Sample:
    """Return the panel's origin in the camera's frame, with the rotation that all sightings share.

    A single pose is most accurate where the panel is seen, in the middle of the image; its own small rotation error
    would move a distant origin. The point on the optical axis is therefore used as measured, and the vector from it to
    the origin is computed with the mean rotation.
    """
    own = panel.camera_from_panel
    normal = own.rotation[:, 2]
    ahead = float(normal @ own.translation) / normal[2] if abs(normal[2]) > 0.1 else float(own.translation[2])
    in_camera = np.array([0.0, 0.0, ahead])
    origin = in_camera - rotation @ own.inverse().apply(in_camera)
    return Sample(reading=panel.reading, tip=np.asarray(origin), covariance=np.zeros((3, 3)))


def _touched(
    contacts: Sequence[Contact], rotation: Array, camera_from_axes: Array, fit: Fit, config: HandEyeConfig
) -> tuple[Fit, Array, Array]:
    """Return the retracted tip from contacts, at which it is at the panel's point; otherwise like :func:`_seen`.

    Contacts are too few for their own direction and scatter: the result is a mean along the panel's normal.
    """
    readings, count = np.array([c.reading for c in contacts]), len(contacts)
    touched = np.array([c.in_panel for c in contacts]) @ rotation.T
    points = np.column_stack([readings[:, :2], np.ones(count)]) @ fit.regression + touched
    points = points + readings[:, 2:] * camera_from_axes[:, 2]
    mean = points.mean(axis=0)
    rms = float(np.sqrt(np.mean(np.sum((points - mean) ** 2, axis=1))))
    if rms > 4 * config.contact_sigma_m:
        raise DegenerateError(
            Message(
                "carriage.contacts_miss_one_another_rms",
                rms_mm=rms * 1000.0,
                contact_sigma_mm=4000.0 * config.contact_sigma_m,
            )
        )
    noise = config.contact_sigma_m**2 * np.eye(3)
    tip = Fit(
        regression=mean[np.newaxis],
        spread=noise / count,
        sigma_px=float("nan"),
        common=RayError(eye=None, across_m=0.0, along_m=0.0),
        variance_factor=1.0,
        rms_m=rms,
        used=np.ones(count, dtype=bool),
    )
    return tip, mean, np.array([0.0, 0.0, -1.0])


def _seen(
    tips: Sequence[Sample], camera_from_axes: Array, cameras: StereoModel, config: HandEyeConfig
) -> tuple[Fit, Array, Array]:
    """Return the fit of the tip on the extension, the retracted tip (3,) m, and its direction (3,) in base_link."""
    extensions = np.array([s.reading[2] for s in tips])
    with_stylus = bool(np.ptp(extensions) >= config.min_stylus_span_m)
    if not with_stylus:
        up = camera_from_axes[:, 2]
        tips = [dataclasses.replace(s, tip=s.tip + s.reading[2] * up) for s in tips]
    # The tip is at rest in the image: all its sightings are from one position.
    fit = fit_tip(extension_design(extensions, with_stylus), tips, 1, cameras, config)
    if not with_stylus:
        return fit, fit.regression[-1], np.array([0.0, 0.0, -1.0])
    direction = camera_from_axes.T @ fit.regression[0]
    check_stylus(direction, config)
    return fit, fit.regression[-1], direction


def shifted(camera_from_base: Transform, base_from_reading: Array, reading: Array) -> Transform:
    """Return camera_from_base of a camera on the carriage for readings (3,) m, from that at readings zero."""
    moved = np.array([*(base_from_reading @ reading[:2]), 0.0])
    return dataclasses.replace(
        camera_from_base, translation=camera_from_base.translation - camera_from_base.rotation @ moved
    )
