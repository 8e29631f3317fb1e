"""Fits a shaded, blurred disc jointly to luma and chroma around a ball, for colour of lower resolution than the image.

MJPEG with 4:2:0 stores a ball of 10 px as 5 colour samples and quantises their fine detail away: chroma alone is 0.7 px
off. Luma keeps every pixel. Both show the same disc with the same shading, each with its own blur and background. The
fit is Gauss-Newton over centre, radius, blurs and brightness; Tukey's weights suppress what is not the ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.colour.blurred_disc import profile_tables
from harris_perception.colour.disc_kernels import BACKGROUND, SHADING, disc_equations, weighted_sums
from harris_perception.core.image.medians import median

Array = npt.NDArray[Any]

_TURNS = 10
_SETTLED_PX = 1e-2
_SCALE_TURNS = 4
"""Number of iterations in which the noise's scale is updated; without a limit the fit does not converge."""
RADIUS_SHARE = 0.01
"""Standard deviation of the expected radius, as a share."""
_TUKEY = 4.685


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Channel:
    """One channel's pixels around the ball.

    Attributes
    ----------
    values
        (N,) values of the pixels, grey levels.
    around
        (N,) values of the background behind the ball, grey levels.
    use
        (N,) pixels to use.
    blur_px, blur_sigma_px
        Expected blur and its standard deviation.
    noise
        Minimum standard deviation of a pixel, grey levels.
    """

    values: Array
    around: Array
    use: npt.NDArray[np.bool_]
    blur_px: float
    blur_sigma_px: float
    noise: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SoftFit:
    """A fitted disc.

    Attributes
    ----------
    centre
        (2,) px.
    radius
        In px.
    errors
        Rms misfit of each channel, as a share of the ball's brightness in it.
    counted
        Share of the pixels that have weight in the fit, for each channel.
    """

    centre: Array
    radius: float
    errors: tuple[float, ...]
    counted: tuple[float, ...]


def fit_soft(
    at: Array, channels: Sequence[Channel], centre: Array, radius: float, radius_share: float = RADIUS_SHARE
) -> SoftFit:
    """Fit one disc to the channels; the first must have the best-known brightness.

    Parameters
    ----------
    at
        (N, 2) pixels in the plane that touches the viewing sphere near the ball, px.
    channels
        Values of these pixels.
    centre
        (2,) first guess, px; within one pixel is enough.
    radius
        The expected radius, px.
    radius_share
        Standard deviation of the expected radius, as a share.
    """
    disc = np.array([*centre, radius])
    count = len(channels)
    blurs = np.array([c.blur_px for c in channels])
    # Parameters: constant, two tilts and dome of the first channel; one gain for each other channel; each channel's
    # background.
    shape, gains, rests = np.zeros(4), np.ones(count), np.zeros(count)
    levels = np.array([_level(c, at, disc) for c in channels])
    noises = np.ones(count)
    errors: list[Array] = [np.zeros(0)] * count
    weights: list[Array] = [np.zeros(0)] * count
    size = 3 + count + 4 + count + count
    # Each channel's unknowns; the gain of the first channel is 1.
    columns = [[0, 1, 2, 3 + i, *range(3 + count, 7 + count), 7 + count + i] for i in range(count)]
    for i in range(1, count):
        columns[i].append(7 + 2 * count + i)
    blocks = [np.ix_(own, own) for own in columns]
    pixels = [(np.ascontiguousarray(at[c.use]), c.values[c.use], c.around[c.use]) for c in channels]
    for turn in range(_TURNS):
        normal, known = np.zeros((size, size)), np.zeros(size)
        _expect(normal, known, 2, radius - disc[2], radius_share * radius)
        for i, c in enumerate(channels):
            used, value, around = pixels[i]
            tables = profile_tables(blurs[i] / disc[2])
            if turn == 0:
                start, _ = disc_equations(used, value, around, *tables, disc, blurs[i], shape, 1.0, 0.0)
                terms, outside = start[:, SHADING:BACKGROUND], start[:, BACKGROUND]
                basis = np.column_stack([terms, outside])
                first = np.linalg.lstsq(basis, value - around * outside, rcond=1e-3)[0]
                if i == 0:
                    shape, rests[0] = np.array(first[:4]), first[4]
                else:
                    gains[i] = float(terms @ first[:4] @ (terms @ shape)) / max(
                        float(np.sum((terms @ shape) ** 2)), 1.0
                    )
            joint, errors[i] = disc_equations(
                used, value, around, *tables, disc, blurs[i], shape, float(gains[i]), float(rests[i])
            )
            if turn < _SCALE_TURNS:
                noises[i] = max(1.48 * median(np.abs(errors[i])), c.noise)
            part, right_side, weights[i] = weighted_sums(joint, errors[i], _TUKEY * noises[i], noises[i])
            fitted = len(columns[i])
            normal[blocks[i]] += part[:fitted, :fitted]
            known[columns[i]] += right_side[:fitted]
            _expect(normal, known, 3 + i, c.blur_px - blurs[i], c.blur_sigma_px)
            _expect(normal, known, 7 + count + i, -rests[i], 1e3 * levels[i])
        # Shading cannot be stronger than the ball's brightness.
        for k in range(1, 4):
            _expect(normal, known, 3 + count + k, -shape[k], levels[0])
        normal[np.diag_indices(size)] += 1e-9
        change = np.linalg.solve(normal, known)
        disc = disc + np.clip(change[:3], -0.5, 0.5)
        blurs = np.clip(blurs + np.clip(change[3 : 3 + count], -0.3, 0.3), 0.12 * radius, 0.7 * radius)
        shape = shape + change[3 + count : 7 + count]
        rests = rests + change[7 + count : 7 + 2 * count]
        gains = gains + change[7 + 2 * count :]
        if turn >= _SCALE_TURNS and np.abs(change[:3]).max() < _SETTLED_PX:
            break
    shares = tuple(float(np.sqrt(np.mean(e**2)) / level) for e, level in zip(errors, levels))
    counted = tuple(float((w > 0.2).mean()) for w in weights)
    return SoftFit(centre=disc[:2], radius=float(disc[2]), errors=shares, counted=counted)


def _level(channel: Channel, at: Array, disc: Array) -> float:
    """Return the ball's own brightness in a channel, at least one grey level."""
    inner = channel.use & (np.hypot(*(at - disc[:2]).T) < 0.7 * disc[2])
    return max(abs(float(np.median(channel.values[inner]))) if inner.any() else 1.0, 1.0)


def _expect(normal: Array, known: Array, index: int, missing: float, sigma: float) -> None:
    """Add the observation that the unknown ``index`` differs from its expected value by ``missing``."""
    normal[index, index] += 1 / sigma**2
    known[index] += missing / sigma**2


def warm() -> None:
    """Compile the code that a fit needs, or load it from the cache, so that the first image is not late."""
    at = np.stack(np.meshgrid(np.arange(-5.0, 6.0), np.arange(-5.0, 6.0)), axis=-1).reshape(-1, 2)
    inside = np.hypot(*at.T) < 3.0
    channel = Channel(
        values=100.0 * inside,
        around=np.zeros(len(at)),
        use=np.hypot(*at.T) < 5.0,
        blur_px=0.6,
        blur_sigma_px=0.15,
        noise=6.0,
    )
    fit_soft(at, [channel, channel], np.zeros(2), 3.0)
