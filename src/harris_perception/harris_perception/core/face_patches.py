"""Where on the panel's face a picture shows the template's print: a correlation patch by patch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.panel_template import PanelTemplate
from harris_perception.core.planar_pose import inverse, map_points
from icu_common.core.geometry import Array

# Most patches of a place; so many of them, less a rounding error, that agree are beside it; the part of a print's
# variance from which on it is print.
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
        (N,) which look like the template.
    likeness
        Mean correlation of those, 0 without one.
    purity
        Where most patches of a place agree, the part that does: print that is partly hidden agrees nearly everywhere
        that it can be seen, a wrong pose here and there.
    contradiction
        The part that shows other print in the place of the template's, which a hand does not.
    intrusion
        The same of those beside which two or more agree: where the print goes on as another panel's, not only under
        what lies upon it.
    side_mm
        Of each patch.
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
        """How many agree."""
        return int(self.agreeing.sum())

    @property
    def agreement(self) -> float:
        """The part that agrees; 0 where there are too few to tell."""
        return float(self.agreeing.mean()) if len(self.agreeing) >= 8 else 0.0


def compared(
    template: PanelTemplate,
    visible: npt.NDArray[np.bool_],
    warped: npt.NDArray[np.uint8],
    patch_mm: float,
    patch_correlation: float,
) -> Patches:
    """Compare a picture with the template, patch by patch.

    Parameters
    ----------
    template
        Its ``gray`` is (H, W).
    visible
        (H, W) where steady print is not hidden.
    warped
        (H, W) uint8, the picture as the template shows the face.
    patch_mm
        Side of a patch.
    patch_correlation
        Normalised correlation from which on a patch agrees.
    """
    side = max(5, round(patch_mm * template.px_per_mm))
    a, b = (cv2.GaussianBlur(p, (0, 0), 1.0).astype(np.float32) for p in (template.gray, warped))
    weight = visible.astype(np.float32)
    rows, columns = a.shape[0] // side, a.shape[1] // side
    across = np.linspace(-1.0, 1.0, side, dtype=np.float32)
    plane = np.stack([np.ones((side, side), np.float32), *np.meshgrid(across, across)], axis=-1).reshape(-1, 3)

    def patches(values: Any) -> Any:
        """(rows, columns, side * side)."""
        cut = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
        return cut.transpose(0, 2, 1, 3).reshape(rows, columns, side * side)

    w, a, b = patches(weight), patches(a), patches(b)
    count = w.sum(axis=2, dtype=np.float64)
    moments = (w @ (plane[:, :, None] * plane[:, None]).reshape(-1, 9)).reshape(rows, columns, 3, 3).astype(np.float64)
    moments += 1e-3 * np.eye(3)

    def without_light(values: Any) -> Any:
        """What a plane over the patch does not explain: the edge of a shadow is no other print."""
        fit = np.linalg.solve(moments, ((w * values) @ plane)[..., None].astype(np.float64))[..., 0]
        return values - fit.astype(np.float32) @ plane.T

    a, b = without_light(a), without_light(b)
    full = np.maximum(count, 1.0)
    var_a, var_b, both = ((w * v).sum(axis=2, dtype=np.float64) / full for v in (a * a, b * b, a * b))
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
