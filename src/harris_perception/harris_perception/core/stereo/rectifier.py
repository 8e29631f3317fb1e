"""Rectification of raw grey images."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.camera_model import CameraModel

Gray = npt.NDArray[np.uint8]


class Rectifier:
    """Rectifies raw grey images, with cached maps of the pixels.

    Parameters
    ----------
    model
        The camera.
    size
        (width, height) of the rectified images; a pair uses the left camera's for both. None: size of the raw images.
    """

    def __init__(self, model: CameraModel, size: tuple[int, int] | None = None) -> None:
        self._model = model
        self._maps = model.rectification_maps(size)

    def __call__(self, gray: Gray) -> Gray:
        """Rectify (H, W) uint8 into an image of ``size``.

        Raises
        ------
        ValueError
            If the image's size is not the calibrated one, or it is not 8 bits deep.
        """
        if gray.shape != (self._model.height, self._model.width) or gray.dtype != np.uint8:
            calibrated = self._model.height, self._model.width
            raise ValueError(f"picture {gray.shape} {gray.dtype}: {calibrated} uint8 is calibrated")
        # Linear interpolation would blur each line depending on its subpixel position: docs/decisions/stereo.md.
        return np.asarray(cv2.remap(gray, self._maps[0], self._maps[1], cv2.INTER_CUBIC), np.uint8)
