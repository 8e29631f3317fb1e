"""The result of a search for the ball in a pair of images."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.geometry.geometry import Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Outline:
    """A circle fitted to the ball's visible outline in one image.

    Attributes
    ----------
    centre_px
        (2,) centre in rectified pixels.
    error
        Rms difference of the pixels from a shaded disc, as a share of the ball's chroma.
    arc_deg
        Angle of the circle that the outline used covers.
    """

    centre_px: Array
    error: float
    arc_deg: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Search:
    """The result of a search for the ball in one pair: the tip, or the reason why there is none.

    Attributes
    ----------
    tip
        (3,) centre of the ball in metres, left rectified frame; None if uncertain.
    reason
        Reason why there is no tip.
    left, right
        The fitted outlines of the tip.
    row_error_px
        Difference between the rows of both centres.
    row_limit_px
        Maximum difference for images of one instant.
    """

    tip: Array | None
    reason: str = ""
    left: Outline | None = None
    right: Outline | None = None
    row_error_px: float = 0.0
    row_limit_px: float = 0.0
