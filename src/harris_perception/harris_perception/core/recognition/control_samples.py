"""Samples of an image at points on the controls of a panel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.sampling import sampled
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import Control

Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ControlSamples:
    """Samples of one image at all points: colours (N, 3), whether outside the image, whether behind the stylus.

    ``coloured`` is true if the image has colours.
    """

    parts: dict[tuple[str, str], slice]
    colours: Array
    outside: npt.NDArray[np.bool_]
    covered: Array
    coloured: bool

    def __call__(self, control: Control, part: str) -> Array:
        """Return the colours of a control's part, (N, 3)."""
        return self.colours[self.parts[control.name, part]]

    def hidden(self, control: Control, part: str) -> npt.NDArray[np.bool_]:
        """Return which points of a control's part cannot be seen, (N,)."""
        where = self.parts[control.name, part]
        return np.asarray((self.covered[where] > 0) | self.outside[where])


def on_top(control: Control, grid: Array, height_mm: float | None = None) -> Array:
    """Return (N, 3) metres in panel_link of points (N, 2) on a control's top, in halves of its size."""
    half = np.array(control.size_mm) / 2
    xy = np.array(control.position_mm) + grid * half
    height = control.height_mm if height_mm is None else height_mm
    return np.asarray(np.column_stack([xy, np.full(len(xy), height)]) * 1e-3)


def square_grid(count: int, reach: float) -> Array:
    """Return (count * count, 2) points from -reach to reach in each direction."""
    share = np.linspace(-reach, reach, count)
    return np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)


def values_at(picture: Picture, pixels: Array) -> Array:
    """Return (N,) or (N, C) values of the image at pixels (N, 2), interpolated."""
    x, y = pixels.T
    return np.asarray(sampled(picture, x[None], y[None])[0], np.float64)


def is_inside(pixels: Array, camera: CameraModel) -> npt.NDArray[np.bool_]:
    """Return which pixels (N, 2) lie in the camera's image, (N,)."""
    return np.asarray(((pixels >= 0) & (pixels <= np.array(camera.size) - 1.0)).all(axis=1))
