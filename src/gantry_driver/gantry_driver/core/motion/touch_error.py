"""Uncertainty of a touch: the covariance of the tip relative to the target in base_link's plane, and its 95 % bound.

The same cameras see tip and target, so an error that both share (a wrong hand-eye translation, a wrong distance of the
whole panel) cancels. The remaining errors are computed here, each one separately.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gantry_driver.core.motion.scene import Scene
from icu_common.core.alignment.findings import Finding, FindingCode
from icu_common.core.alignment.layout import ControlDeviation
from icu_common.core.alignment.pair import PairState
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Array

_RINGS, _SPOKES = 24, 48


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchErrorConfig(Config):
    """Errors that no message reports."""

    across_sigma_m: float = setting(
        0.00001,
        "Standard deviation of the seen tip relative to the panel's print, perpendicular to the line of sight",
        minimum=1e-6,
        maximum=0.01,
        unit="m",
    )
    disparity_sigma_px: float = setting(
        0.01, "Standard deviation of the tip's disparity", minimum=0.001, maximum=5.0, unit="px"
    )
    unchecked_depth_m: float = setting(
        0.001,
        "Standard deviation of the tip's distance while the cameras have not been compared",
        minimum=0.0,
        maximum=0.1,
        unit="m",
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TouchError:
    """The seen offset (2,) m of the tip from its target in base_link, and the covariance (2, 2) m^2 of the true one."""

    seen: Array
    covariance: Array

    def bound_m(self) -> float:
        """Return the distance from the target within which the tip is, with 95 % probability, in metres."""
        # Deterministic sample of the normal distribution: rings of equal probability.
        radius = np.sqrt(-2.0 * np.log(1.0 - (np.arange(_RINGS) + 0.5) / _RINGS))
        angle = 2.0 * np.pi * (np.arange(_SPOKES) + 0.5) / _SPOKES
        unit = (radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)).reshape(-1, 2)
        values, axes = np.linalg.eigh(self.covariance)
        spread = (unit * np.sqrt(np.maximum(values, 0.0))) @ axes.T
        return float(np.quantile(np.linalg.norm(self.seen + spread, axis=1), 0.95))

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        (xx, xy), (_, yy) = self.covariance
        sigma_x, sigma_y = math.sqrt(xx), math.sqrt(yy)
        return (
            ("offset_x_m", f"{self.seen[0]:.6f}"),
            ("offset_y_m", f"{self.seen[1]:.6f}"),
            ("sigma_x_m", f"{sigma_x:.6f}"),
            ("sigma_y_m", f"{sigma_y:.6f}"),
            ("correlation", f"{xy / (sigma_x * sigma_y):.3f}"),
            ("error_95_m", f"{self.bound_m():.6f}"),
        )


def ray_at(in_base: Array, scene: Scene, pair: PairState | None) -> Array:
    """Return the unit vector (3,) in base_link from the middle between the cameras to a position (3,)."""
    middle = np.array([0.0 if pair is None else pair.baseline_m / 2, 0.0, 0.0])
    way = in_base - scene.camera_from_base.inverse().apply(middle)
    return np.asarray(way / np.linalg.norm(way))


def covariance_at(
    in_base: Array, scene: Scene, pair: PairState | None, layout_sigma_m: tuple[float, float], config: TouchErrorConfig
) -> Array:
    """Return the covariance (2, 2) in m^2 at a position (3,) in base_link.

    Parameters
    ----------
    in_base
        The target.
    scene
        Poses.
    pair
        State of the cameras as the tracker reports it.
    layout_sigma_m
        Standard deviations of the target in its layout, along the panel's x and y.
    config
        Errors that no message reports.
    """
    in_camera = scene.camera_from_base.apply(in_base)
    distance = float(np.linalg.norm(in_camera))
    base_from_camera = scene.camera_from_base.inverse().rotation
    ray = base_from_camera @ (in_camera / distance)
    across_m, along_m = config.across_sigma_m, 0.0
    if pair is not None and pair.known:
        depth_by_px = distance**2 / (pair.focal_px * pair.baseline_m)
        pitch_px, yaw_px = (float(sigma) * pair.focal_px for sigma in pair.sigma_rad[:2])
        along_m = math.hypot(config.disparity_sigma_px, yaw_px) * depth_by_px
        across_m = math.hypot(across_m, 0.5 * pitch_px * distance / pair.focal_px)
    else:
        along_m = config.unchecked_depth_m
    panel = scene.base_from_panel.rotation[:2, :2]
    layout = panel @ np.diag(np.square(layout_sigma_m)) @ panel.T
    outer = np.outer(ray, ray)[:2, :2]
    covariance = across_m**2 * (np.eye(2) - outer) + along_m**2 * outer + layout
    return np.asarray(covariance)


def layout_sigma_m(deviation: ControlDeviation | None) -> tuple[float, float]:
    """Return the standard deviations of a control along x and y; 0 on the bare face, whose print gives the pose."""
    return (0.0, 0.0) if deviation is None else (1e-3 * deviation.sigma_mm[0], 1e-3 * deviation.sigma_mm[1])


def uncertain(error: TouchError | None, limit_m: float) -> Finding | None:
    """Return a finding if a touch is not known well enough to be confirmed."""
    if error is None or (bound_m := error.bound_m()) <= limit_m:
        return None
    values = (("uncertainty_mm", f"{1e3 * bound_m:.2f}"), ("limit_mm", f"{1e3 * limit_m:g}"))
    return Finding(code=FindingCode.UNCERTAIN, values=values)
