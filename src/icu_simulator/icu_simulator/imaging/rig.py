"""The true cameras at a moment: error of the calibration, then later changes by warming and knocks."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from icu_common.core.geometry.geometry import Transform
from icu_simulator.core.optics import Camera, StereoRig, stereo_rig, turn
from icu_simulator.imaging.board import true_cameras
from icu_simulator.imaging.configuration import ImagingConfig, WarmingConfig

if TYPE_CHECKING:
    from icu_simulator.core.configuration import BenchConfig

SIDES = ("left", "right")
STEP_PX = 0.02
"""Maximum step in px of a warming camera's ramp: each step redraws the static scene."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraShift:
    """Change of a camera: rotation about its own axes (degrees), lens shift (px), focal length."""

    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lens_px: tuple[float, float] = (0.0, 0.0)
    focal_ppm: float = 0.0

    def __add__(self, other: CameraShift) -> CameraShift:
        """Return both shifts in sequence; the rotations are small enough to be added."""
        x, y, z = (a + b for a, b in zip(self.turn_deg, other.turn_deg))
        u, v = (a + b for a, b in zip(self.lens_px, other.lens_px))
        return CameraShift(turn_deg=(x, y, z), lens_px=(u, v), focal_ppm=self.focal_ppm + other.focal_ppm)

    def of(self, camera: Camera) -> Camera:
        """Return the camera after the shift."""
        if self == CameraShift():
            return camera
        x, y, z = self.turn_deg
        # The camera rotates by this angle, so its view rotates by the inverse.
        back = (turn(2, z) @ turn(1, y) @ turn(0, x)).T
        return dataclasses.replace(
            camera,
            focal_px=camera.focal_px * (1 + 1e-6 * self.focal_ppm),
            centre_px=(camera.centre_px[0] + self.lens_px[0], camera.centre_px[1] + self.lens_px[1]),
            camera_from_base=Transform(back, np.zeros(3)) @ camera.camera_from_base,
        )


Shifts = tuple[CameraShift, CameraShift]
NO_SHIFTS: Shifts = (CameraShift(), CameraShift())


def true_rig(config: BenchConfig, shifts: Shifts = NO_SHIFTS) -> StereoRig:
    """Return the true cameras; the rectification is that of the calibration files, which the robot uses."""
    rig = stereo_rig(config.camera)
    left, right = rig.left, rig.right
    imaging = config.imaging
    if imaging.calibration.enabled or imaging.lens.enabled:
        found = true_cameras(config.camera, imaging.calibration, imaging.lens, config.seed)
        left, right = found.left, found.right
    return dataclasses.replace(rig, left=shifts[0].of(left), right=shifts[1].of(right))


def _warmed(config: WarmingConfig, seed: int, focal_px: float, width: int, share: float) -> Shifts:
    rng = np.random.default_rng((seed, 643))
    result = []
    full_px = math.radians(config.turn_deg) * focal_px + 1e-6 * abs(config.focal_ppm) * width / 2
    steps = max(math.ceil(full_px / STEP_PX), 1)
    done = math.floor(share * steps) / steps
    for _ in SIDES:
        direction = rng.standard_normal(3)
        x, y, z = (config.turn_deg * done * direction / np.linalg.norm(direction)).tolist()
        result.append(CameraShift(turn_deg=(x, y, z), focal_ppm=config.focal_ppm * done))
    return result[0], result[1]


class Drift:
    """Follows warming and knocks; times are seconds of one clock.

    Parameters
    ----------
    seed
        Seed of the directions in which warming cameras rotate.
    focal_px, width
        Focal length and width of the cameras, for the size of a step.
    """

    def __init__(self, seed: int, focal_px: float, width: int) -> None:
        self._seed, self._focal_px, self._width = seed, focal_px, width
        self._knocked: dict[str, CameraShift] = {}
        self._begun: dict[str, tuple[object, float]] = {}

    def knock(self, camera: str, shift: CameraShift) -> None:
        """Apply a knock to a camera now; knocks add up."""
        if camera not in SIDES:
            raise ValueError(f"camera {camera!r}: expected one of {', '.join(SIDES)}")
        self._knocked[camera] = self._knocked.get(camera, CameraShift()) + shift

    def at(self, imaging: ImagingConfig, now_s: float) -> Shifts:
        """Return both cameras' shifts; an effect begins at the first call with its present setting."""
        shifts = [self._knocked.get(side, CameraShift()) for side in SIDES]
        if (since := self._since("warming", imaging.warming, now_s)) is not None:
            share = min(since / imaging.warming.ramp_s, 1.0)
            warm = _warmed(imaging.warming, self._seed, self._focal_px, self._width, share)
            shifts = [a + b for a, b in zip(shifts, warm)]
        knock = imaging.knock
        if (since := self._since("knock", knock, now_s)) is not None and since >= knock.after_s:
            x, y, z = knock.turn_deg
            index = SIDES.index(knock.camera)
            hit = CameraShift(turn_deg=(x, y, z), lens_px=(knock.lens_px[0], knock.lens_px[1]))
            shifts[index] = shifts[index] + hit
        return shifts[0], shifts[1]

    def _since(self, name: str, effect: WarmingConfig | object, now_s: float) -> float | None:
        if not getattr(effect, "enabled", False):
            self._begun.pop(name, None)
            return None
        setting, begin_s = self._begun.get(name, (None, now_s))
        if setting != effect:
            begin_s = now_s
        self._begun[name] = effect, begin_s
        # A free-running camera may expose before the one that is drawn first.
        return max(now_s - begin_s, 0.0)
