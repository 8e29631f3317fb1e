"""Fits a circle to a ball's outline, then a shaded disc to its pixels, in the plane that touches the viewing sphere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.medians import median
from harris_perception.core.stylus.ball_view import BallView, Doubt
from icu_common.core.geometry.geometry import Array

ARC_BINS = 36
"""Number of equal arcs of an outline, each of which is visible or hidden."""

_MISFIT = 0.04
"""Deviation of a real ball from Lambert's law, as a share of its chroma; a tighter scale makes the weights jump."""


@dataclass(frozen=True, slots=True, eq=False)
class OutlineCircle:
    """A circle fitted to an outline: direction of its centre (3,), radius in px, visible arcs."""

    ray: Array
    radius: float
    seen: npt.NDArray[np.bool_]

    @property
    def arc_deg(self) -> float:
        return 360.0 / ARC_BINS * int(self.seen.sum())


def touching_frame(centre: Array) -> Array:
    """Return the (3, 3) rotation plane_from_camera of the plane that touches the viewing sphere at a direction."""
    z = centre / np.linalg.norm(centre)
    # Cross products of the camera's y with z, and of z with x: np.cross takes twenty times as long for a single pair.
    x = np.array([z[2], 0.0, -z[0]])
    x /= np.linalg.norm(x)
    y = (z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0])
    return np.array([x, y, z])


def in_plane(rays: Array, frame: Array, focal: float) -> Array:
    """Return the intersections of (N, 3) directions with such a plane, (N, 2) px for a focal length in px."""
    turned = rays @ frame.T
    flat: Array = turned[:, :2] / turned[:, 2:] * focal
    return flat


def arc_bins(offset: Array) -> npt.NDArray[np.intp]:
    """Return the index of the equal arc of the circle in which each (N, 2) offset from its centre lies."""
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5
    return np.minimum((turn * ARC_BINS).astype(np.intp), ARC_BINS - 1)


def fit_circle(at: Array, outward: Array, radius: float) -> tuple[Array, Array]:
    """Fit a circle of about ``radius`` to the part of an outline that is circular.

    Every outline point with its normal proposes a centre; the proposal that most points agree with starts a
    least-squares fit with Tukey's weights. The radius is known to about 4 %, which adds one observation.

    Returns
    -------
    xyr, weight
        (3,) centre and radius in pixels, (N,) weights from 0 to 1.
    """
    proposed = at - radius * outward
    offset = at[None] - proposed[:, None]
    distance = np.linalg.norm(offset, axis=2)
    facing = np.einsum("ijk,jk->ij", offset, outward) > 0.7 * distance
    near = np.abs(distance - radius) < max(0.6, 0.1 * radius)
    xyr = np.append(proposed[int(np.argmax((near & facing).sum(axis=1)))], radius)
    weight = np.zeros(len(at))
    for _ in range(8):
        offset = at - xyr[:2]
        distance = np.maximum(np.hypot(*offset.T), 1e-9)
        error = distance - xyr[2]
        facing_now = np.einsum("ij,ij->i", offset, outward) > 0.6 * distance
        close = np.abs(error[facing_now & (np.abs(error) < 1.5)])
        scale = 4.685 * max(1.48 * median(close), 0.08) if len(close) else 1.0
        weight = np.where(facing_now, np.clip(1 - (error / scale) ** 2, 0, None) ** 2, 0.0)
        jacobian = np.column_stack([-offset / distance[:, None], -np.ones(len(at))])
        weighted = jacobian * weight[:, None]
        normal = weighted.T @ jacobian
        prior = (0.2 / (0.04 * radius)) ** 2  # outline points are accurate to about 0.2 px
        normal[2, 2] += prior
        right = -weighted.T @ error
        right[2] += prior * (radius - xyr[2])
        normal[np.diag_indices(3)] += 1e-9
        change = np.linalg.solve(normal, right)
        xyr = xyr + np.clip(change, -radius, radius)
        if np.abs(change).max() < 1e-2:
            break
    return xyr, weight


