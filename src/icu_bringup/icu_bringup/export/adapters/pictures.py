"""Images of a bag as pixels, as files, as videos, and as a strip of thumbnails."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.export.adapters.reading import decoded, image_topics

_ENCODINGS = {
    "mono8": (np.uint8, 1),
    "8UC1": (np.uint8, 1),
    "bgr8": (np.uint8, 3),
    "rgb8": (np.uint8, 3),
    "bgra8": (np.uint8, 4),
    "rgba8": (np.uint8, 4),
    "mono16": (np.uint16, 1),
    "16UC1": (np.uint16, 1),
}
_SWAPPED = {"rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGRA}
_MAGIC = {b"\xff\xd8\xff": "jpg", b"\x89PN": "png"}
STRIP_COLUMNS, THUMBNAIL_PX = 8, 160
Picture = np.ndarray


def pixels(message: Any) -> Picture:
    """Return the pixels of an Image or a CompressedImage: grey (H, W), BGR or BGRA (H, W, C).

    Raises
    ------
    ValueError
        If they cannot be decoded.
    """
    if not hasattr(message, "encoding"):
        data = np.asarray(message.data, np.uint8)
        picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
        if picture is None:
            raise ValueError(f"an image with the format {message.format!r} cannot be decoded")
        return picture
    if message.encoding not in _ENCODINGS:
        raise ValueError(f"encoding {message.encoding!r} is none of {', '.join(_ENCODINGS)}")
    dtype, channels = _ENCODINGS[message.encoding]
    row = message.width * channels * np.dtype(dtype).itemsize
    if message.step < row or len(message.data) != message.height * message.step:
        raise ValueError(f"{len(message.data)} bytes are no {message.width} x {message.height} {message.encoding}")
    rows = np.asarray(message.data, np.uint8).reshape(message.height, message.step)[:, :row]
    ordered = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    picture = np.ascontiguousarray(rows).view(ordered).astype(dtype, copy=False)
    picture = picture if channels == 1 else picture.reshape(message.height, message.width, channels)
    return cv2.cvtColor(picture, _SWAPPED[message.encoding]) if message.encoding in _SWAPPED else picture


def as_file(message: Any) -> tuple[str, bytes]:
    """Return suffix and content of an image file: JPEG and PNG unchanged, others as PNG.

    Raises
    ------
    ValueError
        If the image cannot be decoded.
    """
    if not hasattr(message, "encoding"):
        data = bytes(message.data)
        if data[:3] in _MAGIC:
            return _MAGIC[data[:3]], data
    done, packed = cv2.imencode(".png", pixels(message), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise ValueError("an image cannot be written as PNG")
    return "png", packed.tobytes()


def colour(picture: Picture) -> Picture:
    """Return a picture as 8-bit BGR, 16-bit values scaled to their maximum."""
    if picture.dtype != np.uint8:
        picture = cv2.convertScaleAbs(picture, alpha=255.0 / max(int(picture.max()), 1))
    if picture.ndim == 2:
        return cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    return picture if picture.shape[2] == 3 else cv2.cvtColor(picture, cv2.COLOR_BGRA2BGR)


def folder_name(topic: str) -> str:
    """Return a topic as the name of a file or folder."""
    return topic.strip("/").replace("/", "_")


class _Index:
    """frames.csv of each topic: the message of each frame."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._stream = (folder / "frames.csv").open("w", newline="", encoding="utf-8")
        self._rows = csv.writer(self._stream)
        self._rows.writerow(["frame", "received_ns", "stamp_ns", "file"])
        self.count = 0

    def add(self, received_ns: int, message: Any, file: str) -> None:
        stamp = message.header.stamp
        self._rows.writerow([self.count, received_ns, stamp.sec * 10**9 + stamp.nanosec, file])
        self.count += 1

    def close(self) -> None:
        self._stream.close()


def write_images(bag: BagReader, folder: Path) -> tuple[int, dict[str, list[str]]]:
    """Write each image as a file; return their number, and the reasons for omitted images by topic."""
    indices: dict[str, _Index] = {}
    problems: dict[str, list[str]] = {}
    for topic, received_ns, message in decoded(bag, set(image_topics(bag))):
        place = folder / folder_name(topic)
        try:
            suffix, data = as_file(message)
        except (ValueError, cv2.error) as error:
            problems.setdefault(topic, []).append(str(error))
            continue
        index = indices.get(topic) or indices.setdefault(topic, _Index(place))
        name = f"{index.count:06d}.{suffix}"
        (place / name).write_bytes(data)
        index.add(received_ns, message, name)
    for index in indices.values():
        index.close()
    return sum(index.count for index in indices.values()), problems


