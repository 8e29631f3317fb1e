"""Measures a raised control's position from its outline in the images of both cameras.

The top of a control is a plane figure of known size at a known height. Grey values are sampled across its outline in
the plane of its top, and the figure is shifted to the position where the gradients of all sides agree. The edge of a
bevel lies inside the outline on every side, so no shift aligns two opposite ones. A wrong height looks like a shift
away from the cameras; two cameras and the layout's tolerance separate both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control

Gray = npt.NDArray[np.uint8]
REACH_MM = 1.5
"""Maximum shift that is searched."""
_STEP_MM = 0.05
_SMOOTH_MM = 0.2
_ALONG = 15
"""Number of samples along each side of a rectangle."""
_ALONG_SHARE = 0.7
"""Share of a side that is sampled: its corners may be round."""
_NORMALS = ((1, 0), (-1, 0), (0, 1), (0, -1))
"""Outward normals of a rectangle's sides."""
_INSIDE_MM, _OUTSIDE_MM = 1.6, 0.8
"""Length of a profile inside the top's outline, and beyond a wall."""
_BEVELS_MM = (0.0, 0.4, 0.7, 1.0)
_BLUR_MM = 0.3
_NOISE = 2.0
"""Variance of a profile that no edge explains, in squared grey values."""
_INDEPENDENT = 10
"""Number of independent samples of a profile; they are one blur apart."""
_LEAST_STEP = 6.0
"""Minimum range of grey values across a side for the side to be visible."""
_SPOKES = 48
_LEAST_GRADIENT = 8.0
"""Minimum slope, in grey values per mm, for a side to be visible."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TopShift:
    """Position of a control's top in one image.

    Attributes
    ----------
    shift_mm
        (2,) shift in the plane of the nominal height.
    lean
        (2,) change of that shift per mm of height.
    sigma_mm
        (2,) standard deviation over all explanations that fit the image about as well: another bevel, another edge.
    """

    shift_mm: Array
    lean: Array
    sigma_mm: Array


def top_shift(image: Gray, control: Control, camera_from_panel: Transform, camera: CameraModel) -> TopShift | None:
    """Measure a control in one rectified image; None if its outline is not visible all around.

    Parameters
    ----------
    image
        (H, W) uint8, rectified.
    control
        The control in the layout.
    camera_from_panel
        Pose of the panel in the frame of this image.
    camera
        Intrinsics of the rectified image.
    """
    eye = 1e3 * camera_from_panel.inverse().translation
    place = np.array([*control.position_mm, control.height_mm])
    lean = (place[:2] - eye[:2]) / (eye[2] - place[2])
    walls = [max(0.0, -float(np.dot(normal, lean))) * control.height_mm for normal in _NORMALS]
    half = round((REACH_MM + max(_INSIDE_MM, max(walls) + _OUTSIDE_MM)) / _STEP_MM) + 1
    steps = _STEP_MM * np.arange(-half, half + 1)
    points, outward = _outline(control)
    line = points[:, None, :] + steps[None, :, None] * outward[:, None, :]
    in_panel = np.concatenate([line, np.full((*line.shape[:2], 1), control.height_mm)], axis=2)
    seen = camera_from_panel.apply(1e-3 * in_panel.reshape(-1, 3))
    uv = seen[:, :2] / seen[:, 2:] * (camera.p[0, 0], camera.p[1, 1]) + camera.p[:2, 2]
    if not (seen[:, 2].min() > 0 and uv.min() >= 0 and (uv.max(axis=0) < np.array(image.shape[::-1]) - 1).all()):
        return None
    columns, rows = (uv[:, k].reshape(line.shape[:2]).astype(np.float32) for k in (0, 1))
    values = np.asarray(cv2.remap(image, columns, rows, cv2.INTER_LINEAR), dtype=np.float64)
    if control.shape == "circle":
        shift = _of_circle(values, outward)
        return None if shift is None else TopShift(shift_mm=shift, lean=lean, sigma_mm=np.zeros(2))
    sides = _of_rectangle(values, walls)
    return None if sides is None else TopShift(shift_mm=sides[:, 0], lean=lean, sigma_mm=sides[:, 1])


def _outline(control: Control) -> tuple[Array, Array]:
    """Return points (N, 2) mm of the outline and outward unit vectors (N, 2); for a rectangle side by side."""
    centre, (half_x, half_y) = np.array(control.position_mm), np.array(control.size_mm) / 2
    if control.shape == "circle":
        angle = 2 * np.pi * np.arange(_SPOKES) / _SPOKES
        outward = np.column_stack([np.cos(angle), np.sin(angle)])
        return centre + half_x * outward, outward
    share = _ALONG_SHARE * np.linspace(-1, 1, _ALONG)
    points = [
        np.column_stack([np.full(_ALONG, nx * half_x), share * half_y])
        if nx
        else np.column_stack([share * half_x, np.full(_ALONG, ny * half_y)])
        for nx, ny in _NORMALS
    ]
    return centre + np.concatenate(points), np.repeat(np.array(_NORMALS, dtype=np.float64), _ALONG, axis=0)


def _gradients(values: Array) -> Array:
    """Return absolute slopes of profiles (N, K), grey values per mm, smoothed."""
    sigma = _SMOOTH_MM / _STEP_MM
    smooth = cv2.GaussianBlur(np.ascontiguousarray(values), (0, 0), sigmaX=sigma, sigmaY=1e-6)
    return np.abs(np.gradient(np.asarray(smooth, dtype=np.float64), _STEP_MM, axis=1))


def _of_rectangle(values: Array, walls_mm: Sequence[float]) -> Array | None:
    """Return shift and standard deviation, (2, 2) mm with one row per axis.

    ``values`` (4 * _ALONG, K) are the profiles of the four sides; the walls ``walls_mm`` are visible across them.
    """
    right, left, up, down = (side.mean(axis=0) for side in np.split(values, 4))
    across, along = _common((right, left), walls_mm[:2]), _common((up, down), walls_mm[2:])
    return None if across is None or along is None else np.array([across, along])


def _common(profiles: tuple[Array, Array], walls_mm: Sequence[float]) -> tuple[float, float] | None:
    """Return the shift in mm at which both ends of a figure look like steps at its edges, and its standard deviation.

    Both profiles run outward. The levels between the edges are free parameters; the edges are those of the top, of its
    bevel, and of a visible wall. Bevel and shift are unknown, so each pair of them is weighted by how well it explains
    the image. If two pairs explain it about equally well, the result lies between them and is as uncertain as they
    differ.
    """
    if min(float(np.ptp(profile)) for profile in profiles) < _LEAST_STEP:
        return None
    middle, reach = len(profiles[0]) // 2, round(REACH_MM / _STEP_MM)
    shifts = np.arange(-reach, reach + 1)
    scores = np.zeros((len(_BEVELS_MM), len(shifts)))
    for score, bevel in zip(scores, _BEVELS_MM):
        for profile, wall, sign in zip(profiles, walls_mm, (1, -1)):
            window, basis, inverse = _model(round(wall / _STEP_MM), bevel)
            seen = profile[middle + window[None, :] + sign * shifts[:, None]]
            rest = seen - (seen @ inverse.T) @ basis.T
            left, whole = (rest**2).mean(axis=1), seen.var(axis=1)
            # Levels alone also fit a flat part of the image well, so only the variance that the steps explain counts.
            score += np.log((whole - left + _NOISE) / (left + _NOISE))
    weights = np.exp(_INDEPENDENT / 2 * (scores - scores.max())).sum(axis=0)
    weights /= weights.sum()
    if int(np.argmax(weights)) in (0, len(weights) - 1):
        return None  # the figure is farther away, or not visible
    mean = float(weights @ shifts)
    return _STEP_MM * mean, _STEP_MM * float(np.sqrt(weights @ (shifts - mean) ** 2))


@lru_cache(256)
def _model(wall_steps: int, bevel_mm: float) -> tuple[npt.NDArray[np.intp], Array, Array]:
    """Return the samples (K,) of a window, each level's share in them (K, L), and the pseudo-inverse of the shares."""
    window = np.arange(round(-_INSIDE_MM / _STEP_MM), wall_steps + round(_OUTSIDE_MM / _STEP_MM) + 1)
    edges = [0.0, *([-bevel_mm] if bevel_mm else []), *([wall_steps * _STEP_MM] if wall_steps > 1 else [])]
    basis = np.column_stack([np.ones(len(window)), *(_step((window * _STEP_MM - edge) / _BLUR_MM) for edge in edges)])
    return window, basis, np.asarray(np.linalg.pinv(basis))


