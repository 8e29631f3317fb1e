"""Pictures of differences: images next to each other, and the points of clouds over their source image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from icu_bringup.adapters.bag.bag_pictures import COMPRESSED, IMAGE, PictureCodec
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.core.check.comparison import ComparedMessage, Row, TopicMessages
from icu_bringup.core.check.values import PIXELS, Kind, Value, columns, coordinates, stamp_ns, values_of
from icu_common.core.geometry.geometry import Array

_GREEN, _RED, _WHITE = (90, 220, 90), (60, 60, 255), (235, 235, 235)
_GAIN = 8.0
"""Factor of the differences of two images."""
_SIZE_PX, _EDGE_PX = 900, 40
"""Size and margin of a picture of points that are not in an image."""


def draw(
    rows: Sequence[Row],
    expected: Mapping[str, TopicMessages],
    found: Mapping[str, TopicMessages],
    bag: Path,
    folder: Path,
) -> list[str]:
    """Draw each image and cloud that differs, and return the names of the files in ``folder``."""
    names = []
    for row in (r for r in rows if not r.passed and r.topic in expected and r.topic in found):
        old, new = (_value(all_[row.topic], row) for all_ in (expected, found))
        if old is None or new is None or old.kind is not new.kind:
            continue
        picture = None
        if old.kind is Kind.IMAGE:
            picture = _images(old.data, new.data)
        elif old.kind is Kind.CLOUD and old.text == new.text and len(names_ := coordinates(old)) > 1:
            background = _background(bag, row.topic, row.at) if names_ == PIXELS else None
            picture = _clouds(columns(old, names_[:2]), columns(new, names_[:2]), background)
        if picture is not None:
            names.append(f"{row.topic.strip('/').replace('/', '_')}.{row.field.replace('/', '_')}.png")
            cv2.imwrite(str(folder / names[-1]), picture)
    return names


def _value(topic: TopicMessages, row: Row) -> Value | None:
    message: ComparedMessage | None = next((m for m in topic.messages if m.stamp_ns == row.at), None)
    return message.values.get(row.field) if message is not None else None


def _images(old: Array, new: Array) -> Array | None:
    if old.shape != new.shape:
        return None
    a, b = (np.nan_to_num(image.astype(np.float64), posinf=0.0, neginf=0.0) for image in (old, new))
    scale = 255.0 / max(float(a.max(initial=0.0)), 1e-9) if old.dtype != np.uint8 else 1.0
    parts = [_labelled(scale * a, "expected"), _labelled(scale * b, "found")]
    return np.hstack([*parts, _labelled(_GAIN * scale * np.abs(a - b), f"difference x {_GAIN:g}")])


def _labelled(pixels: Array, label: str) -> Array:
    grey = np.clip(pixels, 0, 255).astype(np.uint8)
    picture = grey[..., :3].copy() if grey.ndim == 3 and grey.shape[2] >= 3 else cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    return _text(picture, label)


def _text(picture: Any, label: str) -> Array:
    cv2.putText(picture, label, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.8, _WHITE, 2, cv2.LINE_AA)
    return np.asarray(picture)


def _clouds(before: Array, after: Array, background: Array | None) -> Array:
    """Draw points over an image, or enlarged where there is none."""
    if background is None:
        both = np.vstack([before, after])
        both = both[np.isfinite(both).all(axis=1)]
        low = both.min(axis=0) if len(both) else np.zeros(2)
        zoom = _SIZE_PX / max(float(np.ptp(both, axis=0).max()) if len(both) else 1.0, 1e-9)
        before, after = ((points - low) * zoom + _EDGE_PX for points in (before, after))
        background = np.full((_SIZE_PX + 2 * _EDGE_PX, _SIZE_PX + 2 * _EDGE_PX, 3), 32, np.uint8)
    picture: Any = background.copy()
    for points, colour, marker in ((before, _GREEN, cv2.MARKER_SQUARE), (after, _RED, cv2.MARKER_CROSS)):
        for x, y in points[np.isfinite(points).all(axis=1)]:
            cv2.drawMarker(picture, (round(x), round(y)), colour, marker, 9, 1, cv2.LINE_AA)
    return _text(picture, f"expected {len(before)} (green squares), found {len(after)} (red crosses)")


def _background(bag: Path, topic: str, at_ns: int) -> Array | None:
    """Return the bag's image of a stamp whose topic has the most of its path in common with ``topic``."""
    place = topic.rpartition("/")[0]
    with BagReader(bag) as reader:
        names = {t.name: t.type for t in reader.topics if t.type in (IMAGE, COMPRESSED) and t.name.startswith(place)}
        for name, _, data in reader.messages(sorted(names)):
            message = reader.decode(data, names[name])
            if stamp_ns(message) != at_ns:
                continue
            if names[name] == COMPRESSED:
                message = reader.decode(PictureCodec().unpack(data), IMAGE)
            pixels = values_of(message)["data"].data
            grey = pixels if pixels.dtype == np.uint8 else np.zeros(pixels.shape, np.uint8)
            dark: Any = (grey if grey.ndim == 3 else cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)) // 2
            return np.asarray(dark, np.uint8)
    return None
