"""Types and errors that all sources of camera images share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]
Clock = Callable[[], int]

SIDES = ("left", "right")


class SourceError(Exception):
    """The source cannot be opened or no longer delivers images; reopening it may help."""


class SourceEnded(Exception):
    """A recording that is not looped has ended."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frames:
    """Images of one instant, left first, each (H, W, 3) BGR or (H, W) grey, and the time each was taken.

    ``cameras`` has the index of each image's camera (0 is the left one); empty: all cameras in order.
    """

    pictures: tuple[Picture, ...]
    stamps_ns: tuple[int, ...]
    cameras: tuple[int, ...] = ()


class CameraSource(Protocol):
    """An open source of images."""

    def read(self, timeout_s: float) -> Frames:
        """Return the next images.

        Raises
        ------
        TimeoutError
            If no image arrived in time; the next call may succeed.
        SourceError
            If the source is broken and must be closed.
        SourceEnded
            If the recording has ended.
        """

    def close(self) -> None: ...
