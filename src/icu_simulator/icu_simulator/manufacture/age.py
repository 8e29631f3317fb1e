"""Wear of the print on a drawn face, and dust."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.panel.panel_layout import ArtworkLine, ArtworkText, PanelLayout
from icu_simulator.manufacture.configuration import AgeConfig

Picture = npt.NDArray[np.uint8]
_SPOT_MM = 1.6
"""Size in mm of a spot worn by fingers and cloths."""
_EDGE = 0.35
"""Softness of the edge of a worn spot, in standard deviations of the field."""
_DUST_MM = (0.08, 0.35)
"""Minimum and maximum radius of a speck in mm."""


def aged(
    layout: PanelLayout, config: AgeConfig, seed: int, per_mm: float, draw: Callable[[PanelLayout, float], Picture]
) -> Picture:
    """Return the face (height * per_mm, width * per_mm, 3) BGR after years of use.

    Parameters
    ----------
    layout
        The panel as manufactured.
    config
        Wear and dust.
    seed
        Seed of spots and specks.
    per_mm
        Texels per millimetre.
    draw
        Draws a layout's face.
    """
    rng = np.random.default_rng((seed, 2))
    face = draw(layout, per_mm)
    if config.wear > 0:
        # Letters and lines wear off; painted areas below them are thicker.
        bare = tuple(item for item in layout.artwork if not isinstance(item, (ArtworkText, ArtworkLine)))
        face = _worn(face, draw(dataclasses.replace(layout, artwork=bare), per_mm), config.wear, per_mm, rng)
    _dusty(face, config.dust_per_dm2, per_mm, rng)
    return face


def _worn(face: Picture, bare: Picture, share: float, per_mm: float, rng: np.random.Generator) -> Picture:
    """Return the face with ``bare`` in spots that cover ``share`` of it."""
    # The spots are far larger than a texel, so their field is drawn coarsely.
    step = max(round(_SPOT_MM * per_mm / 4), 1)
    rows, columns = (-(-side // step) for side in face.shape[:2])
    smooth = cv2.GaussianBlur(rng.standard_normal((rows, columns), dtype=np.float32), (0, 0), 2.0)
    field = np.asarray(smooth) / max(float(smooth.std()), 1e-9)
    limit = float(np.quantile(field, 1 - share))
    spots = np.clip((field - limit) / _EDGE + 0.5, 0, 1)
    mask = cv2.resize(spots, (face.shape[1], face.shape[0]), interpolation=cv2.INTER_CUBIC)[..., None]
    mixed: Picture = np.rint(face + (bare.astype(np.float32) - face) * np.clip(mask, 0, 1)).astype(np.uint8)
    return mixed


def _dusty(face: Picture, per_dm2: float, per_mm: float, rng: np.random.Generator) -> None:
    height, width = face.shape[0] / per_mm, face.shape[1] / per_mm
    for _ in range(rng.poisson(per_dm2 * width * height / 1e4)):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        radius, grey = rng.uniform(*_DUST_MM), rng.uniform(60, 235)
        reach = radius + 1 / per_mm
        c0, c1 = (int(np.clip(v * per_mm, 0, face.shape[1])) for v in (x - reach, x + reach))
        r0, r1 = (int(np.clip(v * per_mm, 0, face.shape[0])) for v in (y - reach, y + reach))
        rows, columns = np.mgrid[r0:r1, c0:c1]
        distance = np.hypot((columns + 0.5) / per_mm - x, (rows + 0.5) / per_mm - y)
        share = np.clip((radius - distance) * per_mm + 0.5, 0, 1)[..., None]
        patch = face[r0:r1, c0:c1]
        patch[:] = np.rint(patch + (grey - patch) * share).astype(np.uint8)
