"""The images that the cameras deliver over time: exposed, lost, repeated, stamped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from icu_simulator.imaging.motion import ShutterTimes
from icu_simulator.imaging.sensor import Picture
from icu_simulator.imaging.timing import Shot, shots

if TYPE_CHECKING:
    from icu_simulator.core.bench import Bench
    from icu_simulator.core.configuration import BenchConfig
    from icu_simulator.core.renderer import Moment, Renderer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraImage:
    """An image as delivered by its camera; the stamp is in seconds of the bench's clock."""

    camera: int
    stamp_s: float
    picture: Picture


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """One exposure: its shots, and the moment of each camera that takes a new image."""

    shots: tuple[Shot, ...]
    moments: dict[int, Moment]


class CameraStream:
    """Delivers the cameras' images; the last one of each is kept, for a camera that repeats it."""

    def __init__(self) -> None:
        self._last: dict[int, Picture] = {}

    def take(self, config: BenchConfig, bench: Bench, renderer: Renderer, now_s: float) -> list[CameraImage]:
        """Return the images that are exposed at ``now_s``, none or one of each camera."""
        return self.render(self.expose(shots(config, now_s), config, bench), renderer)

    def expose(self, due: Sequence[Shot], config: BenchConfig, bench: Bench) -> Exposure:
        """Return what the cameras see in shots that :func:`icu_simulator.imaging.timing.shots` has returned."""
        half_s = ShutterTimes.of(config.imaging).half_s(config.camera.height_px)
        fresh = [s for s in due if not (s.repeated and s.camera in self._last)]
        moments = {shot.camera: bench.moment(shot.exposure_s, half_s) for shot in fresh}
        return Exposure(shots=tuple(due), moments=moments)

    def render(self, exposure: Exposure, renderer: Renderer) -> list[CameraImage]:
        """Return the images of an exposure; the scene of each is fixed, so it may be drawn later."""
        if exposure.moments:
            self._last.update(renderer.render_each(exposure.moments))
        return [CameraImage(camera=s.camera, stamp_s=s.stamp_s, picture=self._last[s.camera]) for s in exposure.shots]
