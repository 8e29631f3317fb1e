"""Images and camera models as messages, and back."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import CameraInfo, Image, RegionOfInterest
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.nodes.images import AnyImage
from icu_common.nodes.messages.heads import MAX_NAME

_CHANNELS: dict[str, tuple[Any, int]] = {
    "mono8": (np.uint8, 1),
    "bgr8": (np.uint8, 3),
    "rgb8": (np.uint8, 3),
}


_CHANNELS |= {"bgra8": (np.uint8, 4), "rgba8": (np.uint8, 4)}


_CHANNELS |= {f"bayer_{p}8": (np.uint8, 1) for p in ("rggb", "bggr", "gbrg", "grbg")}


_CHANNELS |= {f"{name[:-1]}16": (np.uint16, count) for name, (_, count) in _CHANNELS.items() if name[-1] == "8"}


_CHANNELS |= {"8UC1": (np.uint8, 1), "16UC1": (np.uint16, 1), "32FC1": (np.float32, 1)}


def _data(values: npt.NDArray[Any]) -> array.array[int]:
    """Return the bytes of a contiguous array in the fastest form for messages; see docs/decisions/transport.md."""
    data = array.array("B")
    data.frombytes(values.data.cast("B") if values.size else b"")
    return data


def image_message(picture: npt.NDArray[Any], encoding: str, head: Header) -> Image:
    """Pack (H, W) or (H, W, C)."""
    contiguous = np.ascontiguousarray(picture, picture.dtype.newbyteorder("<"))
    message = Image(header=head, height=contiguous.shape[0], width=contiguous.shape[1], encoding=encoding)
    message.step = int(np.prod(contiguous.shape[1:])) * contiguous.itemsize  # strides of empty arrays are arbitrary
    message.data = _data(contiguous)
    return message


def image_array(message: AnyImage) -> npt.NDArray[Any]:
    """Return a view on the message's pixels, (H, W) or (H, W, C), without a copy; do not write into it.

    Raises
    ------
    ValueError
        For an unknown encoding, or a size that does not fit the data.
    """
    if message.encoding not in _CHANNELS:
        raise ValueError(f"encoding {plain(message.encoding, 40)!r} is none of {', '.join(_CHANNELS)}")
    dtype, channels = _CHANNELS[message.encoding]
    row = message.width * channels * np.dtype(dtype).itemsize
    if message.step < row or len(message.data) < message.step * message.height:
        raise ValueError(
            f"{message.width} x {message.height} {message.encoding} with step {message.step} does not fit "
            f"{len(message.data)} bytes"
        )
    rows = np.frombuffer(message.data, np.uint8)[: message.step * message.height].reshape(message.height, message.step)
    picture: npt.NDArray[Any] = rows[:, :row].view(np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<"))
    return picture if channels == 1 else picture.reshape(message.height, message.width, channels)


def disparity_message(
    disparity_px: npt.NDArray[np.float32],
    focal_px: float,
    baseline_m: float,
    searched_px: tuple[float, float],
    delta_px: float,
    head: Header,
    first_column: int = 0,
) -> DisparityImage:
    """Pack (H, W) float32 disparities, NaN where unknown, as stereo_image_proc does: unknown is ``min_disparity - 1``.

    Depth is ``focal_px * baseline_m / disparity``. ``searched_px`` are the least and the largest disparity that could
    be found, ``delta_px`` their step; columns left of ``first_column`` are never known.
    """
    height, width = disparity_px.shape
    least, largest = np.float32(searched_px[0]), np.float32(searched_px[1])  # the precision of the message's fields
    message = DisparityImage(header=head, f=float(focal_px), t=float(baseline_m))
    message.min_disparity, message.max_disparity, message.delta_d = float(least), float(largest), float(delta_px)
    known = np.where(np.isnan(disparity_px), least - np.float32(1), disparity_px)
    message.image = image_message(known.astype(np.float32, copy=False), "32FC1", head)
    message.valid_window = RegionOfInterest(x_offset=first_column, width=width - first_column, height=height)
    return message


def camera_info_message(model: CameraModel, head: Header) -> CameraInfo:
    """Pack a camera model."""
    info = CameraInfo(header=head, width=model.width, height=model.height, distortion_model="plumb_bob")
    info.d = [float(x) for x in model.d]
    info.k, info.r, info.p = model.k.ravel(), model.r.ravel(), model.p.ravel()
    return info


def camera_model(info: CameraInfo, name: str = "camera") -> CameraModel:
    """Unpack a camera model of the published images: of the region of interest, after binning.

    Raises
    ------
    ValueError
        If the camera is not calibrated, has a distortion model other than plumb_bob, or a region outside its image.
    """
    if not info.k[0]:
        raise ValueError("the camera is not calibrated (K is 0)")
    if info.distortion_model != "plumb_bob" or len(info.d) != 5:
        model = plain(info.distortion_model, MAX_NAME)
        raise ValueError(f"distortion {model!r} with {len(info.d)} values; expected plumb_bob with 5")
    # The message has the size and matrices of the full image and the region before binning; 0 means the full image.
    roi, binning = info.roi, (max(info.binning_x, 1), max(info.binning_y, 1))
    width, height = roi.width or info.width, roi.height or info.height
    if roi.x_offset + width > info.width or roi.y_offset + height > info.height:
        raise ValueError(
            f"region of interest {width} x {height} at {roi.x_offset}, {roi.y_offset} px leaves the picture of "
            f"{info.width} x {info.height} px"
        )
    # A binned pixel covers several pixels, and pixel centres are at integers in both images.
    scale = np.diag([1 / binning[0], 1 / binning[1], 1.0])
    scale[:2, 2] = [(0.5 - start) / b - 0.5 for start, b in zip((roi.x_offset, roi.y_offset), binning)]
    return CameraModel(
        name=name,
        width=width // binning[0],
        height=height // binning[1],
        k=scale @ np.array(info.k).reshape(3, 3),
        d=np.array(info.d),
        r=np.array(info.r).reshape(3, 3),
        p=scale @ np.array(info.p).reshape(3, 4),
    )


_CAMERA_FIELDS = ("width", "height", "distortion_model", "binning_x", "binning_y", "roi")


def same_camera(known: CameraInfo | None, info: CameraInfo) -> bool:
    """Return whether two messages hold the same calibration; comparing costs less than unpacking each message."""
    return (
        known is not None
        and all(getattr(known, name) == getattr(info, name) for name in _CAMERA_FIELDS)
        and all(np.array_equal(getattr(known, name), getattr(info, name)) for name in "dkrp")
    )
