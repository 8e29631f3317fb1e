"""Measures the ball in a crop of an image whose colour has a lower resolution than the image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.colour.soft_fit import Channel, SoftFit, fit_soft
from harris_perception.core.stylus.ball_view import Doubt, filled, mixed_chroma_of

Array = npt.NDArray[Any]
Picture = npt.NDArray[np.uint8]
Values = npt.NDArray[np.float32]

_FILLED_PX = (2.0, 1.75)
"""Distances beyond the outline to which the background is filled in, before and after the first fit."""
_CHROMA_FILLED_PX = 3.0
"""The same for the chroma if a coloured object is next to the ball."""
_LUMA_REACH_PX, _CHROMA_REACH_PX = 2.0, 4.0
"""Distances beyond the outline at which the ball is no longer visible in luma and chroma."""
_LUMA_BLUR_PX, _CHROMA_BLUR_PX = (0.6, 0.15), (1.3, 0.15)
"""Expected blur and its standard deviation: of the lens, and of colour sampled at every second pixel."""
_LUMA_NOISE, _CHROMA_NOISE = 6.0, 0.06
"""Standard deviations of a pixel's luma, in grey levels, and of its chroma, as a share of the ball's. The luma contains
deviations from Lambert's law, which shift the centre where one side of the ball is as dark as its background."""
_LUMA_NOISE_420, _CHROMA_NOISE_420 = 3.0, 0.25
"""The same if two rows share one colour: quantisation of the chroma is coarse, and neighbours have the same error."""
_LEAST_COUNTED = 0.6
"""Minimum share of the luma's pixels that a ball explains; 0.9 is usual."""
_LARGEST_ERROR = 2.0
"""Factor by which a ball's chroma may differ more from a shaded disc than in a sharp image."""
_FREE_RADIUS, _LARGEST_SIZE_ERROR = 0.3, 0.25
"""Standard deviation of the radius if the fit determines it, and its maximum error then, both as shares."""
_LARGEST_SHIFT_PX = 2.5


def measure_soft(
    colours: Picture, at: Array, first: Array, focus: Array, radius: float, max_error: float, *, rows_share: bool
) -> tuple[Array, SoftFit]:
    """Return the ball's centre (2,) in the touching plane, px, and the fit.

    Parameters
    ----------
    colours
        (h, w, 3) BGR around the ball.
    at
        (h * w, 2) pixels in the plane that touches the viewing sphere at ``first``, px.
    first
        (2,) pixel of ``colours`` in that direction.
    focus
        (2, 2) pixels of ``colours`` per pixel of the plane.
    radius
        The ball's expected radius, px.
    max_error
        Maximum rms misfit in a sharp image, as a share of the ball's chroma.
    rows_share
        Whether two rows share one colour, as in 4:2:0.

    Raises
    ------
    Doubt
        If it is not a shaded disc.
    """
    luma = np.asarray(cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY), np.float32)
    chroma = mixed_chroma_of(colours)
    border = np.concatenate([chroma[0], chroma[-1], chroma[:, 0], chroma[:, -1]])
    plain = np.full_like(chroma, float(np.median(border)))
    noises = (_LUMA_NOISE_420, _CHROMA_NOISE_420) if rows_share else (_LUMA_NOISE, _CHROMA_NOISE)
    centre, fit = _fitted(luma, chroma, plain, at, first, focus, radius, noises)
    if fit.errors[1] > _LARGEST_ERROR * max_error:
        # A coloured object is behind the ball or next to it.
        behind = filled(chroma, first + focus @ centre, radius + _CHROMA_FILLED_PX)
        centre, fit = _fitted(luma, chroma, behind, at, first, focus, radius, noises)
    if fit.errors[1] > _LARGEST_ERROR * max_error:
        raise Doubt(f"brightness is {fit.errors[1]:.2f} of the ball's off a shaded disc")
    if fit.counted[0] < _LEAST_COUNTED:
        raise Doubt(f"only {fit.counted[0]:.0%} of the brightness is a shaded disc's")
    return centre, fit


def _fitted(
    luma: Values,
    chroma: Values,
    around: Values,
    at: Array,
    first: Array,
    focus: Array,
    radius: float,
    noises: tuple[float, float],
) -> tuple[Array, SoftFit]:
    """Fit twice: the first fit improves the position of the area in which the background is filled in."""
    values = chroma.ravel().astype(np.float64)
    inside = np.hypot(*at.T) < 0.7 * radius
    noise = noises[1] * max(float(np.median(values[inside])) if inside.any() else 0.0, 10.0)
    centre = np.zeros(2)
    for beyond in _FILLED_PX:
        distance = np.hypot(*(at - centre).T)
        behind = filled(luma, first + focus @ centre, radius + beyond).ravel().astype(np.float64)
        channels = [
            Channel(
                values=luma.ravel().astype(np.float64),
                around=behind,
                use=distance < radius + _LUMA_REACH_PX,
                blur_px=_LUMA_BLUR_PX[0],
                blur_sigma_px=_LUMA_BLUR_PX[1],
                noise=noises[0],
            ),
            Channel(
                values=values,
                around=around.ravel().astype(np.float64),
                use=distance < radius + _CHROMA_REACH_PX,
                blur_px=_CHROMA_BLUR_PX[0],
                blur_sigma_px=_CHROMA_BLUR_PX[1],
                noise=noise,
            ),
        ]
        fit = fit_soft(at, channels, centre, radius)
        centre = fit.centre
        if not np.hypot(*centre) <= _LARGEST_SHIFT_PX:
            raise Doubt("outline and brightness disagree about the centre")
    grown = fit_soft(at, channels, centre, radius, _FREE_RADIUS).radius
    if abs(grown / radius - 1) > _LARGEST_SIZE_ERROR:
        raise Doubt(f"a radius of {grown:.1f} px does not fit the expected {radius:.1f} px")
    return centre, fit
