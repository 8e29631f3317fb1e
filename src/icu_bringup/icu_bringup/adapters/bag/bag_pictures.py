"""Images of a recording as JPEG or PNG, in the form of image_transport: CompressedImage on topic/compressed."""

from __future__ import annotations

import sys
from typing import Any

import cv2
import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from icu_bringup.adapters.bag.definitions import decode

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
SUFFIX, BESIDE = "/compressed", "/bag_record"
"""Suffixes of recorded image topics: topic/compressed, or topic/bag_record/compressed if another program has that."""
_ENCODINGS = {
    ("uint8", 1): "mono8",
    ("uint8", 3): "bgr8",
    ("uint8", 4): "bgra8",
    ("uint16", 1): "mono16",
    ("uint16", 3): "bgr16",
    ("uint16", 4): "bgra16",
}
_CHANNELS = {"bgr8": 3, "rgb8": 3, "mono8": 1}


class PictureCodec:
    """Packs and unpacks images as CDR bytes.

    Parameters
    ----------
    form
        ``jpeg`` or ``png``.
    quality
        JPEG quality, 1 to 100.
    """

    def __init__(self, form: str = "jpeg", quality: int = 85) -> None:
        if form not in ("jpeg", "png"):
            raise ValueError(f"form {form!r} is none of jpeg, png")
        if not 1 <= quality <= 100:
            raise ValueError(f"quality = {quality}: 1 to 100 is possible")
        self._types, self._form = get_typestore(Stores.ROS2_JAZZY), form
        self._options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1] if form == "jpeg" else []

    def pack(self, data: bytes) -> bytes:
        """Return the CompressedImage of an Image, with its header.

        Raises
        ------
        ValueError
            For encodings other than bgr8, rgb8 and mono8, and for images that OpenCV cannot compress.
        """
        image: Any = decode(self._types, data, IMAGE)
        if image.encoding not in _CHANNELS:
            raise ValueError(f"pictures in {image.encoding!r} cannot be compressed, only {', '.join(_CHANNELS)}")
        rows = np.asarray(image.data, np.uint8).reshape(image.height, image.step)
        pixels = rows[:, : image.width * _CHANNELS[image.encoding]].reshape(image.height, image.width, -1)
        if image.encoding == "rgb8":
            pixels = pixels[:, :, ::-1]
        try:
            done, packed = cv2.imencode("." + self._form, np.ascontiguousarray(pixels), self._options)
        except cv2.error:  # an image without pixels
            done = False
        if not done:
            raise ValueError(f"a picture of {image.width} x {image.height} px cannot be compressed as {self._form}")
        name = f"{image.encoding}; {self._form} compressed {'bgr8' if image.encoding != 'mono8' else ''}".rstrip()
        message = self._types.types[COMPRESSED](header=image.header, format=name, data=packed.ravel())
        return bytes(self._types.serialize_cdr(message, COMPRESSED))

    def unpack(self, data: bytes) -> bytes:
        """Return the Image of a CompressedImage, with its header: grey, BGR or BGRA, of 8 or 16 bits as packed.

        Raises
        ------
        ValueError
            If the image cannot be decoded.
        """
        try:
            message: Any = decode(self._types, data, COMPRESSED)
        except SerdeError as error:
            raise ValueError(f"not a {COMPRESSED}: {error}") from error
        packed = np.asarray(message.data, np.uint8)
        pixels = cv2.imdecode(packed, cv2.IMREAD_UNCHANGED) if packed.size else None
        if pixels is None:
            raise ValueError(f"a picture with the format {message.format!r} cannot be decoded")
        height, width, channels = np.atleast_3d(pixels).shape
        encoding = _ENCODINGS.get((pixels.dtype.name, channels))
        if encoding is None:
            raise ValueError(
                f"a picture of {channels} x {pixels.dtype} with the format {message.format!r} is not known"
            )
        if encoding == "mono16" and message.format.startswith("16UC1"):
            encoding = "16UC1"  # depths, which must not be shown as brightness
        image = self._types.types[IMAGE](
            header=message.header,
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=int(sys.byteorder == "big"),
            step=width * channels * pixels.itemsize,
            data=np.ascontiguousarray(pixels).reshape(-1).view(np.uint8),
        )
        return bytes(self._types.serialize_cdr(image, IMAGE))