def write_videos(bag: BagReader, folder: Path) -> tuple[int, dict[str, list[str]]]:
    """Write an MP4 (MPEG-4 part 2) for each topic, a frame for each message; returns the same as :func:`write_images`.

    The rate follows from the median interval: a video with missing messages is shorter, and frames.csv has the times.
    """
    problems: dict[str, list[str]] = {}
    total = 0
    for topic in image_topics(bag):
        times = np.array([received_ns for _, received_ns, _ in bag.messages([topic])])
        rate = 1e9 / np.median(np.diff(times)) if len(set(times)) > 1 else 1.0
        place = folder / folder_name(topic)
        index, file, size = _Index(place), None, (0, 0)
        for _, received_ns, message in decoded(bag, {topic}):
            try:
                picture = colour(pixels(message))
            except (ValueError, cv2.error) as error:
                problems.setdefault(topic, []).append(str(error))
                continue
            if file is None:
                size = (picture.shape[1], picture.shape[0])
                code = cv2.VideoWriter.fourcc(*"mp4v")
                file = cv2.VideoWriter(str(place / "video.mp4"), code, min(max(float(rate), 0.1), 240.0), size)
                if not file.isOpened():
                    raise BagError("OpenCV on this computer writes no MPEG-4 video; export images instead")
            if (picture.shape[1], picture.shape[0]) != size:
                problems.setdefault(topic, []).append(f"its size is not that of the first, {size[0]} x {size[1]} px")
                continue
            file.write(picture)
            index.add(received_ns, message, "video.mp4")
        index.close()
        if file is not None:
            file.release()
        total += index.count
    return total, problems


def save_strip(
    bag: BagReader, times_ns: Mapping[str, npt.NDArray[np.int64]], topics: Sequence[str], file: Path
) -> None:
    """Save thumbnails over time, a row for each topic, with seconds since the bag's start.

    The first column is the moment at which each of the topics has an image, the last one the end of the bag. A
    thumbnail shows the last image at its time.

    Raises
    ------
    BagError
        If there are no images, or the file cannot be written.
    """
    received = {topic: times for topic in topics if (times := np.sort(np.asarray(times_ns[topic], np.int64))).size}
    if not received:
        raise BagError(f"{bag.path} has no images of a camera (image_raw)")
    first_ns = max(int(times[0]) for times in received.values())
    shown_ns = bag.start_ns + bag.duration_ns - first_ns
    columns = [first_ns + shown_ns * i // (STRIP_COLUMNS - 1) for i in range(STRIP_COLUMNS)]
    rows = []
    for topic, times in received.items():
        at = [int(i) for i in np.searchsorted(times, columns, side="right") - 1]
        found = {i: _thumbnail_at(bag, topic, int(times[i])) for i in sorted({*at})}
        rows.append(np.hstack([_labelled(found[n], (t - bag.start_ns) / 1e9) for n, t in zip(at, columns)]))
    try:
        _, packed = cv2.imencode(file.suffix.lower(), np.vstack(rows))
        file.write_bytes(packed.tobytes())
    except (cv2.error, OSError) as error:
        reason = error.strerror if isinstance(error, OSError) else "its name must end with .png or .jpg"
        raise BagError(f"{file} cannot be written: {reason}") from error


def _thumbnail_at(bag: BagReader, topic: str, received_ns: int) -> Picture:
    """Return a thumbnail of the last image that was received at this time; other images are not read."""
    *_, (_, _, message) = decoded(bag, {topic}, received_ns, received_ns + 1)
    try:
        return _thumbnail(pixels(message))
    except (ValueError, cv2.error) as error:
        raise BagError(f"{topic}: {error}") from error


def _thumbnail(picture: Picture) -> Picture:
    height = max(1, round(picture.shape[0] * THUMBNAIL_PX / picture.shape[1]))
    return cv2.resize(colour(picture), (THUMBNAIL_PX, height), interpolation=cv2.INTER_AREA)


def _labelled(thumbnail: Picture, seconds: float) -> Picture:
    cell = thumbnail.copy()
    cv2.putText(cell, f"{seconds:.1f} s", (3, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 3)
    cv2.putText(cell, f"{seconds:.1f} s", (3, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1)
    return cell
