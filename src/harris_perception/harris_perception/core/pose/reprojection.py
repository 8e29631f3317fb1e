"""Joint refinement of a hand-eye calibration: all measurements, in pixels, in one least-squares fit.

The error of a triangulated point, and of a pose, is largest along its line of sight, whose direction varies over the
image. A regression of points, each coordinate separately, cannot use this, and gives depth the wrong slope, although
perspective in the pixels determines it well. The closed-form regression is therefore only the start.

Both refinements fit points ``X = design @ regression`` in the camera's rectified frame: the tip, or the panel's origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from harris_perception.core.pose.planar_pose import FacePoints, cross, tukey
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array, nearest_rotation

_ROUNDS = 30
_STEP = 1e-10
_LEAST_PX = 0.01
"""Lower limit of a point's standard deviation, whatever its residual."""
_ALIKE_PX, _CELLS = 0.5, 10
"""Lag, in px, at which the errors of an edge are uncorrelated, and number of cells it is divided into. The error
repeats with the pixels, and half a pixel on it is opposite."""
_FLOOR_PX = 0.1
"""Residuals of the panel's points below a few times this are never outliers."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RayError:
    """An error that differs along and across the line of sight, standard deviations in m.

    ``eye`` (3,) m is the origin of the lines of sight; None if the optical axis counts instead of a point's own line.
    """

    eye: Array | None
    across_m: float
    along_m: float

    def covariance(self, points: Array) -> Array:
        """Return (N, 3, 3) m^2 at points (N, 3) m."""
        rays = np.tile((0.0, 0.0, 1.0), (len(points), 1)) if self.eye is None else points - self.eye
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        along = rays[:, :, None] * rays[:, None, :]
        return np.asarray(self.across_m**2 * (np.eye(3) - along) + self.along_m**2 * along)


def pair_pixels(points: Array, cameras: StereoModel) -> tuple[Array, Array]:
    """Return the positions of points (N, 3) m in both rectified images: (N, 3) px, and the derivative (N, 3, 3) px/m.

    The three are u on the left, u on the right, and the mean of both rows times sqrt 2, so that all have the same
    error.
    """
    x, y, z = points.T
    fx, fy = cameras.left.p[0, 0], cameras.left.p[1, 1]
    row = np.sqrt(2.0) * fy
    pixels = np.column_stack([fx * x / z, fx * (x - cameras.baseline) / z, row * y / z])
    derivative = np.zeros((len(points), 3, 3))
    derivative[:, 0, 0] = derivative[:, 1, 0] = fx / z
    derivative[:, 0, 2] = -fx * x / z**2
    derivative[:, 1, 2] = -fx * (x - cameras.baseline) / z**2
    derivative[:, 2, 1], derivative[:, 2, 2] = row / z, -row * y / z**2
    return pixels, derivative


def refine_points(design: Array, points: Array, start: Array, cameras: StereoModel) -> tuple[Array, Array, float]:
    """Refine a regression of triangulated points by their pixels in both images.

    Parameters
    ----------
    design
        (N, P), without wrong detections.
    points
        (N, 3) m.
    start
        (P, 3) from the closed form.
    cameras
        The pair that measured the points.

    Returns
    -------
    regression, spread, sigma_px
        (P, 3) m; (3 P, 3 P) m^2, its covariance; and a sample's error in one image, estimated from the residuals.
    """
    seen, _ = pair_pixels(points, cameras)
    regression, unknown = start, start.size
    for _ in range(_ROUNDS):
        pixels, derivative = pair_pixels(design @ regression, cameras)
        rows = np.einsum("nij,np->nipj", derivative, design).reshape(-1, unknown)
        step = np.linalg.lstsq(rows, (seen - pixels).ravel(), rcond=None)[0]
        regression = regression + step.reshape(regression.shape)
        if np.abs(step).max() < _STEP:
            break
    error = seen - pair_pixels(design @ regression, cameras)[0]
    sigma = float(np.sqrt(np.sum(error**2) / max(error.size - unknown, 1)))
    return regression, np.asarray(sigma**2 * np.linalg.inv(rows.T @ rows)), sigma


def refine_panel(
    views: Sequence[FacePoints], design: Array, rotation: Array, start: Array, camera: CameraModel
) -> tuple[Array, Array, Array]:
    """Refine the panel's rotation, common to all views, and the regression of its origin, by all measured points.

    Tukey's weights make the fit robust. The points of one view share errors (the same print, the same light), so views
    are independent and points are not. So the covariance is scaled by the error of each view.

    Parameters
    ----------
    views
        The measurements at each of N positions.
    design
        (N, P).
    rotation, start
        (3, 3) camera_from_panel and (P, 3) m, from the closed form.
    camera
        The camera that measured them.

    Returns
    -------
    rotation, regression, covariance
        (3, 3); (P, 3) m; (3 P, 3 P) m^2.
    """
    everything = FacePoints.joined(views)
    counts = [len(view.pixels) for view in views]
    rows = np.repeat(design, counts, axis=0)
    ends = np.cumsum(counts)[:-1]
    regression, unknown = start, 3 + start.size
    for _ in range(_ROUNDS):
        turned = everything.in_space @ rotation.T
        error, by_point = everything.residuals(turned + rows @ regression, camera)
        jacobian = np.empty((len(error), unknown))
        jacobian[:, :3] = np.einsum("nj,njk->nk", by_point, -cross(turned))
        jacobian[:, 3:] = (rows[:, :, None] * by_point[:, None, :]).reshape(len(error), -1)
        root = tukey(error, _FLOOR_PX)[:, None]
        weight = root**2
        normal = jacobian.T @ (weight * jacobian)
        step = np.linalg.solve(normal, jacobian.T @ (weight[:, 0] * error))
        turn = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64)
        rotation = nearest_rotation(turn @ rotation)
        regression = regression + step[3:].reshape(regression.shape)
        if np.abs(step).max() < _STEP:
            break
    own = np.hstack([jacobian[:, :3], by_point])  # by the six parameters of one view's pose
    squares = 0.0
    for part, of, off in zip(np.split(own, ends), np.split(weight, ends), np.split(error, ends)):
        pull = part.T @ (of[:, 0] * off)
        squares += float(pull @ np.linalg.solve(part.T @ (of * part), pull))
    factor = squares / max(6 * len(views) - unknown, 1)
    inverse = np.linalg.inv(jacobian.T @ (_slope(root) * jacobian))
    return rotation, regression, np.asarray(factor * (inverse @ normal @ inverse)[3:, 3:])


def panel_origin(view: FacePoints, rotation: Array, start: Array, camera: CameraModel) -> tuple[Array, Array, Array]:
    """Find the panel's origin from one view's points; robust.

    A line of print along the pixels' rows or columns has the same subpixel position everywhere, and its points share an
    error. The covariance is a "sandwich" of the residuals and their products, with less weight the farther two points
    are apart across such a line.

    Parameters
    ----------
    view
        The measurements.
    rotation, start
        (3, 3) camera_from_panel, which is not changed, and (3,) m.
    camera
        The camera that measured them.

    Returns
    -------
    origin, per_pixel, covariance
        (3,) m; its covariance (3, 3) m^2 if each point had an independent error of 1 px; and that by residuals,
        (3, 3) m^2.
    """
    turned, origin = view.in_space @ rotation.T, start
    for _ in range(_ROUNDS):
        error, by_point = view.residuals(turned + origin, camera)
        weight = tukey(error, _FLOOR_PX)
        rows = by_point * weight[:, None]
        step = np.linalg.lstsq(rows, error * weight, rcond=None)[0]
        origin = origin + step
        if np.abs(step).max() < _STEP:
            break
    per_pixel = np.linalg.inv(rows.T @ rows)
    pull = rows * (error * weight)[:, None]
    flat = np.abs(view.across[:, 1]) > np.abs(view.across[:, 0])
    spread = _together(pull[flat], view.pixels[flat, 1]) + _together(pull[~flat], view.pixels[~flat, 0])
    inverse = np.linalg.inv(by_point.T @ (_slope(weight)[:, None] * by_point))
    covariance = inverse @ spread @ inverse + _LEAST_PX**2 * per_pixel
    return np.asarray(origin), np.asarray(per_pixel), np.asarray(covariance)


def _slope(root: Array) -> Array:
    """Return the derivative of Tukey's psi function from the square roots of its weights."""
    return root * (5.0 * root - 4.0)


def _together(pull: Array, at_px: Array) -> Array:
    """Return the covariance (3, 3) of the sum of ``pull`` (N, 3); near terms are more correlated."""
    if not len(pull):
        return np.zeros((3, 3))
    cell = np.rint((at_px - at_px.min()) * _CELLS / _ALIKE_PX).astype(np.intp)
    sums = np.zeros((int(cell.max()) + 1 + _CELLS, 3))
    np.add.at(sums, cell, pull)
    near = sum((1.0 - lag / _CELLS) * sums[lag:].T @ sums[: len(sums) - lag] for lag in range(1, _CELLS))
    return np.asarray(sums.T @ sums + near + np.transpose(near))
