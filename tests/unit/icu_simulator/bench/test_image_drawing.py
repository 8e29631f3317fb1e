"""Images are drawn in a thread; whoever changes the scene waits for it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any, cast

import numpy as np
import pytest

from icu_simulator.adapters.bench.image_drawing import ImageDrawing
from icu_simulator.core.renderer import Renderer
from icu_simulator.imaging.stream import CameraImage, CameraStream, Exposure

DEADLINE_S = 20.0
NOTHING = Exposure(shots=(), moments={})
RENDERER = cast(Renderer, None)


class SlowCameras:
    """Cameras whose images are drawn once the test allows it."""

    def __init__(self) -> None:
        self.allowed = threading.Event()
        self.begun = threading.Event()

    def render(self, exposure: Exposure, renderer: Any) -> list[CameraImage]:
        self.begun.set()
        if not self.allowed.wait(DEADLINE_S):
            raise TimeoutError
        if renderer is not RENDERER:
            raise ValueError("another renderer")
        return [CameraImage(camera=c, stamp_s=9.9 + 0.01 * c, picture=np.zeros((2, 2, 3), np.uint8)) for c in (0, 1)]


@pytest.fixture
def cameras() -> SlowCameras:
    return SlowCameras()


@pytest.fixture
def drawing(cameras: SlowCameras) -> Iterator[ImageDrawing]:
    made = ImageDrawing(cast(CameraStream, cameras))
    yield made
    cameras.allowed.set()
    made.close()


def test_images_are_drawn_while_the_caller_goes_on(cameras: SlowCameras, drawing: ImageDrawing) -> None:
    assert drawing.take() == ([], []), "nothing has been exposed"
    drawing.begin(NOTHING, RENDERER, 10.0, 5_000_000_000)
    assert cameras.begun.wait(DEADLINE_S)
    cameras.allowed.set()
    images, stamps = drawing.take()
    assert [image.camera for image in images] == [0, 1]
    assert stamps == [4_900_000_000, 4_910_000_000], "as far before the exposure's ROS time as before its bench time"
    assert drawing.take() == ([], []), "each image is sent once"


def test_a_change_of_the_scene_waits_for_the_images(cameras: SlowCameras, drawing: ImageDrawing) -> None:
    drawing.finish()  # nothing is being drawn
    drawing.begin(NOTHING, RENDERER, 10.0, 0)
    finished = threading.Event()

    def change() -> None:
        drawing.finish()
        finished.set()

    thread = threading.Thread(target=change)
    thread.start()
    assert cameras.begun.wait(DEADLINE_S) and not finished.wait(0.1)
    cameras.allowed.set()
    assert finished.wait(DEADLINE_S)
    thread.join()
    assert len(drawing.take()[0]) == 2, "the images are still to be sent"


def test_an_error_while_drawing_is_raised_where_the_images_are_taken(
    cameras: SlowCameras, drawing: ImageDrawing
) -> None:
    drawing.begin(NOTHING, cast(Renderer, object()), 10.0, 0)
    cameras.allowed.set()
    drawing.finish()
    with pytest.raises(ValueError, match="another renderer"):
        drawing.take()
