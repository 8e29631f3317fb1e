"""Areas of the panel's face where an image shows the template's print: a correlation patch by patch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.pose.planar_pose import inverse, map_points
from harris_perception.core.recognition.panel_template import PanelTemplate
from icu_common.core.geometry.geometry import Array

# Share of agreeing patches that counts as most of a neighbourhood. Number of agreeing neighbours, less a rounding
# error, that makes a patch adjacent to them. Minimum share of the print's variance for print.
_MOST = 0.6
_BESIDE = 1.5
_PRINT = 0.25


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Patches:
    """The face's textured patches that no control hides.

    Attributes
    ----------
    centres_mm
        (N, 2) mm.
    agreeing
        (N,) patches similar to the template.
    likeness
        Mean correlation of the agreeing patches, 0 without one.
    purity
        Share of agreeing patches in neighbourhoods of which most agree. Partly hidden print agrees nearly everywhere
        that is visible; with a wrong pose, patches agree here and there.
    contradiction
        Share of patches with other print than the template's, which a hand does not show.
    intrusion
        The same among patches next to two or more agreeing ones: print of another panel continues there, while an
        object on the panel hides it.
    side_mm
        Side of each patch.
    """

    centres_mm: Array
    agreeing: npt.NDArray[np.bool_]
    likeness: float = 0.0
    purity: float = 0.0
    contradiction: float = 0.0
    intrusion: float = 0.0
    side_mm: float = 0.0

    @property
    def count(self) -> int:
        """Number of agreeing patches."""
        return int(self.agreeing.sum())

    @property
    def agreement(self) -> float:
        """Share of agreeing patches; 0 if there are too few patches."""
        return float(self.agreeing.mean()) if len(self.agreeing) >= 8 else 0.0


class PatchGrid:
    """Patches of a face that are partly visible, and values that do not depend on the compared image.

    Parameters
    ----------
    visible
        (H, W) where steady print is visible.
    side
        Side of a patch, px.
    """

    def __init__(self, visible: npt.NDArray[np.bool_], side: int) -> None:
        self.side = side
        self._rows, self._columns = visible.shape[0] // side, visible.shape[1] // side
        across = np.linspace(-1.0, 1.0, side, dtype=np.float32)
        plane = np.stack([np.ones((side, side), np.float32), *np.meshgrid(across, across)], axis=-1).reshape(-1, 3)
        self._plane = plane
        self.weight = w = self._patches(visible.astype(np.float32))
        self.count = w.sum(axis=2, dtype=np.float64)
        moments = (w @ (plane[:, :, None] * plane[:, None]).reshape(-1, 9)).reshape(*w.shape[:2], 3, 3)
        self._moments = moments.astype(np.float64) + 1e-3 * np.eye(3)
        self._full = np.maximum(self.count, 1.0)

    def cut(self, picture: npt.NDArray[np.uint8]) -> Any:
        """Return (rows, columns, side * side) of an image (H, W), minus a fitted plane in each patch.

        The plane removes lighting: the edge of a shadow is no other print.
        """
        values = self._patches(cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32))
        pull = ((self.weight * values) @ self._plane)[..., None].astype(np.float64)
        fit = np.linalg.solve(self._moments, pull)[..., 0]
        return values - fit.astype(np.float32) @ self._plane.T

    def mean(self, values: Any) -> Any:
        """Return the mean of the visible part of each patch, (rows, columns)."""
        return (self.weight * values).sum(axis=2, dtype=np.float64) / self._full

    def _patches(self, values: Any) -> Any:
        """(rows, columns, side * side)."""
        rows, columns, side = self._rows, self._columns, self.side
        cut = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
        return cut.transpose(0, 2, 1, 3).reshape(rows, columns, side * side)


class PrintPatches:
    """A template's print in the patches of a grid.

    Parameters
    ----------
    template
        Its ``gray`` is (H, W).
    grid
        The visible patches.
    """

    def __init__(self, template: PanelTemplate, grid: PatchGrid) -> None:
        self.template, self.grid = template, grid
        self.values = grid.cut(template.gray)
        self.variance = grid.mean(self.values * self.values)


def patch_side(template: PanelTemplate, patch_mm: float) -> int:
    """Return the side in px of a patch of ``patch_mm``."""
    return max(5, round(patch_mm * template.px_per_mm))


def compared(printed: PrintPatches, seen_values: Any, patch_correlation: float) -> Patches:
    """Compare an image with the template, patch by patch.

    Parameters
    ----------
    printed
        The template's patches.
    seen_values
        Image warped to the template's view of the face, cut by the same grid.
    patch_correlation
        Minimum normalised correlation of an agreeing patch.
    """
    template, grid, side = printed.template, printed.grid, printed.grid.side
    count, var_a = grid.count, printed.variance
    var_b, both = grid.mean(seen_values * seen_values), grid.mean(printed.values * seen_values)
    correlation = both / np.sqrt(var_a * var_b + 1e-6)
    textured = (count > 0.3 * side * side) & (var_a > 36.0)
    agreeing = textured & (correlation > patch_correlation)
    around: Any = {"ddepth": -1, "ksize": (3, 3), "normalize": False, "borderType": cv2.BORDER_CONSTANT}
    there, agreed = (cv2.boxFilter(values.astype(np.float64), **around) for values in (textured, agreeing))
    seen = textured & (agreed > _MOST * there)
    row, column = np.nonzero(textured)
    centres = (np.column_stack([column, row]) + 0.5) * side - 0.5
    gain = float(np.median(var_b[agreeing] / var_a[agreeing])) if agreeing.any() else 1.0
    contradicting = textured & ~agreeing & (var_b > _PRINT * gain * var_a)
    beside = textured & (agreed > _BESIDE)
    return Patches(
        centres_mm=map_points(inverse(template.px_from_mm), centres),
        agreeing=agreeing[textured],
        likeness=float(correlation[agreeing].mean()) if agreeing.any() else 0.0,
        purity=float(agreeing[seen].mean()) if seen.any() else 0.0,
        contradiction=float(contradicting.sum() / max(int(textured.sum()), 1)),
        intrusion=float(contradicting[beside].mean()) if beside.any() else 0.0,
        side_mm=side / template.px_per_mm,
    )
