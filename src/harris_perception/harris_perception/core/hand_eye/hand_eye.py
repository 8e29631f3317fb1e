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

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from harris_perception.core.pose.reprojection import RayError, pair_pixels, refine_points
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array, Transform, nearest_rotation

_SUBSETS, _MOST_LISTED = 3000, 200_000


@dataclass(frozen=True, slots=True, kw_only=True)
class HandEyeConfig(Config):
    """Minimum quality of the samples, and limits of a plausible machine."""

    min_samples: int = setting(6, "Minimum number of samples that fit", minimum=4, maximum=1000)
    min_span_m: float = setting(
        0.06, "Minimum extent of the readings along each of two directions", minimum=0.001, maximum=5.0, unit="m"
    )
    min_stylus_span_m: float = setting(
        0.004,
        "Minimum extent of the stylus readings from which the stylus's direction is also fitted",
        minimum=0.0001,
        maximum=1.0,
        unit="m",
    )
    tip_sigma_px: float = setting(
        0.02,
        "Lower limit of a sample's standard deviation in each image; the sightings of a sample share their background",
        minimum=0.0001,
        maximum=5.0,
        unit="px",
    )
    common_error: float = setting(
        1.15,
        "Error shared by all samples (the ball's shading), which more samples do not reduce, as a fraction of "
        "one sample's error",
        minimum=0.0,
        maximum=5.0,
    )
    place_error: float = setting(
        1.0,
        "Error shared by samples from one position in the image (background of the ball), as a fraction of "
        "one sample's error",
        minimum=0.0,
        maximum=5.0,
    )
    panel_sigma_m: float = setting(
        0.000022,
        "Error of the panel's position across the line of sight, shared by all its sightings",
        minimum=0.0,
        maximum=0.01,
        unit="m",
    )
    panel_depth_sigma_m: float = setting(
        0.00016,
        "Error of the panel's distance as measured by one camera, shared by all its sightings",
        minimum=0.0,
        maximum=0.05,
        unit="m",
    )
    contact_sigma_m: float = setting(
        0.0003, "Standard deviation of a touched point", minimum=1e-6, maximum=0.01, unit="m"
    )
    outlier_sigmas: float = setting(
        4.5, "Deviation, in standard deviations, above which a sample is removed", minimum=2.0, maximum=100.0
    )
    max_outliers: float = setting(0.3, "Maximum fraction of samples that may be removed", minimum=0.0, maximum=0.49)
    max_rms_m: float = setting(0.0005, "Maximum accepted rms misfit", minimum=1e-6, maximum=0.1, unit="m")
    max_scale_error: float = setting(
        0.05, "Maximum relative error of an axis's scale against its readings", minimum=0.001, maximum=0.5
    )
    max_skew: float = setting(
        0.05,
        "Maximum deviation from 90 degrees of the angle between the axes, and between the stylus and both axes",
        minimum=0.001,
        maximum=0.5,
        unit="rad",
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sample:
    """A sighting of the tip while the machine was at rest.

    Attributes
    ----------
    reading
        (3,) m: x, y, stylus extension.
    tip
        (3,) m in the camera's rectified frame.
    covariance
        (3, 3) m^2 of ``tip``.
    """

    reading: Array
    tip: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Place:
    """Position of a point: the tip or, with cameras on the carriage, the panel's origin.

    Attributes
    ----------
    reading
        (3,) m: x, y, stylus extension.
    point
        (3,) m in the camera's rectified frame.
    per_pixel
        (3, 3) m^2: the covariance of ``point`` if all measurements in the images had an independent error of 1 px.
    covariance
        (3, 3) m^2 of ``point``, without the error shared with its neighbours.
    """

    reading: Array
    point: Array
    per_pixel: Array
    covariance: Array


class DegenerateError(ValueError):
    """The samples do not determine the calibration; the message says what to add."""


class MisfitError(DegenerateError):
    """The samples disagree; more of them may show which are wrong."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fit:
    """A robust linear regression of points on readings.

    Attributes
    ----------
    regression
        (P, 3) columns of the model, point = design @ regression.
    spread
        (3 P, 3 P) m^2, covariance of ``regression``, row by row.
    sigma_px
        Error of the tip in each image, estimated from the residuals; NaN if it was not fitted by pixels.
    common
        Error shared by all samples.
    variance_factor
        Squared residuals over the samples' own predicted covariances (chi-square per degree of freedom).
    rms_m
        Misfit of the samples used.
    used
        (N,) bool, samples used.
    """

    regression: Array
    spread: Array
    sigma_px: float
    common: RayError
    variance_factor: float
    rms_m: float
    used: npt.NDArray[np.bool_]

    def covariance(self, design: Array) -> Array:
        """Return (N, 3, 3) m^2: covariance of the fitted point of each row of ``design`` (N, P)."""
        return self.own_covariance(design) + self.common.covariance(design @ self.regression)

    def own_covariance(self, design: Array) -> Array:
        """Return the same, (N, 3, 3) m^2, without the error that all samples share."""
        count = len(self.regression)
        blocks = self.spread.reshape(count, 3, count, 3)
        return np.asarray(np.einsum("np,nq,piqj->nij", design, design, blocks))


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
        own = self.fit.covariance(_design(rows, len(self.fit.regression) == 4))
        if self.tip_fit is None:
            return own
        return own + self.tip_fit.covariance(extension_design(rows[:, 2], len(self.tip_fit.regression) == 2))

    def sigma_m(self, readings: Array) -> float:
        """Return the predicted rms distance, m, between fitted and true tip over readings (N, 3)."""
        return _rms(self.covariance(readings))

    def own_sigma_m(self, readings: Array) -> float:
        """Return the same without the error that all samples share: the part that more samples reduce."""
        rows = np.atleast_2d(readings)
        own = self.fit.own_covariance(_design(rows, len(self.fit.regression) == 4))
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
    readings, tips = checked(samples, "the tip", config)
    with_stylus = bool(np.ptp(readings[:, 2]) >= config.min_stylus_span_m)
    if with_stylus:
        _check_stylus(readings, config)
    places = len(np.unique(np.round(readings[:, :2], 4), axis=0))
    fit = fit_tip(_design(readings, with_stylus), samples, places, cameras, config)
    _check_motion(readings[fit.used], tips[fit.used], "the tip", config)
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


def fit_tip(design: Array, samples: Sequence[Sample], places: int, cameras: StereoModel, config: HandEyeConfig) -> Fit:
    """Fit the tip by design (N, P): in closed form without wrong detections, then by all other pixels jointly.

    Parameters
    ----------
    design, samples
        The regression.
    places
        Number of positions in the images at which the tip was seen. The tracker's error at one position, with the same
        light and background, is reduced only by this number.
    cameras
        The pair that measured it.
    config
        Limits.

    Raises
    ------
    DegenerateError
        Like :func:`robust_fit`.
    """
    tips = np.array([s.tip for s in samples], dtype=np.float64)
    # Medians: wrong samples are not known yet, and one sample far away would make all seem noisier.
    by_pixel = np.linalg.inv(pair_pixels(np.median(tips, axis=0, keepdims=True), cameras)[1][0])
    shape = by_pixel @ by_pixel.T
    seen, derivative = pair_pixels(tips, cameras)
    told = np.einsum("nij,njk,nik->n", derivative, np.array([s.covariance for s in samples]), derivative) / 3
    expected_px = float(np.sqrt(np.median(told) + config.tip_sigma_px**2))
    fit = robust_fit(design, tips, expected_px**2 * shape, config)
    used, regression = fit.used, fit.regression
    for _ in range(10):
        regression, spread, sigma = refine_points(design[used], tips[used], regression, cameras)
        off = seen - pair_pixels(design @ regression, cameras)[0]
        again = np.linalg.norm(off, axis=1) <= config.outlier_sigmas * max(sigma, expected_px)
        if (again == used).all():
            break
        used = again
        _check_left_out(used, config)
    # Stereo depth depends on the difference of both images' errors, so a shared error does not affect it.
    shared = max(sigma, config.tip_sigma_px)
    far = float(np.mean(tips[used, 2]))
    pixel_m = far / cameras.focal_px
    return dataclasses.replace(
        fit,
        used=used,
        regression=regression,
        spread=spread,
        sigma_px=sigma,
        rms_m=misfit_rms(design[used], tips[used], regression),
        common=RayError(
            eye=np.array([0.5 * cameras.baseline, 0.0, 0.0]),
            across_m=float(np.hypot(config.common_error, config.place_error * np.sqrt(0.5 / places)))
            * shared
            * pixel_m,
            along_m=config.place_error * float(np.sqrt(2.0 / places)) * shared * pixel_m * far / cameras.baseline,
        ),
        variance_factor=(sigma / expected_px) ** 2,
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


def checked(samples: Sequence[Sample], what: str, config: HandEyeConfig) -> tuple[Array, Array]:
    """Return readings (N, 3) and points (N, 3) of samples after checking that they are enough, finite and spread.

    Raises
    ------
    DegenerateError
        With the motion that would help.
    """
    if len(samples) < config.min_samples:
        raise DegenerateError(
            f"{len(samples)} samples, {config.min_samples} are needed: move to another place and add one"
        )
    readings = np.array([s.reading for s in samples], dtype=np.float64)
    points = np.array([s.tip for s in samples], dtype=np.float64)
    if not (np.isfinite(readings).all() and np.isfinite(points).all()):
        raise DegenerateError("a sample is not finite")
    _check_motion(readings, points, what, config)
    return readings, points


def robust_fit(design: Array, points: Array, shape: Array, config: HandEyeConfig) -> Fit:
    """Fit points (N, 3) by design (N, P), without outliers.

    Parameters
    ----------
    design, points
        The regression.
    shape
        (3, 3) m^2 covariance of every sample up to one factor, which the residuals determine.
    config
        Limits.

    Raises
    ------
    DegenerateError
        If there are too many outliers, or the misfit of the others is too large.
    """
    used = _consensus(design, points, shape, config)
    regression: Array = np.linalg.lstsq(design[used], points[used], rcond=None)[0].astype(np.float64)
    leverage: Array = np.linalg.inv(design[used].T @ design[used]).astype(np.float64)
    residuals = points[used] - design[used] @ regression
    freedom = 3 * (int(used.sum()) - design.shape[1])
    # The residuals determine the size of the covariance (a posteriori variance of unit weight).
    factor = float(np.einsum("ni,ij,nj->", residuals, np.linalg.inv(shape), residuals)) / max(freedom, 1)
    rms = misfit_rms(design[used], points[used], regression)
    if rms > config.max_rms_m:
        raise MisfitError(
            f"the samples miss one another by {rms * 1e3:.2f} mm rms, {config.max_rms_m * 1e3:.2f} mm are accepted: "
            "check that the tip is seen well and that nothing slips"
        )
    return Fit(
        regression=regression,
        spread=np.kron(leverage, shape * factor),
        sigma_px=float("nan"),
        common=RayError(eye=None, across_m=0.0, along_m=0.0),
        variance_factor=factor,
        rms_m=rms,
        used=used,
    )


def misfit_rms(design: Array, points: Array, regression: Array) -> float:
    """Return the rms distance of points (N, 3) m from design (N, P) @ regression (P, 3), per degree of freedom."""
    squared = float(np.sum((points - design @ regression) ** 2))
    return float(np.sqrt(3.0 * squared / max(points.size - regression.size, 1)))


def _design(readings: Array, with_stylus: bool) -> Array:
    columns = readings if with_stylus else readings[:, :2]
    return np.column_stack([columns, np.ones(len(readings))])


def extension_design(extensions: Array, with_stylus: bool) -> Array:
    """Return the design (N, 2) or (N, 1) of a point that moves only with the stylus, for extensions (N,) m."""
    ones = np.ones((len(extensions), 1))
    return np.column_stack([extensions, ones]) if with_stylus else ones


def split_axes(x_rail: Array, y_rail: Array, config: HandEyeConfig) -> tuple[Array, Array]:
    """Return R (3, 3) and upper triangular M (2, 2) with [x_rail, y_rail] = R[:, :2] M.

    Raises
    ------
    DegenerateError
        If the axes are implausible.
    """
    x = x_rail / np.linalg.norm(x_rail)
    z = np.cross(x_rail, y_rail)
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    rotation = nearest_rotation(np.column_stack([x, y, z]))
    axes = np.array([[np.linalg.norm(x_rail), x @ y_rail], [0.0, y @ y_rail]])
    check_axes(axes, config)
    return rotation, axes


def _check_motion(readings: Array, tips: Array, what: str, config: HandEyeConfig) -> None:
    """Reject samples that leave one of the two directions undetermined."""
    centre = readings[:, :2].mean(axis=0)
    _, _, directions = np.linalg.svd(readings[:, :2] - centre)
    along, across = (float(np.ptp(readings[:, :2] @ d)) for d in directions)
    need = config.min_span_m
    if along < 0.001:
        raise DegenerateError(
            f"the readings do not differ ({along * 1e3:.2f} mm): the gantry did not move; move at least "
            f"{need * 1e3:.0f} mm in x and in y"
        )
    if along < need:
        raise DegenerateError(
            f"the samples are too close together ({along * 1e3:.1f} mm): move at least "
            f"{need * 1e3:.0f} mm in x and in y"
        )
    if across < need:
        off = 1.05 * need * directions[1] * np.sign(directions[1][np.argmax(np.abs(directions[1]))])
        x, y = (centre + off) * 1e3
        kind = "lie on one line" if across < 0.1 * need else "hardly leave one line"
        raise DegenerateError(
            f"the samples {kind} ({along * 1e3:.0f} mm long, {across * 1e3:.1f} mm across): add one near "
            f"x = {x:.0f}, y = {y:.0f} mm or at least {need * 1e3:.0f} mm off that line"
        )
    seen = float(np.linalg.norm(tips.max(axis=0) - tips.min(axis=0)))
    if seen < 0.2 * along:
        raise DegenerateError(
            f"the gantry moved {along * 1e3:.0f} mm but {what} that was seen only {seen * 1e3:.1f} mm: what is "
            "tracked is not it, the camera is mounted otherwise, or the drive slips; look at the picture before "
            "moving again"
        )


def _check_stylus(readings: Array, config: HandEyeConfig) -> None:
    """Reject extensions that are correlated with x and y, so that their effects cannot be separated."""
    flat = _design(readings, False)
    fitted, *_ = np.linalg.lstsq(flat, readings[:, 2], rcond=None)
    own = readings[:, 2] - flat @ fitted
    if np.ptp(own) < 0.5 * config.min_stylus_span_m:
        raise DegenerateError(
            f"the stylus extension changes together with x and y (own part {np.ptp(own) * 1e3:.2f} mm): add a "
            "sample at the same x and y with the stylus "
            f"{config.min_stylus_span_m * 1e3:.0f} mm further in or out"
        )


def _consensus(design: Array, tips: Array, shape: Array, config: HandEyeConfig) -> npt.NDArray[np.bool_]:
    """Return the consistent samples: least median of squares over small subsets, then re-fitted inliers."""
    count, unknown = design.shape
    whiten = np.linalg.cholesky(np.linalg.inv(shape))
    flat = tips @ whiten
    subsets = _subsets(count, unknown)
    matrices = design[subsets]
    sound = np.abs(np.linalg.det(matrices)) > 1e-3 * np.abs(np.linalg.det(matrices)).max()
    models = np.linalg.solve(matrices[sound], flat[subsets[sound]])
    squares = np.sum((flat[None] - design @ models) ** 2, axis=2)
    keep = (count + unknown + 1) // 2
    best = int(np.argmin(np.sort(squares, axis=1)[:, keep - 1]))
    # 2.366 is the median of chi-square with three degrees of freedom; the factor in n is the usual small-sample one.
    scale = np.sqrt(np.sort(squares[best])[keep - 1] / 2.366) * (1 + 5 / max(1, count - unknown))
    used = np.sqrt(squares[best]) <= config.outlier_sigmas * max(scale, 1.0)
    for _ in range(10):
        fitted, *_ = np.linalg.lstsq(design[used], flat[used], rcond=None)
        distances = np.sqrt(np.sum((flat - design @ fitted) ** 2, axis=1))
        freedom = max(1, 3 * (int(used.sum()) - unknown))
        sigma = max(1.0, float(np.sqrt(np.sum(distances[used] ** 2) / freedom)))
        again = distances <= config.outlier_sigmas * sigma
        if (again == used).all():
            break
        used = again
    _check_left_out(used, config)
    return np.asarray(used)


def _subsets(count: int, size: int) -> npt.NDArray[np.intp]:
    """Return elemental subsets (M, size) of ``count`` samples: all, an even selection, or random ones of many.

    See Rousseeuw, Leroy, "Robust Regression and Outlier Detection". The first subsets in order all contain the first
    sample; if that is wrong, so are all their models.
    """
    if math.comb(count, size) > _MOST_LISTED:
        chance = np.random.default_rng(0).random((_SUBSETS, count))
        return np.argsort(chance, axis=1)[:, :size]
    subsets = np.array(list(itertools.combinations(range(count), size)))
    return subsets[:: max(1, len(subsets) // _SUBSETS)]


def _check_left_out(used: npt.NDArray[np.bool_], config: HandEyeConfig) -> None:
    left_out = np.flatnonzero(~used)
    if len(left_out) > config.max_outliers * len(used) or int(used.sum()) < config.min_samples:
        numbers = ", ".join(str(i + 1) for i in left_out)
        raise MisfitError(
            f"{len(left_out)} of {len(used)} samples do not fit the rest (numbers {numbers}): the tip was seen wrongly "
            "there, or the drive slipped; add samples in other places or start anew"
        )


def axes_skew(base_from_reading: Array) -> float:
    """Return the deviation of the axes from 90 degrees, rad; positive if y leans towards x."""
    return float(np.arctan2(base_from_reading[0, 1], base_from_reading[1, 1]))


def check_axes(axes: Array, config: HandEyeConfig) -> None:
    """Reject an implausible base_from_reading (2, 2).

    Raises
    ------
    DegenerateError
        With the axis and the plausible range.
    """
    skew = axes_skew(axes)
    for name, scale in (("x", axes[0, 0]), ("y", axes[1, 1])):
        if abs(scale - 1) > config.max_scale_error:
            raise DegenerateError(
                f"the {name} axis moves {scale:.3f} m per metre of reading, {1 - config.max_scale_error:.2f} to "
                f"{1 + config.max_scale_error:.2f} are plausible: check steps per mm and the camera calibration"
            )
    if abs(skew) > config.max_skew:
        raise DegenerateError(
            f"the axes miss a right angle by {np.degrees(skew):.1f} degrees, {np.degrees(config.max_skew):.1f} are "
            "plausible"
        )


def check_side(camera_from_axes: Array, seen: Array) -> None:
    """Reject axes (3, 3) that are mirrored; without a fitted stylus no other check detects this.

    Their z is computed from x and y, and points out of the panel, towards the cameras, which see its face at ``seen``
    (3,) m.

    Raises
    ------
    DegenerateError
        With the parts that may be reversed.
    """
    if not camera_from_axes[:, 2] @ seen < 0:
        raise DegenerateError(
            "x and y do not go as they should: one of them runs backwards, or the two are swapped: move each a little "
            "and look which it is, before motors or settings are changed"
        )


def check_stylus(direction: Array, config: HandEyeConfig) -> None:
    """Reject an implausible motion (3,) in base_link per metre of extension.

    One sample at another extension fits every direction, even if its tip was measured wrongly.

    Raises
    ------
    DegenerateError
        With the deviation and the plausible range.
    """
    depth, aside = -float(direction[2]), float(np.hypot(*direction[:2]))
    if abs(depth + 1) <= config.max_scale_error:
        raise DegenerateError(
            "stylus, x and y do not go as they should: x or y runs backwards, or the two are swapped, or the stylus "
            "goes up where it should go down: move each a little and look which it is, before motors or settings are "
            "changed"
        )
    if not abs(depth - 1) <= config.max_scale_error:
        raise DegenerateError(
            f"the stylus moves {depth:.3f} m towards the panel per metre of extension, "
            f"{1 - config.max_scale_error:.2f} to {1 + config.max_scale_error:.2f} are plausible: check its steps per "
            "mm, or add samples with the stylus further in and out"
        )
    if not np.arctan2(aside, depth) <= config.max_skew:
        raise DegenerateError(
            f"the stylus leans by {np.degrees(np.arctan2(aside, depth)):.1f} degrees, "
            f"{np.degrees(config.max_skew):.1f} are plausible: add samples with the stylus further in and out"
        )