def _step(at: npt.NDArray[Any]) -> Array:
    """Return a blurred step; the logistic function differs from the normal distribution's by less than 0.01."""
    return np.asarray(1.0 / (1.0 + np.exp(-1.702 * np.clip(at, -30.0, 30.0))))


def _of_circle(values: Array, outward: Array) -> Array | None:
    slopes = _gradients(values)
    slopes = np.minimum(slopes, np.quantile(slopes, 0.95))
    middle, at, spokes = slopes.shape[1] // 2, np.zeros(2), np.arange(len(slopes))

    roots = np.sqrt(slopes)

    def scores(shifts: Array) -> Array:
        """Return (N,) scores of shifts (N, 2) mm."""
        index = np.clip(np.rint(middle + shifts @ outward.T / _STEP_MM).astype(int), 0, slopes.shape[1] - 1)
        return np.asarray(roots[spokes, index].mean(axis=1))

    for step in (0.3, 0.1, _STEP_MM):
        rows, columns = np.mgrid[-5:6, -5:6]
        tried = at + step * np.column_stack([columns.ravel(), rows.ravel()])
        at = tried[int(np.argmax(scores(tried)))]
    if np.abs(at).max() >= REACH_MM or scores(at[None])[0] ** 2 < _LEAST_GRADIENT:
        return None
    return at
