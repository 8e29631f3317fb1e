"""Grey and BGR images from the encodings of sensor_msgs/Image (REP-118 names)."""

from __future__ import annotations

from collections import deque
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

_REMEMBERED = 50
"""Number of last instants whose highest level counts; some seconds at least, longer than a blinking lamp is dark."""

# OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
_BAYER_TO_GRAY = {
    "bayer_rggb8": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr8": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg8": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg8": cv2.COLOR_BayerGB2GRAY,
}
_COLOR_TO_GRAY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
}


def gray_of(picture: npt.NDArray[Any], encoding: str) -> npt.NDArray[Any]:
    """Return the grey image, (H, W) uint8 or uint16; without a copy if it is already grey.

    Parameters
    ----------
    picture
        (H, W) or (H, W, C) as returned by ``icu_common.nodes.messages.cameras.image_array``.
    encoding
        mono8, bgr8, rgb8, bgra8, rgba8 or bayer_*8, or one of these with 16 bits; 8UC1 and 16UC1 are mono.

    Raises
    ------
    ValueError
        For another encoding.
    """
    native = picture.astype(picture.dtype.newbyteorder("="), copy=False)
    if encoding in ("mono8", "mono16", "8UC1", "16UC1"):
        return native
    name = _witheight_bits(encoding)
    code = (_COLOR_TO_GRAY | _BAYER_TO_GRAY).get(name)
    if code is None:
        known = ", ".join(("mono8", *_COLOR_TO_GRAY, *_BAYER_TO_GRAY))
        raise ValueError(f"encoding {encoding!r} is none of {known}, nor one of these with 16 bits")
    if picture.size == 0 or (name in _BAYER_TO_GRAY and min(picture.shape) < 3):
        return np.zeros(picture.shape[:2], native.dtype)
    gray: npt.NDArray[Any] = cv2.cvtColor(np.ascontiguousarray(native), code)
    return gray


_TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
}


def bgr_of(picture: npt.NDArray[Any], encoding: str, levels: GreyLevels | None = None) -> npt.NDArray[np.uint8]:
    """Return the colour image, (H, W, 3) uint8, for the encodings of :func:`gray_of`.

    More than 8 bits are reduced as in :func:`eight_bits`; with ``levels`` the brightness matches that of previous
    images.

    Raises
    ------
    ValueError
        For another encoding.
    """
    if encoding == "bgr8":
        return picture
    if not has_color(encoding):
        gray = gray_of(picture, encoding)
        return bgr_of_gray(eight_bits(gray, None if levels is None else levels.of(gray)))
    native = np.ascontiguousarray(picture, picture.dtype.newbyteorder("="))
    if native.size == 0:
        return np.zeros((*picture.shape[:2], 3), np.uint8)
    name = _witheight_bits(encoding)
    color = native if name == "bgr8" else cv2.cvtColor(native, _TO_BGR[name])
    return eight_bits(color, None if levels is None else levels.of(color))


def has_color(encoding: str) -> bool:
    """Return whether images of an encoding that :func:`bgr_of` accepts have colour."""
    name = _witheight_bits(encoding)
    return name == "bgr8" or name in _TO_BGR


def _witheight_bits(encoding: str) -> str:
    return encoding.removesuffix("16") + "8" if encoding.endswith("16") else encoding


def eight_bits(picture: npt.NDArray[Any], level: float | None = None) -> npt.NDArray[np.uint8]:
    """Return the upper 8 of the bits that a camera uses; for floats the largest value becomes 255, not finite ones 0.

    The number of bits that a camera uses of 16 is unknown: the smallest of 8, 10, 12, 14 and 16 that holds the image's
    largest value is assumed. A glint or a hot pixel therefore does not darken the rest, as long as the brightest
    position has a quarter of full light. A darker scene becomes brighter by its unused bits. For images that are
    compared, pass one ``level`` of :class:`GreyLevels`.
    """
    if picture.dtype == np.uint8:
        return picture
    finite = np.nan_to_num(picture.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    level = grey_level_of(picture) if level is None else level
    return np.asarray(np.clip(finite / np.float32(level), 0.0, 255.0), np.uint8)


def bgr_of_gray(gray: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return (H, W, 3) uint8 of :func:`eight_bits`, to draw on."""
    return np.repeat(eight_bits(gray)[:, :, None], 3, axis=2)


def grey_level_of(gray: npt.NDArray[Any]) -> float:
    """Return the size of one grey level of :func:`eight_bits` in the values of an image."""
    if gray.dtype == np.uint8:
        return 1.0
    if gray.dtype.kind == "u":
        largest = int(gray.max(initial=0))
        return next(2.0 ** (bits - 8) for bits in (8, 10, 12, 14, 16) if largest < 2**bits)
    top = float(np.max(gray, where=np.isfinite(gray), initial=0.0))
    return top / 255.0 if top > 0.0 else 1.0


class GreyLevels:
    """Size of one grey level in images that are compared: images of one camera, or both images of a pair.

    Levels of single images may differ by a factor of four. The largest value may be just below a power of two in one
    image, and just above in the next. The value of a single instant is used only for that instant, as an image may be
    corrupt.
    """

    def __init__(self) -> None:
        self._levels: deque[float] = deque(maxlen=_REMEMBERED)

    def of(self, *pictures: npt.NDArray[Any]) -> float:
        """Return the level for images of one instant, from these images and from any two of the last instants."""
        own = max(grey_level_of(picture) for picture in pictures)
        self._levels.append(own)
        return max([own, *sorted(self._levels)[-2:-1]])
