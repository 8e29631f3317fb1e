"""Effects of an ordinary camera on a rendered image before a program receives it: sensor, mosaic, pixel format.

The simulated bench renders ideal images; these functions are the steps of a UVC camera, each by itself:

- a sensor with one colour per pixel (Bayer, RGGB), shot and read noise, and bilinear demosaicing,
- YUYV (one colour for two neighbours in a row) and NV12 (one colour for 2 x 2 pixels),
- MJPEG of a given quality with 4:2:2 or 4:2:0 colour, as OpenCV's V4L2 backend decodes it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Chain = Callable[[Image, np.random.Generator], Image]

READ_NOISE = 1.5
"""Grey levels."""
SHOT_NOISE = 0.16
"""Times the square root of a pixel's grey level: 2.2 grey levels of all noise at 100, as a small sensor in a room."""


def noisy(image: Image, rng: np.random.Generator, scale: float = 1.0) -> Image:
    """Return an image with a sensor's shot and read noise, every value independent."""
    values = image.astype(np.float32)
    sigma = scale * np.sqrt(READ_NOISE**2 + SHOT_NOISE**2 * values)
    values += sigma * rng.standard_normal(values.shape, dtype=np.float32)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def bayer(image: Image, rng: np.random.Generator, scale: float = 1.0) -> Image:
    """Return (H, W, 3) BGR as a noisy RGGB sensor and bilinear interpolation give it."""
    raw = np.empty(image.shape[:2], np.uint8)
    raw[0::2, 0::2] = image[0::2, 0::2, 2]
    raw[0::2, 1::2] = image[0::2, 1::2, 1]
    raw[1::2, 0::2] = image[1::2, 0::2, 1]
    raw[1::2, 1::2] = image[1::2, 1::2, 0]
    # OpenCV names a pattern by the second row's second and third pixel: RGGB is "BG".
    return np.asarray(cv2.cvtColor(noisy(raw, rng, scale), cv2.COLOR_BayerBG2BGR), np.uint8)


def shared_colour(image: Image, columns: int, rows: int) -> Image:
    """Return an image in which blocks of pixels share one colour, unpacked by repeating it (YUYV, NV12)."""
    parts = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    height, width = image.shape[:2]
    colour = parts[..., 1:].astype(np.float32).reshape(height // rows, rows, width // columns, columns, 2)
    colour = np.rint(colour.mean(axis=(1, 3))).astype(np.uint8)
    parts[..., 1:] = colour.repeat(rows, axis=0).repeat(columns, axis=1)
    return np.asarray(cv2.cvtColor(parts, cv2.COLOR_YCrCb2BGR), np.uint8)


def mjpeg(image: Image, quality: int, sampling: int) -> Image:
    """Return an image as it comes out of a JPEG of this quality and colour sampling."""
    settings = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    good, data = cv2.imencode(".jpg", image, settings)
    assert good
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


_420: Any = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
_422: Any = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422

CHAINS: dict[str, Chain] = {
    "clean": noisy,
    "yuyv": lambda image, rng: shared_colour(noisy(image, rng), 2, 1),
    "nv12": lambda image, rng: shared_colour(noisy(image, rng), 2, 2),
    "bayer": bayer,
    "bayer_yuyv": lambda image, rng: shared_colour(bayer(image, rng), 2, 1),
    "mjpeg422_85": lambda image, rng: mjpeg(noisy(image, rng), 85, _422),
    "mjpeg420_90": lambda image, rng: mjpeg(noisy(image, rng), 90, _420),
    "mjpeg420_80": lambda image, rng: mjpeg(noisy(image, rng), 80, _420),
    "bayer_mjpeg422_85": lambda image, rng: mjpeg(bayer(image, rng), 85, _422),
    "webcam": lambda image, rng: mjpeg(bayer(image, rng), 80, _420),
}
"""The formats by name; ``webcam`` is Bayer, noise, MJPEG of quality 80 and 4:2:0 together."""