def fit_shaded(at: Array, view: BallView, radius: float, seen: npt.NDArray[np.bool_]) -> tuple[Array, float, float]:
    """Fit a shaded, blurred disc to the pixels around the visible part of the outline.

    The contour at half brightness lies too far inside where the ball is dark. In the model, the chroma of a pixel is
    therefore the ball's chroma times the share of the pixel that the ball covers, plus ``view.around`` for the rest.
    The ball's chroma varies linearly with the surface normal (Lambert). The share is a normal distribution's integral
    across the outline. The fit is Gauss-Newton over centre, radius, blur and brightness with Tukey's weights.

    Parameters
    ----------
    at
        (N, 2) the view's pixels in the plane touching at the first centre.
    view
        The chroma of these pixels.
    radius
        The expected radius in pixels.
    seen
        (36,) visible arcs of the outline.

    Returns
    -------
    centre, radius, error
        (2,) and float in pixels, and the rms difference as a share of the ball's chroma.
    """
    distance = np.hypot(*at.T)
    # At its ends the visible part is blurred with the object that hides the rest.
    clear = seen & np.roll(seen, 1) & np.roll(seen, -1)
    use = (distance < radius + 3.0) & (clear[arc_bins(at)] & (distance > radius - 2.5) | view.inner)
    # A thin stem hides few directions of the outline but many pixels inside the ball, plus a blur of one pixel around.
    hidden = at[~view.above & (distance < radius - 1.0)]
    at, chroma, around, inner = at[use], view.chroma[use], view.around[use], view.inner[use]
    shown = (np.linalg.norm(at[:, None] - hidden, axis=2) > 1.5).all(axis=1)
    state = np.array([0.0, 0.0, radius, 0.8])  # x, y, radius, blur
    expected = state.copy()
    trust = np.array([0.0, 0.0, 1 / (0.01 * radius), 1 / 0.3])  # prior weights of radius and blur
    # Shading cannot be stronger than the ball's chroma itself.
    level = max(median(chroma[inner]), 1.0) if inner.any() else 1.0
    still = np.array([1e-3, 1.0, 1.0, 1.0, 1e-3]) / level
    certainty, diagonal = np.concatenate([trust, still]) ** 2, np.diag_indices(9)
    brightness: Array = np.zeros(5)
    noise = 1.0
    for turn in range(7):
        offset = at - state[:2]
        distance = np.maximum(np.hypot(*offset.T), 1e-6)
        toward = offset / distance[:, None]
        sine = np.minimum(distance / state[2], 1.0)
        across = (state[2] - distance) / state[3]
        cover = 0.5 * (1 + _erf(across / np.sqrt(2)))
        shape = np.column_stack([np.ones(len(at)), toward * sine[:, None], np.sqrt(1 - sine**2)])
        basis = np.column_stack([shape * cover[:, None], 1 - cover])
        behind = around * (1 - cover)
        if turn == 0:
            brightness = np.asarray(np.linalg.lstsq(basis, chroma - behind, rcond=1e-3)[0])
        error = chroma - behind - basis @ brightness
        if turn < 3:  # a scale that always follows the fit prevents convergence
            noise = max(1.48 * median(np.abs(error)), _MISFIT * level)
        weight = np.clip(1 - (error / (4.685 * noise)) ** 2, 0, None) ** 2
        if not weight.any():
            raise Doubt("nothing of it is as bright as a shaded disc")
        step = (
            np.exp(-0.5 * across**2) / np.sqrt(2 * np.pi) / state[3] * (shape @ brightness[:4] - brightness[4] - around)
        )
        # The derivative includes the change of shading when the centre moves; without it the iteration converges
        # slowly.
        drift = np.where(distance < state[2], cover, 0.0)[:, None] / state[2]
        moved = drift * (brightness[3] * toward * (sine / np.maximum(shape[:, 3], 0.4))[:, None] - brightness[1:3])
        slope = np.column_stack([toward * step[:, None] + moved, step, -across * step])
        joint = np.column_stack([slope, basis])
        weighted = joint * weight[:, None]
        normal = weighted.T @ joint / noise**2
        known = weighted.T @ error / noise**2
        normal[diagonal] += certainty
        known += np.concatenate([trust**2 * (expected - state), -(still**2) * brightness])
        change = np.linalg.solve(normal, known)
        state, brightness = state + np.clip(change[:4], -0.5, 0.5), brightness + change[4:]
        state[3] = min(max(state[3], 0.3), 2.5)
        if np.abs(change[:3]).max() < 1e-2:
            break
    if np.hypot(*state[:2]) > 1.5:
        raise Doubt("outline and brightness disagree about the centre")
    # Unweighted: pixels that the fit rejected count against the ball, except those hidden by the stem.
    spread = float(np.sqrt(np.mean(error[shown] ** 2))) if shown.any() else np.inf
    return state[:2], float(state[2]), spread / level


def _erf(x: Array) -> Array:
    """Approximate the error function to 1.5e-7 (Abramowitz and Stegun 7.1.26)."""
    t = 1 / (1 + 0.3275911 * np.abs(x))
    series = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    value: Array = np.sign(x) * (1 - series * np.exp(-x * x))
    return value
