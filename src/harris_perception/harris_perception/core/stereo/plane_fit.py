"""Fits the panel's plane to points of a stereo pair: RANSAC, then least squares.

A stereo pair measures inverse depth with uniform uncertainty, and a plane is linear in it: with ``a = x / z``,
``b = y / z`` a plane ``n . p = o`` is ``1 / z = (n / o) . (a, b, 1)``. Both steps are therefore linear regressions (M.
A. Fischler, R. C. Bolles, "Random Sample Consensus", CACM 24(6), 1981).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Array, Plane, Transform

_TURNS = 10
_SIGMAS = 2.0
"""Width of the inlier window. A narrower one rejects good points depending on the plane; the plane's error then
doubles, but its covariance does not show it."""
_AT_ONCE = 1_000_000
"""Maximum number of point-to-plane distances computed at once; more would not fit into the processor's cache."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneConfig(Config):
    """Settings of the plane fit."""

    tolerance_m: float = setting(
        0.001,
        "Maximum distance in depth between the plane and its points; two of a point's own standard deviations "
        "if that is more",
        minimum=1e-5,
        maximum=0.1,
        unit="m",
    )
    hypotheses: int = setting(400, "Number of planes through three points that are tried", minimum=10, maximum=5000)
    min_points: int = setting(20, "Minimum number of points on the plane", minimum=4, maximum=100_000)
    min_share: float = setting(0.3, "Minimum fraction of all points that lie on the plane", minimum=0.0, maximum=1.0)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlaneFit:
    """A fitted plane.

    Attributes
    ----------
    plane
        The plane in the frame of the points; the normal points to the frame's origin, the camera.
    centre
        (3,) intersection of the plane with the ray through the middle of its points.
    inlier
        (N,) points that lie on the plane.
    rms_m
        Root mean square distance of the inliers from the plane.
    share
        Number of inliers divided by the number of points.
    covariance
        (6, 6) of the pose in ROS's order, in the frame's axes: a translation [m], and a rotation about ``centre``
        [rad]. A plane determines only the translation along its normal and two rotations; the other entries are zero,
        meaning unknown.
    """

    plane: Plane
    centre: Array
    inlier: npt.NDArray[np.bool_]
    rms_m: float
    share: float
    covariance: Array

    def pose(self) -> Transform:
        """Return frame_from_plane: z is the normal, x is the frame's x axis projected onto the plane."""
        z = self.plane.normal
        x = np.array([1.0, 0.0, 0.0]) - z[0] * z
        x /= np.linalg.norm(x)
        return Transform(np.column_stack([x, np.cross(z, x), z]), self.centre)


