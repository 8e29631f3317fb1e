"""Values of a decoded message, by path: numbers, rotations, texts, images and point clouds.

Messages are objects of rosbags: dataclasses with ``__msgtype__``. Paths are those of ``ros2 topic echo``, such as
``pose.position.x``; an element of an array of messages has its index, ``markers[3].pose.position.x``, and a
diagnostic_msgs/KeyValue its key, ``status[0].values.error_m``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import cv2
import numpy as np

from icu_common.core.geometry.geometry import Array

STAMP = "header.stamp"
_TYPES = {
    **dict.fromkeys(("int8", "8SC1"), np.int8),
    **dict.fromkeys(("mono16", "16UC1"), np.uint16),
    "16SC1": np.int16,
    "32SC1": np.int32,
    "32FC1": np.float32,
    "64FC1": np.float64,
}
_CHANNELS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "8UC3": 3, "8UC4": 4, "8UC2": 2}
_POINTS = {
    **dict.fromkeys([f"geometry_msgs/msg/{name}" for name in ("Point", "Point32", "Vector3")], "xyz"),
    "std_msgs/msg/ColorRGBA": "rgba",
}
"""Message fields whose array is one value: a marker may have thousands of points."""
_POINT_TYPES = ("", "i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""numpy's name of each datatype of sensor_msgs/PointField."""


class Kind(Enum):
    """Kind of a value, which decides how two are compared."""

    NUMBER = "number"
    ROTATION = "rotation"
    TEXT = "text"
    IMAGE = "image"
    CLOUD = "cloud"


@dataclass(frozen=True, slots=True)
class Value:
    """One value of a message.

    Attributes
    ----------
    kind
        Kind of the value.
    data
        Numbers as (N,) float64; a rotation as (4,) x, y, z, w; an image as (H, W) or (H, W, C); the points of a cloud
        as (N, F) float64; an empty array for a text.
    text
        A text, or the names of a cloud's F fields.
    whole
        True for numbers of an integer type, which no processor rounds.
    """

    kind: Kind
    data: Array
    text: str = ""
    whole: bool = False


PIXELS, METRES = ("u", "v"), ("x", "y", "z")
"""Names of a cloud's coordinates: of points in an image, and in space (REP 118)."""


def coordinates(cloud: Value) -> tuple[str, ...]:
    """Return the names of a cloud's coordinates, those of all its fields if none is known."""
    names = cloud.text.split()
    return next((known for known in (METRES, PIXELS) if set(known) <= set(names)), tuple(names))


def columns(cloud: Value, names: Sequence[str]) -> Array:
    """Return some fields of a cloud, (N, F)."""
    there = cloud.text.split()
    return np.asarray(cloud.data[:, [there.index(name) for name in names]])


def values_of(message: Any) -> dict[str, Value]:
    """Return the values of a message by path, without the stamp of its header."""
    return dict(_walk(message, ""))


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header in ns, 0 without one; a Header is its own."""
    header = message if _type(message) == "std_msgs/msg/Header" else getattr(message, "header", None)
    if header is None or not hasattr(header, "stamp"):
        return 0
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _type(value: Any) -> str:
    return str(getattr(value, "__msgtype__", ""))


def _walk(value: Any, path: str) -> Iterator[tuple[str, Value]]:
    kind = _type(value)
    if kind == "geometry_msgs/msg/Quaternion":
        yield path, Value(Kind.ROTATION, np.array([value.x, value.y, value.z, value.w], np.float64))
    elif kind in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
        if path not in (STAMP, "stamp"):
            yield path, _numbers([value.sec + value.nanosec * 1e-9])
    elif kind in ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"):
        yield _joined(path, "data"), Value(Kind.IMAGE, _pixels(value) if kind.endswith("/Image") else _unpacked(value))
        yield _joined(path, "header.frame_id"), Value(Kind.TEXT, np.zeros(0), value.header.frame_id)
    elif kind == "sensor_msgs/msg/PointCloud2":
        yield _joined(path, "points"), _cloud(value)
        yield _joined(path, "header.frame_id"), Value(Kind.TEXT, np.zeros(0), value.header.frame_id)
    elif kind:
        for field in dataclasses.fields(value):
            if field.name != "__msgtype__" and not field.name.isupper():  # constants of the type
                yield from _walk(getattr(value, field.name), _joined(path, field.name))
    elif isinstance(value, str):
        yield path, _text(value)
    elif isinstance(value, np.ndarray):
        yield path, _numbers(value)
    elif isinstance(value, list | tuple):
        yield from _elements(value, path)
    else:
        yield path, _numbers([value])


def _elements(values: list[Any] | tuple[Any, ...], path: str) -> Iterator[tuple[str, Value]]:
    if values and all(_type(v) == "diagnostic_msgs/msg/KeyValue" for v in values):
        for pair in values:
            yield f"{path}.{pair.key}", _text(pair.value)
    elif values and all(_type(v) in _POINTS for v in values):
        yield path, _numbers([[getattr(v, name) for name in _POINTS[_type(v)]] for v in values])
    elif all(isinstance(v, str) for v in values):
        yield path, Value(Kind.TEXT, np.zeros(0), " ".join(values))
    elif values and not any(_type(v) for v in values):
        yield path, _numbers(values)
    else:
        for number, value in enumerate(values):
            yield from _walk(value, f"{path}[{number}]")


def _joined(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _numbers(values: Any) -> Value:
    given = np.asarray(values)
    return Value(Kind.NUMBER, given.astype(np.float64).ravel(), whole=given.dtype.kind in "biu")


def _text(text: str) -> Value:
    """Return a text value; a text of numbers only, as in diagnostics, becomes these numbers."""
    try:
        numbers = [float(part) for part in text.split()]
    except ValueError:
        numbers = []
    return _numbers(numbers) if numbers else Value(Kind.TEXT, np.zeros(0), text)


def _unpacked(image: Any) -> Array:
    """Return the pixels of a compressed image, none for an empty or broken image."""
    pixels = cv2.imdecode(np.asarray(image.data, np.uint8), cv2.IMREAD_UNCHANGED) if len(image.data) else None
    return np.zeros((0, 0)) if pixels is None else np.asarray(pixels)


def _pixels(image: Any) -> Array:
    channels = _CHANNELS.get(image.encoding, 1)
    kind = np.dtype(_TYPES.get(image.encoding, np.uint8)).newbyteorder(">" if image.is_bigendian else "<")
    rows = np.frombuffer(bytes(image.data), np.uint8).reshape(image.height, image.step)
    pixels = np.ascontiguousarray(rows[:, : image.width * channels * kind.itemsize]).view(kind)
    return pixels.reshape((image.height, image.width, channels) if channels > 1 else (image.height, image.width))


def _cloud(message: Any) -> Value:
    order = ">" if message.is_bigendian else "<"
    kind = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [order + _POINT_TYPES[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    data = bytes(message.data)
    rows = [
        np.frombuffer(data, kind, count=message.width, offset=row * message.row_step) for row in range(message.height)
    ]
    points = np.concatenate(rows) if rows else np.zeros(0, kind)
    columns = [np.asarray(points[name], np.float64) for name in kind.names or ()]
    names = " ".join(kind.names or ())
    return Value(Kind.CLOUD, np.column_stack(columns) if columns else np.zeros((len(points), 0)), names)
