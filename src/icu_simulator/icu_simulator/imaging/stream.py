"""The images that the cameras deliver over time: exposed, lost, repeated, stamped."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from icu_simulator.imaging.motion import ShutterTimes
from icu_simulator.imaging.sensor import Picture
from icu_simulator.imaging.timing import Shot, shots

if TYPE_CHECKING:
    from icu_simulator.core.bench import Bench
    from icu_simulator.core.configuration import BenchConfig
    from icu_simulator.core.renderer import Renderer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraImage:
    """An image as delivered by its camera; the stamp is in seconds of the bench's clock."""

    camera: int
    stamp_s: float
    picture: Picture


class CameraStream:
    """Delivers the cameras' images; the last one of each is kept, for a camera that repeats it."""

    def __init__(self) -> None:
        self._last: dict[int, Picture] = {}

    def take(self, config: BenchConfig, bench: Bench, renderer: Renderer, now_s: float) -> Iterator[CameraImage]:
        """Yield the images that arrive at ``now_s``, none or one of each camera, each as soon as it is drawn."""
        return self.render(shots(config, now_s), config, bench, renderer)

    def render(
        self, due: Sequence[Shot], config: BenchConfig, bench: Bench, renderer: Renderer
    ) -> Iterator[CameraImage]:
        """Yield the images of shots that :func:`icu_simulator.imaging.timing.shots` has returned."""
        half_s = ShutterTimes.of(config.imaging).half_s(config.camera.height_px)
        repeated = [s for s in due if s.repeated and s.camera in self._last]
        fresh = {s.camera: s for s in due if s not in repeated}
        for shot in repeated:
            yield self._image(shot)
        moments = {camera: bench.moment(shot.exposure_s, half_s) for camera, shot in fresh.items()}
        for camera, picture in renderer.render_each(moments):
            self._last[camera] = picture
            yield self._image(fresh[camera])

    def _image(self, shot: Shot) -> CameraImage:
        return CameraImage(camera=shot.camera, stamp_s=shot.stamp_s, picture=self._last[shot.camera])