def fit_plane(
    points: npt.ArrayLike, sigma_m: npt.ArrayLike, config: PlaneConfig, rng: np.random.Generator
) -> PlaneFit | None:
    """Fit one plane to points in the frame's coordinates.

    Parameters
    ----------
    points
        (N, 3) metres, z > 0.
    sigma_m
        (N,) standard deviation of each depth, above zero.
    config
        Tolerance and minimum support.
    rng
        Random generator for the hypotheses; a fixed seed makes the result repeatable.

    Returns
    -------
    fit
        None if too few points agree.

    Raises
    ------
    ValueError
        If a point is not finite or not in front of the camera, or a deviation is not finite and above zero.
    """
    xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    sigma = np.asarray(sigma_m, dtype=np.float64)
    z = xyz[:, 2]
    if sigma.shape != z.shape:
        raise ValueError(f"sigma_m has shape {sigma.shape}; expected {z.shape}: one for each point")
    for i in np.flatnonzero(~(np.isfinite(xyz).all(axis=1) & (z > 0)))[:1]:
        raise ValueError(f"points[{i}] = {xyz[i].tolist()} m; expected finite numbers with z above 0")
    for i in np.flatnonzero(~(np.isfinite(sigma) & (sigma > 0)))[:1]:
        raise ValueError(f"sigma_m[{i}] = {sigma[i]:g} m; expected a finite number above 0")
    if len(z) < config.min_points:
        return None
    design = np.column_stack([xyz[:, :2] / z[:, None], np.ones(len(z))])
    inverse = 1 / z
    # A small change of depth by d changes the inverse depth by d / z^2.
    within = np.maximum(config.tolerance_m, _SIGMAS * sigma) * inverse**2
    inlier = _consensus(design, inverse, within, config, rng)
    if inlier is None:
        return None
    weight = 1 / np.maximum(sigma * inverse**2, 1e-9)
    coefficients: Array = np.zeros(3)
    for _ in range(_TURNS):
        if inlier.sum() < config.min_points:
            return None
        w = weight[inlier]
        coefficients = np.asarray(np.linalg.lstsq(design[inlier] * w[:, None], inverse[inlier] * w, rcond=None)[0])
        now = np.abs(design @ coefficients - inverse) <= within
        if np.array_equal(now, inlier):
            break
        inlier = now
    share = float(inlier.mean())
    if inlier.sum() < config.min_points or share < config.min_share:
        return None
    length = float(np.linalg.norm(coefficients))
    plane = Plane(-coefficients / length, -1 / length)
    middle = design[inlier].mean(axis=0)
    rms = float(np.sqrt(np.mean(plane.distance(xyz[inlier]) ** 2)))
    centre = middle / (middle @ coefficients)
    w = weight[inlier]
    misfit = (design[inlier] @ coefficients - inverse[inlier]) * w
    scale = max(1.0, float(misfit @ misfit) / max(len(w) - 3, 1))
    spread = scale * np.linalg.inv((design[inlier] * w[:, None]).T @ (design[inlier] * w[:, None]))
    return PlaneFit(
        plane=plane,
        centre=centre,
        inlier=inlier,
        rms_m=rms,
        share=share,
        covariance=_pose_covariance(plane.normal, centre, coefficients, np.asarray(spread, np.float64)),
    )


def _pose_covariance(normal: Array, centre: Array, coefficients: Array, spread: Array) -> Array:
    """Return (6, 6) from the covariance (3, 3) of the inverse depth's coefficients; see :class:`PlaneFit`."""
    x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    arms = np.array([0.0 * x, x, y])
    rays = centre + 0.1 * arms
    rays = rays / rays[:, 2:]
    depth = 1 / (rays @ coefficients)
    points = rays * depth[:, None]
    # A change of the coefficients moves each point along its ray, and so do a translation along the normal and two
    # rotations.
    by_coefficients = -(depth**2 * (rays @ normal))[:, None] * rays
    arm = np.cross(points - centre, normal)
    by_pose = np.column_stack([np.ones(3), arm @ x, arm @ y])
    change = np.linalg.solve(by_pose, by_coefficients)
    axes = np.zeros((6, 3))
    axes[:3, 0], axes[3:, 1], axes[3:, 2] = normal, x, y
    return np.asarray(axes @ change @ spread @ change.T @ axes.T)


def _consensus(
    design: Array, inverse: Array, within: Array, config: PlaneConfig, rng: np.random.Generator
) -> npt.NDArray[np.bool_] | None:
    """Return the points that agree with the best of many planes through three points."""
    triples = rng.integers(0, len(inverse), (config.hypotheses, 3))
    corners = design[triples]
    usable = np.abs(np.linalg.det(corners)) > 1e-6
    if not usable.any():
        return None
    planes = np.linalg.solve(corners[usable], inverse[triples[usable]][:, :, None])[:, :, 0]
    best, most = np.zeros(len(inverse), np.bool_), -1
    step = max(1, _AT_ONCE // len(inverse))
    for start in range(0, len(planes), step):
        near = np.abs(planes[start : start + step] @ design.T - inverse) <= within
        counts = near.sum(axis=1)
        first = int(np.argmax(counts))
        if counts[first] > most:
            best, most = near[first].copy(), int(counts[first])
    return best
