"""Rectified pairs with exactly known disparity: photographs on slanted surfaces, one in front of another.

Every surface is drawn into both images by its own plane of disparities, the nearest one last. Drawing is at twice the
resolution, so that edges blend with the background as through a lens. Then each image gets its own blur, light and
noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.evaluation.stereo_evaluation import StereoScene

_WIDTH, _HEIGHT = 720, 540
_FINE = 2
_SURFACES = 14
_PHOTOGRAPHS = {"planar/graf3.png": 0.0, "planar/leuvenA.jpg": 0.45, "object/box_in_scene.png": 0.0}
"""Photographs, each with the share omitted at its top: the disparity of an untextured overcast sky is unknowable."""
Gray = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Surface:
    """A box or an ellipse with half size ``reach`` (px of the left image) and disparity a x + b y + c."""

    photograph: Gray
    plane: tuple[float, float, float]
    centre: tuple[float, float]
    reach: tuple[float, float]
    turn: float
    is_round: bool
    zoom: float
    corner: tuple[float, float]

    def disparity(self, x: Gray, y: Gray) -> Gray:
        a, b, c = self.plane
        return np.asarray(a * x + b * y + c, np.float32)

    def left_of(self, x: Gray, y: Gray) -> Gray:
        """Return the left image's x of the point at x in the right image: x + d, where d is linear."""
        a, b, c = self.plane
        return np.asarray((x + b * y + c) / (1 - a), np.float32)

    def covers(self, x: Gray, y: Gray) -> npt.NDArray[np.bool_]:
        u, v, cosine, sine = x - self.centre[0], y - self.centre[1], np.cos(self.turn), np.sin(self.turn)
        p, q = (u * cosine + v * sine) / self.reach[0], (v * cosine - u * sine) / self.reach[1]
        return np.asarray(np.hypot(p, q) < 1 if self.is_round else np.maximum(np.abs(p), np.abs(q)) < 1)

    def shows(self, x: Gray, y: Gray) -> Gray:
        """Return grey values; the photograph is mirrored beyond its edges."""
        at = [self.zoom * (value + start) for value, start in zip((x, y), self.corner)]
        seen = cv2.remap(self.photograph, at[0], at[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return np.asarray(seen, np.float32)


def drawn_scene(data: Path, seed: int) -> StereoScene:
    """Draw one pair from the photographs in the data folder."""
    rng = np.random.default_rng((seed, 4))
    photographs = [_photograph(data / name, part) for name, part in _PHOTOGRAPHS.items()]
    surfaces = [_drawn_surface(rng, photographs, None)]
    surfaces += [_drawn_surface(rng, photographs, nearness) for nearness in np.sort(rng.uniform(14, 60, _SURFACES))]
    rows, columns = np.mgrid[0 : _HEIGHT * _FINE, 0 : _WIDTH * _FINE].astype(np.float32)
    x, y = (columns + 0.5) / _FINE - 0.5, (rows + 0.5) / _FINE - 0.5
    coarse_y, coarse_x = np.mgrid[0:_HEIGHT, 0:_WIDTH].astype(np.float32)
    truth = np.zeros((_HEIGHT, _WIDTH), np.float32)
    fine = [np.zeros(x.shape, np.float32) for _ in range(2)]
    for surface in surfaces:
        for picture, across in zip(fine, (x, surface.left_of(x, y))):
            seen = surface.covers(across, y)
            picture[seen] = surface.shows(across, y)[seen]
        here = surface.covers(coarse_x, coarse_y)
        truth[here] = surface.disparity(coarse_x, coarse_y)[here]
    left, right = (_taken(picture, rng) for picture in fine)
    return StereoScene(name=f"drawn {seed}", left=left, right=right, truth=truth)


def _photograph(path: Path, sky: float) -> Gray:
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if gray is None:
        raise FileNotFoundError(f"{path} cannot be read")
    return np.ascontiguousarray(gray[round(sky * len(gray)) :], np.float32)


def _drawn_surface(rng: np.random.Generator, photographs: list[Gray], nearness: float | None) -> _Surface:
    """Return a random surface with this disparity at its centre, or the wall behind all surfaces."""
    slope = rng.uniform(-0.06, 0.06, 2) if nearness is not None else rng.uniform(-0.015, 0.015, 2)
    centre = rng.uniform((45, 0), (_WIDTH, _HEIGHT)) if nearness is not None else np.array([_WIDTH, _HEIGHT]) / 2
    reach = rng.uniform(38, 128, 2) if nearness is not None else np.array([4.0 * _WIDTH, 4.0 * _HEIGHT])
    return _Surface(
        photograph=photographs[rng.integers(len(photographs))],
        plane=(*slope, (10.0 if nearness is None else nearness) - float(slope @ centre)),
        centre=(float(centre[0]), float(centre[1])),
        reach=(float(reach[0]), float(reach[1])),
        turn=rng.uniform(0, np.pi),
        is_round=nearness is not None and rng.random() < 0.4,
        zoom=rng.uniform(0.8, 1.6),
        corner=(rng.uniform(0, 100), rng.uniform(0, 100)),
    )


def _taken(fine: Gray, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return the image of a camera with its own focus, light and noise."""
    small = cv2.resize(fine, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_AREA)
    blurred = cv2.GaussianBlur(small, (0, 0), rng.uniform(0.4, 0.7))
    lit = rng.uniform(0.94, 1.06) * blurred + rng.uniform(-5, 5) + rng.normal(0, 2.0, small.shape)
    return np.clip(np.rint(lit), 0, 255).astype(np.uint8)
